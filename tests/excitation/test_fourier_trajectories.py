from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.errors import DynidentError
from dynident.excitation.fourier import FourierFamily, FourierMotion
from dynident.excitation.motion import Rest, in_sequence

families = st.builds(FourierFamily, st.integers(2, 12), st.floats(0.5, 60.0))


@given(families, st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_a_trajectory_starts_and_ends_every_period_at_rest(family, seed):
    x = np.random.default_rng(seed).standard_normal((family.n_coefficients, 3))
    borders = family.evaluate(x, family.period * np.arange(4))
    inside = family.evaluate(x, np.linspace(0, family.period, 200))
    assert np.abs(borders.dq).max() < 1e-9 * np.abs(inside.dq).max()
    assert np.abs(borders.ddq).max() < 1e-9 * np.abs(inside.ddq).max()
    np.testing.assert_allclose(borders.q[1:], borders.q[:-1], atol=1e-9)


@given(families, st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_each_signal_is_the_derivative_of_the_one_before(family, seed):
    x = np.random.default_rng(seed).standard_normal((family.n_coefficients, 2))
    t = np.linspace(0.1, 0.9, 17) * family.period
    step = 1e-4 * family.period / family.harmonics
    before, at, after = (family.evaluate(x, t + shift) for shift in (-step, 0.0, step))
    for signal, derivative in (("q", "dq"), ("dq", "ddq"), ("ddq", "dddq")):
        slope = (getattr(after, signal) - getattr(before, signal)) / (2 * step)
        exact = getattr(at, derivative)
        np.testing.assert_allclose(slope, exact, atol=1e-5 * np.abs(exact).max())


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
    motion = FourierMotion(family, x, periods=3)
    samples = in_sequence([Rest(motion.start, 0.5), motion, Rest(motion.start, 0.25)], 100.0)
    np.testing.assert_allclose(samples.t, np.arange(376) / 100)
    np.testing.assert_allclose(samples.q[50:150], samples.q[150:250], atol=1e-12)
    np.testing.assert_allclose(samples.q[:50], motion.start[None].repeat(50, 0))
    np.testing.assert_allclose(np.gradient(samples.q, 0.01, axis=0)[1:-1], samples.dq[1:-1], atol=0.2)


def test_too_few_harmonics_are_refused():
    with pytest.raises(DynidentError, match="at least 2"):
        FourierFamily(1, 10.0)
