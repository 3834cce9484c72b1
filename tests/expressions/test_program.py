"""Machine code over many samples against CasADi's own evaluation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import arm, random_states

from dynident.effects import EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.expressions import Program, UnsupportedOperationError
from dynident.regressors.observation_matrix import Observation

X, Y = ca.SX.sym("x", 3), ca.SX.sym("y")
a, b, c = X[0], X[1], X[2]
positive = ca.fabs(b) + 0.1

EXPRESSIONS = {
    "neg": -a, "sq": a * a, "twice": a + a, "sin": ca.sin(a), "cos": ca.cos(a), "tan": ca.tan(a), "exp": ca.exp(a),
    "log": ca.log(positive), "sqrt": ca.sqrt(positive), "tanh": ca.tanh(a), "fabs": ca.fabs(a), "sign": ca.sign(a),
    "inv": 1 / positive, "not": ca.logic_not(a), "atan": ca.atan(a), "add": a + b, "sub": a - b, "mul": a * b,
    "div": a / positive, "pow": positive**c, "constpow": positive**0.7, "fmin": ca.fmin(a, b), "fmax": ca.fmax(a, b),
    "lt": a < b, "le": a <= b, "eq": a == b, "ne": a != b, "and": ca.logic_and(a, b), "or": ca.logic_or(a, b),
    "if_else": ca.if_else(a > b, ca.sin(a), b * c), "if_else_zero": ca.if_else(a > 0, b, 0),
    "atan2": ca.atan2(a, b), "copysign": ca.copysign(a, b), "constant": ca.SX(2.5), "input": c, "twice_out": a,
    "scalar": Y * a, "asin": ca.asin(ca.tanh(a)), "acos": ca.acos(ca.tanh(a)), "sinh": ca.sinh(a), "cosh": ca.cosh(a),
    "floor": ca.floor(a), "ceil": ca.ceil(a), "erf": ca.erf(a), "fmod": ca.fmod(a, positive),
    "log1p": ca.log1p(positive),
    "expm1": ca.expm1(a), "hypot": ca.hypot(a, b), "asinh": ca.asinh(a), "atanh": ca.atanh(ca.tanh(a)),
    "acosh": ca.acosh(1 + positive),
}  # fmt: skip
ALL = ca.vertcat(*EXPRESSIONS.values())
EVERYTHING = Program([X, Y], ALL)


def casadi_values(expression: ca.SX, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    nonzeros = expression.nz[:] if expression.nnz() else ca.SX(0, 1)
    function = ca.Function("f", [X, Y], [nonzeros])
    return np.array([np.array(function(*row)).ravel() for row in zip(x, y, strict=True)]).reshape(len(x), -1)


@settings(max_examples=30, deadline=None)
@given(m=st.integers(1, 60), seed=st.integers(0, 2**32 - 1), zeros=st.booleans())
def test_any_number_of_samples_is_what_casadi_gives_sample_by_sample(m, seed, zeros):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(m, 3)), rng.normal(size=(m, 1))
    if zeros:
        x[::2, 0] = 0.0
        x[::3, 1] = x[::3, 0]
    np.testing.assert_allclose(EVERYTHING(x, y), casadi_values(ALL, x, y), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_every_operation_alone_is_what_casadi_gives(name):
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(50, 3)), rng.normal(size=(50, 1))
    x[:5, 0] = 0.0
    found = Program([X, Y], EXPRESSIONS[name])(x, y)
    np.testing.assert_allclose(found, casadi_values(EXPRESSIONS[name], x, y), rtol=1e-13)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_expressions_drawn_at_random_are_what_casadi_gives(data):
    # Shared subexpressions, dead ends, values used twice and outputs that feed on one another.
    pool = [a, b, c, Y, ca.SX(0.5)]
    for _ in range(data.draw(st.integers(1, 25))):
        left, right = (pool[data.draw(st.integers(0, len(pool) - 1))] for _ in range(2))
        made = data.draw(st.sampled_from(["+", "-", "*", "sin", "tanh", "sq", "fmin"]))
        pool.append(
            {
                "+": left + right, "-": left - right, "*": left * right, "sin": ca.sin(left), "tanh": ca.tanh(left),
                "sq": ca.tanh(left) ** 2, "fmin": ca.fmin(left, right),
            }[made]
        )  # fmt: skip
    chosen = data.draw(st.lists(st.integers(0, len(pool) - 1), min_size=1, max_size=8))
    expression = ca.densify(ca.vertcat(*(ca.tanh(pool[k]) if k >= 5 else pool[k] for k in chosen)))
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(7, 3)), rng.normal(size=(7, 1))
    np.testing.assert_allclose(
        Program([X, Y], expression)(x, y), casadi_values(expression, x, y), rtol=1e-10, atol=1e-10
    )


def test_a_value_for_all_samples_is_broadcast():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(4013, 3))
    np.testing.assert_array_equal(EVERYTHING(x, np.array([0.7])), EVERYTHING(x, np.full((len(x), 1), 0.7)))


def test_no_samples_give_no_rows():
    assert Program([X, Y], ALL)(np.empty((0, 3)), np.empty((0, 1))).shape == (0, ALL.nnz())


def test_an_empty_expression_gives_empty_rows():
    assert Program([X, Y], ca.SX(6, 4))(np.zeros((5, 3)), np.zeros((5, 1))).shape == (5, 0)


def test_inputs_of_different_lengths_are_refused():
    with pytest.raises(ValueError):
        EVERYTHING(np.zeros((5, 3)), np.zeros((4, 1)))
    with pytest.raises(ValueError):
        EVERYTHING(np.zeros((5, 3)), np.zeros((1, 1)))


def test_inputs_of_other_widths_are_refused():
    with pytest.raises(ValueError, match="numbers a sample"):
        EVERYTHING(np.zeros((5, 2)), np.zeros((5, 1)))


def test_columns_of_larger_tables_are_read_and_written_in_place():
    table, result = np.random.default_rng(4).normal(size=(31, 9)), np.full((31, ALL.numel() + 2), 7.0)
    EVERYTHING(table[:, 2:5], table[:, 8:], out=result[:, 1:-1])
    np.testing.assert_array_equal(result[:, 1:-1], EVERYTHING(table[:, 2:5].copy(), table[:, 8:].copy()))
    assert (result[:, [0, -1]] == 7.0).all()
    backwards = EVERYTHING(np.asfortranarray(table[::-1, 2:5]), table[::-1, 8:])
    np.testing.assert_array_equal(backwards, result[::-1, 1:-1])


def test_a_result_in_the_place_of_an_input_is_that_of_the_input_as_it_was():
    shifted = Program([X], ca.vertcat(c, a, ca.sin(b)))
    table = np.random.default_rng(5).normal(size=(31, 3))
    expected = shifted(table.copy())
    np.testing.assert_array_equal(shifted(table, out=table), expected)
    longer = np.vstack([table, np.zeros(3)])
    expected = shifted(longer[:-1].copy())
    np.testing.assert_array_equal(shifted(longer[:-1], out=longer[1:]), expected)


def test_a_result_that_is_read_only_is_refused():
    held = np.zeros((5, ALL.numel()))
    held.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        EVERYTHING(np.zeros((5, 3)), np.zeros((5, 1)), out=held)
    assert not held.any()


def test_what_is_no_number_goes_through():
    x = np.full((5, 3), np.nan)
    run = Program([X, Y], ca.vertcat(ca.sign(a), ca.fmin(a, b), ca.fmax(Y, a), ca.if_else(a > 0, a, 0)))
    np.testing.assert_array_equal(run(x, np.ones((5, 1)))[0], [np.nan, np.nan, np.nan, 0.0])


def test_an_operation_without_a_translation_is_named():
    with pytest.raises(
        UnsupportedOperationError, match="operation erfinv, which cannot be evaluated here; write it with these: acos, "
    ):
        Program([X, Y], ca.erfinv(a))(np.zeros((1, 3)), np.zeros((1, 1)))


def test_several_threads_at_once_do_not_disturb_each_other():
    robot = arm("ur10")
    signals = Signals(robot)
    observation = Observation.from_columns(
        robot, build_columns([EffectChoice("rigid_body"), EffectChoice("coulomb")], signals), signals
    )
    reference, no_memory = ReferenceParameters.massless(robot), np.zeros((3000, 0))
    inputs = [random_states(robot, 3000, seed) for seed in range(6)]

    def evaluate(states):
        return observation.evaluate(*states, reference=reference, memory=no_memory)

    alone = [evaluate(states) for states in inputs]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            for together, expected in zip(pool.map(evaluate, inputs), alone, strict=True):
                np.testing.assert_array_equal(together, expected)


def test_results_do_not_share_memory_with_later_calls():
    rng = np.random.default_rng(3)
    first = EVERYTHING(rng.normal(size=(4, 3)), np.ones((4, 1)))
    kept = first.copy()
    EVERYTHING(rng.normal(size=(4, 3)), np.ones((4, 1)))
    np.testing.assert_array_equal(first, kept)


@pytest.mark.parametrize("name", ["sin", "cos", "tan", "exp", "log", "atan", "tanh", "asin", "sinh", "expm1", "erf"])
def test_functions_of_several_numbers_at_once_are_those_of_one_and_know_what_is_none(name):
    function = Program([Y], getattr(ca, name)(Y))
    special = [0.0, -0.0, np.nan, np.inf, -np.inf, 1e300, -1e10, 1e-300, 0.5, 1.0, 700.0, 1e5]
    y = np.concatenate([special, np.random.default_rng(8).normal(size=500)])[:, None]
    with np.errstate(invalid="ignore", over="ignore"):
        one_by_one = np.concatenate([function(y[k : k + 1]) for k in range(len(y))])
    np.testing.assert_allclose(function(y), one_by_one, rtol=4 * np.finfo(float).eps, atol=1e-300)


def test_what_several_numbers_are_divided_by_is_as_good_as_divided_by():
    rng = np.random.default_rng(0)
    x = rng.uniform(0.5, 2.0, (50, 3))
    quotients = Program([X], ca.vertcat(a / b, c / b, (a + c) / b, b / c))
    expected = np.stack([x[:, 0] / x[:, 1], x[:, 2] / x[:, 1], (x[:, 0] + x[:, 2]) / x[:, 1], x[:, 1] / x[:, 2]], 1)
    np.testing.assert_allclose(quotients(x), expected, rtol=4e-16)
