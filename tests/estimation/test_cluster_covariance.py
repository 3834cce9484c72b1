"""The covariance from stretches of time, against refits without each of them, dense algebra and drawn data."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import lstsq

from dynident.estimation import (
    EquationFactors,
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
    plain = estimate_cluster_covariance(data.reduction(), replace(found.solution, known=None), is_ordered=True)
    np.testing.assert_allclose(found.statistics.covariance, plain.covariance, rtol=1e-6)
    np.testing.assert_allclose(found.statistics.freedom, plain.freedom, rtol=1e-6)


def test_few_stretches_are_judged_by_joint():
    reduction = Rows(5).reduction().select_blocks([0, 1, 2])
    solution = solve(reduction, SIGMA)
    np.testing.assert_allclose(
        statistics(reduction, solution).covariance, statistics(reduction, solution, "by_joint").covariance
    )


OWN, SHARED = 2, 1


def draw_equations(rng: np.random.Generator, blocks: list[int], per_block: int = 12) -> Reduction:
    """Return equations with two parameters of their own each and a shared one, all true values 1, by their blocks."""
    c, equations = OWN * len(blocks) + SHARED, []
    for k, n in enumerate(blocks):
        w = rng.normal(size=(n, per_block, OWN + SHARED)) + 0.5
        y = w.sum(axis=2) + rng.normal(size=(n, 1)) + rng.normal(size=(n, per_block))
        factors = np.linalg.qr(np.concatenate([w, y[:, :, None]], axis=2), mode="r")
        columns = np.append(np.arange(OWN) + OWN * k, c - 1)
        equations.append(EquationFactors(columns, factors, np.full(n, per_block)))
    times = np.arange(float(max(blocks)))
    return Reduction(c, tuple(equations), np.stack([times, times + 1.0], axis=1))


def pad_blocks(equation: EquationFactors, n: int) -> EquationFactors:
    """Return the same rows in n blocks, the last of which have none."""
    missing = n - len(equation.counts)
    factors = np.pad(equation.factors, [(0, missing), (0, 0), (0, 0)])
    return EquationFactors(equation.columns, factors, np.pad(equation.counts, (0, missing)))


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    blocks=st.lists(st.integers(2, 20), min_size=2, max_size=4).filter(lambda n: max(n) >= 5),
    kind=st.sampled_from(["by_time_and_joints", "by_joint"]),
)
# Near the limit at which blocks are joined.
@example(seed=349, blocks=[12, 5], kind="by_time_and_joints")
def test_equations_may_have_blocks_of_different_numbers(seed, blocks, kind):
    reduction = draw_equations(np.random.default_rng(seed), blocks)
    noise = np.ones(len(blocks))
    solution = solve(reduction, noise)
    found = estimate_cluster_covariance(reduction, solution, kind)
    padded = replace(reduction, equations=tuple(pad_blocks(e, max(blocks)) for e in reduction.equations))
    expected = estimate_cluster_covariance(padded, solution, kind)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)
    np.testing.assert_allclose(found.freedom, expected.freedom, rtol=1e-9)
    np.testing.assert_allclose(
        statistics(reduction, solution, kind).covariance, statistics(padded, solution, kind).covariance, rtol=1e-9
    )


@pytest.mark.parametrize("kind", ["by_time_and_joints", "by_joint"])
@pytest.mark.parametrize("seed", range(3))
def test_an_equation_without_rows_changes_nothing_however_it_is_written(kind, seed):
    plain = draw_equations(np.random.default_rng(seed), [12, 15])
    first = plain.equations[0]
    whole = EquationFactors(first.columns, np.zeros((15, *first.factors.shape[1:])), np.zeros(15, dtype=int))
    nothing = EquationFactors(first.columns[:0], np.zeros((0, 1, 1)), first.counts[:0])
    expected = statistics(plain, solve_weighted(plain), kind)
    for empty in (whole, nothing, pad_blocks(nothing, 15)):
        reduction = replace(plain, equations=(*plain.equations, empty))
        found = statistics(reduction, solve(reduction, np.append(solve_weighted(plain).noise, 1.0)), kind)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)
        np.testing.assert_allclose(found.freedom, expected.freedom, rtol=1e-9)


@pytest.mark.parametrize("kind", ["by_time_and_joints", "by_joint"])
def test_an_equation_with_few_rows_leaves_the_others_their_blocks(kind):
    held, freedom = [], []
    for seed in range(300):
        reduction = draw_equations(np.random.default_rng(seed), [24, 24, 3])
        solution = solve_weighted(reduction)
        found = statistics(reduction, solution, kind)
        held.append(np.abs(solution.values - 1.0) <= found.half_widths())
        freedom.append(found.freedom)
    rich, poor = np.arange(2 * OWN), np.arange(2 * OWN, 3 * OWN)
    # Rows of one block share an error: counted one by one, they would give hundreds of degrees of freedom.
    assert np.median(np.array(freedom)[:, rich]) < 24
    assert np.median(np.array(freedom)[:, poor]) < 3
    assert 0.92 <= np.mean(np.array(held)[:, rich]) <= 0.98
    assert np.mean(np.array(held)[:, poor]) >= 0.92


def test_many_blocks_need_no_matrix_of_all_pairs_of_blocks():
    reduction = draw_equations(np.random.default_rng(1), [1200, 1200, 1200])
    solution = solve_weighted(reduction)
    tracemalloc.start()
    found = estimate_cluster_covariance(reduction, solution, "by_joint")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.freedom.min() > 500
    # All pairs of blocks would take 8 x 3600² bytes for each of seven parameters.
    assert peak < 50e6
