"""What differs in held-out recordings is named where a few numbers explain their error: a load, or friction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import Log, log, read

from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.identified_models.identify_from_recordings import identify
from dynident.identification.identified_models.other_conditions import describe_temperatures


def describe(folder: Path, fit: Log, held: Log) -> str:
    recordings = []
    for name, given in (("fit", fit), ("held", held)):
        (folder / name).mkdir()
        recordings.append(read(given.robot, folder / name, given.columns()).recording)
    result = identify(fit.robot, recordings[:1], recordings[1:], IdentificationChoices())
    return next((warning for warning in result.warnings if "error on validation data" in warning), "")


@pytest.mark.parametrize(("name", "seed", "share"), [("ur10", 1, 0.5), ("ur5", 4, 1.0)])
def test_other_friction_in_the_held_out_run_is_named_with_its_size(
    tmp_path: Path, name: str, seed: int, share: float
) -> None:
    """The drives were cold in the fit and warm in the test: all of the error is friction."""
    fit, held = log(name, seed), log(name, seed + 10)
    velocity = np.gradient(fit.q, fit.t, axis=0)
    damping = share * np.std(fit.tau, axis=0) / np.std(velocity, axis=0)
    told = describe(tmp_path, replace(fit, tau=fit.tau + damping * velocity), held)
    assert "only friction differs in the validation recording" in told
    assert "viscous friction by -" in told


def test_other_friction_of_single_joints_is_named_with_them(tmp_path: Path) -> None:
    fit, held = log("ur10", 1), log("ur10", 11)
    more = np.zeros(held.robot.n)
    more[2] = 0.3 * np.std(held.tau[:, 2])
    told = describe(tmp_path, fit, replace(held, tau=held.tau + more * np.gradient(held.q, held.t, axis=0)))
    assert f"viscous friction of {held.robot.joint_names[2]} by +" in told
    assert "the median" not in told


def test_the_same_friction_with_another_model_error_is_not_called_other_friction(tmp_path: Path) -> None:
    fit, held = log("ur10", 1), log("ur10", 11)
    spring = held.tau + 0.5 * np.std(held.tau, axis=0) * np.sin(3.0 * held.q)
    assert "friction differs" not in describe(tmp_path, fit, replace(held, tau=spring))


def test_temperatures_outside_those_of_the_fit_are_told(tmp_path: Path) -> None:
    given = log("ur10", 1)
    recordings = []
    for name, warm in (("cold", 22.0), ("warm", 47.0)):
        (tmp_path / name).mkdir()
        columns = given.columns() | {f"temperature{k + 1}": np.full(len(given.t), warm + 0.3 * k) for k in range(6)}
        recordings.append(read(given.robot, tmp_path / name, columns).recording)
    (told,) = describe_temperatures(recordings[:1], recordings[1:])
    assert "47 to 48 degC in the validation data and 22 to 24 in" in told
    assert describe_temperatures(recordings[:1], recordings[:1]) == ()
