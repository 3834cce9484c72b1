"""The share of torque that fitted dynamics leave unexplained, as one score a joint; levels of clear differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

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
from dynident.identification.recording_faults.column_faults import TURNS, ColumnFault, Motion
from dynident.identification.recording_faults.tree_fit import (
    BLOCKS,
    TorqueStep,
    TreeFit,
    TreeSolution,
    find_moving_joints,
    list_trees,
)
from dynident.regressors.base_parameters import evaluate_at_random_states, select_base
from dynident.regressors.observation_matrix import Observation
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

CLEARLY, SURELY = 0.6, 2.5
"""Sum over the joints of the logarithm by which the unexplained share of the torque has to fall without a fault (on
one joint to nearly half, or a little on all), and over its standard error among blocks of time. On untouched recordings
of arms of six joints nothing falls by 0.42, nor surely at all; of what can be planted in them 98 % does, but for joints
turned round, which change less (`benchmarks/gross_mistakes.py`). The sum, and not the mean: of an elastic arm of two
joints another order of the columns leaves less by 0.1 to 0.2 a joint."""

CLEARLY_IN_ALL_BLOCKS, IN_ALL_BLOCKS = 0.36, 5.0
"""The same where it falls in every block alike: on untouched recordings it falls by at most 0.3, and by 3.4 standard
errors; where the gain of a joint that carries little is ten times too large, by 0.42 and 8, and where a zero of a joint
is 90 degrees off, by 0.38 and 12 (`benchmarks/planted_mistakes.py`)."""

CERTAIN, CERTAIN_OF_JOINTS, SOUND = 1.2, 2.4, 0.2
"""Sum over the joints of the logarithm of what is left that falls without a fault, from which on nothing else is
likely: of torques or positions alone, and of whole joints; and what may then be left of an average joint's torque. A
zero that is off by 90 degrees or a gain that is ten times too large look like an exchange by up to 1.0 and 1.6 on arms
of six joints, or leave more (`benchmarks/gross_mistakes.py`)."""

INSIDE = 0.33
"""Share of the same that has to fall where the blocks are fitted to, too. In short motions from point to point what was
not fitted to is told by chance: of right ones, 0.04 to 0.4 fell inside where no other order was better; of what was
planted 0.5 and more. What comes of it is among the short motions of `benchmarks/gross_mistakes.py`."""

_AGAINST = 0.5
"""What friction that drives its joint counts, in the same logarithm: there is no such friction."""

_DEPENDENT = 1e-8  # share of the largest singular value, below which columns depend on others
_LEAST, _MOST = 0.02, 3.0
"""Range of the unexplained share: a smaller one is as good as perfect, a larger one as bad as any."""

LEAST_FINE = 1e-4
"""The lower end where a lowest point is looked for: near it all shares of a good recording may be as good as perfect,
and a curve that is cut off flat has its lowest point anywhere."""


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
    fine : (blocks,)
        As `blocks`, and not cut off where nearly all is explained.
    fine_inside : float
        The same of `inside`.
    """

    blocks: FloatArray
    inside: float
    against: int
    moving: BoolArray
    joints: FloatArray
    fine: FloatArray
    fine_inside: float

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

    def is_much_above(self, mended: UnexplainedTorque, fault: ColumnFault) -> bool:
        """Return whether the joints of a fault are much better explained without it; a size says nothing of that."""
        has_less = all(mended.joints[joint] <= _EXPLAINED_MUCH * self.joints[joint] for joint in fault.own_joints)
        return has_less and fault.kind != "torque scaled"

    def is_surely_above(self, other: UnexplainedTorque, *, by_friction: bool = True) -> bool:
        """Tell whether clearly more is unexplained than in another fit, in most blocks, or friction drives more joints.

        Parameters
        ----------
        other : UnexplainedTorque
            What the other fit leaves unexplained.
        by_friction : bool
            Whether friction that drives more joints tells it by itself.
        """
        score, fall = self.compute_summed_fall_to(other), self.compute_fall_to(other)
        # A paired comparison: both fits see the same blocks, so the scatter of the difference counts, which is much
        # smaller than that of either.
        error = float((self.blocks - other.blocks).std(ddof=1)) / np.sqrt(BLOCKS)
        errors = fall / max(error, np.finfo(float).tiny)
        falls_inside = self.inside - other.inside >= INSIDE * fall
        if score >= CLEARLY_IN_ALL_BLOCKS and errors >= IN_ALL_BLOCKS and falls_inside:
            return True
        is_by_friction = by_friction and self.against > other.against
        return score >= CLEARLY and (is_by_friction or (errors >= SURELY and falls_inside))


class HeldOutFit:
    """Fits of a robot's links, rotors and friction to motions of it.

    Only inner products are kept, so that the hundreds of candidate faults each cost a small solution and no pass over
    the rows. Trees of links that stand on the base side by side, such as legs on a trunk that is held, share no
    parameter: each is fitted by itself, and again only if its own signals change.

    Parameters
    ----------
    robot : Robot
        The robot.
    more : tuple of EffectChoice
        Further effects of the model.
    like : HeldOutFit, optional
        Fit of the same links whose parameters are fitted, as where gravity points in another direction.
    """

    def __init__(self, robot: Robot, more: tuple[EffectChoice, ...] = (), like: HeldOutFit | None = None) -> None:
        self._robot = robot
        # Columns that depend on others are those of the fit whose parameters are taken.
        parameters = [model[2] for model in _build_models(robot if like is None else like._robot, more)]
        self._trees = [
            TreeFit(robot, joints, observation, independent)
            for (joints, observation), independent in zip(_build_observations(robot, more), parameters, strict=True)
        ]

    def count_columns(self, motion: Motion) -> int:
        """Return how many independent parameters a motion has anything to do with.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        return sum(tree.count_columns(motion) for tree in self._trees)

    def measure_unexplained(self, motion: Motion) -> UnexplainedTorque:
        """Return the unexplained shares of a motion's torque, each block of time predicted from the others.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        return self._join(motion, [tree.solve(motion) for tree in self._trees])

    def estimate_score(self, motion: Motion, least: float = _LEAST) -> float:
        """Return about the least score that a motion may have, by one fit to all blocks of time.

        A block that is held out is never explained better than where it is fitted to.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        least : float
            Smaller shares count as this one.
        """
        n, moving = self._robot.n, find_moving_joints(motion)
        squares, measured = np.zeros((BLOCKS, n)), np.zeros(n)
        for tree in self._trees:
            squares[:, tree.joints], measured[tree.joints] = tree.solve_inside(motion)
        return float(compute_log_shares(squares, measured / BLOCKS, least)[:, moving].mean())

    def _join(self, motion: Motion, solutions: Sequence[TreeSolution]) -> UnexplainedTorque:
        n, moving = self._robot.n, find_moving_joints(motion)
        squares, measured, against = np.zeros((BLOCKS + 1, n)), np.zeros(n), np.zeros(n, dtype=bool)
        for tree, solution in zip(self._trees, solutions, strict=True):
            squares[:, tree.joints], measured[tree.joints] = solution.squares, solution.measured
            against[tree.joints] = solution.against
        blocks = compute_log_shares(squares[:-1], measured / BLOCKS)[:, moving]
        whole = compute_log_shares(squares[-1], measured)[moving]
        fine = compute_log_shares(squares[:-1], measured / BLOCKS, LEAST_FINE)[:, moving]
        fine_inside = compute_log_shares(squares[-1], measured, LEAST_FINE)[moving]
        rest = squares[:-1].sum(axis=0)
        joints = np.sqrt(np.divide(rest, measured, out=np.zeros_like(rest), where=moving & (measured > 0)))
        return UnexplainedTorque(
            blocks.mean(axis=1),
            float(whole.mean()),
            int((against & moving).sum()),
            moving,
            joints,
            fine.mean(axis=1),
            float(fine_inside.mean()),
        )

    def find_torque_steps(self, motion: Motion) -> list[TorqueStep]:
        """Return the torques that step once, most of what is unexplained of them, as where a sensor is zeroed anew.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        return [step for tree in self._trees for step in tree.find_torque_steps(motion) if step.is_clear]

    def measure_shifted(self, motion: Motion, shifts: IntArray) -> FloatArray:
        """Return the unexplained share of an average joint's torque with the torque read at later rows.

        Each joint is fitted by itself to the rows that every shift has.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording, evenly spaced.
        shifts : (shifts,)
            By how many rows.

        Returns
        -------
        (shifts,)
        """
        margin, m = int(np.abs(shifts).max()), len(motion.q)
        logs = []
        for tree in self._trees:
            for joint, (at, rows) in zip(tree.joints, tree.list_rows(motion), strict=True):
                inner = (at >= margin) & (at < m - margin)
                if inner.sum() <= 2 * rows.shape[1] or not np.ptp(motion.tau[:, joint]):
                    continue
                basis, sizes, _ = np.linalg.svd(rows[inner], full_matrices=False)
                basis = basis[:, sizes > _DEPENDENT * sizes[0]]
                tau = motion.tau[at[inner, None] + shifts, joint]
                measured = np.einsum("ij,ij->j", tau, tau)
                explained = np.einsum("ij,ij->j", along := basis.T @ tau, along)
                logs.append(compute_log_shares(measured - explained, measured))
        return np.exp(np.mean(logs, axis=0)) if logs else np.ones(len(shifts))

    def measure_frictions(self, motion: Motion) -> FloatArray:
        """Return the mean friction torque of each joint (blocks, n), from the other blocks; NaN where it stands.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        frictions = np.full((BLOCKS, self._robot.n), np.nan)
        for tree in self._trees:
            frictions[:, tree.joints] = tree.solve(motion).frictions
        return np.where(find_moving_joints(motion), frictions, np.nan)

    def measure_unexplained_of_sum(
        self, motion: Motion, parts: Sequence[HeldOutFit], factors: Sequence[float]
    ) -> UnexplainedTorque:
        """Return the unexplained shares where W is that of another fit, and multiples of what further ones add to it.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        parts : sequence of HeldOutFit
            The other fits, of the same parameters; always the same ones.
        factors : sequence of float
            How many times what each fit but the first one differs by from the first is added to it.

        Returns
        -------
        UnexplainedTorque
            What such a fit leaves.
        """
        trees = [
            tree.solve_sum(motion, [part._trees[number] for part in parts], factors)
            for number, tree in enumerate(self._trees)
        ]
        return self._join(motion, trees)

    def compute_load_columns(self, q: FloatArray) -> list[FloatArray]:
        """Return the columns of each joint's torque (m, p) for a robot at rest at positions (m, n): its gravity."""
        loads = {joint: load for tree in self._trees for joint, load in tree.compute_load_columns(q).items()}
        return [loads[joint] for joint in range(self._robot.n)]


def measure_unexplained_share(robot: Robot, motion: Motion) -> float:
    """Return the share of an average joint's torque that the robot's dynamics leave unexplained.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
    return HeldOutFit(robot).measure_unexplained(motion).average_share


def measure_gain_by_other_scales(robot: Robot, motion: Motion, factor: float) -> float:
    """Return how much other gains would explain better: near 0 where the torques of all joints are in one unit.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    factor : float
        Of the other gains.

    Returns
    -------
    float
        The largest fall of the score, with the torque of any joint, or of all joints from one on, times or over
        `factor`.
    """
    judge = HeldOutFit(robot)
    # A torque in a single unit fits best as it is; if it gains by scaling some joints, the joints are in different
    # units.
    now, joints = judge.measure_unexplained(motion), np.arange(robot.n)
    groups = [*(joints == k for k in np.flatnonzero(now.moving)), *(joints >= k for k in range(2, robot.n - 1))]
    factors = [np.where(group, times, 1.0) for group in groups for times in (factor, 1.0 / factor)]
    return max(
        now.score - judge.measure_unexplained(replace(motion, tau=motion.tau * times)).score for times in factors
    )


@lru_cache(maxsize=8)
def _build_observations(
    robot: Robot, more: tuple[EffectChoice, ...]
) -> tuple[tuple[tuple[int, ...], Observation], ...]:
    """Build the columns of each tree's links, rotors and friction. They are the same for each recording of a robot."""
    signals = Signals(robot)
    columns = build_columns((*DEFAULT_EFFECTS, *more), signals)
    trees = list_trees(robot)
    observations = []
    for joints in trees:
        names = {robot.joint_names[joint] for joint in joints}
        own = columns if len(trees) == 1 else [column for column in columns if column.link in names]
        observations.append((tuple(joints), Observation.from_columns(robot, own, signals)))
    return tuple(observations)


@lru_cache(maxsize=8)
def _build_models(
    robot: Robot, more: tuple[EffectChoice, ...]
) -> tuple[tuple[tuple[int, ...], Observation, IntArray], ...]:
    """Build the same, and number those columns of each tree that do not depend on others."""
    models = []
    for joints, observation in _build_observations(robot, more):
        own = observation.columns
        # Friction first: no parameter of a link may stand for it.
        order = sorted(range(len(own)), key=lambda k: not get_effect(own[k].effect).is_friction)
        rows = evaluate_at_random_states(observation, _STATES_PER_COLUMN * len(own) // len(joints) + 20)[:, order]
        kinds = tuple((own[k].effect, own[k].unit) for k in order)
        base = select_base(rows, tuple(own[k].name for k in order), kinds=kinds)
        models.append((joints, observation, np.sort(np.array(order)[list(base.kept)])))
    return tuple(models)


def compute_load(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the torque (m, n) that the links need as the description has them; None without masses.

    As `compute_described_load`, by the rows of W that fits are made of.
    """
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return None
    load = np.zeros_like(motion.tau)
    for _, observation in _build_observations(robot, ()):
        memory = np.zeros((len(motion.q), observation.n_memory))
        reference = ReferenceParameters.massless(robot)
        entries = observation.evaluate(motion.q, motion.dq, motion.ddq, reference=reference, memory=memory)
        values = np.zeros(observation.n_columns)
        for k, column in enumerate(observation.columns):
            if get_role(column) == "link":
                link = robot.tree.joint_names.index(column.link)
                values[k] = robot.inertias[link, INERTIAL_NAMES.index(column.parameter)]
        load += observation.compute_torque(entries, values)
    return load


_STATES_PER_COLUMN = 2
"""Random states for each column by which it is decided which columns depend on others."""


def compute_log_shares(squares: FloatArray, measured: FloatArray, least: float = _LEAST) -> FloatArray:
    """Return the logarithm of the unexplained share of a torque.

    Parameters
    ----------
    squares : (..., n)
        Squared errors.
    measured : (n,)
        Squared torque.
    least : float
        Smaller shares count as this one.
    """
    # Clipped: one block that is explained perfectly must not decide a mean of logarithms.
    squares = np.maximum(squares, 0.0)
    shares = np.sqrt(np.divide(squares, measured, out=np.full(squares.shape, _MOST**2), where=np.asarray(measured) > 0))
    return np.asarray(np.log(np.clip(shares, least, _MOST)))


_OFF = 0.09
"""Share of the other joints' friction below which a joint's torque has none: its drive is off, and nothing is told of
its sign or size. Of an arm with a free motor it was up to 0.062; of drives that are on at least 0.13, in motions of
hardly more than one frequency, and 0.19 otherwise. This is half way between, in logarithms."""

_EXPLAINED_MUCH = 0.75
"""Share of what is unexplained of a joint that is left without a fault of its columns: with the sign turned of a drive
that is off it was 0.92 and more on the open recordings, of joints whose sign was turned less."""

_KNOWN = 3.0
"""Standard errors from which on friction is surely not zero."""

_SURELY_ON = 0.19
"""The same share from which on friction surely is that of a drive: of a motor that hardly works it has any sign."""


def find_drives_off(frictions: FloatArray, least: float = _OFF) -> set[tuple[int, ...]]:
    """Return the joints, one by one, whose torque has no friction beside the others'.

    Parameters
    ----------
    frictions : (blocks, n)
        Mean friction torques, each without a block of time.
    least : float
        Share of the others' friction that a drive has at least.
    """
    size = np.abs(np.median(frictions, axis=0))
    others = [np.delete(size, joint) for joint in range(len(size))]
    usual = [float(np.median(sizes[np.isfinite(sizes)])) if np.isfinite(sizes).any() else 0.0 for sizes in others]
    return {(joint,) for joint in range(len(size)) if size[joint] < least * usual[joint]}


def find_joints_with_friction(frictions: FloatArray) -> BoolArray:
    """Return the joints (n,) whose torque surely overcomes friction.

    Parameters
    ----------
    frictions : (blocks, n)
        Mean friction torques, each without a block of time.
    """
    # Each is that without a block of time: their scatter is the jackknife's standard error.
    error = np.sqrt(len(frictions) - 1) * frictions.std(axis=0)
    return np.asarray((frictions.mean(axis=0) > 0.0) & (frictions.mean(axis=0) >= _KNOWN * error))


def is_proved_by_friction(fault: ColumnFault, frictions: FloatArray, mended: FloatArray) -> bool:
    """Tell whether friction that drives joints proves their signs: without the fault it opposes them, as the others.

    Of two joints both have to be turned: one is often passive, and with a wrong gain its friction may have any sign. So
    has that of a motor that hardly works, by the torque that it lacks.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    frictions, mended : (blocks, n)
        As in `find_drives_off`, of the torque as it is, and without the fault.
    """
    own = list(fault.own_joints)
    is_on = find_drives_off(frictions, _SURELY_ON).isdisjoint((joint,) for joint in own)
    opposed, driven = find_joints_with_friction(mended), find_joints_with_friction(-frictions)
    proved = opposed[own].all() and (opposed.sum() > 2 or (opposed & driven).sum() > 1)
    return fault.kind in TURNS and is_on and bool(proved)
