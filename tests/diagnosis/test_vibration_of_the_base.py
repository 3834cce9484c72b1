"""A base that shakes: found in what all joints feel of it, however weak, and also where a joint stands all the time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.further_hidden_effects import FREQUENCY, in_gravity
from support.further_hidden_effects import shaking as shaken
from support.hidden_effects import BAND, ROBOT, WITH_OFFSET, nothing, recorded
from support.oracles import FloatArray, Motion, fourier_motion

from dynident.diagnosis import Comparison, compare
from dynident.diagnosis.residuals.spectral_peaks import find_base_vibration, find_motion_lines
from dynident.identification import Identification, IdentificationChoices, identify

HIGHEST = 11.0


def trembling(motion: Motion, load: FloatArray) -> FloatArray:
    """0.03 m/s² to one side: less torque than the noise of most joints."""
    pushed = in_gravity(motion, ROBOT.gravity + np.array([0.0, 0.03, 0.0])) - load
    return pushed * np.sin(2 * np.pi * FREQUENCY * motion.t + 0.5)[:, None]


def frequencies(model: Identification, compared: Comparison) -> list[float]:
    lines = find_motion_lines([compared], HIGHEST)
    return find_base_vibration([compared], model.model.signals, model.estimate.next_reference(), HIGHEST, lines)


@pytest.fixture(scope="module")
def motion() -> Motion:
    return fourier_motion(ROBOT, 30.0, 200.0, 5)


def test_a_base_that_hardly_shakes_is_found_by_what_all_joints_feel_of_it(motion: Motion) -> None:
    run = recorded(motion, trembling, 1, "trembling")
    model = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    (found,) = frequencies(model, compare(model, run))
    assert found == pytest.approx(FREQUENCY, abs=0.02)


def test_a_base_at_rest_has_no_frequency(motion: Motion) -> None:
    for seed in (1, 2, 3):
        run = recorded(motion, nothing, seed, "still")
        model = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
        assert frequencies(model, compare(model, run)) == []


def test_a_joint_without_any_residual_does_not_end_the_search_for_a_vibration(motion: Motion) -> None:
    run = recorded(motion, nothing, 1, "all joints")
    model = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    one = np.eye(6)[1]
    sweep = replace(motion, q=motion.q * one + 0.3 * (1.0 - one), dq=motion.dq * one, ddq=motion.ddq * one)
    compared = compare(model, recorded(sweep, shaken, 2, "one joint"))
    assert (compared.errors.rms == 0.0).any()
    (found,) = frequencies(model, compared)
    assert found == pytest.approx(FREQUENCY, abs=0.02)
