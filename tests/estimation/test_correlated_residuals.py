"""How far correlated residuals overstate the number of rows, against simulation and known inflations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from dynident.estimation import (
    FactorAccumulator,
    Reduction,
    build_prior,
    compute_correlation_factor,
    compute_pooled_statistics,
    qr_decomposition,
    residual_correlation,
    solve_ordinary,
    solve_weighted,
    statistics,
)
from dynident.estimation.residual_correlation import (
    compute_correlation_factors,
    compute_neighbour_growth,
    count_correlation_freedom,
    count_effective_rows,
    count_growth_worth,
    count_pooled_freedom,
    join_dependent_blocks,
    pool_correlation_factors,
    select_fits,
    widen_for_neighbours,
)

P, M, RATE = 5, 6000, 50.0


def smooth(rng: np.random.Generator, size: tuple[int, int], pole: float) -> np.ndarray:
    """Stationary first-order autoregressive noise of unit variance (size), pole 0: white."""
    white = rng.normal(size=(size[0] + 500, size[1]))
    return signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], white, axis=0)[500:]


def reduced(w: np.ndarray, y: np.ndarray, block_length: float = 2.0) -> Reduction:
    accumulator = FactorAccumulator([np.arange(w.shape[1])], w.shape[1], block_length)
    accumulator.push(np.arange(len(y)) / RATE, [np.column_stack([w, y])])
    return accumulator.finish()


def factor_of(w: np.ndarray, y: np.ndarray, block_length: float = 2.0) -> float:
    reduction = reduced(w, y, block_length)
    return float(compute_correlation_factors(reduction, solve_ordinary(reduction))[0])


def count_own_freedom(w: np.ndarray, block_length: float = 2.0) -> float:
    """Degrees of freedom of the factor of a fit to these rows alone."""
    reduction = reduced(w, w @ np.ones(P), block_length)
    inverse = solve_ordinary(reduction).normal_inverse
    return count_correlation_freedom(reduction.equations[0], inverse)


def many(column_pole: float, residual_pole: float, runs: int = 60, block_length: float = 2.0) -> np.ndarray:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(runs):
        w = smooth(rng, (M, P), column_pole)
        found.append(factor_of(w, w @ np.ones(P) + smooth(rng, (M, 1), residual_pole)[:, 0], block_length))
    return np.array(found)


def test_independent_residuals_count_in_full():
    found = many(0.9, 0.0)
    assert np.median(found) < 1.1
    assert found.max() < 1.8
    assert found.min() >= 1.0


@pytest.mark.parametrize(("column_pole", "residual_pole"), [(0.8, 0.8), (0.95, 0.5), (0.9, 0.9)])
def test_autoregressive_residuals_count_for_less_by_the_known_inflation(column_pole, residual_pole):
    # Var of a mean of products of two AR(1) series: Σ_k (a b)^|k| = (1 + a b) / (1 - a b).
    product = column_pole * residual_pole
    expected = (1 + product) / (1 - product)
    assert np.mean(many(column_pole, residual_pole)) == pytest.approx(expected, rel=0.2)


def test_low_passed_residuals_count_for_less_by_their_bandwidth():
    # White noise through a filter of pass band B leaves 2 B of `RATE` rows a second that are independent, for columns
    # that are slow beside it.
    rng = np.random.default_rng(1)
    taps = signal.firwin(101, 5.0, fs=RATE)
    found = []
    for _ in range(40):
        w = smooth(rng, (M, P), 0.995)
        rest = signal.lfilter(taps, 1, rng.normal(size=M + 200))[200:]
        found.append(factor_of(w, w @ np.ones(P) + rest, block_length=3.0))
    assert np.mean(found) == pytest.approx(RATE / (2 * 5.0), rel=0.25)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_standard_deviations_are_the_spread_of_estimates_with_correlated_residuals(pole):
    rng = np.random.default_rng(2)
    w = smooth(rng, (M, P), 0.95) * [1, 10, 0.1, 3, 1]
    estimates, promised = [], []
    for _ in range(80):
        reduction = reduced(w, w @ np.ones(P) + smooth(rng, (M, 1), pole)[:, 0])
        solution = solve_ordinary(reduction)
        estimates.append(solution.values)
        promised.append(statistics(reduction, solution).standard_deviations)
    np.testing.assert_allclose(np.mean(promised, axis=0), np.std(estimates, axis=0), rtol=0.25)


def test_effective_rows_are_the_rows_over_the_factor():
    rng = np.random.default_rng(3)
    w = smooth(rng, (M, P), 0.9)
    reduction = reduced(w, w @ np.ones(P) + smooth(rng, (M, 1), 0.9)[:, 0])
    solution = solve_ordinary(reduction)
    (factor,) = compute_correlation_factors(reduction, solution)
    assert statistics(reduction, solution).effective_rows[0] == pytest.approx(M / factor)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    scales=st.lists(st.floats(1e-3, 1e3), min_size=P, max_size=P),
    gain=st.floats(1e-3, 1e3),
    order=st.permutations(range(60)),
)
def test_neither_units_nor_the_order_of_stretches_change_the_factor(seed, scales, gain, order):
    rng = np.random.default_rng(seed)
    w = smooth(rng, (M, P), 0.9)
    y = w @ np.ones(P) + smooth(rng, (M, 1), 0.8)[:, 0]
    found = []
    for reduction in (reduced(w, y), reduced(w * scales, gain * y).select_blocks(order)):
        solution = solve_ordinary(reduction)
        (fit,) = select_fits(reduction, solution)
        found.append(compute_correlation_factor(reduction.equations[0], solution.values, fit))
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_the_factor_scatters_as_its_degrees_of_freedom_say():
    rng = np.random.default_rng(6)
    w = smooth(rng, (1000, P), 0.9)
    found = [factor_of(w, w @ np.ones(P) + smooth(rng, (1000, 1), 0.8)[:, 0]) for _ in range(200)]
    freedom = count_own_freedom(w)
    # Ten blocks of five columns have at most 45.
    assert 15.0 < freedom < 45.0
    assert np.log(found).std() == pytest.approx(np.sqrt(2.0 / freedom), rel=0.25)
    assert count_own_freedom(w[:100], block_length=0.6) == 1.0


def test_equations_that_share_their_parameters_lose_less_to_the_fit_than_each_to_one_of_its_own():
    # Eight joints, ten seconds, all with the same parameters: a fit to one joint alone would take most of each block.
    rng = np.random.default_rng(7)
    joints, m, p, pole = 8, 500, 20, 0.5
    taken_alone, together, freedom, promised, found = [], [], [], [], []
    columns = [smooth(rng, (m, p), 0.98) for _ in range(joints)]
    for _ in range(40):
        rows = [np.column_stack([w, w @ np.ones(p) + smooth(rng, (m, 1), pole)[:, 0]]) for w in columns]
        accumulator = FactorAccumulator([np.arange(p)] * joints, p, 0.5)
        accumulator.push(np.arange(m) / RATE, rows)
        reduction = accumulator.finish()
        solution = solve_ordinary(reduction)
        fits = select_fits(reduction, solution)
        taken_alone.append(
            [
                compute_correlation_factor(e, solution.values, np.linalg.inv(r.T @ r))
                for e in reduction.equations
                for r in [e.whole_factor[:, :-1]]
            ]
        )
        together.append(compute_correlation_factors(reduction, solution))
        freedom += [count_correlation_freedom(e, fit) for e, fit in zip(reduction.equations, fits, strict=True)]
        certainty = compute_pooled_statistics(reduction, solution)
        np.testing.assert_allclose(certainty.effective_rows, m / together[-1])
        promised.append(certainty.standard_deviations)
        found.append(solution.values)
    # Σ |a b|^|k| of two AR(1) series, as above.
    expected = (1 + 0.98 * pole) / (1 - 0.98 * pole)
    assert np.mean(taken_alone) > 1.25 * expected
    assert np.mean(together) == pytest.approx(expected, rel=0.2)
    np.testing.assert_allclose(np.mean(promised, axis=0), np.std(found, axis=0), rtol=0.35)
    assert np.log(together).std(axis=0).mean() == pytest.approx(np.sqrt(2.0 / np.mean(freedom)), rel=0.25)


def test_too_few_stretches_to_see_a_correlation_claim_none():
    rng = np.random.default_rng(4)
    w = smooth(rng, (100, P), 0.9)
    assert factor_of(w, smooth(rng, (100, 1), 0.9)[:, 0], block_length=0.6) == 1.0


def test_a_perfect_fit_claims_no_correlation():
    rng = np.random.default_rng(5)
    w = smooth(rng, (M, P), 0.9)
    assert factor_of(w, np.zeros(M)) == 1.0


def test_a_column_that_an_equation_hardly_sees_does_no_harm():
    rng = np.random.default_rng(6)
    w = smooth(rng, (M, P), 0.9)
    y = w @ np.ones(P) + smooth(rng, (M, 1), 0.9)[:, 0]
    plain = factor_of(w, y)
    wide = np.column_stack([w, np.zeros(M)])
    accumulator = FactorAccumulator([np.arange(P + 1)], P + 1, 2.0)
    accumulator.push(np.arange(M) / RATE, [np.column_stack([wide, y])])
    equation = accumulator.finish().equations[0]
    alone = solve_ordinary(reduced(w, y))
    values, fit = np.append(alone.values, 7.0), np.pad(alone.normal_inverse, [(0, 1), (0, 1)])
    assert compute_correlation_factor(equation, values, fit) == pytest.approx(plain, rel=1e-6)


def test_columns_are_whitened_as_by_singular_values(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    w = smooth(rng, (M, P), 0.9) * np.array([1.0, 1e2, 1e-2, 3.0, 0.1])
    equation = reduced(w, smooth(rng, (M, 1), 0.9)[:, 0]).equations[0]
    columns, factor = equation.factors[:, :, :-1], equation.whole_factor[:, :-1]
    inverted = qr_decomposition.whiten_columns(columns, factor)
    monkeypatch.setattr(qr_decomposition, "_REGULAR", np.inf)
    by_singular_values = qr_decomposition.whiten_columns(columns, factor)
    for found in (inverted, by_singular_values):
        flat = found.rows.reshape(-1, P)
        np.testing.assert_allclose(flat.T @ flat, np.eye(P), atol=1e-10)
    assert np.trace(inverted.squares) == pytest.approx(np.trace(by_singular_values.squares), rel=1e-10)
    assert not np.allclose(inverted.rows, by_singular_values.rows)


def draw_shared(seed: int, memory: float, joints: int = 3, p: int = 6, mixed: np.ndarray | None = None) -> Reduction:
    """Twenty seconds of equations that share their parameters, one of a constant; residuals of so long a memory.

    Columns are multiplied by `mixed` at last.
    """
    m = round(20 * RATE)
    columns = np.random.default_rng(8)
    rng = np.random.default_rng([9, seed])
    pole = np.exp(-1.0 / (RATE * memory)) if memory else 0.0
    accumulator = FactorAccumulator([np.arange(p)] * joints, p, 1.0)
    rows = []
    for _ in range(joints):
        w = np.column_stack([smooth(columns, (m, p - 1), 0.95), np.ones(m)])
        y = w @ np.ones(p) + smooth(rng, (m, 1), pole)[:, 0]
        rows.append(np.column_stack([w if mixed is None else w @ mixed, y]))
    accumulator.push(np.arange(m) / RATE, rows)
    return accumulator.finish()


@pytest.mark.parametrize(("memory", "least"), [(0.0, 0.87), (0.5, 0.85), (1.5, 0.77)])
@pytest.mark.parametrize("kind", ["by_time_and_joints", "by_joint"])
def test_intervals_hold_the_truth_on_average_and_less_often_for_a_constant(memory, least, kind):
    held = []
    for seed in range(120):
        reduction = draw_shared(seed, memory)
        solution = solve_ordinary(reduction)
        held.append(np.abs(solution.values - 1.0) <= statistics(reduction, solution, kind).half_widths())
    # Of 720 intervals, 95 % are 684 ± 6; those of one draw go together.
    assert 0.92 <= np.mean(held) <= 0.985
    # A constant is what slow residuals resemble most. Blocks are joined until no dependence is significant over all
    # columns together, which is too early for one of them: its intervals are too narrow.
    assert np.mean(held, axis=0).min() >= least


def test_variances_grow_as_those_of_sums_over_neighbours_that_depend_on_each_other():
    rng = np.random.default_rng(5)
    steps = np.column_stack([smooth(rng, (4000, 1), pole) for pole in (0.0, 0.6, 0.99)])
    # (1 + ρ) / (1 - ρ), up to a correlation of 0.9.
    assert compute_neighbour_growth([steps]) == pytest.approx([1.0, 4.0, 19.0], rel=0.1)
    # Groups do not follow each other: of two samples each, one pair is left.
    assert compute_neighbour_growth([steps[:2], steps[2:4]])[0] == compute_neighbour_growth([steps[2:4], steps[:2]])[0]
    # Twenty independent ones grow little by chance, and their order would be all that tells.
    chance = [compute_neighbour_growth([rng.standard_normal((20, 8))]) for _ in range(200)]
    assert 1.0 <= np.mean(chance) < 1.15
    assert compute_neighbour_growth([np.zeros((0, 3))]).tolist() == [1.0] * 3
    # Of 100 samples with ρ = 0.5, a variance is known as of 60 independent ones.
    assert count_growth_worth(np.array([3.0]), np.array([1.0])) == pytest.approx([0.6])


@pytest.mark.parametrize("kind", ["by_time_and_joints", "by_joint"])
def test_intervals_depend_neither_on_the_order_of_parameters_nor_on_their_units(kind):
    # Parameters that are hard to tell apart: what the columns before it explain of one depends on the order.
    alike = np.eye(6) + 0.8 * np.eye(6, k=5) + 0.8 * np.eye(6, k=1)
    order, units = np.array([5, 2, 0, 3, 1, 4]), np.array([1.0, 1e-3, 20.0, 1e4, 0.3, 7.0])
    for seed in range(8):
        plain, changed = draw_shared(seed, 1.5, mixed=alike), draw_shared(seed, 1.5, mixed=(alike * units)[:, order])
        one, other = (statistics(data, solve_ordinary(data), kind) for data in (plain, changed))
        np.testing.assert_allclose(other.standard_deviations * units[order], one.standard_deviations[order], rtol=1e-8)
        np.testing.assert_allclose(other.freedom, one.freedom[order], rtol=1e-8)


def test_a_held_parameter_stays_certain_where_neighbours_widen_the_others():
    steps = smooth(np.random.default_rng(6), (4000, 2), 0.6)
    directions = np.array([[1.0, 0.0], [0.0, 0.0], [0.6, 0.8]])
    widened = widen_for_neighbours(np.eye(2), [steps], directions)
    assert np.diag(directions @ widened @ directions.T) == pytest.approx([4.0, 0.0, 4.0], rel=0.1)


def test_blocks_are_joined_only_where_neighbours_depend_on_each_other():
    counts = {memory: [] for memory in (0.0, 0.02, 1.5)}
    for memory, found in counts.items():
        for seed in range(40):
            reduction = draw_shared(seed, memory)
            found.append(join_dependent_blocks(reduction, solve_ordinary(reduction)).n_blocks)
    whole = draw_shared(0, 0.0).n_blocks
    # One in forty by chance.
    assert np.mean(np.array(counts[0.0]) == whole) >= 0.9
    assert np.mean(np.array(counts[0.02]) == whole) >= 0.8
    assert max(counts[1.5]) < whole
    assert min(counts[1.5]) >= 5


def test_statistics_join_blocks_once(monkeypatch):
    reduction = draw_shared(0, 1.5)
    solution = solve_ordinary(reduction)
    worth = count_effective_rows(reduction, solution)

    def refuse(*_):
        raise AssertionError("joined again")

    monkeypatch.setattr(residual_correlation, "join_dependent_blocks", refuse)
    np.testing.assert_array_equal(statistics(reduction, solution).effective_rows, worth)


@pytest.mark.parametrize("spread", [0.02, 0.2])
def test_weights_settle_beside_a_prior_whether_blocks_are_joined_or_not(spread):
    # Residuals of this memory are about as often joined as not: a decision in every round never ended in 1 of 30.
    prior = build_prior(np.array([1.3, 0.7]), spread**2 * np.eye(2), np.array([5, 0]), 6)
    assert all(solve_weighted(draw_shared(seed, 0.5), prior).converged for seed in range(100))


@pytest.mark.parametrize(
    ("true", "share"),
    [
        (np.full(6, 2.4), 0.4),
        (np.full(6, 10.0), 0.6),
        (2.4 * np.array([1.0, 1.1, 1.3, 1.5, 1.8, 2.0]), 0.9),
        # Joints as different as on an arm that moves slowly: nothing is to be had, and nothing is lost.
        (2.4 * np.array([1.0, 1.2, 1.5, 3.0, 4.0, 5.0]), 1.05),
    ],
)
def test_pooled_factors_are_nearer_to_the_true_ones(true, share):
    rng, freedom = np.random.default_rng(3), np.array([20.0, 20.0, 16.0, 16.0, 12.0, 12.0])
    own = true * rng.chisquare(freedom, (400, 6)) / freedom
    pooled = np.array([pool_correlation_factors(factors, freedom, 2.4) for factors in own])
    errors, own_errors = (np.sqrt(np.mean(np.log(factors / true) ** 2)) for factors in (pooled, own))
    assert errors < share * own_errors
    # The logarithms of the own factors are some 0.06 too small in the mean.
    assert np.log(pooled / true).mean() == pytest.approx(0.0, abs=0.15)


def test_pooled_factors_are_known_as_well_as_what_they_are_drawn_to():
    freedom = np.array([20.0, 20.0, 10.0])
    # The same factor three times: the mean has the freedom of all, nearly. Far from each other, each has its own.
    assert count_pooled_freedom(np.full(3, 2.4), freedom) == pytest.approx(2 * 9 / np.sum(2 / freedom))
    assert count_pooled_freedom(np.array([1.0, 1e3, 1e6]), freedom) == pytest.approx(10.0, rel=0.02)
    # One joint alone: only what is known of noise draws it.
    assert count_pooled_freedom(np.array([3.0]), freedom[:1]) == pytest.approx(20.0)
    assert pool_correlation_factors(np.array([1.5]), freedom[:1], 2.4) == pytest.approx([2.4])
    assert pool_correlation_factors(np.array([24.0]), freedom[:1], 2.4) == pytest.approx([24.0], rel=0.05)
