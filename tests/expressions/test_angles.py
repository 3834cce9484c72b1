"""Sines and cosines that are known before their angles are."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynident.expressions.sines_and_cosines import AngleTerms, substitute_angles

X, Y = ca.SX.sym("x", 2), ca.SX.sym("y")


def value(expression: ca.SX, **given: float) -> np.ndarray:
    symbols = ca.symvar(expression)
    return ca.Function("f", symbols, [expression])(*(given[one.name()] for one in symbols)).full()


def test_sines_of_symbols_are_those_given_and_all_else_is_of_the_angle() -> None:
    given = AngleTerms(ca.SX.sym("angle", 2), ca.SX.sym("c", 2), ca.SX.sym("s", 2))
    expression = ca.horzcat(ca.sin(X[0]) * Y + X[0], ca.SX(1, 1), ca.cos(X[1] + Y), ca.if_else(Y > 0, ca.cos(X[1]), 2))
    found = substitute_angles(expression, X, given)
    assert found.sparsity() == expression.sparsity()
    expected = ca.horzcat(
        given.sines[0] * Y + given.angles[0], ca.SX(1, 1), ca.cos(given.angles[1] + Y),
        ca.if_else(Y > 0, given.cosines[1], 2),
    )  # fmt: skip
    numbers = dict(zip(("angle_0", "angle_1", "c_0", "c_1", "s_0", "s_1"), (0.3, 0.4, 0.5, 0.6, 0.7, 0.8), strict=True))
    for y in (-1.0, 2.0):
        np.testing.assert_array_equal(value(found, **numbers, y=y), value(expected, **numbers, y=y))


def test_an_expression_without_the_symbols_stays() -> None:
    expression = ca.sin(Y) * Y
    assert substitute_angles(expression, X, AngleTerms.from_angles(X)) is expression


@pytest.mark.parametrize("longest", [1e-9, 1e-3, 0.1, 0.25, 1.0])
def test_a_step_onward_turns_exactly(longest: float) -> None:
    start, step = 0.7, np.linspace(-longest, longest, 41)
    made = AngleTerms.from_angles(ca.SX(start)).add_steps(Y, np.array([longest]))
    found = ca.Function("f", [Y], list(made.parts)).map(len(step)).call([step[None]])
    angles, cosines, sines = (one.full().ravel() for one in found)
    np.testing.assert_allclose(angles, start + step, rtol=1e-15)
    np.testing.assert_allclose(cosines, np.cos(start + step), atol=3e-16)
    np.testing.assert_allclose(sines, np.sin(start + step), atol=3e-16)


def test_the_tangent_of_half_an_angle_gives_all_of_it() -> None:
    angles = np.linspace(-1.5, 2.5, 41)
    made = AngleTerms.from_half_tangents(Y, 0.5)
    found = ca.Function("f", [Y], list(made.parts)).map(len(angles)).call([np.tan(0.5 * (angles - 0.5))[None]])
    for one, expected in zip(found, (angles, np.cos(angles), np.sin(angles)), strict=True):
        np.testing.assert_allclose(one.full().ravel(), expected, atol=1e-15)
