"""A residual that no effect explains is told by its cause: a sensor that drifts, a drive that is coupled."""

from __future__ import annotations

import numpy as np
import pytest
from support.further_hidden_effects import saturated, scaled, tied
from support.hidden_effects import EFFORT, NAMES, Hidden, coupled, drives, experiment, nothing
from support.oracles import FloatArray, Motion

from dynident.diagnosis import UnknownPattern, diagnose
from dynident.diagnosis.comparison.measured_against_predicted import compare
from dynident.diagnosis.conclusion import conclude
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import find_unknown_patterns

COUPLING, DRIFT = -0.35, 0.08


def couple_wrist(motion: Motion, load: FloatArray) -> FloatArray:
    """The motor of the last joint turns with the one before it, whose torque it takes a share of."""
    tau = np.zeros_like(load)
    tau[:, 4] = COUPLING * (load + drives(motion))[:, 5]
    return tau


def warm_up(motion: Motion, load: FloatArray) -> FloatArray:
    """The sensor of one joint drifts after it was switched on."""
    tau = np.zeros_like(load)
    tau[:, 1] = DRIFT * EFFORT[1] * (1.0 - np.exp(-2.5 * motion.t / motion.t[-1]))
    return tau


@pytest.mark.parametrize("seed", [0, 2])
def test_a_coupled_wrist_is_told_with_its_share(seed: int) -> None:
    run = experiment(couple_wrist, seed=seed)
    (cause,) = {p.cause for p in find_unknown_patterns([compare(run.identification, run.training)]) if p.cause}
    assert cause.startswith(f"The torque of {NAMES[4]} probably contains about -0.3")
    assert f'"{NAMES[5]}": {{"coupling": {{"{NAMES[4]}": 0.3' in cause


@pytest.mark.parametrize("seed", [0, 2])
def test_a_sensor_that_drifts_is_told_with_its_drift(seed: int) -> None:
    run = experiment(warm_up, seed=seed)
    (cause,) = {p.cause for p in find_unknown_patterns([compare(run.identification, run.training)]) if p.cause}
    assert cause.startswith(f"The offset of the torque of {NAMES[1]} drifts by about")
    drift = float(cause.partition("about ")[2].split()[0])
    assert drift == pytest.approx(DRIFT * EFFORT[1] * (1.0 - np.exp(-2.5)), rel=0.25)


@pytest.mark.slow
def test_the_summary_and_the_next_step_say_the_cause() -> None:
    run = experiment(warm_up)
    diagnosis = diagnose(run.identification, [run.training], validation=[run.validation])
    assert f"The offset of the torque of {NAMES[1]} drifts" in diagnosis.summary


def test_the_next_step_is_that_of_the_cause() -> None:
    pattern = UnknownPattern("elbow_joint", "time", 0.9, "The offset drifts. Warm it up.")
    conclusion = conclude("unexplained", [pattern], None, (1.0, 1.0), NAMES, is_given_up=False)
    assert (conclusion.next_step, conclusion.next_action) == ("The offset drifts. Warm it up.", None)


@pytest.mark.parametrize("seed", [0, 2, 5])
@pytest.mark.parametrize("hidden", [nothing, scaled, saturated, tied, coupled])
def test_what_no_other_drive_explains_has_no_cause(hidden: Hidden, seed: int) -> None:
    """Noise, wrong gains, a cable, and friction that two joints share: what a free load explains is no drive's."""
    run = experiment(hidden, seed=seed)
    assert not any(p.cause for p in find_unknown_patterns([compare(run.identification, run.training)]))
