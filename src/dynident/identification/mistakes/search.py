"""Which mistake, if any, was made: the one without which the robot's own dynamics explain the torque clearly better."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.effects import OFFSETS
from dynident.identification.mistakes.bands import thinned, whole_motion_of
from dynident.identification.mistakes.delays import BESIDE_OFFSETS, Delay, delay_of
from dynident.identification.mistakes.described import SecondOpinion
from dynident.identification.mistakes.frictions import excess_of, nearer_to_others
from dynident.identification.mistakes.judge import CLEARLY, Judge, Left, moving_joints
from dynident.identification.mistakes.scales import by_masses, heavy_joints, load_of, nearer_to_masses
from dynident.identification.mistakes.swaps import Mistake, Motion, alone, mistakes_among
from dynident.recordings import Recording
from dynident.robot.model import Robot

MOST_JOINTS = 12
"""Of longer chains the pairs are too many to be tried while somebody waits."""

_ROWS_PER_COLUMN = 8

_CERTAIN, _CERTAIN_OF_JOINTS, SOUND = 1.2, 2.4, 0.2
"""Sum over the joints of the logarithm of what is left that falls without a mistake, from which on nothing else is
likely: of torques or positions alone, and of whole joints; and what may then be left of an average joint's torque. A
zero that is off by 90 degrees or a gain that is ten times too large look like an exchange by up to 1.0 and 1.6 on arms
of six joints, or leave more (`benchmarks/gross_mistakes.py`)."""

CLEARLY_AGREES = 0.05
"""Mean over the joints of that logarithm by which other gains of some joints have to explain more, for the joints not
to be in one unit: at most 0.04 with twice or half of it, on the open recordings."""

ALIKE = 0.02
"""Causes without which that mean falls as much, to this, cannot be told from each other."""

_APART = 0.75
"""Share of what is explained without a mistake that its joints may explain by themselves, apart from the others: where
it is more, they do not go with the others, for whatever reason. Of right short motions it was 0.9 and more where an
order or a sign looked wrong, with what was planted at most 0.5. What comes of it is among the short motions of
`benchmarks/gross_mistakes.py`."""

_CURED = 0.3
"""Of what is left without a mistake on an average joint: where it is more, something else is wrong."""

_OFF = 0.05
"""Share of the other joints' friction below which a joint's torque has none: its drive is off, and nothing is told of
its sign or size. Of an arm with a free motor it was up to 0.04; the smallest of drives that are on has 0.15."""

WORST_EXPLAINED = 0.15
"""Share of the torque of the joint that is explained worst, below which nothing else about the robot is looked for."""

_EXPLAINED = 0.2
"""Share left of an average joint's torque, or of the worst joint's, from which on the motion's own band is looked at
instead: an elastic arm leaves that with the filters of an identification, and half of it there."""

_MOST_MISTAKES = 3

_PARALLEL = 0.999
"""Cosine of the angle between axes, 2.6 degrees, up to which they count as parallel: calibrated robots differ less."""


@dataclass(frozen=True)
class Finding:
    """A mistake that was made, what it cannot be told from, and what is left of the torque with it and without.

    Where it is not `certain`, something else that is wrong may look so.
    """

    mistake: Mistake
    alike: tuple[Mistake, ...]
    left_with: float
    left_without: float
    certain: bool


def mistakes_in(robot: Robot, recording: Recording) -> tuple[tuple[Finding, ...], float] | None:
    """The gross mistakes in a recording, the one that explains most first.

    One after the other is mended until none is left without which the torque is explained clearly better.

    Returns
    -------
    The mistakes, and the share of an average joint's torque that is left without them; None where the recording is too
    short, or the robot too long, to tell.
    """
    judges = Judges(robot)
    whole = motion_to_judge(recording, judges) if robot.n <= MOST_JOINTS else None
    return None if whole is None else mistakes_of(robot, thinned(whole[0]), judges)


def mistakes_of(robot: Robot, motion: Motion, judges: Judges | None = None) -> tuple[tuple[Finding, ...], float] | None:
    """The same of rows that are filtered already, `judges` those of the robot, if they are at hand."""
    found = find_mistakes(robot, motion, judges)
    return None if found is None else (found[0], found[1].usual)


def find_mistakes(
    robot: Robot, motion: Motion, judges: Judges | None = None
) -> tuple[tuple[Finding, ...], Left] | None:
    """Find the mistakes in filtered rows, and what is left without them; None where the rows are too few to tell."""
    judges = judges or Judges(robot)
    judge = judges.plain
    if not _is_enough(motion, judge):
        return None
    found: list[Finding] = []
    now = judge.left(motion)
    while len(found) < _MOST_MISTAKES:
        step = _best(judge, robot, motion, now)
        if step is None:
            break
        fall, summed = now.score - step.left.score, now.summed_fall_to(step.left)
        mended = step.mistake.mended(motion)
        if judge is judges.plain and _fall_of(judges.beside_offsets, motion, mended) < BESIDE_OFFSETS * fall:
            # A constant torque explains the same: what else there is, is looked for beside it.
            judge = judges.beside_offsets
            now = judge.left(motion)
            continue
        least = _CERTAIN_OF_JOINTS if step.mistake.is_of_whole_joints else _CERTAIN
        # A drive that is coupled with its neighbour looks like a gain that is wrong, by as much; of several none does.
        may_be_sure = step.mistake.kind != "torque scaled" or len(step.mistake.joints) > 1
        certain = may_be_sure and summed >= least and step.left.usual <= SOUND
        found.append(Finding(step.mistake, step.alike, now.usual, step.left.usual, certain))
        motion, now = mended, step.left
    return tuple(found), now


class Judges:
    """What judges motions of a robot: its links and friction, or those beside a constant torque on each joint.

    Each is built when it is first asked for, and serves whatever is asked of the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @cached_property
    def plain(self) -> Judge:
        """Of links and friction."""
        return Judge(self._robot)

    @cached_property
    def beside_offsets(self) -> Judge:
        """Of these and a constant torque on each joint."""
        return Judge(self._robot, (OFFSETS,))


def _fall_of(judge: Judge, motion: Motion, mended: Motion) -> float:
    """By how much less is left without a mistake."""
    return judge.left(motion).score - judge.left(mended).score


class _Step(NamedTuple):
    """A mistake, what cannot be told from it, and what is left without it."""

    mistake: Mistake
    alike: tuple[Mistake, ...]
    left: Left


def _best(judge: Judge, robot: Robot, motion: Motion, now: Left) -> _Step | None:
    """The mistake without which least is left of a motion; None where none is told."""
    sizes = _Sizes(load_of(robot, motion), judge.frictions(motion), _excess(judge, robot, motion))
    has_torque = np.ptp(motion.tau, axis=0) > 0
    among = mistakes_among(now.moving, parallel_to_the_one_before(robot), has_torque, chains_of(robot))
    off = _joints_off(sizes.frictions)
    possible = [one for one in among if one.joints not in off and _may_be(one, robot, motion, sizes)]
    tried = [(one, judge.left(one.mended(motion))) for one in possible]
    described = SecondOpinion(robot, motion, now)
    for best, left in sorted(tried, key=lambda pair: pair[1].score):
        if not now.surely_above(left, best.kind) or left.usual > _CURED:
            return None
        if best.kind != "torque scaled" and left.against >= now.against and len(best.joints) < robot.n:
            apart = judge.left(alone(motion, best.joints))
            if now.fall_to(apart) > _APART * now.fall_to(left):
                return None
        if described.refutes(best):
            continue
        own = (best.kind, best.joints)
        alike = [one for one, other in tried if (one.kind, one.joints) != own and other.score - left.score < ALIKE]
        if best.kind == "torque scaled":
            best = replace(best, factor=by_masses(robot, motion, best.joints, best.factor))
            left = judge.left(best.mended(motion))
        return _Step(best, tuple(one for one in alike if not _is_told_apart(best, one, described)), left)
    return None


def _is_told_apart(best: Mistake, other: Mistake, described: SecondOpinion) -> bool:
    return described.refutes(other) or described.prefers(best, other)


def _joints_off(frictions: FloatArray) -> set[tuple[int, ...]]:
    """Joints, one by one, whose torque has no friction beside that of the others, of friction (blocks, n)."""
    size = np.abs(np.median(frictions, axis=0))
    others = [np.delete(size, joint) for joint in range(len(size))]
    usual = [float(np.median(one[np.isfinite(one)])) if np.isfinite(one).any() else 0.0 for one in others]
    return {(joint,) for joint in range(len(size)) if size[joint] < _OFF * usual[joint]}


@dataclass(frozen=True, eq=False)
class _Sizes:
    """What tells a torque's size: the load (m, n) of the masses, frictions (blocks, n), joints that have too much."""

    load: FloatArray | None
    frictions: FloatArray
    excess: Collection[int]


def _may_be(one: Mistake, robot: Robot, motion: Motion, sizes: _Sizes) -> bool:
    """Whether neither masses nor friction refute a mistake: a torque in another unit is far from those of the others.

    Where the friction of some joints is too large, they are among them.
    """
    if one.kind != "torque scaled":
        return True
    if sizes.excess and (not set(sizes.excess) <= set(one.joints) or one.factor > 1.0):
        return False
    return all(
        nearer_to_masses(sizes.load, motion, joint, one.factor)
        and nearer_to_others(robot, sizes.frictions, joint, one.factor)
        for joint in one.joints
    )


def motion_to_judge(recording: Recording, judges: Judges) -> tuple[Motion, float] | None:
    """Filter a recording as an identification does; or narrower, where much is left that way and clearly less so.

    Returns
    -------
    Rows in their order, and the seconds between them; None where the recording is too short.
    """
    wide = whole_motion_of(recording)
    if wide is None or not _is_enough(wide[0], judges.plain):
        return wide
    left = judges.plain.left(thinned(wide[0]))
    if max(left.usual, left.worst) < _EXPLAINED:
        return wide
    narrow = whole_motion_of(recording, narrow=True)
    if narrow is None or not _is_enough(narrow[0], judges.plain):
        return wide
    return narrow if left.summed_fall_to(judges.plain.left(thinned(narrow[0]))) >= CLEARLY else wide


def _is_enough(motion: Motion, judge: Judge) -> bool:
    """Whether there are rows enough to tell anything."""
    return len(thinned(motion).q) * int(moving_joints(motion).sum()) >= _ROWS_PER_COLUMN * judge.n_columns


def chains_of(robot: Robot) -> list[list[int]]:
    """Give the joints of each chain without branches: of every leg, or arm, of a robot."""
    children = Counter(joint.parent for joint in robot.joints)
    chains: list[list[int]] = []
    for k, joint in enumerate(robot.joints):
        if chains and joint.parent == chains[-1][-1] and children[joint.parent] == 1:
            chains[-1].append(k)
        else:
            chains.append([k])
    return chains


def parallel_to_the_one_before(robot: Robot) -> BoolArray:
    """(n,): joints that turn about an axis parallel to that of the joint before: their angles may be counted together.

    Of a robot whose joints follow others nothing is told.
    """
    found = np.zeros(robot.n, dtype=bool)
    for k in range(1, robot.n if robot.linkage is None else 0):
        joint, before = robot.joints[k], robot.joints[k - 1]
        if joint.parent != k - 1 or {joint.kind, before.kind} != {"revolute"}:
            continue
        across = np.asarray(joint.placement)[:3, :3] @ np.asarray(joint.axis)
        found[k] = abs(float(across @ np.asarray(before.axis))) > _PARALLEL
    return found


def excess_in(robot: Robot, motion: Motion, judges: Judges | None = None) -> dict[int, float]:
    """The joints whose friction is too large for the robot, and how many times."""
    return _excess((judges or Judges(robot)).plain, robot, motion)


def _excess(judge: Judge, robot: Robot, motion: Motion) -> dict[int, float]:
    return excess_of(robot, judge.frictions(motion), heavy_joints(robot, motion))


def delay_among(robot: Robot, motion: Motion, period: float, judges: Judges | None = None) -> Delay | None:
    """By how much the torque of a motion is late: all filtered rows, in their order, `period` s apart.

    None where they are too few to tell.
    """
    judges = judges or Judges(robot)
    judge = judges.plain
    if not _is_enough(motion, judge):
        return None
    return delay_of(
        motion,
        period,
        lambda tried: judge.left(thinned(tried)),
        lambda tried: judges.beside_offsets.left(thinned(tried)),
    )


def better_by_other_gains(robot: Robot, motion: Motion, factor: float) -> float:
    """By how much other gains would explain better: near 0 where the torques of all joints are in one unit.

    Returns
    -------
    The largest fall of the mean logarithm of what is left, with the torque of any joint, or of all joints from one on,
    times or over `factor`.
    """
    judge = Judge(robot)
    now, joints = judge.left(motion), np.arange(robot.n)
    groups = [*(joints == k for k in np.flatnonzero(now.moving)), *(joints >= k for k in range(2, robot.n - 1))]
    tried = [np.where(group, one, 1.0) for group in groups for one in (factor, 1.0 / factor)]
    return max(now.score - judge.left(replace(motion, tau=motion.tau * times)).score for times in tried)


def left_of(robot: Robot, motion: Motion) -> float:
    """Share of an average joint's torque that the robot's dynamics leave."""
    return Judge(robot).left(motion).usual
