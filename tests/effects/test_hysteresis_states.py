"""Hysteresis states against the recursion, one sample after the other."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynident.effects import DAHL, STOP, TRAVEL, MemorySignal, Operator
from dynident.effects.hysteresis_states import MemoryStates, build_step_expression, step_state

SIGNALS = (
    MemorySignal(STOP, 0, 2e-3),
    MemorySignal(DAHL, 0, 2e-3),
    MemorySignal(STOP, 1, 0.05),
    MemorySignal(DAHL, 1, 0.3),
    MemorySignal(STOP, 0, 0.5),
    MemorySignal(TRAVEL, 0, 2e-3),
    MemorySignal(TRAVEL, 1, 0.3),
)
PATH_ALONE = tuple(signal for signal in SIGNALS if signal.operator != TRAVEL)
# Moves of every size, with stretches of standstill.
moves = st.one_of(st.just(0.0), st.floats(-1, 1), st.floats(-3e-3, 3e-3), st.sampled_from([1e-12, -1e-12]))


@st.composite
def paths(draw):
    m = draw(st.integers(1, 60))
    return np.cumsum(draw(arrays(float, (m, 2), elements=moves)), axis=0)


@st.composite
def cuts(draw):
    return sorted(draw(st.lists(st.integers(0, 60), max_size=8)))


def naive(path: np.ndarray) -> np.ndarray:
    states = np.zeros(len(SIGNALS))
    out = np.empty((len(path), len(SIGNALS)))
    before = path[0]
    for k, here in enumerate(path):
        states = np.array(
            [step_state(s, z, here[s.joint] - before[s.joint]) for s, z in zip(SIGNALS, states, strict=True)]
        )
        out[k] = states
        before = here
    return out


@settings(max_examples=200, deadline=None)
@given(path=paths(), borders=cuts())
def test_states_are_those_of_the_recursion_however_the_run_is_cut_into_blocks(path, borders):
    memory = MemoryStates(SIGNALS)
    found = np.concatenate([memory.push(part) for part in np.split(path, [b for b in borders if b <= len(path)])])
    np.testing.assert_allclose(found, naive(path), atol=1e-9)
    assert np.abs(found).max() <= 1.0


@settings(max_examples=50, deadline=None)
@given(path=paths(), still=st.integers(1, 20))
def test_standing_still_changes_no_state(path, still):
    memory = MemoryStates(PATH_ALONE)
    before = memory.push(path)[-1]
    after = memory.push(np.repeat(path[-1:], still, axis=0))
    np.testing.assert_array_equal(after, np.tile(before, (still, 1)))


@settings(max_examples=50, deadline=None)
@given(path=paths(), still=st.integers(1, 20))
def test_a_joint_that_stands_still_forgets_what_it_travelled(path, still):
    memory = MemoryStates([signal for signal in SIGNALS if signal.operator == TRAVEL])
    memory.push(path)
    assert not memory.push(np.repeat(path[-1:], still, axis=0)).any()


@given(state=st.floats(-1, 1), displacement=moves)
def test_a_state_is_the_same_as_an_expression(state, displacement):
    for signal in SIGNALS:
        found = build_step_expression(signal, ca.SX(state), ca.SX(displacement))
        assert float(found) == pytest.approx(step_state(signal, state, displacement), abs=1e-12)


def test_a_new_run_starts_relaxed():
    memory = MemoryStates(SIGNALS)
    memory.push(np.array([[0.0, 0.0], [1.0, 1.0]]))
    memory.restart()
    assert not memory.push(np.array([[5.0, 5.0]])).any()


def test_no_samples_and_no_signals_are_nothing_special():
    assert MemoryStates(SIGNALS).push(np.empty((0, 2))).shape == (0, len(SIGNALS))
    assert MemoryStates(()).push(np.zeros((4, 2))).shape == (4, 0)


def test_travel_is_counted_from_the_last_stop_or_reversal_at_any_speed():
    slip = 0.02
    there, back = np.linspace(0, 0.05, 51), np.linspace(0.05, 0.02, 301)[1:]
    path = np.concatenate([there, back, np.full(20, back[-1]), back[-1] - there[1:]])[:, None]
    z = MemoryStates([MemorySignal(TRAVEL, 0, slip)]).push(path)[:, 0]
    expected = [
        1 - np.exp(-there / slip),
        np.exp(-(0.05 - back) / slip) - 1,
        np.zeros(20),
        np.exp(-there[1:] / slip) - 1,
    ]
    np.testing.assert_allclose(z, np.concatenate(expected), atol=1e-12)


def test_a_stop_operator_saturates_after_twice_its_slip_distance():
    signal = MemorySignal(STOP, 0, 0.01)
    path = np.concatenate([np.linspace(0, 0.05, 51), np.linspace(0.05, 0, 51)])[:, None]
    z = MemoryStates([signal]).push(path)[:, 0]
    assert z[10] == pytest.approx(1.0)  # 0.01 rad after the relaxed start
    back = np.linspace(0.05, 0, 51)
    np.testing.assert_allclose(z[51:], np.clip(1 - (0.05 - back) / 0.01, -1, 1), atol=1e-12)


def test_dahls_state_solves_its_differential_equation():
    # dz/dq = (1 - z sign q̇) / slip, integrated with small steps by Euler's method.
    slip = 0.02
    q = 0.05 * np.sin(np.linspace(0, 7, 200_001))
    z = MemoryStates([MemorySignal(DAHL, 0, slip)]).push(q[:, None])[:, 0]
    euler, x = np.empty(len(q)), 0.0
    for k, dq in enumerate(np.diff(q, prepend=q[0])):
        x += dq / slip * (1 - x * np.sign(dq))
        euler[k] = x
    np.testing.assert_allclose(z, euler, atol=1e-3)


class Half(Operator):
    """A rule of somebody's own: half of the way is remembered, up to one."""

    name = "half"

    def step(self, state, ratio):
        return ca.tanh(ca.atanh(state) + ratio / 2)

    def stroke(self, begun, ratio):
        return np.tanh(np.arctanh(begun) + ratio / 2)


def test_a_rule_of_ones_own_runs_beside_ours_and_differentiates_itself():
    mine = MemorySignal(Half(), 0, 0.1)
    assert mine == MemorySignal(Half(), 0, 0.1)
    path = np.cumsum(np.random.default_rng(0).normal(0, 0.02, (200, 1)), axis=0)
    states = MemoryStates([mine, MemorySignal(STOP, 0, 0.1)]).push(path)
    np.testing.assert_allclose(states[:, 0], np.tanh((path - path[0])[:, 0] / 0.2), atol=1e-9)
    np.testing.assert_array_equal(states[:, 1:], MemoryStates([MemorySignal(STOP, 0, 0.1)]).push(path))
    before, ratio = np.array([0.2, -0.5]), np.array([0.3, 0.1])
    passes, follows = Half().slopes(before, np.tanh(np.arctanh(before) + ratio / 2), ratio)
    step = 1e-6
    for slope, (up, down) in (
        (passes, ((before + step, ratio), (before - step, ratio))),
        (follows, ((before, ratio + step), (before, ratio - step))),
    ):
        numeric = (np.tanh(np.arctanh(up[0]) + up[1] / 2) - np.tanh(np.arctanh(down[0]) + down[1] / 2)) / (2 * step)
        np.testing.assert_allclose(slope, numeric, rtol=1e-6)


@pytest.mark.parametrize("operator", [STOP, DAHL, TRAVEL])
def test_slopes_in_closed_form_are_those_of_the_step(operator):
    rng = np.random.default_rng(1)
    before, ratio = rng.uniform(-0.9, 0.9, 50), rng.normal(0, 0.05, 50)
    after = operator.stroke(before, ratio[None, :])[0]
    for found, expected in zip(
        operator.slopes(before, after, ratio), Operator.slopes(operator, before, after, ratio), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12)
