"""The covariance from stretches of time, against refits without each of them, dense algebra and drawn data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import lstsq

from dynident.estimation import (
    FactorAccumulator,
    PriorInformation,
    Reduction,
    solve,
    solve_instrumental,
    solve_weighted,
    statistics,
)
from dynident.estimation.parameter_covariance import estimate_cluster_covariance

N_PARAMETERS = 4
CONTAINS = (np.array([0, 1, 2]), np.array([1, 2, 3]))
SIGMA = np.array([0.5, 3.0])
PER_STRETCH, STRETCHES = 12, 16


class Rows:
    """Rows of two equations whose errors are the same but for their size, and remember what they were."""

    def __init__(self, seed: int = 0, correlated: float = 0.9, alike: bool = False) -> None:
        rng = np.random.default_rng(seed)
        m = PER_STRETCH * STRETCHES
        self.t = np.arange(m) / PER_STRETCH
        self.truth = np.array([1.0, -2.0, 0.5, 3.0])
        self.w = [rng.normal(size=(m, 3)) + 1.0 for _ in CONTAINS]
        if alike:
            self.w[1][:, :2] = self.w[0][:, 1:]
        sigmas = np.ones(2) if alike else SIGMA
        common = rng.normal(size=m)
        own = [correlated * common + np.sqrt(1 - correlated**2) * rng.normal(size=m) for _ in CONTAINS]
        self.y = [
            w @ self.truth[columns] + sigma * e
            for w, columns, sigma, e in zip(self.w, CONTAINS, sigmas, own, strict=True)
        ]

    def reduction(self) -> Reduction:
        accumulator = FactorAccumulator(CONTAINS, N_PARAMETERS, 1.0 - 1e-6)
        accumulator.push(self.t, [np.column_stack([w, y]) for w, y in zip(self.w, self.y, strict=True)])
        return accumulator.finish()

    def dense(self, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        wide = []
        for w, columns, sigma in zip(self.w, CONTAINS, SIGMA, strict=True):
            one = np.zeros((len(self.t), N_PARAMETERS))
            one[:, columns] = w / sigma
            wide.append(one[keep])
        return np.concatenate(wide), np.concatenate([y[keep] / s for y, s in zip(self.y, SIGMA, strict=True)])

    @property
    def stretch(self) -> np.ndarray:
        return np.floor(self.t + 1e-9).astype(int)


def test_it_is_the_jackknife_of_refits_without_each_stretch():
    data = Rows()
    reduction = data.reduction()
    assert reduction.n_blocks == STRETCHES
    solution = solve(reduction, SIGMA)
    refits = np.array([lstsq(*data.dense(data.stretch != s))[0] for s in range(STRETCHES)])
    away = refits - solution.values
    expected = (STRETCHES - 1) / STRETCHES * away.T @ away
    np.testing.assert_allclose(estimate_cluster_covariance(reduction, solution).covariance, expected, rtol=1e-8)


def test_what_was_known_beside_the_data_stays_known_in_every_refit():
    data = Rows(1)
    known = PriorInformation(np.array([[0.0, 3.0, 1.0, 0.0]]), np.array([-5.0]))
    solution = solve(data.reduction(), SIGMA, known)
    refits = []
    for s in range(STRETCHES):
        w, y = data.dense(data.stretch != s)
        refits.append(lstsq(np.vstack([w, known.factor]), np.append(y, known.right))[0])
    away = np.array(refits) - solution.values
    w, _ = data.dense(np.ones(len(data.t), dtype=bool))
    bread = np.linalg.inv(w.T @ w + known.factor.T @ known.factor)
    of_known = bread @ known.factor.T @ known.factor @ bread
    expected = (STRETCHES - 1) / STRETCHES * away.T @ away + of_known
    np.testing.assert_allclose(estimate_cluster_covariance(data.reduction(), solution).covariance, expected, rtol=1e-8)


def test_degrees_of_freedom_are_those_of_the_quadratic_form_in_independent_rows():
    data = Rows(2)
    solution = solve(data.reduction(), SIGMA)
    w, _ = data.dense(np.ones(len(data.t), dtype=bool))
    stretch = np.tile(data.stretch, 2)
    bread = np.linalg.inv(w.T @ w)
    left = np.eye(len(w)) - w @ bread @ w.T
    steps = []
    for s in range(STRETCHES):
        own = w[stretch == s]
        steps.append(np.linalg.inv(w.T @ w - own.T @ own) @ own.T @ left[stretch == s])
    maps = np.array(steps)  # (s, c, rows): how every stretch's step follows from independent errors
    for k, freedom in enumerate(estimate_cluster_covariance(data.reduction(), solution).freedom):
        omega = maps[:, k] @ maps[:, k].T
        assert freedom == pytest.approx(np.trace(omega) ** 2 / np.sum(omega**2), rel=1e-6)


def test_errors_that_equations_share_widen_the_intervals_as_far_as_estimates_spread():
    found, together, apart = [], [], []
    for seed in range(200):
        reduction = Rows(seed, correlated=0.95, alike=True).reduction()
        solution = solve_weighted(reduction)
        found.append(solution.values)
        together.append(statistics(reduction, solution).standard_deviations)
        apart.append(statistics(reduction, solution, "by_joint").standard_deviations)
    spread = np.std(found, axis=0)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(together), axis=0)), spread, rtol=0.2)
    # Parameters 1 and 2 are in both equations, with the same columns.
    assert (np.mean(apart, axis=0)[1:3] < 0.9 * spread[1:3]).all()


def test_what_one_stretch_alone_tells_of_is_not_called_sure():
    data = Rows(3)
    data.w[0][PER_STRETCH:, 0] = 0.0
    data.y[0] = data.y[0] - 0.0
    reduction = data.reduction()
    solution = solve(reduction, SIGMA)
    found = estimate_cluster_covariance(reduction, solution)
    by_rows = statistics(reduction, solution, "independent").standard_deviations
    assert 0.3 * by_rows[0] < np.sqrt(found.covariance[0, 0]) < 10 * by_rows[0]
    # Nobody knows how far off it is: its interval is as wide as one degree of freedom makes it.
    assert found.freedom[0] < 2
    assert found.freedom[2] > 5


def test_a_motion_within_one_stretch_is_judged_by_its_rows_and_never_called_exact():
    data = Rows(6)
    moving = data.stretch == 3
    accumulator = FactorAccumulator(CONTAINS, N_PARAMETERS, 1.0 - 1e-6)
    rows = [np.column_stack([w, y]) for w, y in zip(data.w, data.y, strict=True)]
    accumulator.push(data.t, rows, np.column_stack([moving, moving]))
    reduction = accumulator.finish()
    assert reduction.n_blocks == STRETCHES
    solution = solve(reduction, SIGMA)
    found = statistics(reduction, solution).standard_deviations
    np.testing.assert_allclose(found, statistics(reduction, solution, "by_joint").standard_deviations)
    assert (found > 0).all()


def test_instruments_that_are_the_columns_themselves_change_nothing():
    data = Rows(4)
    accumulator = FactorAccumulator(
        tuple(np.concatenate([columns, columns + N_PARAMETERS]) for columns in CONTAINS), 2 * N_PARAMETERS, 1.0 - 1e-6
    )
    accumulator.push(data.t, [np.column_stack([w, w, y]) for w, y in zip(data.w, data.y, strict=True)])
    found = solve_instrumental(accumulator.finish())
    plain = estimate_cluster_covariance(data.reduction(), replace(found.solution, known=None))
    np.testing.assert_allclose(found.statistics.covariance, plain.covariance, rtol=1e-6)
    np.testing.assert_allclose(found.statistics.freedom, plain.freedom, rtol=1e-6)


def test_few_stretches_are_judged_by_joint():
    reduction = Rows(5).reduction().select_blocks([0, 1, 2])
    solution = solve(reduction, SIGMA)
    np.testing.assert_allclose(
        statistics(reduction, solution).covariance, statistics(reduction, solution, "by_joint").covariance
    )
