"""Instrumental variables from triangular factors against statsmodels and numpy on all rows, and against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from statsmodels.sandbox.regression.gmm import IV2SLS

from dynident.estimation import (
    EstimationError,
    FactorAccumulator,
    Reduction,
    build_prior,
    solve_instrumental,
    solve_ordinary,
    solve_weighted,
    statistics,
)

CONTAINS = (np.array([0, 1, 2]), np.array([1, 2, 3, 4]))
C, M, RATE = 5, 600, 50.0
TRUTH = np.array([1.0, -2.0, 0.5, 3.0, 0.2])
SIGMA = np.array([0.3, 2.0])


class Rows:
    """Columns that are measured with noise, and instruments that do not share it."""

    def __init__(self, seed: int = 0, m: int = M, spoiled: float = 0.5, spread: float = 0.2) -> None:
        rng = np.random.default_rng(seed)
        self.t = np.arange(m) / RATE
        true = [rng.normal(size=(m, len(columns))) for columns in CONTAINS]
        self.z = [one + spread * rng.normal(size=one.shape) for one in true]
        self.w = [one + spoiled * rng.normal(size=one.shape) for one in true]
        self.y = [
            one @ TRUTH[columns] + s * rng.normal(size=m) for one, columns, s in zip(true, CONTAINS, SIGMA, strict=True)
        ]

    def reduction(self) -> Reduction:
        accumulator = FactorAccumulator([np.concatenate([k, k + C]) for k in CONTAINS], 2 * C, 0.5)
        rows = [np.column_stack(parts) for parts in zip(self.z, self.w, self.y, strict=True)]
        accumulator.push(self.t, rows)
        return accumulator.finish()

    def dense(self, noise) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        parts = []
        for z, w, y, columns, s in zip(self.z, self.w, self.y, CONTAINS, noise, strict=True):
            wide = np.zeros((2, len(y), C))
            wide[0][:, columns], wide[1][:, columns] = z, w
            parts.append((wide[0] / s, wide[1] / s, y / s))
        return tuple(np.concatenate(items) for items in zip(*parts, strict=True))


def test_estimates_are_those_of_statsmodels_on_the_same_weighted_rows():
    data = Rows()
    found = solve_instrumental(data.reduction())
    z, w, y = data.dense(found.solution.noise)
    np.testing.assert_allclose(found.solution.values, IV2SLS(y, w, instrument=z).fit().params, rtol=1e-9)


def test_instruments_that_are_the_columns_themselves_give_weighted_least_squares():
    data = Rows(1)
    data.z = data.w
    found, expected = (
        solve_instrumental(data.reduction()),
        solve_weighted(data.reduction().select_columns(np.arange(C, 2 * C))),
    )
    np.testing.assert_allclose(found.solution.values, expected.values, rtol=1e-9)
    observed = data.reduction().select_columns(np.arange(C, 2 * C))
    np.testing.assert_allclose(found.statistics.covariance, statistics(observed, expected).covariance, rtol=1e-7)
    assert found.strength == pytest.approx(1.0)


def test_the_strength_is_the_smallest_canonical_correlation():
    data = Rows(2)
    found = solve_instrumental(data.reduction())
    z, w, _ = data.dense(found.solution.noise)
    expected = np.linalg.svd(np.linalg.qr(z)[0].T @ np.linalg.qr(w)[0], compute_uv=False)[-1]
    assert found.strength == pytest.approx(expected, rel=1e-9)


def test_noise_in_the_columns_biases_least_squares_but_not_instrumental_variables():
    runs = 60
    estimates, deviations, plain, plain_deviations = [], [], [], []
    for seed in range(runs):
        both = Rows(seed).reduction()
        found = solve_instrumental(both)
        observed = both.select_columns(np.arange(C, 2 * C))
        least = solve_ordinary(observed)
        estimates.append(found.solution.values)
        deviations.append(found.statistics.standard_deviations)
        plain.append(least.values)
        plain_deviations.append(statistics(observed, least).standard_deviations)
    bias = (np.mean(plain, axis=0) - TRUTH) / np.mean(plain_deviations, axis=0)
    assert np.abs(bias[[0, 1, 3]]).min() > 3.0
    left = (np.mean(estimates, axis=0) - TRUTH) / np.mean(deviations, axis=0)
    assert np.abs(left).max() < 0.5
    np.testing.assert_allclose(np.mean(deviations, axis=0), np.std(estimates, axis=0), rtol=0.25)


def test_what_is_known_beforehand_counts_as_its_own_instrument():
    data = Rows(3)
    known = build_prior(np.array([3.0]), np.array([[0.04]]), np.array([3]), C)
    found = solve_instrumental(data.reduction(), known)
    z, w, y = data.dense(found.solution.noise)
    row, right = known.factor, known.right
    expected = np.linalg.solve(z.T @ w + row.T @ row, z.T @ y + row.T @ right)
    np.testing.assert_allclose(found.solution.values, expected, rtol=1e-9)
    certain = build_prior(np.array([7.0]), np.zeros((1, 1)), np.array([0]), C)
    assert solve_instrumental(data.reduction(), certain).solution.values[0] == pytest.approx(7.0, abs=1e-5)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 500),
    scales=st.lists(st.floats(1e-3, 1e3), min_size=C, max_size=C),
    others=st.lists(st.floats(1e-3, 1e3), min_size=C, max_size=C),
)
def test_units_of_parameters_change_only_their_units_and_those_of_instruments_nothing(seed, scales, others):
    data = Rows(seed)
    one = solve_instrumental(data.reduction())
    s, instruments = np.array(scales), np.array(others)
    data.w = [w * s[columns] for w, columns in zip(data.w, CONTAINS, strict=True)]
    data.z = [z * instruments[columns] for z, columns in zip(data.z, CONTAINS, strict=True)]
    other = solve_instrumental(data.reduction())
    np.testing.assert_allclose(other.solution.values * s, one.solution.values, rtol=1e-6)
    deviations = other.statistics.standard_deviations * s
    np.testing.assert_allclose(deviations, one.statistics.standard_deviations, rtol=1e-5)
    assert other.strength == pytest.approx(one.strength, rel=1e-6)


def test_instruments_that_have_nothing_to_do_with_the_columns_are_refused():
    data = Rows(4)
    rng = np.random.default_rng(9)
    data.z = [rng.normal(size=one.shape) for one in data.z]
    with pytest.raises(EstimationError, match="in the weakest direction") as caught:
        solve_instrumental(data.reduction())
    assert caught.value.title == "Weak instruments"


@pytest.mark.parametrize("which", ["z", "w"])
def test_a_column_that_is_zero_is_refused(which):
    data = Rows(5)
    getattr(data, which)[0][:, 0] = 0.0
    with pytest.raises(EstimationError, match="simulated" if which == "z" else "measured"):
        solve_instrumental(data.reduction())


def test_fewer_rows_than_parameters_are_refused():
    with pytest.raises(EstimationError, match="4 equations cannot determine 5 parameters"):
        solve_instrumental(Rows(6, m=2).reduction())
