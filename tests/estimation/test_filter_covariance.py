"""How sure recursive estimates are, on equations whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimation import FactorAccumulator, build_prior, build_weighted_factor
from dynident.estimation.kalman_filter import compute_recursive_statistics

STRETCHES, LENGTH, C = 50, 40, 3


def noise_of(rng, correlated: bool, size: float):
    """Noise of one equation: white, or the same throughout a stretch."""
    white = rng.normal(size=(STRETCHES, LENGTH))
    return size * (np.repeat(white[:, :1], LENGTH, axis=1) if correlated else white).ravel()


def estimated(seed: int, correlated: bool, size: float = 1.0):
    """Two equations that both contain all parameters; the second hardly sees the first parameter."""
    rng = np.random.default_rng(seed)
    t = np.arange(STRETCHES * LENGTH) / LENGTH
    # Columns that are constant over a stretch: what correlated noise is hardest for.
    level = np.repeat(rng.normal(size=(2, STRETCHES, C)), LENGTH, axis=1)
    level[1, :, 0] *= 1e-4
    rows = [np.column_stack([w, noise_of(rng, correlated, size)]) for w in level]
    accumulator = FactorAccumulator([np.arange(C)] * 2, C, 1.0)
    accumulator.push(t, rows)
    reduction = accumulator.finish()
    start = build_prior(np.zeros(C), 1e4 * np.eye(C), np.arange(C), C)
    factor = build_weighted_factor(reduction, np.ones(2), start)
    values = np.linalg.solve(factor[:C, :C], factor[:C, C])
    return values, compute_recursive_statistics(reduction, values, start)


@pytest.mark.parametrize(("correlated", "size"), [(False, 1.0), (False, 0.1), (True, 1.0)])
def test_standard_deviations_are_the_spread_of_the_estimates_whatever_the_noise_is(correlated, size):
    found = [estimated(seed, correlated, size) for seed in range(60)]
    distance = np.array([values / judged.standard_deviations for values, judged in found])
    # 60 estimates of three parameters, each known to 9 %.
    assert 0.8 < np.sqrt(np.mean(distance**2)) < 1.2
    assert np.all(np.sqrt(np.mean(distance**2, axis=0)) < 1.35)


def test_samples_that_repeat_one_another_count_as_one():
    _, white = estimated(0, False)
    _, repeated = estimated(0, True)
    assert np.all(white.effective_rows > 0.5 * STRETCHES * LENGTH)
    assert np.all(repeated.effective_rows < 3 * STRETCHES)
