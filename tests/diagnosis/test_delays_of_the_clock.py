"""A delay of the torque within a sampling step is the log's: it is told and modelled, but named only where longer."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from support.hidden_effects import NOISE, ROBOT, WITH_OFFSET, drives
from support.oracles import FloatArray, fourier_motion, pinocchio_torque

from dynident.diagnosis import Diagnosis, diagnose
from dynident.diagnosis.search.identifiability_and_invisible_effects import find_clock_delays
from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Preprocessing, Recording, recording_from_arrays
from dynident.regressors.model_structure import build_model

FAST, RATE = 1000, 40
EVERY = FAST // RATE
BAND = Preprocessing(6.0, 6.0, 1)


def log(seconds: float, seed: int, late: float, averaged: bool) -> Recording:
    """A log at 40 Hz of torque that is late by some seconds, or averaged over the last sampling step."""
    motion = fourier_motion(ROBOT, seconds, FAST, seed)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + drives(motion)
    if averaged:
        tau = uniform_filter1d(tau, EVERY, axis=0, origin=EVERY // 2)
    tau = np.column_stack([np.interp(motion.t - late, motion.t, own) for own in tau.T])[::EVERY]
    tau = tau + NOISE * np.random.default_rng(seed).normal(size=tau.shape)
    counts = 2.0 * np.pi / 2**16
    q = np.round(motion.q[::EVERY] / counts) * counts
    return recording_from_arrays(motion.t[::EVERY], q, tau, joint_names=ROBOT.joint_names, name=f"log {seed}")


@cache
def find(late: float, averaged: bool = False, seed: int = 5) -> tuple[Diagnosis, FloatArray]:
    training, other = log(40.0, seed, late, averaged), log(20.0, seed + 100, late, averaged)
    model = identify(ROBOT, [training], [other], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(model, [training])
    return found, found.residual_rms


@pytest.mark.parametrize(
    ("late", "averaged", "shown"), [(0.3 / RATE, False, 0.3 / RATE), (0.0, True, 0.5 / RATE)], ids=["late", "averaged"]
)
def test_a_delay_within_a_sampling_step_is_told_and_no_missing_effect(late, averaged, shown):
    found, residual = find(late, averaged)
    assert found.recommended == ()
    assert found.verdict != "missing_effect"
    (outcome,) = (outcome for outcome in found.outcomes if outcome.choice.effect == "torque_delay")
    assert outcome.reason.code == "within_sampling"
    values = dict(outcome.reason.values)
    assert values["delay"] == pytest.approx(shown, rel=0.15)
    assert values["sampling_step"] == pytest.approx(1.0 / RATE)
    assert outcome.reason.text in found.summary
    assert '"torque_delay"' in outcome.reason.text
    (row,) = (row for row in found.candidates if row.effect == "torque_delay")
    assert (row.significant, row.reason) == (False, outcome.reason)
    # It is in the model beside which the rest is judged: no more than noise is left.
    assert np.all(residual < 1.2 * found.noise_floor)


def test_a_longer_delay_is_named_at_the_same_rate():
    found, residual = find(1.2 / RATE)
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("torque_delay", ())]
    assert "within_sampling" not in {outcome.reason.code for outcome in found.outcomes}
    assert np.all(residual < 1.2 * found.noise_floor)


@pytest.mark.parametrize(
    ("delay", "deviation", "periods", "explained"),
    [
        (3e-3, 1e-5, (10e-3,), True),
        (8e-3, 2e-3, (10e-3,), True),
        (8e-3, 1e-5, (10e-3,), False),
        (30e-3, 13.5e-3, (10e-3,), False),
        (-30e-3, 13.5e-3, (10e-3,), False),
        (4e-4, 1e-5, (1e-3, 10e-3), True),
        (4e-3, 1e-5, (1e-3, 10e-3), False),
    ],
)
def test_the_clock_explains_delays_within_a_step_of_the_fastest_log(delay, deviation, periods, explained):
    choice = EffectChoice("torque_delay")
    model = build_model(ROBOT, (*WITH_OFFSET, choice))
    grown = SimpleNamespace(
        model=model,
        parameters=[SimpleNamespace(value=delay, standard_deviation=deviation)] * model.n_parameters,
    )
    recordings = [SimpleNamespace(period=period) for period in periods]
    delays = find_clock_delays(grown, [None], [choice], recordings, ())
    assert bool(delays) == explained
    assert all(dict(clock.reason.values)["sampling_step"] == min(periods) for clock in delays)
