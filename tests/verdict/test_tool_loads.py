"""The force at the tool that shows: thresholds that keep their rate of false alarms, and the force that they mean."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from support.oracles import arm

from dynident.estimation.residual_errors import compute_threshold
from dynident.robot import compute_tool_jacobian, tool_path
from dynident.verdict.held_out_evidence import _compute_lift

_RATE = 25
_HOURS = 2


@pytest.mark.parametrize("memory", [0.05, 0.3, 1.0])
def test_correlated_residuals_cross_their_threshold_once_an_hour_at_most(memory: float) -> None:
    alarms, heights = [], []
    for trial in range(20):
        coefficient = np.exp(-1.0 / (_RATE * memory))
        white = np.random.default_rng([trial, int(100 * memory)]).normal(size=(30 + 3600 * _HOURS) * _RATE)
        residual = np.abs(lfilter([1.0], [1.0, -coefficient], white))
        known, later = residual[: 30 * _RATE], residual[30 * _RATE :]
        threshold = compute_threshold([known.reshape(30, _RATE).max(axis=1)], 1.0 / 3600.0)
        alarms.append(np.count_nonzero((later[1:] > threshold) & (later[:-1] <= threshold)) / _HOURS)
        heights.append(threshold / np.sqrt((residual**2).mean()))
    assert np.mean(alarms) < 1.0
    assert np.mean(np.array(alarms) > 1.0) <= 0.1
    # Nor is it so high that nothing shows: of independent normal samples it would be at 4.5.
    assert np.median(heights) < 9.0


def test_the_jacobian_is_the_velocity_of_the_tool() -> None:
    robot = arm("ur10")
    rng = np.random.default_rng(0)
    q, dq = rng.normal(size=(5, 6)), rng.normal(size=(5, 6))
    moved = (tool_path(robot, q + 1e-6 * dq) - tool_path(robot, q - 1e-6 * dq)) / 2e-6
    assert np.einsum("mij,mj->mi", compute_tool_jacobian(robot, q), dq) == pytest.approx(moved, abs=1e-6)


def test_a_force_shows_on_the_joint_with_the_best_lever() -> None:
    # One joint that feels forces along y by a lever of half a metre, and one that feels nothing.
    jacobian = np.array([[[0.0, 0.0], [0.5, 0.0], [0.0, 0.0]]])
    seen = _compute_lift(jacobian, np.array([2.0, 1.0]))
    assert seen is not None
    assert 1.0 / seen == pytest.approx(4.0)
    assert _compute_lift(np.zeros((1, 3, 2)), np.ones(2)) is None
