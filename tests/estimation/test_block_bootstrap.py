"""The bootstrap over stretches of time, against dense least squares on rows drawn in the same manner."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import lstsq

from dynident.estimation import (
    FactorAccumulator,
    PriorInformation,
    Reduction,
    bootstrap_estimates,
    solve,
    solve_weighted,
    statistics,
)

CONTAINS = (np.array([0, 1, 2]), np.array([1, 2, 3]))
SIGMA = np.array([0.5, 3.0])
PER_STRETCH = 30


class Rows:
    def __init__(self, stretches: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        m = PER_STRETCH * stretches
        self.stretches = stretches
        self.t = np.arange(m) / PER_STRETCH
        self.stretch = np.floor(self.t + 1e-9).astype(int)
        shared = np.repeat(rng.normal(size=stretches), PER_STRETCH)
        truth = np.array([1.0, -2.0, 0.5, 3.0])
        self.w = [rng.normal(size=(m, 3)) + np.repeat(rng.normal(size=(stretches, 3)), PER_STRETCH, 0) for _ in SIGMA]
        self.y = [
            w @ truth[columns] + sigma * (shared + rng.normal(size=m))
            for w, columns, sigma in zip(self.w, CONTAINS, SIGMA, strict=True)
        ]

    def reduction(self) -> Reduction:
        accumulator = FactorAccumulator(CONTAINS, 4, 1.0 - 1e-6)
        accumulator.push(self.t, [np.column_stack([w, y]) for w, y in zip(self.w, self.y, strict=True)])
        return accumulator.finish()

    def solved(self, rows: np.ndarray, noise: np.ndarray) -> np.ndarray:
        wide, right = [], []
        for w, y, columns, sigma in zip(self.w, self.y, CONTAINS, noise, strict=True):
            one = np.zeros((len(rows), 4))
            one[:, columns] = w[rows] / sigma
            wide.append(one)
            right.append(y[rows] / sigma)
        return lstsq(np.concatenate(wide), np.concatenate(right))[0]

    def weighed(self, rows: np.ndarray, noise: np.ndarray) -> np.ndarray:
        for _ in range(3):
            found = self.solved(rows, noise)
            noise = np.array(
                [np.std(y[rows] - w[rows] @ found[c]) for w, y, c in zip(self.w, self.y, CONTAINS, strict=True)]
            )
        return found

    def drawn(self, draws: int, noise: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(99)
        rows = [np.flatnonzero(self.stretch == s) for s in range(self.stretches)]
        found = []
        for _ in range(draws):
            picked = np.concatenate([rows[s] for s in rng.integers(self.stretches, size=self.stretches)])
            found.append(self.weighed(picked, noise))
        return np.std(found, axis=0)


def test_pairs_are_those_of_rows_drawn_stretch_by_stretch_and_weighed_anew():
    data = Rows(40)
    solution = solve_weighted(data.reduction())
    found = bootstrap_estimates(data.reduction(), solution, draws=2000, seed=1)
    assert (found.kind, found.lost) == ("pairs", 0)
    np.testing.assert_allclose(found.deviations, data.drawn(2000, solution.noise), rtol=0.08)


def test_wild_draws_are_those_of_dense_residuals_with_webbs_weights():
    data = Rows(12)
    solution = solve(data.reduction(), SIGMA)
    wide, right = [], []
    for w, y, columns, sigma in zip(data.w, data.y, CONTAINS, SIGMA, strict=True):
        one = np.zeros((len(y), 4))
        one[:, columns] = w / sigma
        wide.append(one)
        right.append(y / sigma)
    w, y, stretch = np.concatenate(wide), np.concatenate(right), np.tile(data.stretch, 2)
    rest = y - w @ solution.values
    inverse = np.linalg.inv(w.T @ w)
    straight = rest.copy()
    for s in range(data.stretches):
        own = w[stretch == s]
        straight[stretch == s] = np.linalg.solve(np.eye(len(own)) - own @ inverse @ own.T, rest[stretch == s])
    rng = np.random.default_rng(5)
    values = np.sqrt([0.5, 1.0, 1.5])
    drawn = [
        lstsq(w, w @ solution.values + rng.choice([*values, *-values], size=data.stretches)[stretch] * straight)[0]
        for _ in range(3000)
    ]
    found = bootstrap_estimates(data.reduction(), solution, draws=3000, reweigh=False)
    assert found.kind == "wild"
    np.testing.assert_allclose(found.deviations, np.std(drawn, axis=0), rtol=0.06)


@pytest.mark.parametrize("stretches", [12, 60])
def test_it_agrees_with_what_is_told_without_drawing(stretches):
    data = Rows(stretches, 3)
    solution = solve_weighted(data.reduction())
    told = statistics(data.reduction(), solution).standard_deviations
    np.testing.assert_allclose(bootstrap_estimates(data.reduction(), solution).deviations, told, rtol=0.25)


def test_it_disagrees_where_the_shared_error_is_not_counted():
    data = Rows(20, 4)
    solution = solve_weighted(data.reduction())
    told = statistics(data.reduction(), solution, "independent").standard_deviations
    assert np.median(bootstrap_estimates(data.reduction(), solution).deviations / told) > 1.5


def test_what_was_known_is_drawn_with_its_own_error():
    data = Rows(20, 6)
    known = PriorInformation(np.array([[1e4, 0.0, 0.0, 0.0]]), np.array([1e4]))
    solution = solve(data.reduction(), SIGMA, known)
    found = bootstrap_estimates(data.reduction(), solution, draws=2000)
    assert found.deviations[0] == pytest.approx(1e-4, rel=0.05)


def test_draws_that_lack_what_a_parameter_is_told_by_are_counted():
    data = Rows(40, 7)
    for w in data.w:
        w[data.stretch > 1] *= np.array([1.0, 1.0, 0.0]) if w is data.w[1] else np.ones(3)
    data.y[1] = data.w[1] @ np.array([-2.0, 0.5, 3.0]) + np.random.default_rng(0).normal(size=len(data.t))
    found = bootstrap_estimates(data.reduction(), solve_weighted(data.reduction()), kind="pairs", draws=300)
    assert 0.08 < found.lost / 300 < 0.2
