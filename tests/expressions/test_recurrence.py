"""A state stepped through time in machine code, against a loop in Python."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynident.expressions import Recurrence

X, U, P = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 2)
# Each state needs both old ones: a step that wrote the first too early would show.
FOLLOWING = ca.vertcat(P[0] * X[1] + U, ca.sin(X[0]) - P[1] * X[1])
STEPS = Recurrence(X, U, P, FOLLOWING, ca.vertcat(X[0] * U, X[1], ca.SX(3.0)))


def test_a_state_is_stepped_as_a_loop_would():
    rng = np.random.default_rng(0)
    u, p, x = rng.normal(size=(40, 1)), np.array([0.7, 0.4]), np.array([0.3, -0.2])
    expected = []
    last = x
    for value in u[:, 0]:
        expected.append([last[0] * value, last[1], 3.0])
        last = np.array([p[0] * last[1] + value, np.sin(last[0]) - p[1] * last[1]])
    end, samples = STEPS.run(x, u, p)
    np.testing.assert_allclose(samples, expected, rtol=1e-13)
    np.testing.assert_allclose(end, last, rtol=1e-13)
    middle, first = STEPS.run(x, u[:17], p)
    np.testing.assert_array_equal(np.vstack([first, STEPS.run(middle, u[17:], p)[1]]), samples)


def test_no_steps_leave_the_state_as_it_is():
    end, samples = STEPS.run(np.array([1.0, 2.0]), np.zeros((0, 1)), np.zeros(2))
    assert end.tolist() == [1.0, 2.0]
    assert samples.shape == (0, 3)


@pytest.mark.parametrize("sizes", [(3, 1, 2), (2, 2, 2), (2, 1, 1)])
def test_other_sizes_are_refused(sizes):
    with pytest.raises(ValueError, match="needed"):
        STEPS.run(np.zeros(sizes[0]), np.zeros((4, sizes[1])), np.zeros(sizes[2]))
