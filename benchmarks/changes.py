"""What changed since the other day? Pairs of days of arms that another engine moves, one thing different or nothing.

    python benchmarks/changes.py [--seed 1 | --seed new] [--pairs 60] [--days 2] [--processes 2]

Every day has two runs of its own, at full speed and at a lower one, other motions on the second day than on the first
(Fourier or point to point with pauses, drawn), with sticking joints and a controller of some Hz. A third of the pairs
are of the same arm; the others have more friction on a joint (+15 to +50 %), a mass of 0.2 to 2 kg on a link behind the
first, a base that leans by 0.5 to 2 degrees, an offset, a drive gain that is 3 to 8 % off, or an encoder zero that is
0.3 to 1 degree off. In half of the pairs all friction follows the temperature, by up to 20 % up and down.

`right`: the change is named, on its joint (a mass: its link, or one that the data are said not to tell from it);
`missed`: nothing is; `small`: nothing is, and the change leaves less than benchmarks/hiding/visibility.py asks of a
hidden effect, told with Pinocchio's regressor beside a clean twin of the same days; `wrong`: something is named that
did not change; `alarm`: of pairs where nothing changed. `held`: 95 % intervals that hold the true difference.
`felt`: those of what the friction of each joint differs by, at the speed that it has.

With more than two days each pair is a series of so many, changed from one of them on: a change is right on that day
alone, or on one that the data are said not to tell from it.
"""

from __future__ import annotations

import argparse
import os
import secrets
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine import (
    Arm,
    Bandwidth,
    Drives,
    FloatArray,
    Hidden,
    Instruments,
    Plan,
    Run,
    effort_limits,
    record,
    usual_drives,
)
from engine.disturbances import GainError, Offset, ZeroError
from engine.motions import fourier_motion
from engine.point_to_point import point_to_point_motion
from engine.robots import arm_by_name, as_described
from engine.structure import Tilt
from hiding.visibility import SHOWS, shown_beside

from dynident.diagnosis import Change, FrictionDifference, diagnose
from dynident.diagnosis.monitoring import build_measure, monitor_days, reduce_day
from dynident.identification import identify
from dynident.recordings import FurtherColumns, Recording, recording_from_arrays
from dynident.robot import Robot

ARMS = ("ur5", "ur10", "franka_panda")
KINDS = ("friction", "mass", "tilt", "offset", "gain", "zero")
NAMES = {
    "friction": ("coulomb", "viscous"),
    "mass": ("payload",),
    "tilt": ("base_tilt",),
    "offset": ("offset", "coulomb_asymmetric"),
    "gain": ("drive_gain_error",),
    "zero": ("encoder_zero_error",),
}
_SIGNLESS = ("zero",)
"""Kinds whose parameter has its sign by convention."""
_RATE, _DURATION, _COUNTS = 250.0, 14.0, 2**18
_PACES = (1.0, 0.45)


@dataclass(frozen=True)
class Pair:
    """Days of an arm: what is different from one of them on, where and how much; whether friction follows warmth."""

    arm: str
    kind: str
    joint: int
    size: float
    warm: bool
    seed: int
    days: int = 2
    since: int = 1

    @property
    def text(self) -> str:
        """For a line of a table."""
        place = "" if self.kind in ("nothing", "tilt") else f" joint {self.joint + 1}"
        from_day = f" from day {self.since + 1}" if self.days > 2 else ""
        return f"{self.arm} {self.kind}{place} {self.size:.3g}{' warm' if self.warm else ''}{from_day}"


@dataclass(frozen=True)
class Outcome:
    """What came of a pair."""

    pair: Pair
    shows: bool
    right: bool
    wrong: bool
    held: tuple[bool, ...]
    felt: tuple[bool, ...]
    words: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--days", type=int, default=2)
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    start = time.perf_counter()
    outcomes = []
    print(f"seed {seed}", flush=True)
    with ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn")) as pool:
        for outcome in pool.map(judged, [drawn(seed, number, arguments.days) for number in range(arguments.pairs)]):
            outcomes.append(outcome)
            mark = "wrong" if outcome.wrong else "right" if outcome.right else "missed" if outcome.shows else "small"
            print(f"  {len(outcomes):3d} {mark:6s} {outcome.pair.text} -> {outcome.words}", flush=True)
    show(f"What changed, seed {seed}, {time.perf_counter() - start:.0f} s", table(outcomes))


def drawn(seed: int, number: int, days: int = 2) -> Pair:
    """The pair of that number."""
    rng = np.random.default_rng([seed, number])
    arm = str(rng.choice(ARMS))
    robot = arm_by_name(arm)
    kind = "nothing" if rng.random() < 1 / 3 else str(rng.choice(KINDS))
    # No motion shows the zero of the first joint, and a mass on the first link hardly shows.
    joint = int(rng.integers(1 if kind in ("zero", "mass") else 0, robot.n - (kind == "zero")))
    sign = float(rng.choice([-1.0, 1.0]))
    sizes = {
        "friction": rng.uniform(0.15, 0.5),
        "mass": np.exp(rng.uniform(np.log(0.2), np.log(2.0))),
        "tilt": np.radians(rng.uniform(0.5, 2.0)),
        "offset": sign * rng.uniform(0.01, 0.03) * effort_limits(robot)[joint],
        "gain": sign * rng.uniform(0.03, 0.08),
        "zero": sign * np.radians(rng.uniform(0.3, 1.0)),
    }
    warm, own = bool(rng.random() < 0.5), int(rng.integers(2**31))
    return Pair(arm, kind, joint, float(sizes.get(kind, 0.0)), warm, own, days, int(rng.integers(1, days)))


def judged(pair: Pair) -> Outcome:
    """Record the days, identify on the first, ask what has changed."""
    robot = arm_by_name(pair.arm)
    recordings = [recorded(pair, day) for day in range(pair.days)]
    model = identify(as_described(robot, pair.seed), recordings[:1])
    friction: tuple[FrictionDifference, ...] = ()
    if pair.days == 2:
        found_between = diagnose(model, recordings[1:], baseline=recordings[:1])
        changes, friction = found_between.changes or (), found_between.friction
        right = [one for one in changes if _is_right(pair, one, robot)]
    else:
        measure = build_measure(model, with_temperature=pair.warm)
        found = monitor_days(measure, [reduce_day(measure, one.name, [one]) for one in recordings]).changes
        changes = tuple(one.change for one in found)
        on_time = [one.change for one in found if one.earliest <= pair.since <= one.latest]
        right = [one for one in on_time if _is_right(pair, one, robot)]
    return Outcome(
        pair,
        shows(pair),
        bool(right) or (pair.kind == "nothing" and not changes),
        len(right) < len(changes),
        _held(pair, right, robot),
        _felt(pair, friction, robot),
        "; ".join(f"{one.choice.effect} {','.join(one.choice.joints)} {one.main.value:+.3g}" for one in changes)
        or "nothing",
    )


def _is_right(pair: Pair, change: Change, robot: Robot) -> bool:
    if change.choice.effect not in NAMES.get(pair.kind, ()):
        return False
    name = robot.joint_names[pair.joint]
    return not change.choice.joints or name in change.choice.joints or name in change.equivalent


def _held(pair: Pair, right: Sequence[Change], robot: Robot) -> tuple[bool, ...]:
    """Whether the intervals hold the truth, of those values that have one.

    All friction follows the warmth, what it changed by among it: the truth is what it was in the later runs.
    """
    drives, parameter = usual_drives(robot), pair.joint + 1
    later = [1.0 + run.warmth for day in range(pair.since, pair.days) for run in day_of(pair, day).runs]
    kinds = {
        "friction": {
            f"Fc{parameter}": [pair.size * drives.coulomb[pair.joint] * factor for factor in later],
            f"Fv{parameter}": [pair.size * drives.viscous[pair.joint] * factor for factor in later],
        },
        "mass": {f"Mp{parameter}": [pair.size]},
        "offset": {f"b{parameter}": [pair.size]},
        "gain": {f"eps{parameter}": [pair.size]},
        "zero": {f"dq0{parameter}": [pair.size]},
    }
    truths = kinds.get(pair.kind, {})
    values = {value.parameter: value for one in right for value in (one.main, *one.more) if value.parameter in truths}
    found = []
    for value in values.values():
        low, high = value.interval
        turned = -1.0 if pair.kind in _SIGNLESS and truths[value.parameter][0] * value.value < 0 else 1.0
        truth = [turned * one for one in truths[value.parameter]]
        found.append(bool(low <= max(truth) and min(truth) <= high))
    return tuple(found)


def _felt(pair: Pair, friction: Sequence[FrictionDifference], robot: Robot) -> tuple[bool, ...]:
    """Whether the intervals of what each joint's friction differs by hold the truth: none but where it was changed.

    What another gain of the joint's own drive makes of its friction is no more of it.
    """
    drives = usual_drives(robot)
    later = [1.0 + run.warmth for day in range(pair.since, pair.days) for run in day_of(pair, day).runs]
    found = []
    for one in friction:
        joint = robot.joint_names.index(one.joint)
        if (pair.kind, pair.joint) == ("gain", joint):
            continue
        own = pair.size if (pair.kind, pair.joint) == ("friction", joint) else 0.0
        truth = [own * (drives.coulomb[joint] + drives.viscous[joint] * one.speed) * factor for factor in later]
        found.append(bool(one.interval[0] <= max(truth) and min(truth) <= one.interval[1]))
    return tuple(found)


def shows(pair: Pair) -> bool:
    """Whether the change leaves anything beyond what the same days leave without it, told without the program.

    Warmth is left out of both: it is recorded, and hides nothing from who looks at it.
    """
    if pair.kind == "nothing":
        return False
    changed, twins = (
        [run for day in range(pair.days) for run in runs_of(one, day, cool=True)[0]]
        for one in (pair, replace(pair, kind="nothing"))
    )
    return bool(shown_beside(arm_by_name(pair.arm), changed, twins).max() >= SHOWS)


def recorded(pair: Pair, day: int) -> Recording:
    """A day's recording: two runs of another motion each, as segments."""
    runs, heat = runs_of(pair, day)
    return recording_from_arrays(
        np.concatenate([run.t for run in runs]),
        np.concatenate([run.q for run in runs]),
        np.concatenate([run.tau for run in runs]),
        joint_names=arm_by_name(pair.arm).joint_names,
        further=FurtherColumns(temperature=np.concatenate(heat) if pair.warm else None),
        segment=np.repeat(np.arange(len(runs)), [len(run.t) for run in runs]),
        name=f"day {day + 1}",
    )


@dataclass(frozen=True)
class DrawnRun:
    """One run of a day: how fast it is, how much more friction its warmth gives, and what is drawn for it."""

    pace: float
    warmth: float
    motion_seed: int
    noise_seed: int


@dataclass(frozen=True)
class DrawnDay:
    """A day: its controller's bandwidth in Hz, whether it moves from point to point, and its runs."""

    bandwidth: float
    still: bool
    runs: tuple[DrawnRun, ...]


def day_of(pair: Pair, day: int) -> DrawnDay:
    """What is drawn for a day."""
    rng = np.random.default_rng([pair.seed, day])
    bandwidth, still = float(np.exp(rng.uniform(np.log(4.0), np.log(12.0)))), bool(rng.random() < 0.4)
    runs = tuple(
        DrawnRun(
            pace,
            float(rng.uniform(-0.2, 0.2)) if pair.warm else 0.0,
            int(rng.integers(2**31)),
            int(rng.integers(2**31)),
        )
        for pace in _PACES
    )
    return DrawnDay(bandwidth, still, runs)


def runs_of(pair: Pair, day: int, cool: bool = False) -> tuple[list[Run], list[FloatArray]]:
    """A day's runs, and the temperatures (m, n) in degC of each; `cool`: the same motions without the warmth."""
    changed = day >= pair.since
    robot = _heavier(arm_by_name(pair.arm), pair) if changed else arm_by_name(pair.arm)
    hidden: tuple[Hidden, ...] = (*_hidden(pair),) if changed else ()
    drawn = day_of(pair, day)
    instruments = Instruments(_COUNTS, 0.006, _RATE)
    noise = np.random.default_rng([pair.seed, day, 1])
    runs, heat = [], []
    for number, own in enumerate(drawn.runs):
        felt = 0.0 if cool else own.warmth
        arm = Arm(robot, _drives(pair, changed, 1.0 + felt), hidden, Bandwidth(drawn.bandwidth))
        make = point_to_point_motion if drawn.still else fourier_motion
        motion = make(robot, _DURATION, own.motion_seed, arm.step, pace=own.pace)
        runs.append(record(arm, motion, instruments, own.noise_seed, Plan(number, 0.0)))
        heat.append(35.0 - 40.0 * own.warmth + 0.1 * noise.standard_normal(runs[-1].q.shape))
    return runs, heat


def _drives(pair: Pair, changed: bool, warmth: float) -> Drives:
    usual = usual_drives(arm_by_name(pair.arm))
    more = np.ones(len(usual.coulomb))
    if changed and pair.kind == "friction":
        more[pair.joint] += pair.size
    return replace(usual, coulomb=usual.coulomb * more * warmth, viscous=usual.viscous * more * warmth)


def _hidden(pair: Pair) -> list[Hidden]:
    heading = np.random.default_rng([pair.seed, 9]).uniform(0, 2 * np.pi)
    kinds: dict[str, Hidden] = {
        "tilt": Tilt(float(pair.size * np.cos(heading)), float(pair.size * np.sin(heading))),
        "offset": Offset(pair.joint, pair.size),
        "gain": GainError(pair.joint, pair.size),
        "zero": ZeroError(pair.joint, pair.size),
    }
    return [kinds[pair.kind]] if pair.kind in kinds else []


def _heavier(robot: Robot, pair: Pair) -> Robot:
    """The arm with a ball on one of its links, where that is what changed."""
    if pair.kind != "mass":
        return robot
    assert robot.inertias is not None
    x, y, z = centre = np.random.default_rng([pair.seed, 8]).uniform(-0.08, 0.08, 3)
    inertia = pair.size * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    inertia[[0, 3, 5]] += 0.4 * pair.size * 0.03**2
    inertias: FloatArray = robot.inertias.copy()
    inertias[pair.joint] += np.concatenate([inertia, pair.size * centre, [pair.size]])
    return replace(robot, inertias=inertias)


def table(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    """Counts by kind, and all together."""
    rows = []
    for kind in ("nothing", *KINDS):
        own = [one for one in outcomes if one.pair.kind == kind]
        counts = Counter(right=sum(one.right for one in own), wrong=sum(one.wrong for one in own))
        held = [held for one in own for held in one.held]
        said = f"{counts['right']}/{len(own)} right, {counts['wrong']} wrong"
        rows.append((kind, f"{said}, {sum(held)}/{len(held)} held" if held else said))
    changed = [one for one in outcomes if one.pair.kind != "nothing"]
    showing = [one for one in changed if one.shows]
    same = [one for one in outcomes if one.pair.kind == "nothing"]
    held = [held for one in outcomes for held in one.held]
    felt = [felt for one in outcomes for felt in one.felt]
    return [
        *rows,
        ("right", f"{sum(one.right for one in changed)}/{len(changed)}"),
        ("right of those that show", f"{sum(one.right for one in showing)}/{len(showing)}"),
        ("wrong", f"{sum(one.wrong for one in changed)}/{len(changed)}"),
        ("alarm", f"{sum(one.wrong for one in same)}/{len(same)}"),
        ("held", f"{sum(held)}/{len(held)}"),
        ("felt", f"{sum(felt)}/{len(felt)}"),
    ]


if __name__ == "__main__":
    main()
