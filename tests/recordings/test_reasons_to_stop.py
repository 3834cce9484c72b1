"""When a run that is under way is to be stopped."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.recordings import Check, JointLimits, Recording, find_stop_reasons, recording_from_arrays

RATE = 100.0
LIMITS = (JointLimits(position=(-1.0, 1.0), velocity=2.0), JointLimits(velocity=2.0))


def swing(size: float = 0.8, rate: float = 0.3, wait: float = 0.0, seconds: float = 6.0) -> np.ndarray:
    t = np.maximum(np.arange(round(seconds * RATE)) / RATE - wait, 0.0)
    noise = 1e-5 * np.random.default_rng(0).normal(size=(len(t), 2))
    return size * np.stack([np.sin(2 * np.pi * rate * t), np.cos(2 * np.pi * rate * t) - 1.0], axis=1) + noise


def record(q: np.ndarray) -> Recording:
    return recording_from_arrays(np.arange(len(q)) / RATE, q, np.zeros_like(q), joint_names=("a", "b"))


def codes(q: np.ndarray, checks: tuple[Check, ...] = (), planned: np.ndarray | None = None) -> list[tuple[str, str]]:
    motion = None if planned is None else (np.arange(len(planned)) / RATE, planned)
    return [(reason.code, reason.joint) for reason in find_stop_reasons(record(q), checks, LIMITS, motion)]


def test_a_sound_run_goes_on() -> None:
    sound = (Check("saturation", "ok", ""), Check("quantisation", "warning", ""))
    assert codes(swing(), sound, swing()) == []


def test_limits_that_are_exceeded_are_named_with_their_joint() -> None:
    assert codes(swing(size=1.2)) == [("position_limit", "a"), ("velocity_limit", "a"), ("velocity_limit", "b")]
    assert codes(swing(size=0.9, rate=0.45)) == [("velocity_limit", "a"), ("velocity_limit", "b")]


@pytest.mark.parametrize("name", ["saturation", "torque_sign", "torque_order"])
def test_findings_that_no_further_second_heals_stop_a_run(name: str) -> None:
    assert codes(swing(), (Check(name, "warning", "why"),)) == [(name, "")]
    assert codes(swing(), (Check(name, "ok", "fine"),)) == []


@pytest.mark.parametrize(("rate", "slow"), [(0.3, False), (0.2, False), (0.1, True)])
def test_a_run_is_too_slow_at_less_than_half_of_its_design(rate: float, slow: bool) -> None:
    assert (("too_slow", "") in codes(swing(rate=rate), planned=swing())) is slow


def test_after_a_gap_a_run_is_not_compared_with_the_beginning_of_its_plan() -> None:
    fast, slow = swing(rate=0.3, seconds=8.0), swing(rate=0.05, seconds=8.0)
    planned = np.concatenate([fast, slow])
    t = np.arange(len(planned)) / RATE + 0.3 * (np.arange(len(planned)) >= len(fast))
    recording = recording_from_arrays(t, planned, np.zeros_like(planned), joint_names=("a", "b"))
    assert len(recording.segments) == 2
    assert find_stop_reasons(recording, (), LIMITS, (np.arange(len(planned)) / RATE, planned)) == ()


def test_limits_that_were_exceeded_before_a_gap_count() -> None:
    q = np.concatenate([swing(size=1.2), swing(size=0.5)])
    t = np.arange(len(q)) / RATE + 0.3 * (np.arange(len(q)) >= len(q) // 2)
    recording = recording_from_arrays(t, q, np.zeros_like(q), joint_names=("a", "b"))
    assert [(reason.code, reason.joint) for reason in find_stop_reasons(recording, (), LIMITS)] == [
        ("position_limit", "a"),
        ("velocity_limit", "a"),
        ("velocity_limit", "b"),
    ]


def test_a_motion_that_has_only_just_begun_is_not_slow() -> None:
    q = np.zeros((500, 2))
    q[-1] = 0.05
    assert codes(q, planned=swing()) == []
    assert codes(swing(), planned=q) == []


def test_waiting_before_the_motion_is_not_slowness() -> None:
    assert codes(swing(wait=2.5), planned=swing()) == []
    # Too little of it has been seen.
    assert codes(swing(rate=0.1, wait=4.0), planned=swing()) == []
    assert codes(np.zeros((500, 2)), planned=swing()) == []
