"""How sure constants inside columns are, against refits by a nonlinear solver without each stretch of time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from dynident.estimation import (
    FactorAccumulator,
    PriorInformation,
    Reduction,
    linearise_constants,
    parameter_covariance,
    solve,
    statistics,
)
from dynident.estimation.least_squares import compute_correlated_noise

STRETCHES, PER_STRETCH = 20, 50
TRUTH = np.array([2.0, -1.0, 0.7])
SIGMA = 0.05
WIDE = np.array([100.0])


class Decay:
    """y = a exp(-θ x) + b with errors that stretches of time share."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        m = STRETCHES * PER_STRETCH
        self.t = np.arange(m) / PER_STRETCH
        self.x = rng.uniform(0.0, 4.0, m)
        shared = np.repeat(rng.normal(size=STRETCHES), PER_STRETCH)
        self.y = self.of(TRUTH) + SIGMA * (shared + rng.normal(size=m))

    def of(self, p: np.ndarray) -> np.ndarray:
        return p[0] * np.exp(-p[2] * self.x) + p[1]

    def best(self, keep: np.ndarray) -> np.ndarray:
        return least_squares(lambda p: (self.of(p) - self.y)[keep], TRUTH, xtol=1e-12, ftol=1e-12).x

    def reduction(self, p: np.ndarray, *, shaped: bool = True) -> Reduction:
        wave = np.exp(-p[2] * self.x)
        columns = [wave, np.ones_like(wave), -p[0] * self.x * wave]
        width = 3 if shaped else 2
        accumulator = FactorAccumulator([np.arange(width)], width, 1.0 - 1e-6)
        accumulator.push(self.t, [np.column_stack([*columns[:width], self.y])])
        return accumulator.finish()


def estimated(data: Decay):
    best = data.best(np.ones(len(data.t), dtype=bool))
    return best, solve(data.reduction(best, shaped=False), np.array([SIGMA]))


def test_deviations_are_those_of_nonlinear_refits_without_each_stretch(monkeypatch):
    # Refits tell nothing of stretches that depend on their neighbours, which twenty may seem to do by chance.
    monkeypatch.setattr(parameter_covariance, "widen_for_neighbours", lambda covariance, *_: covariance)
    data = Decay()
    best, solution = estimated(data)
    stretch = np.floor(data.t + 1e-9).astype(int)
    away = np.array([data.best(stretch != s) for s in range(STRETCHES)]) - best
    expected = np.sqrt((STRETCHES - 1) / STRETCHES * (away**2).sum(axis=0))
    found = linearise_constants(data.reduction(best), solution, WIDE, "by_time_and_joints")
    assert abs(found.steps[0]) < 1e-4 * found.deviations[0]
    np.testing.assert_allclose(found.deviations, expected[2:], rtol=0.03)
    np.testing.assert_allclose(found.parameter_statistics.standard_deviations, expected[:2], rtol=0.03)


def test_parameters_are_less_sure_than_with_the_constant_taken_for_certain():
    data = Decay(1)
    best, solution = estimated(data)
    certain = statistics(data.reduction(best, shaped=False), solution).standard_deviations
    found = linearise_constants(data.reduction(best), solution, WIDE, "by_time_and_joints")
    assert found.parameter_statistics.standard_deviations[1] > 1.3 * certain[1]
    known = linearise_constants(data.reduction(best), solution, np.array([1e-9]), "by_time_and_joints")
    np.testing.assert_allclose(known.parameter_statistics.standard_deviations, certain, rtol=1e-3)


def test_an_estimate_beside_the_best_is_told_where_the_best_is():
    data = Decay(2)
    best, _ = estimated(data)
    beside = best + np.array([0.0, 0.0, 0.01])
    solution = solve(data.reduction(beside, shaped=False), np.array([SIGMA]))
    start = np.array([*solution.values, beside[2]])
    found = linearise_constants(data.reduction(start), solution, WIDE, "by_time_and_joints")
    assert beside[2] + found.steps[0] == pytest.approx(best[2], abs=5e-4)


def test_a_constant_that_no_row_tells_of_is_as_uncertain_as_its_range():
    data = Decay(3)
    best, solution = estimated(data)
    nothing = data.reduction(np.array([0.0, best[1], best[2]]))
    found = linearise_constants(nothing, solution, np.array([0.4]), "by_time_and_joints")
    assert found.deviations[0] == pytest.approx(0.4, rel=1e-6)


def test_rows_are_worth_as_much_as_in_the_columns_of_the_parameters_alone(monkeypatch):
    data = Decay(5)
    best, solution = estimated(data)
    expected = compute_correlated_noise(data.reduction(best, shaped=False), solution)
    # Without columns that are made triangular again, which takes as long as all the rest.
    monkeypatch.delattr(Reduction, "select_columns")
    found = linearise_constants(data.reduction(best), solution, WIDE, "by_time_and_joints")
    np.testing.assert_allclose(found.solution.noise, expected, rtol=1e-9)


def test_what_was_known_of_the_parameters_stays_known():
    data = Decay(4)
    best, _ = estimated(data)
    known = PriorInformation(np.array([[1e4, 0.0]]), np.array([1e4 * best[0]]))
    solution = solve(data.reduction(best, shaped=False), np.array([SIGMA]), known)
    found = linearise_constants(data.reduction(best), solution, WIDE, "by_time_and_joints")
    assert found.parameter_statistics.standard_deviations[0] == pytest.approx(1e-4, rel=0.05)
