"""Are gross mistakes in a recording noticed, with the right cure, and right recordings left alone?

    python benchmarks/gross_mistakes.py [--seed 1 | --seed new] [--cases 8] [--each 12]

Recordings of arms of the benchmark's engine, hidden effects and all, and of real arms where there are any. Untouched,
each has to pass; then mistakes are planted one by one: torques, positions or both of two joints exchanged, their signs
turned round. `harm` is the mean over the joints of the logarithm by which the share of the torque grows that the
robot's dynamics leave: what harms nothing (a joint about whose sign the data say nothing) cannot be noticed. `cured`:
what was named, or the first thing that cannot be told from it, undoes it.

Delays and gains: by how much the torque of each is said to be late as it is, and moved by 20 ms ("!": a mistake); on
how many joints a gain ten times too large is noticed by the description's masses, or by friction.

Other faults: gravity in another direction, a joint's zero off by 90 degrees, a gain ten times too large, in recordings
whose columns are right. An exchange or a sign that is named then is wrong; `refused` counts findings that are certain,
`at most` is the largest of the same logarithm by which columns seemed better explained in another order.

Short motions: runs of 8 s from point to point, hidden effects and all, each by itself: what is said of right ones, and
of a few mistakes planted in each how many do harm, are noticed, and are undone by what is named.

Few moves: the same of arms that go from point to point for 8 s while half of the joints stay at each move.

Drawn friction: of arms whose joints' friction is drawn, each by itself, about a share of their limits that is drawn,
too: how many right recordings are said to have a torque that is too large, and of how many gains it is noticed.
"""

from __future__ import annotations

import argparse
import os
import secrets
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine import Arm, Bandwidth, Instruments, Plan, point_to_point_motion, record, usual_drives
from engine.drives import Drives
from engine.motions import Motion as Reference
from engine.motions import fourier_motion
from engine.robots import arm_by_name, as_described
from hiding.drawing import Wanted, draw_cases
from hiding.manners import Manners
from hiding.recorded import recorded
from placebos.subjects import REAL_ARMS, imported

from dynident.identification.recording_faults.column_faults import ColumnFault, Motion, list_possible_faults
from dynident.identification.recording_faults.fault_checks import build_dynamics_checks
from dynident.identification.recording_faults.fault_search import (
    find_excess_of_motion,
    search_faults,
)
from dynident.identification.recording_faults.rows_for_fault_search import (
    filter_motion,
    filter_whole_motion,
    find_delay,
)
from dynident.identification.recording_faults.torque_scale import find_torque_scales
from dynident.identification.recording_faults.unexplained_torque import measure_unexplained_share
from dynident.recordings import Recording, recording_from_arrays
from dynident.robot import Robot

FAULTY, FAULTS = ("ur5", "ur10", "franka_panda"), 6
DRAWN, SPREAD = 8, 0.5
"""Recordings of each arm with drawn friction, and the spread of its logarithm."""
ALL = 1000
"""More recordings than an arm or a case has."""
BRIEF, FEW = 8.0, 3
"""s of a short motion, and mistakes planted in each."""
LATE = 0.02
HARMLESS = 0.1
"""Growth of the same logarithm that is no gross mistake."""


def main() -> None:
    """Run and print the tables."""
    options = _arguments()
    seed = secrets.randbelow(10**6) if options.seed == "new" else int(options.seed)
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    untouched: list[tuple[str, int, float]] = []
    planted: list[tuple[str, float, bool, bool, bool]] = []
    amounts = [("recording", "late as it is", "20 ms later", "20 ms earlier", "gains x 10 noticed")]
    with tempfile.TemporaryDirectory() as folder:
        for name, robot, recording in _recordings(seed, options.cases, Path(folder)):
            motion = filter_motion(recording)
            if motion is None:
                continue
            amounts.append((name, *_delays(robot, recording), _gains(robot, motion)))
            told = search_faults(robot, motion)
            if told is None:
                continue
            untouched.append((name, len(told[0]), told[1].average_share))
            possible = list(list_possible_faults(np.ones(robot.n, dtype=bool)))
            chosen = [possible[k] for k in rng.permutation(len(possible))[: options.each]]
            planted += [(one.kind, *_tried(robot, motion, one)) for one in chosen]
    show(
        "Untouched recordings",
        [("recording", "mistakes named", "left"), *((n, str(c), f"{left:.1%}") for n, c, left in untouched)],
    )
    most = options.recordings or ALL
    faulty, drawn = min(FAULTS, most), min(DRAWN, most)
    show("Other faults", _other_faults(seed, faulty))
    show("Drawn friction", _drawn_frictions(seed, drawn))
    show("Short motions", _short_motions(seed, options.cases, most))
    show("Few moves", _few_moves(seed, faulty))
    show("Delays and gains", amounts)
    rows = [("mistake", "planted", "harmful", "noticed", "cured", "refused")]
    for kind in dict.fromkeys(one[0] for one in planted):
        own = [one for one in planted if one[0] == kind]
        harmful = [one for one in own if one[1] >= HARMLESS]
        told = (sum(one[k] for one in harmful) for k in (2, 3, 4))
        rows.append((kind, str(len(own)), str(len(harmful)), *map(str, told)))
    show("Planted mistakes", rows)


def _tried(robot: Robot, motion: Motion, fault: ColumnFault) -> tuple[float, bool, bool, bool]:
    """Harm of a mistake, whether it is noticed, whether what is named undoes it, and whether it blocks."""
    wrong = fault.mend(motion)
    usual, bad = measure_unexplained_share(robot, motion), measure_unexplained_share(robot, wrong)
    told = search_faults(robot, wrong)
    found = told[0] if told else ()
    mended = wrong
    for one in found:
        mended = one.fault.mend(mended)
    named = bool(found) and fault in (found[0].fault, *found[0].alike)
    cured = named or (bool(found) and measure_unexplained_share(robot, mended) <= usual * 1.05)
    return float(np.log(bad / usual)), bool(found), cured, any(one.certain for one in found)


def _delays(robot: Robot, recording: Recording) -> tuple[str, ...]:
    """What is said of the delay: as it is, and with torques moved; a mistake is marked."""
    told = []
    for seconds in (0.0, LATE, -LATE):
        whole = filter_whole_motion(recording if seconds == 0.0 else _moved_torque(recording, seconds))
        found = None if whole is None else find_delay(robot, *whole)
        told.append("-" if found is None else f"{1e3 * found.seconds:.1f} ms{' !' if found.is_fault else ''}")
    return tuple(told)


def _moved_torque(recording: Recording, seconds: float) -> Recording:
    segment = max(recording.segments, key=lambda one: one.length)
    rows = list(recording.source.rows(segment.first_row, segment.length, 65_536))
    q, tau = (np.concatenate([getattr(one, kind) for one in rows]) for kind in ("q", "tau"))
    t = segment.start_time + np.arange(len(q)) * recording.period
    late = np.stack([np.interp(t - seconds, t, column) for column in tau.T], axis=1)
    return recording_from_arrays(t, q, late, joint_names=recording.joint_names, windows=recording.windows)


def _gains(robot: Robot, motion: Motion) -> str:
    """On how many joints a gain ten times too large is noticed, alone and with the right power; and false alarms."""
    usual = find_torque_scales(robot, motion, find_excess_of_motion(robot, motion))
    right = 0
    for joint in range(robot.n):
        times = np.where(np.arange(robot.n) == joint, 10.0, 1.0)
        large = replace(motion, tau=motion.tau * times)
        found = find_torque_scales(robot, large, find_excess_of_motion(robot, large)) or ()
        right += [(one.joint, one.power) for one in found] == [(joint, 10.0)]
    return f"{right} of {robot.n}" + (f", untouched {len(usual)}" if usual else "")


def _other_faults(seed: int, recordings: int) -> list[tuple[str, str, str, str, str]]:
    rows = [("fault", "recordings", "something named", "refused", "at most")]
    for name, spoiled in (("gravity", _leaning), ("zero by 90 degrees", _off), ("gain times ten", _scaled)):
        named = refused = count = 0
        most = 0.0
        for arm in FAULTY:
            for draw in range(recordings):
                robot, motion = spoiled(arm, np.random.default_rng([seed, draw]))
                told = search_faults(robot, motion)
                found = [one for one in told[0] if one.fault.kind != "torque scaled"] if told else []
                count, named, refused = count + 1, named + bool(found), refused + any(one.certain for one in found)
                most = max([most, *(float(np.log(one.left_with / one.left_without)) for one in found)])
        rows.append((name, str(count), str(named), str(refused), f"{most:.2f}"))
    return rows


def _drawn_frictions(seed: int, recordings: int) -> list[tuple[str, ...]]:
    rows = [("arm", "recordings", "said of right ones", "gains x 10", "noticed", "another joint named")]
    for arm in FAULTY:
        robot, alarms, planted, noticed, wrong = arm_by_name(arm), 0, 0, 0, 0
        for draw in range(recordings):
            rng = np.random.default_rng([seed, 7, draw])
            usual = usual_drives(robot)
            sizes = np.exp(rng.normal(0.0, SPREAD, robot.n) + rng.normal(0.0, SPREAD))
            drives = replace(usual, coulomb=usual.coulomb * sizes, viscous=usual.viscous * sizes)
            motion = _moved(robot, rng, drives)
            told = search_faults(robot, motion)
            alarms += bool(
                (told and told[0]) or find_torque_scales(robot, motion, find_excess_of_motion(robot, motion))
            )
            for joint in range(robot.n):
                large = replace(motion, tau=motion.tau * np.where(np.arange(robot.n) == joint, 10.0, 1.0))
                found = {
                    one.joint for one in find_torque_scales(robot, large, find_excess_of_motion(robot, large)) or ()
                }
                planted, noticed, wrong = planted + 1, noticed + bool(found), wrong + bool(found - {joint})
        rows.append((arm, *map(str, (recordings, alarms, planted, noticed, wrong))))
    return rows


def _short_motions(seed: int, cases: int, recordings: int) -> list[tuple[str, ...]]:
    rows = [("case", "runs", "said of right ones", "harmful", "noticed", "cured")]
    rng = np.random.default_rng([seed, 8])
    for case in draw_cases(Wanted(seed, cases, manners=Manners(motions=("point-to-point",)))):
        robot = as_described(arm_by_name(case.arm), case.noise)
        runs = []
        for run in recorded(case, None).runs[:recordings]:
            n = int(np.searchsorted(run.t - run.t[0], BRIEF))
            runs.append(recording_from_arrays(run.t[:n], run.q[:n], run.tau[:n], joint_names=robot.joint_names))
        rows.append((case.name, *_short(robot, runs, rng)))
    return rows


def _few_moves(seed: int, recordings: int) -> list[tuple[str, ...]]:
    rows = [("arm", "runs", "said of right ones", "harmful", "noticed", "cured")]
    rng = np.random.default_rng([seed, 9])
    for name in FAULTY:
        robot = arm_by_name(name)
        runs = [_run(robot, _half_stay(robot, rng), rng) for _ in range(recordings)]
        rows.append((name, *_short(robot, runs, rng)))
    return rows


def _half_stay(robot: Robot, rng: np.random.Generator) -> Reference:
    return point_to_point_motion(robot, BRIEF, int(rng.integers(2**31)), Arm.step, moving=0.5)


def _short(robot: Robot, runs: Sequence[Recording], rng: np.random.Generator) -> tuple[str, ...]:
    """Number of short runs, what is said of them as they are, and of a few mistakes planted in each."""
    said, counts = [], np.zeros(3, dtype=int)
    names = [f"{kind}{joint + 1}" for kind in ("q", "tau") for joint in range(robot.n)]
    for short in runs:
        checks = build_dynamics_checks(robot)(short, names[: robot.n], names[robot.n :]) or ()
        said += [one.name for one in checks if one.status != "ok"]
        motion = filter_motion(short)
        if motion is None:
            continue
        possible = list(list_possible_faults(np.ones(robot.n, dtype=bool)))
        for k in rng.permutation(len(possible))[:FEW]:
            harm, noticed, cured, _ = _tried(robot, motion, possible[k])
            counts += np.array([True, noticed, cured]) if harm >= HARMLESS else 0
    print(len(runs), said, *counts, flush=True)
    return (str(len(runs)), ", ".join(said) or "nothing", *map(str, counts))


def _leaning(arm: str, rng: np.random.Generator) -> tuple[Robot, Motion]:
    robot = arm_by_name(arm)
    direction = rng.normal(size=3)
    leaning = replace(robot, gravity=9.81 * direction / np.linalg.norm(direction))
    return robot, _moved(leaning, rng)


def _off(arm: str, rng: np.random.Generator) -> tuple[Robot, Motion]:
    robot = arm_by_name(arm)
    motion = _moved(robot, rng)
    off = 0.5 * np.pi * (np.arange(robot.n) == rng.integers(1, robot.n))
    return robot, replace(motion, q=motion.q + off)


def _scaled(arm: str, rng: np.random.Generator) -> tuple[Robot, Motion]:
    robot = arm_by_name(arm)
    motion = _moved(robot, rng)
    return robot, replace(motion, tau=motion.tau * np.where(np.arange(robot.n) == rng.integers(robot.n), 10.0, 1.0))


def _moved(robot: Robot, rng: np.random.Generator, drives: Drives | None = None) -> Motion:
    """Filtered rows of a robot, with the engine's usual drives or others."""
    motion = filter_motion(_run(robot, fourier_motion(robot, 16.0, int(rng.integers(2**31)), Arm.step), rng, drives))
    assert motion is not None
    return motion


def _run(robot: Robot, motion: Reference, rng: np.random.Generator, drives: Drives | None = None) -> Recording:
    """A recording of a robot with the engine's usual drives or others."""
    arm = Arm(robot, drives or usual_drives(robot), (), Bandwidth(8.0))
    run = record(arm, motion, Instruments(2**18, 0.006, 250.0), int(rng.integers(2**31)), Plan(0, 0.0))
    return recording_from_arrays(run.t, run.q, run.tau, joint_names=robot.joint_names)


def _recordings(seed: int, cases: int, folder: Path) -> Iterator[tuple[str, Robot, Recording]]:
    for case in draw_cases(Wanted(seed, cases)):
        robot = as_described(arm_by_name(case.arm), case.noise)
        yield case.name, robot, recorded(case, None).recordings(held_out=False)[0]
    for arm in REAL_ARMS:
        if arm.is_here and len(arm.files) == 1:
            robot, recordings = imported(arm, folder)
            yield arm.name, robot, recordings[0]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=8, help="simulated recordings")
    parser.add_argument("--each", type=int, default=12, help="mistakes planted in each recording")
    parser.add_argument("--recordings", type=int, default=0, help="of each arm and case in the other tables; 0: all")
    return parser.parse_args()


if __name__ == "__main__":
    main()
