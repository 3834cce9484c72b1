"""Which mistake, if any, was made: the one without which the robot's own dynamics explain the torque clearly better."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.effects import DEFAULT_EFFECTS, Signals, columns_of, effect_by_id, role_of
from dynident.errors import DynidentError
from dynident.identification.mistakes.delays import Delay, delay_of
from dynident.identification.mistakes.scales import load_of, nearer_to_masses
from dynident.identification.mistakes.swaps import Mistake, Motion, mistakes_among
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.evidence import shortened
from dynident.recordings.types import SampleBlock
from dynident.regressors.observation import Observation
from dynident.regressors.stream import parallel_filtered
from dynident.robot.model import Robot

MOST_JOINTS = 12
"""Of longer chains the pairs are too many to be tried while somebody waits."""

_ROWS, _ROWS_PER_COLUMN = 2500, 8
_BLOCKS = 10
_STILL, _SLOW = 1e-3, 0.05

CLEARLY, SURELY = 0.1, 2.5
"""Mean over the joints of the logarithm by which the unexplained share of the torque has to fall without a mistake, and
over its standard error among blocks of time. On untouched recordings nothing falls by 0.07, nor surely at all; of what
can be planted in them 98 % does, but for joints turned round, which change less (`benchmarks/gross_mistakes.py`)."""

_CERTAIN, _CERTAIN_OF_JOINTS, _SOUND = 0.2, 0.4, 0.2
"""The same from which on nothing else is likely: of torques or positions alone, and of whole joints; and what may then
be left of an average joint's torque. Gravity in another direction, a zero that is off by 90 degrees or a gain that is
ten times too large look like an exchange by up to 0.16 and 0.27, or leave more (`benchmarks/gross_mistakes.py`)."""

CLEARLY_AGREES = 0.05
"""The same by which other gains of some joints have to explain more, for the joints not to be in one unit: at most 0.04
with twice or half of it, on the open recordings."""

_ALIKE = 0.02
"""Mistakes without which it falls as much, to this, cannot be told from each other."""

_CURED = 0.4
"""Of what is left without a mistake on an average joint: where it is more, something else is wrong."""

_AGAINST = 0.5
"""What friction that drives its joint counts, in the same logarithm: there is no such friction."""

_LEAST, _MOST = 0.02, 3.0
_RIDGE = 1e-6
_QUIET = 1e-12
_MOST_MISTAKES = 3


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


@dataclass(frozen=True, eq=False)
class _Left:
    """What is left of the torque in blocks of time that were not fitted to.

    `blocks` (blocks,) are means of log shares over the joints that move; `against`: joints whose friction drives them.
    """

    blocks: FloatArray
    against: int
    moving: BoolArray

    @property
    def score(self) -> float:
        """The lower the better."""
        return float(self.blocks.mean()) + _AGAINST * self.against

    @property
    def usual(self) -> float:
        """Share of an average joint's torque."""
        return float(np.exp(self.blocks.mean()))

    def surely_above(self, other: _Left) -> bool:
        """Whether clearly more is left than of another, in most blocks; or friction is against the motion."""
        if self.score - other.score < CLEARLY:
            return False
        fall = self.blocks - other.blocks
        error = float(fall.std(ddof=1)) / np.sqrt(len(fall))
        return self.against > other.against or float(fall.mean()) >= SURELY * error


@dataclass(frozen=True, eq=False)
class _Rows:
    """W of a motion where each joint moves: inner products (blocks, n, c, c); by block and joint, which rows, and them.

    Of the rows only those columns are kept that the joint's torque depends on.
    """

    motion: Motion
    inner: FloatArray
    parts: dict[tuple[int, int], tuple[IntArray, FloatArray]]

    def is_of(self, other: Motion) -> bool:
        """Whether another motion is the same but for its torque."""
        names = ("q", "dq", "ddq", "block")
        return all(np.array_equal(getattr(self.motion, name), getattr(other, name)) for name in names)


class _Judge:
    """Fits a robot's links, rotors and friction to motions of it."""

    def __init__(self, robot: Robot) -> None:
        signals = Signals(robot)
        self._robot = robot
        self._observation = Observation.of(robot, columns_of(DEFAULT_EFFECTS, signals), signals)
        self._layout = [self._observation.joint_entries(joint) for joint in range(robot.n)]
        self._known: list[_Rows] = []

    @property
    def n_columns(self) -> int:
        """Number of parameters."""
        return self._observation.n_columns

    def left(self, motion: Motion) -> _Left:
        """What the robot leaves of the torque, each block of time told by the others."""
        grams, moving = self._grams(motion), _moving(motion)
        measured = grams[:, :, -1, -1].sum(axis=0)
        # A joint without torque, or none that is left, must not get an infinite weight.
        least = max(_QUIET * float(measured.max(initial=0.0)), np.finfo(float).tiny)
        noise = np.sqrt(np.maximum(measured, least))
        squares, values = grams[:, :, -1, -1], np.zeros((_BLOCKS, self.n_columns))
        for _ in range(2):
            values = self._fitted(grams, noise)
            residual = np.concatenate([-values, np.ones((_BLOCKS, 1))], axis=1)
            squares = (np.einsum("bjik,bk->bji", grams, residual) * residual[:, None, :]).sum(axis=2)
            noise = np.sqrt(np.maximum(squares.sum(axis=0), least))
        usual = np.maximum(measured / _BLOCKS, np.finfo(float).tiny)
        shares = np.clip(np.sqrt(np.maximum(squares, 0.0) / usual), _LEAST, _MOST)
        rest = squares.sum(axis=0)
        against = sum(self._drives(grams, values, int(joint), float(rest[joint])) for joint in np.flatnonzero(moving))
        return _Left(np.log(shares[:, moving]).mean(axis=1), against, moving)

    def _grams(self, motion: Motion) -> FloatArray:
        """(blocks, n, c + 1, c + 1): inner products of [W | Y] where each joint moves."""
        known, c = self._rows_of(motion), self.n_columns
        grams = np.zeros((_BLOCKS, self._robot.n, c + 1, c + 1))
        grams[:, :, :c, :c] = known.inner
        for (block, joint), (at, rows) in known.parts.items():
            columns, measured = self._layout[joint][1], motion.tau[at, joint]
            gram = grams[block, joint]
            gram[columns, c] = gram[c, columns] = rows.T @ measured
            gram[c, c] = measured @ measured
        return grams

    def _rows_of(self, motion: Motion) -> _Rows:
        """W of a motion; of two motions it is kept, since most of what is tried changes torques alone."""
        known = next((one for one in self._known if one.is_of(motion)), None) or self._evaluated(motion)
        self._known = [known, *(one for one in self._known if one is not known)][:2]
        return known

    def _evaluated(self, motion: Motion) -> _Rows:
        robot, c = self._robot, self.n_columns
        reference, memory = np.zeros(10 * robot.tree.n), np.zeros((len(motion.q), self._observation.n_memory))
        entries = self._observation.evaluate(motion.q, motion.dq, motion.ddq, reference=reference, memory=memory)
        moves = np.abs(motion.dq) > _SLOW * np.sqrt((motion.dq**2).mean(axis=0))
        blocks = [motion.block == block for block in range(_BLOCKS)]
        inner, parts = np.zeros((_BLOCKS, robot.n, c, c)), {}
        for joint, (positions, columns) in enumerate(self._layout):
            rows = np.ascontiguousarray(entries[:, positions])
            for block, inside in enumerate(blocks):
                at = np.flatnonzero(moves[:, joint] & inside)
                part = rows[at]
                inner[block, joint][np.ix_(columns, columns)] = part.T @ part
                parts[block, joint] = at, part
        return _Rows(motion, inner, parts)

    def _fitted(self, grams: FloatArray, noise: FloatArray) -> FloatArray:
        """(blocks, c): parameters of the blocks but each one; where the motion says nothing, the smallest ones."""
        each = np.einsum("bjik,j->bik", grams, 1.0 / noise**2)
        others = each.sum(axis=0) - each
        scale = np.sqrt(np.maximum(np.einsum("bii->bi", others)[:, :-1], np.finfo(float).tiny))
        normal = others[:, :-1, :-1] / (scale[:, :, None] * scale[:, None, :]) + _RIDGE * np.eye(self.n_columns)
        right = others[:, :-1, -1] / scale
        return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0] / scale)

    def _drives(self, grams: FloatArray, values: FloatArray, joint: int, rest: float) -> bool:
        """Whether a joint's friction, in every fit, gives it energy, and more than what is left could be."""
        name, columns = self._robot.joint_names[joint], self._observation.columns
        friction = [k for k, one in enumerate(columns) if one.link == name and effect_by_id(one.effect).is_friction]
        sign = next(k for k in friction if role_of(columns[k]) == "dry")
        whole = grams[:, joint].sum(axis=0)
        work = values[:, friction] @ whole[sign, friction]
        size = np.einsum("bi,ik,bk->b", values[:, friction], whole[np.ix_(friction, friction)], values[:, friction])
        return bool((work < 0).all() and np.median(size) > 0.25 * rest)


def mistakes_in(robot: Robot, recording: Recording) -> tuple[tuple[Finding, ...], float] | None:
    """The gross mistakes in a recording, the one that explains most first.

    One after the other is mended until none is left without which the torque is explained clearly better.

    Returns
    -------
    The mistakes, and the share of an average joint's torque that is left without them; None where the recording is too
    short, or the robot too long, to tell.
    """
    motion = motion_of(recording) if robot.n <= MOST_JOINTS else None
    return None if motion is None else mistakes_of(robot, motion)


def mistakes_of(robot: Robot, motion: Motion) -> tuple[tuple[Finding, ...], float] | None:
    """The same of rows that are filtered already."""
    judge = _Judge(robot)
    if len(motion.q) * int(_moving(motion).sum()) < _ROWS_PER_COLUMN * judge.n_columns:
        return None
    found: list[Finding] = []
    now = judge.left(motion)
    while len(found) < _MOST_MISTAKES:
        load = load_of(robot, motion)
        possible = [one for one in mistakes_among(now.moving) if _may_be(one, motion, load)]
        tried = [(one, judge.left(one.mended(motion))) for one in possible]
        if not tried:
            break
        best, left = min(tried, key=lambda pair: pair[1].score)
        if not now.surely_above(left) or left.usual > _CURED:
            break
        twins = tuple(one for one, other in tried if one is not best and other.score - left.score < _ALIKE)
        least = _CERTAIN_OF_JOINTS if best.is_of_whole_joints else _CERTAIN
        # A drive that is coupled with its neighbour looks like a gain that is wrong, by as much.
        certain = best.kind != "torque scaled" and now.score - left.score >= least and left.usual <= _SOUND
        found.append(Finding(best, twins, now.usual, left.usual, certain))
        motion, now = best.mended(motion), left
    return tuple(found), now.usual


def _may_be(one: Mistake, motion: Motion, load: FloatArray | None) -> bool:
    """Whether the masses of the description do not refute a mistake: a torque in another unit is far from them."""
    return one.kind != "torque scaled" or nearer_to_masses(load, motion, one.joints[0], one.factor)


def delay_among(robot: Robot, motion: Motion, period: float) -> Delay | None:
    """By how much the torque of a motion is late: all filtered rows, in their order, `period` s apart.

    None where they are too few to tell.
    """
    judge = _Judge(robot)
    if len(thinned(motion).q) * int(_moving(motion).sum()) < _ROWS_PER_COLUMN * judge.n_columns:
        return None
    return delay_of(motion, period, lambda tried: judge.left(thinned(tried)).blocks)


def better_by_other_gains(robot: Robot, motion: Motion, factor: float) -> float:
    """By how much other gains would explain better: near 0 where the torques of all joints are in one unit.

    Returns
    -------
    The largest fall of the mean logarithm of what is left, with the torque of any joint, or of all joints from one on,
    times or over `factor`.
    """
    judge = _Judge(robot)
    now, joints = judge.left(motion), np.arange(robot.n)
    groups = [*(joints == k for k in np.flatnonzero(now.moving)), *(joints >= k for k in range(2, robot.n - 1))]
    tried = [np.where(group, one, 1.0) for group in groups for one in (factor, 1.0 / factor)]
    return max(now.score - judge.left(replace(motion, tau=motion.tau * times)).score for times in tried)


def left_of(robot: Robot, motion: Motion) -> float:
    """Share of an average joint's torque that the robot's dynamics leave."""
    return _Judge(robot).left(motion).usual


def _moving(motion: Motion) -> BoolArray:
    speed = np.sqrt((motion.dq**2).mean(axis=0))
    return np.asarray((speed > _STILL * speed.max(initial=0.0)) & (np.ptp(motion.tau, axis=0) > 0))


def motion_of(recording: Recording) -> Motion | None:
    """Filtered rows from all over a recording; None where it is too short to be filtered."""
    found = whole_motion_of(recording)
    return None if found is None else thinned(found[0])


def thinned(motion: Motion) -> Motion:
    """As many rows from all over a motion as mistakes are looked for in."""
    step = max(1, len(motion.q) // _ROWS)
    q, dq, ddq, tau = (np.ascontiguousarray(one[::step]) for one in (motion.q, motion.dq, motion.ddq, motion.tau))
    block: IntArray = np.arange(len(q)) * _BLOCKS // len(q)
    return Motion(q, dq, ddq, tau, block)


def whole_motion_of(recording: Recording) -> tuple[Motion, float] | None:
    """Filtered rows in their order, and the seconds between them; None where it is too short to be filtered."""
    try:
        choice = choose_preprocessing([recording])
    except DynidentError:
        return None
    n = recording.n

    def values(block: SampleBlock) -> FloatArray:
        return np.concatenate([block.q, block.dq, block.ddq, block.tau], axis=1)

    short = shortened(recording, choice.decimation)
    rows = [part for _, _, part in parallel_filtered(short, choice, values)]
    whole = np.concatenate(rows) if rows else np.zeros((0, 4 * n))
    if not len(whole):
        return None
    block: IntArray = np.arange(len(whole)) * _BLOCKS // len(whole)
    q, dq, ddq, tau = (np.ascontiguousarray(part) for part in np.split(whole, 4, axis=1))
    return Motion(q, dq, ddq, tau, block), short.period * choice.decimation
