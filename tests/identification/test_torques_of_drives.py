"""What drives and controllers do to torques before they are logged is told by its name, with a way on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import Log, log, read

from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices, identify

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))


def identify_log(given: Log, tau: np.ndarray, folder: Path) -> Identification:
    found = read(given.robot, folder, given.columns(tau=tau))
    return identify(given.robot, [found.recording], [], IdentificationChoices(EFFECTS))


@pytest.mark.parametrize(("name", "seed"), [("ur10", 1), ("franka_panda", 2)])
def test_torques_without_friction_are_told_as_those_of_a_compensating_controller(
    name: str, seed: int, tmp_path: Path
) -> None:
    given = log(name, seed)
    dq = np.gradient(given.q, given.t, axis=0)
    friction = 0.1 * np.abs(given.tau).max(axis=0) * (np.tanh(dq / 0.01) + dq / np.abs(dq).max(axis=0))
    told = [w for w in identify_log(given, given.tau - 1.3 * friction, tmp_path).warnings if "negative" in w]
    assert len(told) == 1
    assert "compensation of friction" in told[0]


def test_negative_friction_of_one_joint_is_that_of_a_wrong_column(tmp_path: Path) -> None:
    given = log("ur10", 1)
    dq = np.gradient(given.q[:, 2], given.t)
    tau = given.tau.copy()
    tau[:, 2] -= 0.3 * np.abs(tau[:, 2]).max() * np.tanh(dq / 0.01)
    told = [w for w in identify_log(given, tau, tmp_path).warnings if "is negative" in w]
    assert any("Fc3 on elbow_joint" in w and "check the sign of its torque" in w for w in told)


@pytest.mark.parametrize("share", [0.6, 0.3])
def test_coarse_torques_are_named_with_their_steps(share: float, tmp_path: Path) -> None:
    given = log("ur10", 4)
    tau, rms = given.tau.copy(), np.sqrt(np.mean(given.tau**2, axis=0))
    step = share * rms[4]
    tau[:, 4] = np.round(tau[:, 4] / step) * step
    (check,) = [one for one in read(given.robot, tmp_path, given.columns(tau=tau)).checks if "resolution" in one.name]
    assert check.status == "warning"
    assert f"tau5 (steps of {step:.3g}, rounding {100 * share / np.sqrt(12):.0f}" in check.detail
    assert "tau4" not in check.detail


@pytest.mark.parametrize("digits", [0.01, 0.1])
def test_torques_with_enough_steps_are_not_called_coarse(digits: float, tmp_path: Path) -> None:
    given = log("ur10", 4)
    step = digits * np.sqrt(np.mean(given.tau**2, axis=0))
    fine = replace(given, tau=np.round(given.tau / step) * step)
    checks = read(given.robot, tmp_path, fine.columns()).checks
    assert [one.status for one in checks if one.name == "torque_resolution"] == ["ok"]
