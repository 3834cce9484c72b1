"""Backward elimination on reduced data, against the same done densely and against what is known of the truth."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.estimation import (
    EliminationPath,
    FactorAccumulator,
    Reduction,
    eliminate_parameters,
    solve_ordinary,
    statistics,
)
from dynident.estimation.backward_elimination import compute_wald_test

M, RATE = 3000, 50.0


def reduced(w: np.ndarray, y: np.ndarray) -> Reduction:
    accumulator = FactorAccumulator([np.arange(w.shape[1])], w.shape[1], 2.0)
    accumulator.push(np.arange(len(y)) / RATE, [np.column_stack([w, y])])
    return accumulator.finish()


def drawn(truth: np.ndarray, seed: int = 0, noise: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(M, len(truth))) * np.array([1, 10, 0.1, 3, 1, 2, 0.5, 5])[: len(truth)]
    return w, w @ truth + noise * rng.normal(size=M)


def path_of(w: np.ndarray, y: np.ndarray, **more) -> EliminationPath:
    reduction = reduced(w, y)
    solution = solve_ordinary(reduction)
    return eliminate_parameters(reduction, solution, statistics(reduction, solution), **more)


ZEROS = np.array([2.0, 0.3, 20.0, 0.0, 0.0, 1.0, 0.0, 0.4])


def test_parameters_that_are_zero_go_and_the_others_stay():
    often = [set(path_of(*drawn(ZEROS, seed)).removed) for seed in range(20)]
    assert all(removed <= {3, 4, 6} for removed in often)
    assert sum(removed == {3, 4, 6} for removed in often) >= 15


def test_what_is_left_is_least_squares_with_these_columns_alone():
    w, y = drawn(ZEROS)
    path = path_of(w, y)
    kept = [k for k in range(len(ZEROS)) if k not in path.removed]
    expected = np.linalg.lstsq(w[:, kept], y, rcond=None)[0]
    np.testing.assert_allclose(path.eliminations[-1].values[kept], expected, rtol=1e-9)
    assert not path.eliminations[-1].values[list(path.removed)].any()


def test_the_first_to_go_is_the_one_with_the_largest_relative_deviation():
    w, y = drawn(ZEROS, 1)
    reduction = reduced(w, y)
    solution = solve_ordinary(reduction)
    relative = statistics(reduction, solution).relative_standard_deviations(solution.values)
    first = path_of(w, y).eliminations[0]
    assert first.removed == int(np.argmax(relative))
    assert first.relative_deviation == pytest.approx(relative.max())
    assert first.ratio == pytest.approx(relative.max() / relative.min())


def test_the_test_is_the_f_test_of_statsmodels_where_residuals_are_independent():
    w, y = drawn(ZEROS, 2)
    fitted = sm.OLS(y, w).fit()
    path = path_of(w, y)
    for count, step in enumerate(path.eliminations, start=1):
        restriction = np.eye(len(ZEROS))[list(path.removed[:count])]
        expected = fitted.f_test(restriction)
        # The measured correlation of white residuals is not exactly none.
        assert step.statistic == pytest.approx(float(expected.fvalue), rel=0.35)


def test_a_parameter_that_noise_cannot_explain_is_not_taken_out_however_badly_it_is_known_beside_the_best():
    truth = np.array([1000.0, 0.3, 20.0, 0.1])
    path = path_of(*drawn(truth, 3))
    assert path.stop == "test"
    assert path.refused is not None
    assert path.refused.p_value < 0.05
    assert path.refused.removed not in path.removed
    assert path.ratio > 10


def test_parameters_that_are_all_known_alike_all_stay():
    w, y = drawn(np.array([3.0, 0.3, 30.0, 1.0]), 4)
    path = path_of(w, y)
    assert path.removed == ()
    assert path.stop == "ratio"
    assert path.ratio < 10


def test_of_noise_alone_at_least_one_parameter_is_left():
    path = path_of(*drawn(np.zeros(4), 5), ratio=1.0000001, level=1e-9)
    assert len(path.removed) == 3
    assert path.stop in ("last", "ratio")


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 500), scales=st.lists(st.floats(1e-3, 1e3), min_size=8, max_size=8))
def test_units_of_the_parameters_change_nothing(seed, scales):
    w, y = drawn(ZEROS, seed)
    assert path_of(w, y).removed == path_of(w * scales, y).removed


def test_a_test_of_many_estimates_is_that_of_statsmodels_where_rows_are_independent():
    rng = np.random.default_rng(5)
    w, extra = rng.normal(size=(M, 4)), rng.normal(size=(M, 3))
    y = w @ [1.0, -2.0, 0.5, 3.0] + 0.02 * extra[:, 0] + rng.normal(size=M)
    whole = np.hstack([w, extra])
    f_value, p_value, count = sm.OLS(y, whole).fit().compare_f_test(sm.OLS(y, w).fit())
    reduction = reduced(whole, y)
    solution = solve_ordinary(reduction)
    uncertainty = statistics(reduction, solution, "independent")
    test = compute_wald_test(solution.values[4:], uncertainty.covariance[4:, 4:], float(uncertainty.freedom[0]))
    assert (test.count, test.freedom) == (count, M - 7)
    assert test.statistic == pytest.approx(f_value)
    assert test.p_value == pytest.approx(p_value)


def test_a_covariance_from_few_blocks_does_not_make_noise_significant():
    rng, rejected = np.random.default_rng(6), 0
    for _ in range(400):
        sums = rng.normal(size=(12, 4))
        test = compute_wald_test(sums.mean(axis=0), np.cov(sums.T) / 12, 11.0, from_blocks=True)
        rejected += test.p_value < 0.05
    # 20 of 400 are expected, with a standard deviation of 4.4; F with 11 degrees of freedom would give some 80.
    assert 8 <= rejected <= 36
