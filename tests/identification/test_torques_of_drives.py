"""What drives and controllers do to torques before they are logged is told by its name, with a way on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import Log, log, read
from support.oracles import pinocchio_torque

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


@pytest.mark.parametrize("name", ["ur10", "scara"])
@pytest.mark.parametrize("n_right", [0, 1])
def test_friction_that_is_negative_since_torques_are_turned_is_no_compensation(
    name: str, n_right: int, tmp_path: Path
) -> None:
    """The masses are turned with it."""
    given = log(name, 2)
    signs = np.where(np.arange(given.robot.n) < given.robot.n - n_right, -1.0, 1.0)
    warnings = identify_log(given, given.tau * signs, tmp_path).warnings
    assert not any("compensation of friction" in w for w in warnings)
    assert any("check the sign of its torque" in w for w in warnings)


def test_positions_that_are_turned_are_no_compensation_of_friction(tmp_path: Path) -> None:
    given = log("scara", 2)
    warnings = identify_log(replace(given, q=-given.q), given.tau, tmp_path).warnings
    assert not any("compensation of friction" in w for w in warnings)


@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("seed", [2, 33])
def test_torques_that_lead_are_no_compensation_of_friction(rows: int, seed: int, tmp_path: Path) -> None:
    """Of sensors behind the gears, which feel no friction: the lead takes damping alone."""
    given = log("scara", seed)
    dq = np.gradient(given.q, given.t, axis=0)
    tau = pinocchio_torque(given.robot, given.q, dq, np.gradient(dq, given.t, axis=0))
    tau += 0.005 * np.abs(tau).max(axis=0) * np.random.default_rng(seed).normal(size=tau.shape)
    warnings = identify_log(given, np.concatenate([tau[rows:], tau[-rows:]]), tmp_path).warnings
    assert not any("compensation of friction" in w for w in warnings)


def test_negative_friction_of_one_joint_is_that_of_a_wrong_column(tmp_path: Path) -> None:
    given = log("ur10", 1)
    dq = np.gradient(given.q[:, 2], given.t)
    tau = given.tau.copy()
    tau[:, 2] -= 0.3 * np.abs(tau[:, 2]).max() * np.tanh(dq / 0.01)
    told = [w for w in identify_log(given, tau, tmp_path).warnings if "is negative" in w]
    assert any("Fc3 on elbow_joint" in w and "check the sign of its torque" in w for w in told)


@pytest.mark.parametrize("share", [0.6, 0.3])
@pytest.mark.parametrize(("name", "joint", "unit"), [("ur10", 4, "N m"), ("scara", 2, "N")])
def test_coarse_torques_are_named_with_their_steps(
    name: str, joint: int, unit: str, share: float, tmp_path: Path
) -> None:
    given = log(name, 4)
    tau = given.tau - given.tau.mean(axis=0)
    step = share * tau[:, joint].std()
    tau[:, joint] = np.round(tau[:, joint] / step) * step
    (check,) = [one for one in read(given.robot, tmp_path, given.columns(tau=tau)).checks if "resolution" in one.name]
    assert check.status == "warning"
    lost = step / np.sqrt(12.0) / np.sqrt(np.mean(tau[:, joint] ** 2))
    assert f"tau{joint + 1} (steps of {step:.3g} {unit}, rounding {100 * lost:.0f}" in check.detail
    assert check.detail.count("steps of") == 1


@pytest.mark.parametrize("digits", [0.01, 0.1])
def test_torques_with_enough_steps_are_not_called_coarse(digits: float, tmp_path: Path) -> None:
    given = log("ur10", 4)
    step = digits * np.sqrt(np.mean(given.tau**2, axis=0))
    fine = replace(given, tau=np.round(given.tau / step) * step)
    checks = read(given.robot, tmp_path, fine.columns()).checks
    assert [one.status for one in checks if one.name == "torque_resolution"] == ["ok"]
