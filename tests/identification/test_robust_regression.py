"""Robust regression: what contacts and glitches do to least squares they do not do to it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation.least_squares import floor_noise
from dynident.estimation.row_weights import BISQUARE, HUBER, estimate_robust_scale
from dynident.identification import Identification, IdentificationChoices, from_bytes, identify, to_bytes
from dynident.recordings import Preprocessing
from dynident.regressors import row_cache as rows_module

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
CHOICES = IdentificationChoices(EFFECTS, estimator="irls", preprocessing=Preprocessing(15.0, 15.0, 5))
FC, FV = 2.0, 1.5
JOINTS = slice(0, 3)


def recording(disturbed: bool, seed: int = 0):
    """Twenty seconds of a UR10; disturbed: two pushes, a hundredth of the samples, against the first joints."""
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 200.0, seed=2)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + FC * np.sign(motion.dq) + FV * motion.dq
    tau = tau + 0.5 * np.random.default_rng(seed).normal(size=tau.shape)
    if disturbed:
        for start in (1000, 2600):
            tau[start : start + 20, JOINTS] += 150.0
    return record(robot, motion, tau)


@cache
def identified(estimator: str, disturbed: bool, seed: int = 0) -> Identification:
    return identify(arm("ur10"), [recording(disturbed, seed)], choices=replace(CHOICES, estimator=estimator))


def truth(found: Identification) -> np.ndarray:
    robot = arm("ur10")
    return found.model.base.grouping @ np.concatenate(
        [robot.inertias.reshape(-1), np.full(robot.n, FC), np.full(robot.n, FV)]
    )


def off(found: Identification) -> np.ndarray:
    """By how many of an undisturbed fit's standard deviations each parameter is off."""
    calm = identified("wls", False)
    return np.abs(found.values - truth(found)) / calm.statistics.standard_deviations


def test_pushes_that_mislead_least_squares_leave_the_robust_estimate_where_it_was():
    robust, plain = off(identified("irls", True)), off(identified("wls", True))
    assert plain.max() > 10
    assert np.mean(plain) > 3 * np.mean(robust)
    # Its own intervals hold the truth.
    found = identified("irls", True)
    inside = np.abs(found.values - truth(found)) < 2.0 * found.statistics.standard_deviations
    assert inside.mean() > 0.9


def test_rows_without_weight_are_no_noise_also_after_reading_the_file():
    calm, pushed = identified("irls", False), identified("irls", True)
    np.testing.assert_allclose(pushed.noise, calm.noise, rtol=0.1)
    assert np.all(identified("wls", True).noise[JOINTS] > 5 * pushed.noise[JOINTS])
    np.testing.assert_array_equal(from_bytes(to_bytes(pushed)).noise, pushed.noise)


def test_the_pushes_are_named_with_joint_and_time():
    warning = next(text for text in identified("irls", True).warnings if "have no weight" in text)
    for joint in arm("ur10").joint_names[JOINTS]:
        assert joint in warning
    assert "wrist_3_joint" not in warning
    assert "4.9 to 5.2 s of run" in warning or "5.0 to 5.1 s of run" in warning or "4.9 to 5.1 s of run" in warning
    assert not any("have no weight" in text for text in identified("irls", False).warnings)


def test_without_outliers_it_loses_little_against_least_squares():
    robust, plain = identified("irls", False), identified("wls", False)
    ratio = robust.statistics.standard_deviations / plain.statistics.standard_deviations
    assert 0.85 < np.median(ratio) < 1.3
    gap = np.abs(robust.values - plain.values) / plain.statistics.standard_deviations
    assert gap.max() < 1.5


def test_rows_that_are_not_kept_in_memory_give_the_same(monkeypatch):
    kept = identified("irls", True)
    monkeypatch.setattr(rows_module, "MOST_VALUES", 100)
    streamed = identify(arm("ur10"), [recording(True)], choices=CHOICES)
    assert streamed.in_memory.training is None
    np.testing.assert_allclose(streamed.values, kept.values, rtol=1e-9, atol=1e-12)


def test_it_is_the_robust_regression_of_statsmodels_on_one_joint():
    """Bisquare from Huber's solution on the rows of the last joint, where only its own equation decides."""
    robot = arm("ur10")
    choices = replace(CHOICES, effects=tuple(replace(e, joints=("wrist_3_joint",)) for e in EFFECTS[1:]))
    # No residual scale may differ: statsmodels takes the median about the median, as here where there is no offset.
    found = identify(robot, [only_friction()], choices=choices)
    samples = [s for part in found.in_memory.training.samples for s in part]
    w = np.concatenate([s.values for s in samples])
    y = np.concatenate([s.tau[:, 5] for s in samples])
    huber = sm.RLM(y, w, M=sm.robust.norms.HuberT()).fit(scale_est=sm.robust.scale.mad, tol=1e-10)
    assert np.abs(huber.params - [FC, FV]).max() < 0.2
    bisquare = sm.RLM(y, w, M=sm.robust.norms.TukeyBiweight())
    theirs = bisquare.fit(start_params=huber.params, tol=1e-10, maxiter=200)
    np.testing.assert_allclose(found.values, theirs.params, atol=0.1 * theirs.bse.min())


def only_friction():
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 200.0, seed=2)
    tau = np.zeros_like(motion.q)
    tau[:, 5] = FC * np.sign(motion.dq[:, 5]) + FV * motion.dq[:, 5]
    tau = tau + 0.5 * np.random.default_rng(3).normal(size=tau.shape)
    tau[500:560, 5] += 40.0
    return record(robot, motion, tau)


def test_equations_of_many_rows_cannot_be_weighed_row_by_row():
    with pytest.raises(DynidentError, match="dynamic model") as raised:
        identify(arm("ur10"), [recording(False)], choices=replace(CHOICES, model="power"))
    assert raised.value.pointer == "/estimator"


@settings(max_examples=50)
@given(u=st.lists(st.floats(-100, 100), min_size=1, max_size=20))
def test_weights_fall_with_the_residual_and_slopes_are_derivatives(u):
    x = np.sort(np.abs(np.array(u)))
    step = 1e-6
    for influence, corners in ((HUBER, [1.345]), (BISQUARE, [4.685])):
        weight = influence.weight(x)
        assert (np.diff(weight) <= 1e-12).all()
        assert ((weight >= 0) & (weight <= 1)).all()
        smooth = np.min(np.abs(x[:, None] - corners), axis=1) > 1e-3
        psi = [influence.weight(x + shift) * (x + shift) for shift in (step, -step)]
        np.testing.assert_allclose(((psi[0] - psi[1]) / (2 * step))[smooth], influence.slope(x)[smooth], atol=1e-6)


def test_the_scale_is_that_of_the_noise_with_a_quarter_of_outliers():
    rng = np.random.default_rng(0)
    residuals = rng.normal(size=(20_000, 2)) * [1.0, 5.0]
    assert estimate_robust_scale(residuals) == pytest.approx([1.0, 5.0], rel=0.03)
    residuals[:4000] += 1000.0
    assert estimate_robust_scale(residuals) == pytest.approx([1.0, 5.0], rel=0.4)
    assert floor_noise(np.array([0.0, 2.0]))[0] > 0
