"""The share of torque that fitted dynamics, or those of the description, leave unexplained, as one score a joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

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
from dynident.identification.recording_faults.column_faults import ColumnFault, Motion
from dynident.identification.recording_faults.tree_fit import (
    BLOCKS,
    LEAVE_ONE_OUT,
    TreeFit,
    TreeSolution,
    find_moving_joints,
    find_moving_rows,
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

INSIDE = 0.33
"""Share of the same that has to fall where the blocks are fitted to, too. In short motions from point to point what was
not fitted to is told by chance: of right ones, 0.04 to 0.4 fell inside where no other order was better; of what was
planted 0.5 and more. What comes of it is among the short motions of `benchmarks/gross_mistakes.py`."""

_AGAINST = 0.5
"""What friction that drives its joint counts, in the same logarithm: there is no such friction."""

_LEAST, _MOST = 0.02, 3.0
"""Range of the unexplained share: a smaller one is as good as perfect, a larger one as bad as any."""

_LEAST_FINE = 1e-4
"""The lower end where a lowest point is looked for: near it all shares of a good recording may be as good as perfect,
and a curve that is cut off flat has its lowest point anywhere."""

# Added to the scaled normal matrix, so that it has a Cholesky factor where columns depend on each other.
_RIDGE = 1e-9

_FEW_ROWS = 400
"""Rows by which it is estimated what the description leaves: it has a few parameters a joint."""


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

    def is_surely_above(self, other: UnexplainedTorque) -> bool:
        """Tell whether clearly more is unexplained than in another fit, in most blocks, or friction drives more joints.

        Parameters
        ----------
        other : UnexplainedTorque
            What the other fit leaves unexplained.
        """
        score, fall = self.compute_summed_fall_to(other), self.compute_fall_to(other)
        # A paired comparison: both fits see the same blocks, so the scatter of the difference counts, which is much
        # smaller than that of either.
        error = float((self.blocks - other.blocks).std(ddof=1)) / np.sqrt(BLOCKS)
        errors = fall / max(error, np.finfo(float).tiny)
        falls_inside = self.inside - other.inside >= INSIDE * fall
        if score >= CLEARLY_IN_ALL_BLOCKS and errors >= IN_ALL_BLOCKS and falls_inside:
            return True
        return score >= CLEARLY and (self.against > other.against or (errors >= SURELY and falls_inside))


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
        models = _build_models(robot, more)
        parameters = [model[2] for model in (models if like is None else _build_models(like._robot, more))]
        self._trees = [
            TreeFit(robot, joints, observation, independent)
            for (joints, observation, _), independent in zip(models, parameters, strict=True)
        ]

    @property
    def n_columns(self) -> int:
        """Number of independent parameters."""
        return sum(tree.n_columns for tree in self._trees)

    def measure_unexplained(self, motion: Motion) -> UnexplainedTorque:
        """Return the unexplained shares of a motion's torque, each block of time predicted from the others.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        return self._join(motion, [tree.solve(motion) for tree in self._trees])

    def estimate_score(self, motion: Motion) -> float:
        """Return about the least score that a motion may have, by one fit to all blocks of time.

        A block that is held out is never explained better than where it is fitted to.

        Parameters
        ----------
        motion : Motion
            Filtered rows of the recording.
        """
        n, moving = self._robot.n, find_moving_joints(motion)
        squares, measured = np.zeros((BLOCKS, n)), np.zeros(n)
        for tree in self._trees:
            squares[:, tree.joints], measured[tree.joints] = tree.solve_inside(motion)
        return float(compute_log_shares(squares, measured / BLOCKS)[:, moving].mean())

    def _join(self, motion: Motion, solutions: Sequence[TreeSolution]) -> UnexplainedTorque:
        n, moving = self._robot.n, find_moving_joints(motion)
        squares, measured, against = np.zeros((BLOCKS + 1, n)), np.zeros(n), np.zeros(n, dtype=bool)
        for tree, solution in zip(self._trees, solutions, strict=True):
            squares[:, tree.joints], measured[tree.joints] = solution.squares, solution.measured
            against[tree.joints] = solution.against
        blocks = compute_log_shares(squares[:-1], measured / BLOCKS)[:, moving]
        whole = compute_log_shares(squares[-1], measured)[moving]
        fine = compute_log_shares(squares[:-1], measured / BLOCKS, _LEAST_FINE)[:, moving]
        fine_inside = compute_log_shares(squares[-1], measured, _LEAST_FINE)[moving]
        rest = squares[:-1].sum(axis=0)
        joints = np.where(moving, np.sqrt(rest / np.maximum(measured, np.finfo(float).tiny)), 0.0)
        return UnexplainedTorque(
            blocks.mean(axis=1),
            float(whole.mean()),
            int((against & moving).sum()),
            moving,
            joints,
            fine.mean(axis=1),
            float(fine_inside.mean()),
        )

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


@lru_cache(maxsize=8)
def _build_models(
    robot: Robot, more: tuple[EffectChoice, ...]
) -> tuple[tuple[tuple[int, ...], Observation, IntArray], ...]:
    """Build the columns of each tree's links, rotors and friction, and number those that do not depend on others.

    They are the same for each recording of a robot.
    """
    signals = Signals(robot)
    columns = build_columns((*DEFAULT_EFFECTS, *more), signals)
    trees = list_trees(robot)
    models = []
    for joints in trees:
        names = {robot.joint_names[joint] for joint in joints}
        own = columns if len(trees) == 1 else [column for column in columns if column.link in names]
        observation = Observation.from_columns(robot, own, signals)
        # Friction first: no parameter of a link may stand for it.
        order = sorted(range(len(own)), key=lambda k: not get_effect(own[k].effect).is_friction)
        rows = evaluate_at_random_states(observation, _STATES_PER_COLUMN * len(own) // len(joints) + 20)[:, order]
        base = select_base(rows, tuple(own[k].name for k in order))
        models.append((tuple(joints), observation, np.sort(np.array(order)[list(base.kept)])))
    return tuple(models)


def compute_load(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the torque (m, n) that the links need as the description has them; None without masses.

    As `compute_described_load`, by the rows of W that fits are made of.
    """
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return None
    load = np.zeros_like(motion.tau)
    for _, observation, _ in _build_models(robot, ()):
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
    shares = np.sqrt(np.maximum(squares, 0.0) / np.maximum(measured, np.finfo(float).tiny))
    return np.asarray(np.log(np.clip(shares, least, _MOST)))


@dataclass(frozen=True, eq=False)
class DescriptionFit:
    """Opinion of a robot's description on faults in a motion.

    In few moves a fit of all parameters explains by chance: another order of the columns of a short right motion left
    less by 0.2 and more in five of 180, the description's own masses at most 0.03 less. Where the description explains
    as much as a fit, planted faults left 0.3 less and more without the fault.

    Parameters
    ----------
    robot : Robot
        The robot with the masses of its description.
    motion : Motion
        Filtered rows of the recording.
    now : UnexplainedTorque
        What a fit of all parameters leaves of the torque as it is.
    """

    robot: Robot
    motion: Motion
    now: UnexplainedTorque

    def refutes(self, fault: ColumnFault) -> bool:
        """Tell whether the description explains the torque as the columns are, and no better without a fault.

        It has no opinion on a scaled torque, as its gain is free.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is = self._left_as_is
        if fault.kind == "torque scaled" or as_is is None:
            return False
        mended = self.measure_left(fault)
        if mended is None:
            return False
        explains_as_it_is = as_is.mean() <= self.now.blocks.mean() + self._threshold
        return bool(
            (explains_as_it_is and as_is.mean() - mended.mean() < self._threshold)
            or self._is_surely_less(as_is, mended)
        )

    def surely_demands(self, fault: ColumnFault) -> bool:
        """Tell whether the description surely explains more without a fault.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is, mended = self._left_as_is, self.measure_left(fault)
        return as_is is not None and mended is not None and self._is_surely_less(mended, as_is)

    def measure_left(self, fault: ColumnFault) -> FloatArray | None:
        """Return what the description leaves in every block (blocks,) without a fault; None without masses.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        if fault not in self._blocks_by_fault:
            self._blocks_by_fault[fault] = measure_blocks_left_by_description(self.robot, fault.mend(self.motion))
        return self._blocks_by_fault[fault]

    def may_demand(self, fault: ColumnFault) -> bool:
        """Tell whether the description may explain more without a fault, by a few rows; also without masses.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is, mended = self._estimate_as_is, self.estimate_left(fault)
        return as_is is None or mended is None or as_is - mended >= 0.5 * self._threshold

    def estimate_left(self, fault: ColumnFault) -> float | None:
        """Return what the description leaves of a few rows without a fault, in the mean; None without masses.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        motion = fault.mend(self._few_rows)
        if fault.is_of_positions:
            shares = _estimate_shares(motion, compute_load(self.robot, motion))
        else:
            # Neither the load nor other joints depend on the torque of some joints.
            shares = self._few_shares | _estimate_shares(motion, self._few_loads, fault.joints)
        return float(np.mean([*shares.values()])) if shares else None

    def _is_surely_less(self, left: FloatArray, other: FloatArray) -> bool:
        """Tell whether clearly less is left than otherwise, and in most blocks."""
        more = other - left
        error = float(more.std(ddof=1)) / np.sqrt(BLOCKS)
        return bool(more.mean() >= max(self._threshold, SURELY * error))

    def prefers(self, fault: ColumnFault, other: ColumnFault) -> bool:
        """Tell whether the description explains clearly more without one fault than without another.

        It decides between faults that a fit cannot tell apart.

        Parameters
        ----------
        fault, other : ColumnFault
            Two faults.
        """
        first, second = self.measure_left(fault), self.measure_left(other)
        return first is not None and second is not None and second.mean() - first.mean() >= self._threshold

    @property
    def _threshold(self) -> float:
        return CLEARLY / max(int(self.now.moving.sum()), 1)

    @cached_property
    def _left_as_is(self) -> FloatArray | None:
        return measure_blocks_left_by_description(self.robot, self.motion)

    @cached_property
    def _estimate_as_is(self) -> float | None:
        return float(np.mean([*self._few_shares.values()])) if self._few_shares else None

    @cached_property
    def _few_rows(self) -> Motion:
        every = max(1, len(self.motion.q) // _FEW_ROWS)
        return Motion(*(getattr(self.motion, name)[::every] for name in ("q", "dq", "ddq", "tau", "block")))

    @cached_property
    def _few_loads(self) -> FloatArray | None:
        return compute_load(self.robot, self._few_rows)

    @cached_property
    def _few_shares(self) -> dict[int, float]:
        return _estimate_shares(self._few_rows, self._few_loads)

    @cached_property
    def _blocks_by_fault(self) -> dict[ColumnFault, FloatArray | None]:
        return {}


def measure_left_by_description(robot: Robot, motion: Motion) -> float | None:
    """Return the mean logarithm of the unexplained share of the torque, with the description's load on each joint.

    The gain of the load, dry and viscous friction and the inertia of the drive are not negative; a constant torque is
    free. Each block of time is predicted from the others, as in `HeldOutFit.measure_unexplained`.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.

    Returns
    -------
    float or None
        None where the description has no masses.
    """
    blocks = measure_blocks_left_by_description(robot, motion)
    return None if blocks is None else float(blocks.mean())


def measure_blocks_left_by_description(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the same of every block (blocks,).

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
    load = compute_load(robot, motion)
    if load is None:
        return None
    moves = find_moving_rows(motion)
    shares = [
        _measure_unexplained(
            _build_columns(motion, load, int(joint)), motion.tau[:, joint], motion.block, moves[:, joint]
        )
        for joint in np.flatnonzero(find_moving_joints(motion))
    ]
    return np.asarray(np.mean(shares, axis=0))


def _estimate_shares(motion: Motion, load: FloatArray | None, joints: Sequence[int] | None = None) -> dict[int, float]:
    """Return the log share of each joint's torque that a load leaves, of all rows that are fitted to.

    Only of joints that move, and of the stated ones; none without a load.
    """
    moves, moving, shares = find_moving_rows(motion), find_moving_joints(motion), {}
    for joint in range(len(moving)) if joints is None else joints:
        if load is None or not moving[joint]:
            continue
        rows = np.column_stack([_build_columns(motion, load, joint), motion.tau[:, joint]])[moves[:, joint]]
        gram = rows.T @ rows
        residual = np.append(-_fit(gram), 1.0)
        shares[joint] = float(compute_log_shares(residual @ gram @ residual, gram[-1, -1]))
    return shares


def _build_columns(motion: Motion, load: FloatArray, joint: int) -> FloatArray:
    """Return the columns (m, 6): load, dry and viscous friction, inertia of the drive, and ± a constant."""
    # A constant of either sign, as two columns that are not negative.
    dq, ones = motion.dq[:, joint], np.ones(len(load))
    return np.stack([load[:, joint], np.sign(dq), dq, motion.ddq[:, joint], ones, -ones], axis=1)


def _measure_unexplained(columns: FloatArray, tau: FloatArray, block: IntArray, moves: BoolArray) -> FloatArray:
    rows = np.concatenate([columns, tau[:, None]], axis=1)
    parts = [rows[moves & (block == number)] for number in range(BLOCKS)]
    grams = np.stack([part.T @ part for part in parts])
    # Inner products of all blocks but each one: every block is then predicted from a fit without it, at no further
    # pass.
    others = np.tensordot(LEAVE_ONE_OUT, grams, axes=1)
    residual = np.stack([np.append(-_fit(gram), 1.0) for gram in others[:-1]])
    squares = np.einsum("bi,bik,bk->b", residual, grams, residual)
    return compute_log_shares(squares, others[-1, -1, -1] / BLOCKS)


def _fit(gram: FloatArray) -> FloatArray:
    """Return the parameters (c,), none of them negative, of inner products (c + 1, c + 1) of [W | Y]."""
    # Columns of equal size, or the ridge would weigh them by their units.
    scale = np.sqrt(np.maximum(np.diag(gram)[:-1], np.finfo(float).tiny))
    normal = gram[:-1, :-1] / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    # Non-negative least squares on the Cholesky factor has the same solution as on all rows, and is small.
    upper = cholesky(normal)
    scaled_values, _ = nnls(upper, solve_triangular(upper, gram[:-1, -1] / scale, trans="T"))
    return scaled_values / scale
