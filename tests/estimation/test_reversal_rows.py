"""Rows where a joint turns round have a noise of their own: told from the others, and weighed by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.estimation import (
    BlockRows,
    FactorAccumulator,
    IntervalRows,
    PriorInformation,
    Reduction,
    RowGroup,
    SeparateRows,
    compute_errors,
    compute_row_noise,
    concatenate_reductions,
    estimate_group_weights,
    merge_row_groups,
    solve,
    solve_ordinary,
    solve_weighted,
)
from dynident.estimation.least_squares import ReweightedEquations

N_ROWS, N_COLUMNS, STRETCHES = 600, 4, 12
COLUMNS = [np.array([0, 1, 2]), np.array([1, 2, 3])]
TRUTH = np.array([2.0, -1.0, 0.5, 3.0])


def rows(seed: int, noise: tuple[float, float], share: float = 0.1) -> tuple[list[np.ndarray], np.ndarray]:
    """[W | Y] of two equations, and at which rows (m, 2) their joints turn round, with noise of its own there."""
    rng = np.random.default_rng(seed)
    turns = rng.random((N_ROWS, 2)) < share
    found = []
    for k, columns in enumerate(COLUMNS):
        w = rng.normal(size=(N_ROWS, 3))
        y = w @ TRUTH[columns] + rng.normal(size=N_ROWS) * np.where(turns[:, k], noise[1], noise[0])
        found.append(np.column_stack([w, y]))
    return found, turns


def reduction(found: list[np.ndarray], turns: np.ndarray) -> Reduction:
    # Every fourth of the other rows is beside a halt.
    starts = ~turns & (np.arange(N_ROWS) % 4 == 0)[:, None]
    accumulator = FactorAccumulator(3 * COLUMNS, N_COLUMNS, N_ROWS / STRETCHES)
    accumulator.push(np.arange(N_ROWS, dtype=float), 3 * found, np.hstack([~turns & ~starts, turns, starts]))
    return merge_row_groups(accumulator.finish())


def by_rows(found: list[np.ndarray], turns: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Least squares of rows, those where joints turn round divided by their noise; both equations count alike."""
    stacked = np.zeros((2 * N_ROWS, N_COLUMNS + 1))
    for k, columns in enumerate(COLUMNS):
        part = slice(k * N_ROWS, (k + 1) * N_ROWS)
        scale = np.where(turns[:, k], np.sqrt(weights[k]), 1.0)[:, None]
        stacked[part, columns], stacked[part, -1:] = scale * found[k][:, :-1], scale * found[k][:, -1:]
    return np.linalg.lstsq(stacked[:, :-1], stacked[:, -1])[0]


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1000), st.tuples(st.floats(0.001, 1.0), st.floats(0.001, 1.0)))
def test_a_solution_is_that_of_rows_divided_by_their_noise_whatever_they_were_weighed_by_before(seed, given_weights):
    found, turns = rows(seed, (0.1, 0.5))
    weights = np.array(given_weights)
    once = reduction(found, turns).weight_groups(weights)
    again = reduction(found, turns).weight_groups(np.array([0.3, 0.02])).weight_groups(weights)
    expected = by_rows(found, turns, weights)
    np.testing.assert_allclose(solve_ordinary(once).values, expected, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(solve_ordinary(again).values, expected, rtol=1e-9, atol=1e-10)


def test_weights_are_what_the_noise_of_either_kind_of_rows_says():
    weights = estimate_group_weights(reduction(*rows(1, (0.1, 0.5))))
    assert weights == pytest.approx([1 / 25] * 2, rel=0.4)


@pytest.mark.parametrize("is_known", [False, True])
def test_weights_agree_with_the_solution_that_they_give(is_known):
    data = reduction(*rows(4, (0.1, 0.5)))
    known = PriorInformation(np.eye(N_COLUMNS), TRUTH) if is_known else None
    weights = estimate_group_weights(data, known)
    values = solve_weighted(data.weight_groups(weights), known).values
    for equation, weight in zip(data.equations, weights, strict=True):
        group, own = equation.weighted_rows, values[equation.columns]
        count = equation.counts.sum() - group.count
        squares = equation.sum_squares(values).sum() - group.sum_squares(own)
        assert weight == pytest.approx((squares / count) / (group.sum_squares(own) / group.count), rel=0.02)


def test_equations_by_themselves_have_the_squares_of_their_rows_and_the_solution_with_any_noise():
    data = reduction(*rows(5, (0.1, 0.5)))
    equations = ReweightedEquations.from_solution(data, solve_ordinary(data))
    for noise in (np.array([0.1, 0.4]), np.array([1e-6, 1.0])):
        values = equations.solve(noise)
        np.testing.assert_allclose(values, solve(data, noise).values, rtol=1e-9)
        expected = [equation.sum_squares(values).sum() for equation in data.equations]
        np.testing.assert_allclose(equations.sum_squares(values), expected, rtol=1e-9)


def test_rows_that_are_quieter_where_a_joint_turns_round_count_as_the_others_do():
    assert (estimate_group_weights(reduction(*rows(1, (0.5, 0.1)))) == 1.0).all()


def test_estimates_come_nearer_to_the_truth_than_with_all_rows_alike():
    drawn = [reduction(*rows(seed, (0.1, 2.0))) for seed in range(20)]
    alike = [solve_weighted(one).values - TRUTH for one in drawn]
    weighed = [solve_weighted(one.weight_groups(estimate_group_weights(one))).values - TRUTH for one in drawn]
    assert np.linalg.norm(weighed) < 0.4 * np.linalg.norm(alike)


def test_errors_are_told_of_all_rows_alike_whatever_they_count_for():
    found, turns = rows(2, (0.1, 0.5))
    data = reduction(found, turns)
    weighed = data.weight_groups(np.array([0.1, 0.0]))
    values = TRUTH + 0.1
    rests = [own[:, -1] - own[:, :-1] @ values[columns] for own, columns in zip(found, COLUMNS, strict=True)]
    for one in (data, weighed):
        assert compute_errors(one, values).squares == pytest.approx([rest @ rest for rest in rests])
        assert compute_errors(one, values).measured == pytest.approx([own[:, -1] @ own[:, -1] for own in found])
    assert compute_row_noise(weighed, values) == pytest.approx(compute_row_noise(data, values))


@pytest.mark.parametrize("picked", [[0, 1, 2, 3], [3, 1], [2]])
def test_fewer_columns_and_combinations_of_them_keep_what_is_told_apart(picked):
    found, turns = rows(3, (0.1, 0.5))
    weights = np.array([0.04, 0.2])
    change = np.eye(N_COLUMNS)[:, picked]
    for smaller in (reduction(found, turns).select_columns(picked), reduction(found, turns).combine_columns(change)):
        expected = reduction(found, turns).weight_groups(weights).select_columns(picked)
        np.testing.assert_allclose(
            solve_ordinary(smaller.weight_groups(weights)).values, solve_ordinary(expected).values
        )


def test_recordings_behind_one_another_are_told_apart_where_all_of_them_are():
    drawn = [rows(seed, (0.1, 0.5), share) for seed, share in ((4, 0.02), (5, 0.3))]
    both = concatenate_reductions([reduction(*one) for one in drawn])
    stacked = [np.concatenate([one[0][k] for one in drawn]) for k in range(2)]
    turns = np.concatenate([one[1] for one in drawn])
    assert [e.weighted_rows.counts.sum() for e in both.equations] == turns.sum(axis=0).tolist()
    rest = stacked[0][turns[:, 0]]
    assert both.equations[0].weighted_rows.sum_squares(TRUTH[COLUMNS[0]]) == pytest.approx(
        float(((rest[:, -1] - rest[:, :-1] @ TRUTH[COLUMNS[0]]) ** 2).sum())
    )
    plain = reduction(*drawn[0])
    mixed = concatenate_reductions([plain, plain.select_columns(range(N_COLUMNS)).select_blocks(range(3))])
    assert mixed.equations[0].weighted_rows is None


def test_of_recordings_that_are_not_all_told_apart_it_is_known_all_the_same_which_rows_turn():
    nothing = BlockRows(np.zeros((0, 0, len(COLUMNS[0]) + 1)), np.zeros(0, dtype=int))
    standing = np.zeros((0, len(COLUMNS[0])))
    beside = SeparateRows(None, nothing, IntervalRows(standing, standing, np.zeros(0), np.zeros(0)))
    told = replace(reduction(*rows(4, (0.1, 0.5))).equations[0], separate_rows=beside)
    mixed = concatenate_reductions(
        [Reduction(N_COLUMNS, (one,), np.zeros((0, 2))) for one in (told, told.with_fixed_weights)]
    )
    turning = mixed.equations[0].group_rows
    assert isinstance(turning, RowGroup)
    assert turning.count == 2 * told.weighted_rows.count
    assert turning.sum_squares(TRUTH[COLUMNS[0]]) == pytest.approx(
        2 * told.weighted_rows.sum_squares(TRUTH[COLUMNS[0]])
    )


def test_where_no_joint_turns_round_nothing_changes():
    found, _ = rows(6, (0.1, 0.5))
    data = reduction(found, np.zeros((N_ROWS, 2), dtype=bool))
    assert (estimate_group_weights(data) == 1.0).all()
    np.testing.assert_array_equal(
        solve_ordinary(data.weight_groups(np.full(2, 0.5))).values, solve_ordinary(data).values
    )


def test_a_zero_row_among_others_loses_none_of_them() -> None:
    factors = np.zeros((2, 4, 4))
    factors[:, 0, :] = 1.0
    factors[:, 2, 2:] = 3.0
    group_rows = BlockRows.from_factors(factors, np.array([5, 7]))
    np.testing.assert_array_equal(
        np.einsum("sri,srj->sij", group_rows.rows, group_rows.rows),
        np.einsum("sri,srj->sij", factors, factors),
    )
