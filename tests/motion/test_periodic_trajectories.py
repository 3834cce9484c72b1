from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.errors import DynidentError
from dynident.motion.joint_trajectories import BSplineFamily, FourierFamily, PeriodicMotion, Rest, sample_pieces

families = st.one_of(
    st.builds(FourierFamily, st.integers(2, 12), st.floats(0.5, 60.0)),
    st.builds(BSplineFamily, st.integers(2, 25), st.floats(0.5, 60.0)),
)


@given(families, st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_a_trajectory_starts_and_ends_every_period_at_rest(family, seed):
    x = np.random.default_rng(seed).standard_normal((family.n_coefficients, 3))
    borders = PeriodicMotion(family, x).evaluate(family.period * np.arange(4))
    inside = PeriodicMotion(family, x).evaluate(np.linspace(0, family.period, 200))
    assert np.abs(borders.dq).max() < 1e-9 * np.abs(inside.dq).max()
    assert np.abs(borders.ddq).max() < 1e-9 * np.abs(inside.ddq).max()
    np.testing.assert_allclose(borders.q[1:], borders.q[:-1], atol=1e-9)


@given(families, st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_each_derivative_of_the_basis_is_the_slope_of_the_one_before(family, seed):
    t = np.random.default_rng(seed).uniform(0.1, 0.9, 17) * family.period
    step = 1e-5 * family.period / family.waves
    before, at, after = (family.basis(t + shift) for shift in (-step, 0.0, step))
    for order in range(4):
        slope = (after[order] - before[order]) / (2 * step)
        np.testing.assert_allclose(slope, at[order + 1], atol=1e-3 * np.abs(at[order + 1]).max())


@given(families, st.floats(0.5, 3.0))
@settings(max_examples=20, deadline=None)
def test_the_same_path_at_another_pace_goes_through_the_same_postures(family, longer):
    x = np.random.default_rng(0).standard_normal((family.n_coefficients, 2))
    u = np.linspace(0.0, 0.99, 30)
    slow = family.with_period(longer * family.period)
    motion = PeriodicMotion(family, x).evaluate(u * family.period)
    at_pace = PeriodicMotion(slow, x).evaluate(u * slow.period)
    np.testing.assert_allclose(at_pace.q, motion.q, atol=1e-9)
    np.testing.assert_allclose(at_pace.dq * longer, motion.dq, atol=1e-6 * np.abs(motion.dq).max())


@given(families)
@settings(max_examples=20, deadline=None)
def test_the_first_coefficient_is_the_mean_posture(family):
    basis = family.basis((np.arange(4000) + 0.5) / 4000 * family.period)[0]
    np.testing.assert_allclose(basis.mean(axis=0), np.eye(family.n_coefficients)[0], atol=1e-4)


def test_a_spline_has_a_polynomial_of_degree_five_between_its_knots_and_as_many_shapes_as_intervals():
    family = BSplineFamily(7, 3.5)
    assert family.n_coefficients == 7
    u = np.linspace(0.01, 0.49, 40)
    for interval in range(7):
        values = family.basis(0.5 * interval + u)[0]
        _, residual, _, _ = np.linalg.lstsq(np.vander(u, 6), values, rcond=None)
        assert residual.max() < 1e-16
    assert np.linalg.matrix_rank(family.basis(np.linspace(0, 3.5, 200))[0]) == 7


def test_all_motions_of_the_chosen_harmonics_that_rest_at_the_border_are_in_the_family():
    family = FourierFamily(4, 2.0)
    rng = np.random.default_rng(1)
    sine, cosine = rng.standard_normal(4), rng.standard_normal(4)
    k = np.arange(1, 5)
    sine[0] -= k @ sine
    cosine[0] -= k**2 @ cosine
    t = np.linspace(0, 2, 50)
    wanted = 0.3 + np.sin(np.pi * np.outer(t, k)) @ sine + np.cos(np.pi * np.outer(t, k)) @ cosine
    _, residual, _, _ = np.linalg.lstsq(family.basis(t)[0], wanted, rcond=None)
    assert residual < 1e-20


def test_motions_in_sequence_are_sampled_without_a_seam():
    family = FourierFamily(3, 1.0)
    x = np.random.default_rng(0).standard_normal((family.n_coefficients, 2))
    motion = PeriodicMotion(family, x, periods=3)
    samples = sample_pieces([Rest(motion.start, 0.5), motion, Rest(motion.start, 0.25)], 100.0)
    np.testing.assert_allclose(samples.t, np.arange(376) / 100)
    np.testing.assert_allclose(samples.q[50:150], samples.q[150:250], atol=1e-12)
    np.testing.assert_allclose(samples.q[:50], motion.start[None].repeat(50, 0))
    np.testing.assert_allclose(np.gradient(samples.q, 0.01, axis=0)[1:-1], samples.dq[1:-1], atol=0.2)


@pytest.mark.parametrize("family", [FourierFamily, BSplineFamily])
def test_too_few_shapes_are_refused(family):
    with pytest.raises(DynidentError, match="at least 2"):
        family(1, 10.0)
    with pytest.raises(DynidentError, match="positive number"):
        family(5, 0.0)
