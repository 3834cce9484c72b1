"""Which parameters are told apart badly, on columns whose dependence is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.estimation import FactorAccumulator, compute_pooled_statistics, solve_ordinary
from dynident.estimation.parameter_correlation import Collinearity, find_collinearity

M = 2000


def found(w: np.ndarray, **more) -> Collinearity:
    rng = np.random.default_rng(1)
    accumulator = FactorAccumulator([np.arange(w.shape[1])], w.shape[1], 2.0)
    y = w @ np.ones(w.shape[1]) + rng.normal(size=M)
    accumulator.push(np.arange(M) / 50.0, [np.column_stack([w, y])])
    reduction = accumulator.finish()
    solution = solve_ordinary(reduction)
    return find_collinearity(solution, compute_pooled_statistics(reduction, solution), **more)


def columns(share: float, seed: int = 0) -> np.ndarray:
    """Four columns, the second being the first but for a share."""
    w = np.random.default_rng(seed).normal(size=(M, 4))
    w[:, 1] = w[:, 0] + share * w[:, 1]
    return w


def test_columns_that_have_nothing_to_do_with_one_another_give_neither_pairs_nor_directions():
    result = found(columns(1.0)[:, [0, 2, 3]])
    assert result.pairs == ()
    assert result.directions == ()
    np.testing.assert_allclose(result.correlation, np.eye(3), atol=0.1)


def test_two_columns_alike_make_a_pair_with_the_known_correlation():
    share = 0.2
    pair = found(columns(share)).pairs[0]
    assert (pair.first, pair.second) == (0, 1)
    # Of columns x and x + s e: estimates correlate by -1 / sqrt(1 + s²).
    assert pair.correlation == pytest.approx(-1 / np.sqrt(1 + share**2), abs=0.01)


def test_two_columns_all_but_equal_are_a_direction_in_which_nothing_is_determined():
    w = columns(1e-4)
    direction = found(w * [1.0, 2.0, 1.0, 1.0]).directions[0]
    assert {number for number, _ in direction.parts} == {0, 1}
    weights = dict(direction.parts)
    # x and 2 x: what is seen is χ0 + 2 χ1, so that χ0 - 2 χ1 is not.
    assert weights[0] / weights[1] == pytest.approx(-0.5, rel=1e-3)
    assert direction.ratio == pytest.approx(2 / 1e-4, rel=0.1)
    assert direction.deviation > 100


@settings(max_examples=20, deadline=None)
@given(scales=st.lists(st.floats(1e-3, 1e3), min_size=4, max_size=4))
def test_units_change_neither_correlations_nor_ratios(scales):
    one, other = found(columns(1e-3)), found(columns(1e-3) * scales)
    np.testing.assert_allclose(one.correlation, other.correlation, atol=1e-5)
    assert [d.ratio for d in one.directions] == pytest.approx([d.ratio for d in other.directions], rel=1e-4)


def test_the_lists_are_no_longer_than_asked_for():
    w = np.random.default_rng(0).normal(size=(M, 1)) + 1e-4 * np.random.default_rng(1).normal(size=(M, 6))
    result = found(w, most=3)
    assert len(result.pairs) <= 3
    assert len(result.directions) == 3
    assert result.directions[0].ratio >= result.directions[-1].ratio
