"""Least squares under constraints, against cvxpy's formulation of the same problem and against scipy."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from dynident.estimation.constrained_least_squares import (
    EqualityConstraints,
    InfeasibleError,
    MatrixBound,
    solve_constrained,
)


def symmetric(rng: np.random.Generator, *shape: int) -> np.ndarray:
    a = rng.normal(size=shape)
    return a + np.swapaxes(a, -1, -2)


@pytest.mark.parametrize("seed", range(5))
def test_a_bounded_solution_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    factor, right = rng.normal(size=(12, 5)), rng.normal(size=12)
    found = solve_constrained(factor, right, not_negative=range(5))
    expected = nnls(factor, right)[0]
    np.testing.assert_allclose(found.values, expected, atol=1e-8)
    # What is held are the parameters that scipy has at zero.
    held = sorted(int(np.flatnonzero(row)[0]) for row in found.held)
    assert held == list(np.flatnonzero(expected == 0))


@pytest.mark.parametrize("seed", range(5))
def test_a_solution_with_positive_semidefinite_matrices_is_that_of_cvxpy(seed):
    rng = np.random.default_rng(seed)
    factor, right = rng.normal(size=(14, 7)), 3 * rng.normal(size=14)
    bounds = [
        MatrixBound(np.array([0, 1, 2, 3]), symmetric(rng, 4, 3, 3), 0.5 * np.eye(3)),
        MatrixBound(np.array([3, 4, 5]), symmetric(rng, 3, 4, 4), np.eye(4)),
    ]
    equations = EqualityConstraints(rng.normal(size=(1, 7)), np.array([0.1]))
    found = solve_constrained(factor, right, bounds, [6], equations)

    x = cp.Variable(7)
    constraints = [x[6] >= 0, equations.factor @ x == equations.right]
    constraints += [
        bound.constant + sum(x[int(k)] * part for k, part in zip(bound.columns, bound.parts, strict=True)) >> 0
        for bound in bounds
    ]
    cp.Problem(cp.Minimize(cp.sum_squares(factor @ x - right)), constraints).solve(solver="SCS", eps=1e-10)
    np.testing.assert_allclose(found.values, x.value, atol=1e-5)
    for bound in bounds:
        assert np.linalg.eigvalsh(bound.evaluate(found.values)).min() > -1e-8
    np.testing.assert_allclose(equations.factor @ found.values, equations.right, atol=1e-9)


def test_constraints_that_hold_nothing_back_leave_the_least_squares_solution():
    rng = np.random.default_rng(3)
    factor, truth = rng.normal(size=(30, 4)), np.array([2.0, 0.1, 1.0, 0.5])
    bound = MatrixBound(np.arange(3), np.array([[[1.0, 0], [0, 0]], [[0, 1.0], [1.0, 0]], [[0, 0], [0, 1.0]]]),
                        np.zeros((2, 2)))  # fmt: skip
    found = solve_constrained(factor, factor @ truth, [bound], [3])
    np.testing.assert_allclose(found.values, truth, rtol=1e-8)
    assert len(found.held) == 0


def test_a_matrix_at_its_bound_holds_the_direction_that_would_leave_it():
    # [[a, b], [b, c]] nearest to [[1, 2], [2, 1]]: eigenvalues 3 and -1 become 3 and 0.
    parts = np.array([[[1.0, 0], [0, 0]], [[0, 1.0], [1.0, 0]], [[0, 0], [0, 1.0]]])
    weights = np.diag([1.0, np.sqrt(2.0), 1.0])
    bound = MatrixBound(np.arange(3), parts, np.zeros((2, 2)))
    found = solve_constrained(weights, weights @ [1.0, 2.0, 1.0], [bound])
    np.testing.assert_allclose(found.values, [1.5, 1.5, 1.5], atol=1e-7)
    assert found.held.shape == (1, 3)
    np.testing.assert_allclose(found.held[0] / found.held[0, 0], [1.0, -2.0, 1.0], atol=1e-4)


def test_constraints_that_contradict_one_another_are_called_infeasible():
    bound = MatrixBound(np.array([0]), np.array([[[1.0]]]), np.array([[-1.0]]))
    equations = EqualityConstraints(np.array([[1.0, 0.0]]), np.array([0.5]))
    with pytest.raises(InfeasibleError, match="no parameters satisfy"):
        solve_constrained(np.eye(2), np.zeros(2), [bound], (), equations)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(1e-6, 1e6))
def test_the_units_of_the_residual_do_not_matter(seed, size):
    rng = np.random.default_rng(seed)
    factor, right = rng.normal(size=(9, 3)), rng.normal(size=9)
    parts = symmetric(rng, 3, 3, 3)
    bound = MatrixBound(np.arange(3), parts, np.eye(3))
    one = solve_constrained(factor, right, [bound]).values
    other = solve_constrained(size * factor, size * right, [bound]).values
    # Near its least value the sum of squares is flat: it is known to many more digits than where it is least.
    np.testing.assert_allclose(one, other, atol=1e-4)
    assert np.sum((factor @ one - right) ** 2) == pytest.approx(np.sum((factor @ other - right) ** 2), rel=1e-6)
    assert np.linalg.eigvalsh(bound.evaluate(other)).min() > -1e-7
