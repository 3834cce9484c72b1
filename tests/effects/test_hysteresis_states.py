"""Hysteresis states against the recursion, one sample after the other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynident.effects import MemorySignal
from dynident.effects.memory import MemoryStates, step

SIGNALS = (
    MemorySignal("stop", 0, 2e-3),
    MemorySignal("dahl", 0, 2e-3),
    MemorySignal("stop", 1, 0.05),
    MemorySignal("dahl", 1, 0.3),
    MemorySignal("stop", 0, 0.5),
)
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
        states = np.array([step(s, z, here[s.joint] - before[s.joint]) for s, z in zip(SIGNALS, states, strict=True)])
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
    memory = MemoryStates(SIGNALS)
    before = memory.push(path)[-1]
    after = memory.push(np.repeat(path[-1:], still, axis=0))
    np.testing.assert_array_equal(after, np.tile(before, (still, 1)))


def test_a_new_run_starts_relaxed():
    memory = MemoryStates(SIGNALS)
    memory.push(np.array([[0.0, 0.0], [1.0, 1.0]]))
    memory.restart()
    assert not memory.push(np.array([[5.0, 5.0]])).any()


def test_no_samples_and_no_signals_are_nothing_special():
    assert MemoryStates(SIGNALS).push(np.empty((0, 2))).shape == (0, len(SIGNALS))
    assert MemoryStates(()).push(np.zeros((4, 2))).shape == (4, 0)


def test_a_stop_operator_saturates_after_twice_its_slip_distance():
    signal = MemorySignal("stop", 0, 0.01)
    path = np.concatenate([np.linspace(0, 0.05, 51), np.linspace(0.05, 0, 51)])[:, None]
    z = MemoryStates([signal]).push(path)[:, 0]
    assert z[10] == pytest.approx(1.0)  # 0.01 rad after the relaxed start
    back = np.linspace(0.05, 0, 51)
    np.testing.assert_allclose(z[51:], np.clip(1 - (0.05 - back) / 0.01, -1, 1), atol=1e-12)


def test_dahls_state_solves_its_differential_equation():
    # dz/dq = (1 - z sign q̇) / slip, integrated with small steps by Euler's method.
    slip = 0.02
    q = 0.05 * np.sin(np.linspace(0, 7, 200_001))
    z = MemoryStates([MemorySignal("dahl", 0, slip)]).push(q[:, None])[:, 0]
    euler, x = np.empty(len(q)), 0.0
    for k, dq in enumerate(np.diff(q, prepend=q[0])):
        x += dq / slip * (1 - x * np.sign(dq))
        euler[k] = x
    np.testing.assert_allclose(z, euler, atol=1e-3)
