"""Measure how well a robot's own dynamics explain the torque of a motion, in blocks of time that were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.effects import (
    DEFAULT_EFFECTS,
    EffectChoice,
    ReferenceParameters,
    Signals,
    build_columns,
    get_effect,
    get_role,
)
from dynident.identification.recording_faults.column_faults import FaultKind, Motion
from dynident.regressors.observation import Observation
from dynident.robot.model import Robot

BLOCKS = 10
"""Blocks of time that a motion is cut into."""

_STILL, _SLOW = 1e-3, 0.05
"""Share of the fastest joint's speed below which a joint is at rest, and share of its own rms speed below which a row
is left out: sticking joints have a friction of any size."""

CLEARLY, SURELY = 0.6, 2.5
"""Sum over the joints of the logarithm by which the unexplained share of the torque has to fall without a fault (on
one joint to nearly half, or a little on all), and over its standard error among blocks of time. On untouched recordings
of arms of six joints nothing falls by 0.42, nor surely at all; of what can be planted in them 98 % does, but for joints
turned round, which change less (`benchmarks/gross_mistakes.py`). The sum, and not the mean: of an elastic arm of two
joints another order of the columns leaves less by 0.1 to 0.2 a joint."""

CLEARLY_SCALED, SURELY_SCALED = 0.36, 5.0
"""The same of one joint's torque times a power of ten, which changes less but in every block alike: on untouched
recordings it falls by at most 0.3, and by 3.4 standard errors; where the gain of a joint that carries little is ten
times too large, by 0.42 and 8 (`benchmarks/planted_mistakes.py`)."""

INSIDE = 0.33
"""Share of the same that has to fall where the blocks are fitted to, too. In short motions from point to point what was
not fitted to is told by chance: of right ones, 0.04 to 0.4 fell inside where no other order was better; of what was
planted 0.5 and more. What comes of it is among the short motions of `benchmarks/gross_mistakes.py`."""

_DRIVES = 2.5
"""Standard errors by which friction's work has to be negative for it to drive its joint: in right motions that are
short 0.7, by chance; planted faults of which nothing else tells give 2.7 and more."""

_AGAINST = 0.5
"""What friction that drives its joint counts, in the same logarithm: there is no such friction."""

LEAVE_ONE_OUT = np.concatenate([1.0 - np.eye(BLOCKS), np.ones((1, BLOCKS))])
"""(blocks + 1, blocks): of which blocks a sum is made: of all but each, and of all. What only one block has must not be
left of a difference by rounding."""

_LEAST, _MOST = 0.02, 3.0
"""Range of the unexplained share: a smaller one is as good as perfect, a larger one as bad as any."""

_RIDGE = 1e-6
"""Added to the scaled normal matrix: it decides what the motion leaves open, and nothing else."""

_QUIET = 1e-12
"""Share of the largest squared torque that the noise of every joint has at least."""


@dataclass(frozen=True, eq=False)
class UnexplainedTorque:
    """Unexplained shares of the torque of a motion.

    Parameters
    ----------
    blocks : (blocks,)
        Means of log shares over the joints that move, each block held out.
    inside : float
        The same of all blocks together, where they are fitted to.
    against : int
        Number of joints whose friction drives them.
    moving : (n,)
        Which joints move.
    joints : (n,)
        Share of each joint's torque, held out; 0 for joints that do not move.
    """

    blocks: FloatArray
    inside: float
    against: int
    moving: BoolArray
    joints: FloatArray

    @property
    def score(self) -> float:
        """Mean log share with a penalty for friction that drives a joint; the lower the better."""
        return float(self.blocks.mean()) + _AGAINST * self.against

    @property
    def average_share(self) -> float:
        """Unexplained share of an average joint's torque."""
        return float(np.exp(self.blocks.mean()))

    def compute_fall_to(self, other: UnexplainedTorque) -> float:
        """Return the mean logarithm by which the unexplained share falls to another, friction aside."""
        return float((self.blocks - other.blocks).mean())

    @property
    def worst_share(self) -> float:
        """Unexplained share of the joint that is explained worst, which a mean over the joints hides."""
        return float(self.joints.max(initial=0.0))

    def compute_summed_fall_to(self, other: UnexplainedTorque) -> float:
        """Return the sum over the joints of the logarithm by which the score falls to another."""
        return float(self.moving.sum()) * (self.score - other.score)

    def is_surely_above(self, other: UnexplainedTorque, kind: FaultKind | None = None) -> bool:
        """Tell whether clearly more is unexplained than in another fit, in most blocks, or friction drives more joints.

        Parameters
        ----------
        other : UnexplainedTorque
            What the other fit leaves unexplained.
        kind : str, optional
            Of the fault that was mended for the other.
        """
        score, fall = self.compute_summed_fall_to(other), self.compute_fall_to(other)
        # A paired comparison: both fits see the same blocks, so the scatter of the difference counts, which is much
        # smaller than that of either.
        error = float((self.blocks - other.blocks).std(ddof=1)) / np.sqrt(BLOCKS)
        errors = fall / max(error, np.finfo(float).tiny)
        falls_inside = self.inside - other.inside >= INSIDE * fall
        if kind == "torque scaled" and score >= CLEARLY_SCALED and errors >= SURELY_SCALED and falls_inside:
            return True
        return score >= CLEARLY and (self.against > other.against or (errors >= SURELY and falls_inside))


@dataclass(frozen=True, eq=False)
class _MotionRows:
    """W of a motion where each joint moves: inner products (blocks + 1, n, c, c) of each block, and last of all.

    `of_joints`: the numbers of these rows (m,), the rows (m, p) in those columns that the joint's torque depends on,
    and the matrix that adds them up by block and in all (blocks + 1, m).
    """

    motion: Motion
    inner: FloatArray
    of_joints: tuple[tuple[IntArray, FloatArray, FloatArray], ...]

    def is_same_motion(self, other: Motion) -> bool:
        """Tell whether another motion is the same but for its torque."""
        names = ("q", "dq", "ddq", "block")
        return all(np.array_equal(getattr(self.motion, name), getattr(other, name)) for name in names)


@dataclass(frozen=True, eq=False)
class GramMatrices:
    """Inner products where each joint moves, of each block and last of all of them.

    Parameters
    ----------
    inner : (blocks + 1, n, c, c)
        WᵀW.
    right : (blocks + 1, n, c)
        Wᵀτ.
    measured : (blocks + 1, n)
        τᵀτ.
    """

    inner: FloatArray
    right: FloatArray
    measured: FloatArray

    def compute_squares(self, values: FloatArray) -> FloatArray:
        """Return the squared errors (blocks + 1, n) of parameters (blocks + 1, c), each row in its own block."""
        # τᵀτ - 2 χᵀWᵀτ + χᵀWᵀW χ: the squared error from inner products alone.
        products = (self.inner @ values[:, None, :, None])[..., 0]
        remainder = self.measured + np.einsum("bji,bi->bj", products - 2.0 * self.right, values)
        return np.asarray(np.maximum(remainder, 0.0))


class HeldOutFit:
    """Fits of a robot's links, rotors and friction to motions of it.

    Only inner products are kept, so that the hundreds of candidate faults each cost a small solution and no pass over
    the rows.

    Parameters
    ----------
    robot : Robot
        The robot.
    more : tuple of EffectChoice
        Further effects of the model.
    """

    def __init__(self, robot: Robot, more: tuple[EffectChoice, ...] = ()) -> None:
        self._robot = robot
        self._observation = _build_observation(robot, more)
        self._layout = [self._observation.joint_entries(joint) for joint in range(robot.n)]
        self._known: list[_MotionRows] = []

    @property
    def n_columns(self) -> int:
        """Number of parameters."""
        return self._observation.n_columns

    def measure_unexplained(self, motion: Motion) -> UnexplainedTorque:
        """Return the unexplained shares of a motion's torque, each block of time predicted from the others.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        return self._measure_unexplained(motion, self._get_rows(motion))

    def _measure_unexplained(self, motion: Motion, known: _MotionRows) -> UnexplainedTorque:
        grams, moving = self._compute_grams(motion, known), find_moving_joints(motion)
        measured = grams.measured[-1]
        values, squares = self._solve_weighted(grams)
        blocks = compute_log_shares(squares[:-1], measured / BLOCKS)[:, moving]
        whole = compute_log_shares(squares[-1], measured)[moving]
        rest = squares[:-1].sum(axis=0)
        against = sum(
            self._is_driven_by_friction(grams, values[:-1], int(k), float(rest[k])) for k in np.flatnonzero(moving)
        )
        joints = np.where(moving, np.sqrt(rest / np.maximum(measured, np.finfo(float).tiny)), 0.0)
        return UnexplainedTorque(blocks.mean(axis=1), float(whole.mean()), against, moving, joints)

    def measure_frictions(self, motion: Motion) -> FloatArray:
        """Return the mean friction torque of each joint (blocks, n), from the other blocks; NaN where it stands.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        grams, moving = self._compute_grams(motion, self._get_rows(motion)), find_moving_joints(motion)
        values, _ = self._solve_weighted(grams)
        frictions = np.full((BLOCKS, self._robot.n), np.nan)
        for joint in np.flatnonzero(moving):
            friction, sign = self._friction_columns[int(joint)]
            # The projection of the friction torque onto the sign of the velocity: its mean size against the motion.
            whole = grams.inner[-1, joint]
            frictions[:, joint] = values[:-1, friction] @ whole[sign, friction] / max(whole[sign, sign], 1.0)
        return frictions

    def measure_unexplained_of_sum(
        self, motion: Motion, parts: Sequence[HeldOutFit], factors: Sequence[float]
    ) -> UnexplainedTorque:
        """Return the unexplained shares where W is a weighted sum of those of other fits of the same links.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        parts : sequence of HeldOutFit
            The other fits.
        factors : sequence of float
            One factor for each of them.

        Returns
        -------
        UnexplainedTorque
            What such a fit leaves.
        """
        of_joints = []
        for joint, (at, rows, sums) in enumerate(self._get_rows(motion).of_joints):
            columns, total = self._layout[joint][1], np.zeros_like(rows)
            for part, factor in zip(parts, factors, strict=True):
                # Without gravity a joint has fewer columns, so each fit's columns are sought among those of all.
                own = np.searchsorted(columns, part._layout[joint][1])
                total[:, own] += factor * part._get_rows(motion).of_joints[joint][1]
            of_joints.append((at, total, sums))
        return self._measure_unexplained(motion, self._add_inner_products(motion, of_joints))

    def compute_load_columns(self, q: FloatArray) -> list[FloatArray]:
        """Return the columns of each joint's torque (m, p) for a robot at rest at positions (m, n): its gravity."""
        rest, memory = np.zeros_like(q), np.zeros((len(q), self._observation.n_memory))
        reference = ReferenceParameters.massless(self._robot)
        entries = self._observation.evaluate(q, rest, rest, reference=reference, memory=memory)
        return [entries[:, positions] for positions, _ in self._layout]

    def _solve_weighted(self, grams: GramMatrices) -> tuple[FloatArray, FloatArray]:
        """Solve from all blocks but each one, and last from all of them.

        Returns
        -------
        Parameters (blocks + 1, c); and the squares (blocks + 1, n) that they leave, in the one block and in all.
        """
        measured = grams.measured[-1]
        # A joint whose torque is zero, or explained exactly, must not get an infinite weight.
        least = max(_QUIET * float(measured.max(initial=0.0)), np.finfo(float).tiny)
        noise = np.sqrt(np.maximum(measured, least))
        squares, values = grams.measured, np.zeros((BLOCKS + 1, self.n_columns))
        # Two rounds: the first weighs joints by their torque, the second by what the first left unexplained.
        for _ in range(2):
            values = self._fit_all_but_each(grams, noise)
            squares = grams.compute_squares(values)
            noise = np.sqrt(np.maximum(squares[:-1].sum(axis=0), least))
        return values, squares

    def _compute_grams(self, motion: Motion, known: _MotionRows) -> GramMatrices:
        right = np.zeros((BLOCKS + 1, self._robot.n, self.n_columns))
        measured = np.zeros((BLOCKS + 1, self._robot.n))
        for joint, (at, rows, sums) in enumerate(known.of_joints):
            tau = motion.tau[at, joint]
            right[:, joint, self._layout[joint][1]] = (sums * tau) @ rows
            measured[:, joint] = sums @ tau**2
        return GramMatrices(known.inner, right, measured)

    def _get_rows(self, motion: Motion) -> _MotionRows:
        """Return W of a motion; that of two motions is kept, since most candidates change torques alone."""
        known = next((rows for rows in self._known if rows.is_same_motion(motion)), None) or self._evaluate_rows(motion)
        self._known = [known, *(rows for rows in self._known if rows is not known)][:2]
        return known

    def _evaluate_rows(self, motion: Motion) -> _MotionRows:
        robot = self._robot
        reference = ReferenceParameters.massless(robot)
        memory = np.zeros((len(motion.q), self._observation.n_memory))
        entries = self._observation.evaluate(motion.q, motion.dq, motion.ddq, reference=reference, memory=memory)
        moves = find_moving_rows(motion)
        of_joints = []
        for joint, (positions, _) in enumerate(self._layout):
            at = np.flatnonzero(moves[:, joint])
            inside = (motion.block[at] == np.arange(BLOCKS)[:, None]).astype(np.float64)
            sums = np.concatenate([inside, np.ones((1, len(at)))])
            of_joints.append((at, entries[np.ix_(at, positions)], sums))
        return self._add_inner_products(motion, of_joints)

    def _add_inner_products(
        self, motion: Motion, of_joints: Sequence[tuple[IntArray, FloatArray, FloatArray]]
    ) -> _MotionRows:
        inner = np.zeros((BLOCKS + 1, self._robot.n, self.n_columns, self.n_columns))
        for joint, (at, rows, _) in enumerate(of_joints):
            columns = self._layout[joint][1]
            for number in range(BLOCKS):
                part = rows[motion.block[at] == number]
                inner[number, joint][np.ix_(columns, columns)] = part.T @ part
        inner[-1] = inner[:-1].sum(axis=0)
        return _MotionRows(motion, inner, tuple(of_joints))

    def _fit_all_but_each(self, grams: GramMatrices, noise: FloatArray) -> FloatArray:
        """Return the parameters (blocks + 1, c) of all blocks but each, and of all.

        Of those that the motion does not determine, the smallest.
        """
        # Weights relative to the largest noise: torques may be in any unit, and squares of their inverses may overflow.
        c, weights = self.n_columns, (noise.max() / noise) ** 2
        normal = LEAVE_ONE_OUT @ (weights @ grams.inner[:-1].reshape(BLOCKS, self._robot.n, c * c))
        right = LEAVE_ONE_OUT @ (weights @ grams.right[:-1])
        normal = normal.reshape(-1, c, c)
        # Columns of equal size, so that the ridge does not depend on units.
        scale = np.sqrt(np.maximum(np.einsum("bii->bi", normal), np.finfo(float).tiny))
        normal = normal / (scale[:, :, None] * scale[:, None, :]) + _RIDGE * np.eye(c)
        return np.asarray(np.linalg.solve(normal, (right / scale)[:, :, None])[:, :, 0] / scale)

    def _is_driven_by_friction(self, grams: GramMatrices, values: FloatArray, joint: int, rest: float) -> bool:
        """Tell whether a joint's friction surely gives it energy, and more than the unexplained torque could be."""
        friction, sign = self._friction_columns[joint]
        whole, own = grams.inner[-1, joint], values[:, friction]
        work = own @ whole[sign, friction]
        # Each fit leaves one block out, so the scatter of the fits gives the jackknife's standard error.
        if work.mean() >= -_DRIVES * np.sqrt((BLOCKS - 1) * work.var()):
            return False
        # Friction that is small beside the residual may have any sign.
        size = np.einsum("bi,ik,bk->b", own, whole[np.ix_(friction, friction)], own)
        return bool(np.median(size) > 0.25 * rest)

    @cached_property
    def _friction_columns(self) -> list[tuple[list[int], int]]:
        """Columns of each joint's friction, and that of its dry friction, which is 1 or -1."""
        columns = self._observation.columns
        frictions = []
        for name in self._robot.joint_names:
            own = [
                k for k, column in enumerate(columns) if column.link == name and get_effect(column.effect).is_friction
            ]
            frictions.append((own, next(k for k in own if get_role(columns[k]) == "dry")))
        return frictions


@lru_cache(maxsize=4)
def _build_observation(robot: Robot, more: tuple[EffectChoice, ...]) -> Observation:
    """Build the columns of a robot's links, rotors and friction, which are the same for each of its recordings."""
    signals = Signals(robot)
    return Observation.from_columns(robot, build_columns((*DEFAULT_EFFECTS, *more), signals), signals)


def compute_log_shares(squares: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the logarithm of the unexplained share of a torque.

    Parameters
    ----------
    squares : (..., n)
        Squared errors.
    measured : (n,)
        Squared torque.
    """
    # Clipped: one block that is explained perfectly must not decide a mean of logarithms.
    shares = np.sqrt(np.maximum(squares, 0.0) / np.maximum(measured, np.finfo(float).tiny))
    return np.asarray(np.log(np.clip(shares, _LEAST, _MOST)))


def find_moving_rows(motion: Motion) -> BoolArray:
    """Return where each joint moves (m, n)."""
    return np.asarray(np.abs(motion.dq) > _SLOW * np.sqrt((motion.dq**2).mean(axis=0)))


def find_moving_joints(motion: Motion) -> BoolArray:
    """Return which joints move, and have a torque that changes (n,): the others tell nothing."""
    speed = np.sqrt((motion.dq**2).mean(axis=0))
    return np.asarray((speed > _STILL * speed.max(initial=0.0)) & (np.ptp(motion.tau, axis=0) > 0))
