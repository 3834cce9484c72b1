"""Slow runs, pauses, soft controllers and low rates of the other engine: what they are said to be."""

from __future__ import annotations

import numpy as np
import pytest
from engine import (
    Arm,
    Bandwidth,
    FloatArray,
    Instruments,
    Motion,
    Run,
    fourier_motion,
    point_to_point_motion,
    record,
    usual_drives,
)
from engine.robots import arm_by_name
from hiding.drawing import Wanted, draw_cases
from hiding.manners import Manners
from hiding.moving import moving
from hiding.recorded import label_of, recorded

ROBOT = arm_by_name("ur10")
DRIVES = usual_drives(ROBOT)
EXACT = Instruments(counts=2**40, noise=0.0)
SPEEDS = np.array([joint.limits.velocity for joint in ROBOT.joints], dtype=np.float64)
PACES = (1.0, 0.5, 0.2)


@pytest.mark.parametrize("make", [fourier_motion, point_to_point_motion])
@pytest.mark.parametrize("pace", PACES)
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_motion_is_smooth_and_as_slow_as_its_pace(make, pace: float, seed: int) -> None:  # type: ignore[no-untyped-def]
    motion: Motion = make(ROBOT, 9.0, seed, pace=pace)
    scale = np.abs(motion.ddq).max()
    assert np.abs(np.gradient(motion.q, motion.t, axis=0) - motion.dq).max() < 2e-3 * np.abs(motion.dq).max()
    # The jerk is finite: a step of acceleration would show as half of it.
    assert np.abs(np.gradient(motion.dq, motion.t, axis=0) - motion.ddq).max() < 0.05 * scale
    assert (np.abs(motion.dq).max(axis=0) <= 0.71 * pace * SPEEDS).all()
    assert np.abs(motion.dq).max() > 0.4 * pace * SPEEDS.min()


@pytest.mark.parametrize("seed", range(6))
def test_all_joints_pause_between_the_points_for_as_long_as_they_are_told(seed: int) -> None:
    motion = point_to_point_motion(ROBOT, 20.0, seed, dwells=(0.2, 0.4))
    rest = (motion.dq == 0).all(axis=1)
    begins = np.flatnonzero(rest[1:] & ~rest[:-1])
    # The recording begins with a pause.
    ends = np.flatnonzero(~rest[1:] & rest[:-1])[1:]
    pauses = motion.t[ends] - motion.t[begins[: len(ends)]]
    assert len(pauses) >= 4
    assert (pauses > 0.19).all()
    assert (pauses < 0.41).all()


def _run(hertz: float) -> tuple[Run, Motion]:
    motion = point_to_point_motion(ROBOT, 6.0, 5)
    return record(Arm(ROBOT, DRIVES, servo=Bandwidth(hertz)), motion, EXACT), motion


def test_a_soft_controller_stays_behind_and_a_stiff_one_hardly() -> None:
    far, near = (float(np.abs(run.q - motion.q[::2]).max()) for run, motion in map(_run, (3.0, 20.0)))
    assert far > 10 * near
    assert near < 2e-3


def test_joints_stick_where_they_pause() -> None:
    run, motion = _run(5.0)
    rest = (motion.dq[::2] == 0).all(axis=1)
    speed: FloatArray = np.gradient(run.q, run.t, axis=0)
    stuck = np.abs(speed) < 1e-5
    assert stuck[rest].mean() > 0.5
    assert stuck[~rest & (np.abs(motion.dq[::2]) > 0.1).all(axis=1)].mean() < 0.01


def test_rows_that_count_as_moving_are_clear_of_standstill() -> None:
    run, _ = _run(5.0)
    clear = moving(run, ROBOT, 8.0)
    speed = np.abs(np.gradient(run.q, run.t, axis=0))
    assert (speed[clear] > 1e-3).all()
    assert 0.2 < clear.mean() < 0.8


def test_rates_down_to_60_hz_are_what_the_recording_has() -> None:
    manners = Manners(rates=(60.0,), paces=(1.0, 0.2), motions=("point-to-point",))
    case = draw_cases(Wanted(5, 0, ("clean",), ("ur10",), ("full",), manners))[0]
    runs = recorded(case).recordings(held_out=False)
    assert runs[0].sampling_rate == pytest.approx(case.instruments.rate)
    assert runs[0].sampling_rate == pytest.approx(60.0, rel=0.02)
    assert [len(run.segments) for run in runs] == [2, 2]


def test_the_same_is_hidden_however_it_is_recorded() -> None:
    families = ("stribeck", "torque_ripple", "base_tilt+payload")
    one, other = (
        draw_cases(Wanted(7, 0, families, (), ("full",), manners))
        for manners in (Manners(motions=("fourier",)), Manners(motions=("point-to-point",), rates=(125.0,)))
    )
    assert [case.hidden for case in one] == [case.hidden for case in other]
    assert {case.manner.motion for case in other} == {"point-to-point"}


def test_a_payload_is_in_all_runs_of_its_sitting() -> None:
    for seed in range(4):
        case = draw_cases(Wanted(seed, 0, ("payload",), ("ur10",), ("full",), Manners(paces=PACES)))[0]
        runs = case.hidden[0].physics.runs  # type: ignore[attr-defined]
        assert runs == (3, 4, 5)
        name = "run 1" if case.session[3].joined else "run 4"
        assert [label_of(case, run) for run in runs] == [f"{name}#4", f"{name}#5", f"{name}#6"]
