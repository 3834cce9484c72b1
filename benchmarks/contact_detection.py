"""Does a momentum observer keep its rate of false alarms, and find the contacts that it says it finds?

    python benchmarks/contact_detection.py [--arms NAMES] [--minutes 30] [--contacts 200] [--rate 30] [--seed 0] …

Arms that MuJoCo moves, whose friction has more in it than the identified model (Stribeck friction and friction that
depends on the position, of drawn size). Each is identified on a minute; thresholds come from 4 minutes of other
motions. Then it moves for `--minutes` without contacts, and false alarms are counted; then it is pushed at drawn times,
at drawn points of its last link, in drawn directions, with 1 to 2 times the stated force, and the pushes that are found
within the stated time are counted. A fixed threshold a joint, made for the same rate, stands beside the thresholds by
speed and phase. Recordings of real arms follow, where there are any: false alarms in the held-out recordings that the
thresholds come from, and in each of them with thresholds from the others.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from common import RECORDINGS, show
from engine import Arm, FloatArray, Hidden, Instruments, fourier_motion, point_to_point_motion, record, usual_drives
from engine.friction import PositionFriction, Stribeck
from engine.motions import Motion
from engine.physics import Act, Live
from engine.robots import arm_by_name

import dynident as dy
from dynident.estimation.residual_errors import compute_block_maxima, compute_threshold
from dynident.identification import Identification
from dynident.recordings import RecordedJoints, Recording, RecordingMetadata, import_recording, recording_from_arrays
from dynident.recordings.joint_phases import SLOW
from dynident.robot import Robot
from dynident.validation.contact_detection import (
    ContactDetection,
    compute_contact_forces,
    fit_contact_detection,
    validate_collision,
)
from dynident.validation.momentum_observer import Run, observe_recording

STEP, RATE = 1e-3, 500.0
LENGTH = 0.3
"""Seconds that a push lasts."""
APART = 1.2
"""Seconds from one push to the next."""
NEAR_THE_FLANGE = 0.05
"""Farthest that the point of a push is from the origin of the last link along each axis, m."""
SETTLED = 0.1
"""Seconds after which a start is over."""


@dataclass(frozen=True)
class Push:
    """A force (3,) in N in the base frame at a point (3,) of the last link, from `begin` s on."""

    begin: float
    force: FloatArray
    point: FloatArray
    at_rest: bool


@dataclass(frozen=True)
class Pushes(Hidden):
    """Pushes that follow each other; each is there from one moment to the next, as when the arm runs into something."""

    each: tuple[Push, ...]

    def start(self, live: Live) -> Act:
        body = int(live.model.body(f"b{live.arm.robot.n - 1}").id)
        first = {round(push.begin / live.arm.step): push for push in self.each}
        length, data = round(LENGTH / live.arm.step), live.data
        current: list[tuple[int, Push]] = []

        def act(step: int) -> None:
            if step in first:
                current[:] = [(step + length, first[step])]
            if not current:
                return
            end, push = current[0]
            if step >= end:
                current.clear()
                data.xfrc_applied[body] = 0.0
                return
            lever = data.xmat[body].reshape(3, 3) @ push.point + data.xpos[body] - data.xipos[body]
            data.xfrc_applied[body, :3] = push.force
            data.xfrc_applied[body, 3:] = np.cross(lever, push.force)

        return act


class Cell:
    """An arm with friction that no model here has, and its motions by number."""

    def __init__(self, name: str, seed: int) -> None:
        self.name, self.seed = name, seed
        self.robot = arm_by_name(name)
        drives, rng = usual_drives(self.robot), np.random.default_rng([seed, 1])
        hidden: list[Hidden] = []
        for j in range(self.robot.n):
            hidden += [
                Stribeck(j, rng.uniform(0.1, 0.4) * float(drives.coulomb[j]), 0.05),
                PositionFriction(j, rng.uniform(0.05, 0.2), float(rng.integers(1, 12)), rng.uniform(0.0, 6.0)),
            ]
        self.arm = Arm(self.robot, drives, tuple(hidden), step=STEP)

    def plan(self, number: int, duration: float) -> Motion:
        """Return a motion: those with even numbers never stop, the others go from posture to posture."""
        seed = 1000 * self.seed + number
        # Slow enough for the drives: a saturated actuator is no longer what MuJoCo's integrator takes it for.
        if number % 2:
            return point_to_point_motion(self.robot, duration, seed, STEP, pace=0.7)
        return fourier_motion(self.robot, duration, seed, STEP, period=min(duration, 12.0) if number < 2 else duration)

    def record(self, number: int, duration: float, pushes: Sequence[Push] = ()) -> Recording:
        motion = self.plan(number, duration)
        arm = replace(self.arm, hidden=(*self.arm.hidden, Pushes(tuple(pushes)))) if pushes else self.arm
        run = record(arm, motion, Instruments(rate=RATE), number)
        return recording_from_arrays(run.t, run.q, run.tau, joint_names=self.robot.joint_names, name=f"run {number}")

    def draw_pushes(self, motion: Motion, detection: ContactDetection, rng: np.random.Generator) -> list[Push]:
        """Draw pushes with 1 to 2 times the force that is stated for the moment."""
        pushes = []
        for begin in np.arange(1.0, motion.t[-1] - 2.0, APART) + rng.uniform(0.0, APART - 2 * LENGTH):
            before = (motion.t > begin - SETTLED) & (motion.t <= begin)
            at_rest = bool((np.abs(motion.dq[before]) < SLOW).any(axis=0).all())
            stated = detection.force_at_rest if at_rest else detection.force
            if stated is not None:
                direction = rng.normal(size=3)
                force = rng.uniform(1.0, 2.0) * stated * direction / np.linalg.norm(direction)
                pushes.append(Push(float(begin), force, rng.uniform(-NEAR_THE_FLANGE, NEAR_THE_FLANGE, 3), at_rest))
        return pushes


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", help="names, separated by commas; ur10, franka_panda and a drawn one by default")
    parser.add_argument("--minutes", type=float, default=30.0, help="motion of each arm without contacts")
    parser.add_argument("--contacts", type=int, default=200, help="pushes of each arm")
    parser.add_argument("--rate", type=float, default=30.0, help="false alarms an hour that are asked for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="one arm, one minute, ten pushes, no recordings")
    options = parser.parse_args()
    if options.quick:
        options.arms, options.minutes, options.contacts = "ur10", 1.0, 10
    names = options.arms or f"ur10,franka_panda,six-{options.seed}"
    counts = [judge_arm(Cell(name, options.seed), options) for name in names.split(",")]
    alarms, expected, found, pushed = (sum(values) for values in zip(*counts, strict=True))
    print(
        f"\nTogether: {alarms} false alarms where {expected:.1f} were stated ({alarms / expected:.2f} times); "
        f"{found} of {pushed} pushes found ({100 * found / max(pushed, 1):.1f} %)"
    )
    if RECORDINGS.is_dir() and not (options.arms or options.quick):
        judge_recordings()


def judge_arm(cell: Cell, options: argparse.Namespace) -> tuple[int, float, int, int]:
    """Print the table of an arm; return false alarms counted and stated, pushes found and made while the arm moves."""
    length = 60.0 if not options.quick else 20.0
    held_out = [cell.record(number, length) for number in range(2, 6)]
    model = dy.identify(
        cell.robot, [cell.record(number, 30.0) for number in (0, 1)], validation=held_out
    ).identification
    runs = [run for recording in held_out for run in observe_recording(model, recording)]
    detection = fit_contact_detection(cell.robot, runs, options.rate)
    if detection is None:
        raise SystemExit(f"{cell.name}: no thresholds")
    fixed = fix_thresholds(cell.robot, runs, detection)
    alarms, alarms_of_fixed, seconds = 0, 0, 0.0
    for number in range(int(np.ceil(options.minutes))):
        for run in observe_recording(model, cell.record(100 + number, 60.0)):
            alarms += detection.count_alarms(*run)
            alarms_of_fixed += fixed.count_alarms(*run)
            seconds += len(run[0].residual) * run[1]
    expected = detection.false_alarms_an_hour * seconds / 3600.0
    moving, at_rest = push_arm(cell, model, detection, options.contacts)
    rows = [
        ("", "stated", "found"),
        ("false alarms", f"{expected:.1f}", f"{alarms}"),
        ("the same with fixed thresholds", f"{expected:.1f}", f"{alarms_of_fixed}"),
        ("force at the tool while the arm moves", f"{detection.force:.1f} N", ""),
        ("the same with fixed thresholds", f"{fixed.force:.1f} N", f"{detection.force / fixed.force:.2f} of it"),
        (f"pushes found in {1e3 * detection.within:.0f} ms", "95 %", say_share(moving)),
    ]
    if detection.force_at_rest is not None:
        rows.append(("force at rest", f"{detection.force_at_rest:.1f} N", say_share(at_rest)))
    title = f"{cell.name}: {seconds / 60:.0f} min, {detection.false_alarms_an_hour:.3g} false alarms an hour, "
    show(f"{title}model {100 * model.held_out_judged.relative_total:.1f} %, seed {cell.seed}", rows)
    return alarms, expected, sum(moving), len(moving)


def say_share(found: Sequence[bool]) -> str:
    return f"{100 * np.mean(found):.1f} % of {len(found)}" if found else "none made"


def fix_thresholds(robot: Robot, runs: Sequence[Run], detection: ContactDetection) -> ContactDetection:
    """Return one threshold a joint, for the same rate by the same statistics, and the force that they detect."""
    share = detection.false_alarms_an_hour / 3600.0 / robot.n
    each = [
        compute_threshold([compute_block_maxima(np.abs(run.residual[:, j]), period) for run, period in runs], share)
        for j in range(robot.n)
    ]
    fixed = replace(detection, thresholds=np.repeat(np.array(each)[:, None], detection.thresholds.shape[1], axis=1))
    force, at_rest = compute_contact_forces(robot, runs, fixed)
    return replace(fixed, force=np.inf if force is None else force, force_at_rest=at_rest)


def push_arm(
    cell: Cell, model: Identification, detection: ContactDetection, contacts: int
) -> tuple[list[bool], list[bool]]:
    """Return for each push whether it was found in the stated time: those while the arm moves, and those at rest."""
    rng, number = np.random.default_rng([cell.seed, 2]), 500
    found: tuple[list[bool], list[bool]] = [], []
    while sum(map(len, found)) < contacts:
        motion = cell.plan(number, 60.0)
        pushes = cell.draw_pushes(motion, detection, rng)
        recording = cell.record(number, 60.0, pushes)
        for observed, period in observe_recording(model, recording):
            detected = detection.find_contacts(observed).any(axis=1)
            # The observer's residual begins later than the recording.
            t = motion.t[-1] - period * np.arange(len(detected))[::-1]
            for push in pushes:
                rows = (t >= push.begin) & (t <= push.begin + detection.within + 1.5 * period)
                found[push.at_rest].append(bool(detected[rows].any()))
        number += 1
    return found


GAINS_UR10E = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
RECORDED = {
    "ur10e": (("id_30s_12harm",), ("id_40s_12harm", "id_50s_12harm", "val_ptp10", "pair14_unloaded"), GAINS_UR10E),
    "kr300": (("id_A",), ("val_B", "val_C"), None),
    "airbot_play": (("id_chirp_unloaded",), ("cv_trapezoidal",), None),
    "kinova_gen3": (("run1",), ("run2", "run3"), None),
    "ur10": (("exciting_traj 0 9",), ("exciting_traj 9 18", "exciting_traj 18 27.5"), None),
}
"""Recordings for the fit, held-out recordings (with the seconds that count) and drive gains of each real arm."""


def judge_recordings(rate: float = 200.0) -> None:
    """Print the false alarms in recordings of real arms, at a rate that so few seconds can show."""
    rows = [("", "seconds", "stated", "found", "stated, left out", "found, left out", "force")]
    for name, fit, held_out in read_recordings():
        robot = fit[0]
        model = dy.identify(robot, fit[1], validation=held_out, effects=("default", "offset")).identification
        judged = validate_collision(model, held_out, rate)
        runs = [run for recording in held_out for run in observe_recording(model, recording)]
        if judged.contact is None:
            rows.append((name, *("-",) * 6))
            continue
        seconds = judged.contact.seconds
        counted = sum(judged.contact.count_alarms(*run) for run in runs)
        stated = judged.contact.false_alarms_an_hour * seconds / 3600.0
        left_out = (f"{judged.expected:.1f}", f"{judged.alarms}")
        rows.append((name, f"{seconds:.0f}", f"{stated:.1f}", f"{counted}", *left_out, f"{judged.contact.force:.0f} N"))
    show(f"real arms, {rate:g} false alarms an hour", rows)


def read_recordings() -> Iterator[tuple[str, tuple[Robot, list[Recording]], list[Recording]]]:
    for name, (fit, held_out, gains) in RECORDED.items():
        folder = RECORDINGS / name
        robot = dy.load_robot(folder / "robot.urdf") if (folder / "robot.urdf").is_file() else None
        robot = robot or dy.load_robot(next(folder.glob("*.urdf")))
        joints = RecordedJoints(robot.joint_names, gains=gains)
        with tempfile.TemporaryDirectory() as scratch:
            recordings = []
            for k, stated in enumerate((*fit, *held_out)):
                file, *window = stated.split()
                windows = ((float(window[0]), float(window[1])),) if window else ()
                metadata = RecordingMetadata(name=f"{file} {k}", windows=windows)
                target = Path(scratch) / f"{k}.parquet"
                recordings.append(import_recording(folder / f"{file}.parquet", target, joints, metadata=metadata)[0])
            yield name, (robot, recordings[: len(fit)]), recordings[len(fit) :]


if __name__ == "__main__":
    main()
