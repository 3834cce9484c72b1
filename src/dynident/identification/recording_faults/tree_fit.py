"""Fit links, rotors and friction to one kinematic tree, each of ten blocks of time left out in turn.

The numerics under `fault_search`: holds the ridge, the blocks and which rows count as moving.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.effects import ReferenceParameters, get_effect, get_role
from dynident.identification.recording_faults.column_faults import Motion
from dynident.regressors.observation_matrix import Observation
from dynident.robot.robot_model import Robot

BLOCKS = 10
"""Blocks of time that a motion is cut into."""

_STILL = 1e-3  # share of the fastest joint's speed below which a joint is at rest

_SLOW = 0.05
"""Share of a joint's rms speed below which a row is left out: sticking joints have a friction of any size."""

_DRIVES = 2.5
"""Standard errors by which friction's work has to be negative for it to drive its joint: in right motions that are
short 0.7, by chance; planted faults of which nothing else tells give 2.7 and more."""

LEAVE_ONE_OUT = np.concatenate([1.0 - np.eye(BLOCKS), np.ones((1, BLOCKS))])
"""(blocks + 1, blocks): of which blocks a sum is made: of all but each, and of all. What only one block has must not be
left of a difference by rounding."""

_RIDGE = 1e-6
"""Added to the scaled normal matrix: it decides what the motion leaves open, and nothing else."""

_SIGNALS = ("q", "dq", "ddq", "tau", "block")

_MOST_KNOWN = 4  # solutions that a tree keeps: those of the recording and of what was tried last
_QUIET = 1e-12  # share of the largest squared torque that the noise of every joint has at least


@dataclass(frozen=True)
class TorqueStep:
    """A constant torque that a joint has from one instant on.

    Parameters
    ----------
    joint : int
        Number of the joint.
    row : int
        First row of the motion that has it.
    size : float
        N m or N.
    explained, drift_explained : float
        Share of the squared rest that the step explains, and that a drift explains, steady or as a drive warms up.
    """

    joint: int
    row: int
    size: float
    explained: float
    drift_explained: float

    @property
    def is_clear(self) -> bool:
        """Whether it is most of what is unexplained, and no drift."""
        return self.explained >= _MOST_OF_REST and 1.0 - self.drift_explained >= _BEYOND_DRIFT * (1.0 - self.explained)


_MOST_OF_REST, _BEYOND_DRIFT = 0.7, 1.15
"""Share of the squared rest that a step has to explain, and how many times what it leaves a drift has to leave. Of
untouched recordings a step explains at most 0.64 of it, beside a drift that explains more."""

_WARMING = (0.1, 0.3)
"""Time constants of drives that warm up, over the length of the motion."""

_INDEPENDENT, _NOTHING_LEFT, _FEWEST_OF_STEP, _INSTANTS = 1e-8, 0.01, 200, 160
"""Of singular values and squares, what counts as none; the share of a torque that is as good as explained; rows, and
instants that are tried."""


@dataclass(frozen=True, eq=False)
class _MotionRows:
    """W of a motion where each joint moves: inner products (blocks + 1, n, c, c) of each block, and last of all.

    Here and below n counts the joints of one tree.

    `of_joints`: the numbers of these rows (m,), and the rows (m, p) in those columns that the joint's torque depends
    on. `right` and `measured` are Wᵀτ and τᵀτ of its own torque, as in `GramMatrices`.
    """

    motion: Motion
    inner: FloatArray
    of_joints: tuple[tuple[IntArray, FloatArray], ...]
    right: FloatArray
    measured: FloatArray

    def is_same_motion(self, other: Motion) -> bool:
        """Tell whether another motion is the same but for its torque."""
        return _is_same(self.motion, other, ("q", "dq", "ddq", "block"))


def _is_same(first: Motion, second: Motion, names: Sequence[str]) -> bool:
    # Most signals of most candidates are the very arrays of the recording.
    pairs = ((getattr(first, name), getattr(second, name)) for name in names)
    return all(a is b or np.array_equal(a, b) for a, b in pairs)


@dataclass(frozen=True, eq=False)
class TreeSolution:
    """What a tree's fit leaves of a motion's torque.

    `squares` (blocks + 1, n) of each block held out, and last of all; `measured` (n,) squared torque; `against` (n,)
    joints that friction drives; `frictions` (blocks, n) mean friction torques from the other blocks.
    """

    motion: Motion
    squares: FloatArray
    measured: FloatArray
    against: BoolArray
    frictions: FloatArray


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


@dataclass(frozen=True, eq=False)
class _RowsOfSum:
    """Inner products of W that is a sum of several, of a motion.

    `products`: for each joint the columns (g,) in which the others differ from the first one, and the inner products
    (blocks, p, p) of its rows in the first, in those columns of what each other differs by, and of its torque.
    """

    motion: Motion
    products: tuple[tuple[IntArray, FloatArray], ...]

    def compute_grams(
        self, factors: Sequence[float], layout: Sequence[tuple[IntArray, IntArray]], n_columns: int
    ) -> GramMatrices:
        """Return the inner products of the first W and so many times what each other one differs by from it."""
        n = len(layout)
        inner, right = np.zeros((BLOCKS + 1, n, n_columns, n_columns)), np.zeros((BLOCKS + 1, n, n_columns))
        measured = np.zeros((BLOCKS + 1, n))
        for joint, ((differing, products), (_, columns)) in enumerate(zip(self.products, layout, strict=True)):
            c, g = len(columns), len(differing)
            # The columns of the differences are added to those of the first: from the right side, then from the left.
            summed = products[:, :, [*range(c), -1]]
            parts = [slice(c + number * g, c + (number + 1) * g) for number in range(len(factors))]
            for factor, part in zip(factors, parts, strict=True):
                summed[:, :, differing] += factor * products[:, :, part]
            both = summed[:, [*range(c), -1]]
            for factor, part in zip(factors, parts, strict=True):
                both[:, differing] += factor * summed[:, part]
            inner[:-1, joint, columns[:, None], columns] = both[:, :-1, :-1]
            right[:-1, joint, columns], measured[:-1, joint] = both[:, :-1, -1], both[:, -1, -1]
        for sums in (inner, right, measured):
            sums[-1] = sums[:-1].sum(axis=0)
        return GramMatrices(inner, right, measured)


def list_trees(robot: Robot) -> list[list[int]]:
    """Return the joints of each tree of links that moves independently of the others.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    list of list of int
        All joints in one list where loops, ties or drives couple them.
    """
    if robot.linkage is not None or any(drive.coupling for drive in robot.drives):
        return [list(range(robot.n))]
    trees: list[list[int]] = []
    place: dict[int, int] = {}
    for k, joint in enumerate(robot.joints):
        if joint.parent not in place:
            trees.append([])
        place[k] = place.get(joint.parent, len(trees) - 1)
        trees[place[k]].append(k)
    return trees


def list_chains(robot: Robot) -> list[list[int]]:
    """Return the joints of each chain without branches: of every leg, or arm, of a robot."""
    children = Counter(joint.parent for joint in robot.joints)
    chains: list[list[int]] = []
    for k, joint in enumerate(robot.joints):
        if chains and joint.parent == chains[-1][-1] and children[joint.parent] == 1:
            chains[-1].append(k)
        else:
            chains.append([k])
    return chains


class TreeFit:
    """Fits of some joints of a robot that share no parameter with the others.

    `independent` numbers the columns of the observation that are fitted: the others explain nothing that these do not.
    """

    def __init__(self, robot: Robot, joints: Sequence[int], observation: Observation, independent: IntArray) -> None:
        self._robot, self.joints = robot, list(joints)
        self._observation, self._independent = observation, independent
        self._layout = []
        for joint in joints:
            positions, columns = observation.joint_entries(joint)
            own = np.isin(columns, independent)
            self._layout.append((positions[own], np.searchsorted(independent, columns[own])))
        self._rows: list[_MotionRows] = []
        self._solutions: list[TreeSolution] = []
        self._sum: _RowsOfSum | None = None

    @property
    def n_columns(self) -> int:
        """Number of parameters."""
        return len(self._independent)

    def count_columns(self, motion: Motion) -> int:
        """Return the rank of W of a motion: joints at rest leave parameters out, or lump them together."""
        inner = self._get_rows(motion, self._select(motion)).inner[-1].sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(inner), np.finfo(float).tiny))
        return int(np.linalg.matrix_rank(inner / np.outer(scale, scale), hermitian=True))

    def solve(self, motion: Motion) -> TreeSolution:
        """Solve for a motion; the solutions of a few are kept, as most candidates change few joints."""
        own = self._select(motion)
        known = next((known for known in self._solutions if _is_same(known.motion, own, _SIGNALS)), None)
        solution = known or self._solve(own, self._compute_grams(own, self._get_rows(motion, own)))
        self._solutions = [solution, *(other for other in self._solutions if other is not solution)][:_MOST_KNOWN]
        return solution

    def solve_inside(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Return the squares (blocks, n) that one fit to all blocks leaves, and the squared torque (n,)."""
        own = self._select(motion)
        grams = self._compute_grams(own, self._get_rows(motion, own))
        _, squares = self._solve_weighted(grams, self._fit_all)
        return squares[:-1], grams.measured[-1]

    def list_rows(self, motion: Motion) -> Sequence[tuple[IntArray, FloatArray]]:
        """Return for each joint the numbers of the rows (m,) where it moves, and these rows (m, p) of its columns."""
        return self._get_rows(motion, self._select(motion)).of_joints

    def _select(self, motion: Motion) -> Motion:
        if len(self.joints) == motion.q.shape[1]:
            return motion
        q, dq, ddq, tau = (getattr(motion, name)[:, self.joints] for name in _SIGNALS[:4])
        return Motion(q, dq, ddq, tau, motion.block, motion.t)

    def _solve(self, own: Motion, grams: GramMatrices) -> TreeSolution:
        values, squares = self._solve_weighted(grams, self._fit_all_but_each)
        rest = squares[:-1].sum(axis=0)
        against = [self._is_driven_by_friction(grams, values[:-1], k, float(rest[k])) for k in range(len(self.joints))]
        frictions = np.zeros((BLOCKS, len(self.joints)))
        for k, (friction, sign) in enumerate(self._friction_columns):
            # The projection of the friction torque onto the sign of the velocity: its mean size against the motion.
            whole = grams.inner[-1, k]
            frictions[:, k] = values[:-1, friction] @ whole[sign, friction] / max(whole[sign, sign], 1.0)
        return TreeSolution(own, squares, grams.measured[-1], np.array(against), frictions)

    def find_torque_steps(self, motion: Motion) -> list[TorqueStep]:
        """Return the step of each joint's torque at one instant that explains most of what its own columns leave."""
        own, steps = self._select(motion), []
        for joint, (at, rows) in enumerate(self.list_rows(motion)):
            tau = own.tau[at, joint]
            m = len(tau)
            # A joint that stands all the time has no rows.
            if m < _FEWEST_OF_STEP:
                continue
            basis, sizes, _ = np.linalg.svd(np.column_stack([rows, np.ones(m)]), full_matrices=False)
            basis = basis[:, sizes > _INDEPENDENT * sizes[0]]
            rest = tau - basis @ (basis.T @ tau)
            if rest @ rest <= _NOTHING_LEFT**2 * (tau @ tau):
                continue
            places = np.unique(np.linspace(0.1 * m, 0.9 * m, _INSTANTS).astype(int))
            way = np.linspace(0.0, 1.0, m)
            drifts = np.column_stack([way, *(np.exp(-way / constant) for constant in _WARMING)])
            trials = np.column_stack([np.arange(m)[:, None] >= places, drifts])
            trials = trials - basis @ (basis.T @ trials)
            squares, along = np.einsum("ij,ij->j", trials, trials), rest @ trials
            explained = along**2 / np.maximum(squares, _INDEPENDENT * m) / (rest @ rest)
            best, drift = int(np.argmax(explained[: len(places)])), float(explained[len(places) :].max())
            size = float(along[best] / squares[best])
            steps.append(TorqueStep(self.joints[joint], int(at[places[best]]), size, float(explained[best]), drift))
        return steps

    def solve_sum(self, motion: Motion, parts: Sequence[TreeFit], factors: Sequence[float]) -> TreeSolution:
        """Solve with W of the first of some fits, and of each other one so many times what it differs by from that."""
        own = self._select(motion)
        if self._sum is None or self._sum.motion is not motion:
            self._sum = self._build_sum(motion, own, parts)
        return self._solve(own, self._sum.compute_grams(factors, self._layout, self.n_columns))

    def _build_sum(self, motion: Motion, own: Motion, parts: Sequence[TreeFit]) -> _RowsOfSum:
        products = []
        for joint, (_, columns) in enumerate(self._layout):
            (at, first), *others = (part._fill_rows(motion, own, joint, columns) for part in parts)
            differences = [rows - first for _, rows in others]
            differing = np.flatnonzero(np.any([difference.any(axis=0) for difference in differences], axis=0))
            tau = own.tau[at, joint]
            rows = np.column_stack([first, *(difference[:, differing] for difference in differences), tau])
            products.append((differing, np.stack([rows[part].T @ rows[part] for part in _list_blocks(own, at)])))
        return _RowsOfSum(motion, tuple(products))

    def _fill_rows(self, motion: Motion, own: Motion, joint: int, columns: IntArray) -> tuple[IntArray, FloatArray]:
        """Return the numbers of a joint's rows, and its rows in all of these columns."""
        at, rows = self._get_rows(motion, own).of_joints[joint]
        # Without gravity a joint depends on fewer columns.
        filled = np.zeros((len(at), len(columns)))
        filled[:, np.searchsorted(columns, self._layout[joint][1])] = rows
        return at, filled

    def compute_load_columns(self, q: FloatArray) -> dict[int, FloatArray]:
        """Return the columns of each joint's torque (m, p) at rest, by joint."""
        rest, memory = np.zeros_like(q), np.zeros((len(q), self._observation.n_memory))
        reference = ReferenceParameters.massless(self._robot)
        entries = self._observation.evaluate(q, rest, rest, reference=reference, memory=memory)
        return {joint: entries[:, positions] for joint, (positions, _) in zip(self.joints, self._layout, strict=True)}

    def _solve_weighted(
        self, grams: GramMatrices, fit: Callable[[GramMatrices, FloatArray], FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Solve with joints weighed by what is left unexplained.

        Returns
        -------
        Parameters (blocks + 1, c); and the squares (blocks + 1, n) that they leave, in the one block and in all.
        """
        measured = grams.measured[-1]
        # A joint whose torque is explained exactly must not get an infinite weight. One whose torque was not recorded
        # has none: zeros throughout would say that the links have no mass.
        least = max(_QUIET * float(measured.max(initial=0.0)), np.finfo(float).tiny)
        recorded = measured > 0
        noise = np.where(recorded, np.sqrt(np.maximum(measured, least)), np.inf)
        squares, values = grams.measured, np.zeros((BLOCKS + 1, self.n_columns))
        # Two rounds: the first weighs joints by their torque, the second by what the first left unexplained.
        for _ in range(2):
            values = fit(grams, noise)
            squares = grams.compute_squares(values)
            noise = np.where(recorded, np.sqrt(np.maximum(squares[:-1].sum(axis=0), least)), np.inf)
        return values, squares

    def _compute_grams(self, motion: Motion, known: _MotionRows) -> GramMatrices:
        right, measured = known.right.copy(), known.measured.copy()
        # Most candidates change the torque of one or two joints.
        for joint in np.flatnonzero((motion.tau != known.motion.tau).any(axis=0)).tolist():
            products = _multiply_by_torque(motion, joint, *known.of_joints[joint])
            right[:, joint, self._layout[joint][1]], measured[:, joint] = products[:, :-1], products[:, -1]
        return GramMatrices(known.inner, right, measured)

    def _get_rows(self, motion: Motion, own: Motion) -> _MotionRows:
        """Return W of a motion; that of two motions is kept, since most candidates change torques alone."""
        known = next((rows for rows in self._rows if rows.is_same_motion(own)), None)
        rows = known or self._evaluate_rows(motion, own)
        self._rows = [rows, *(other for other in self._rows if other is not rows)][:2]
        return rows

    def _evaluate_rows(self, motion: Motion, own: Motion) -> _MotionRows:
        reference = ReferenceParameters.massless(self._robot)
        memory = np.zeros((len(motion.q), self._observation.n_memory))
        entries = self._observation.evaluate(motion.q, motion.dq, motion.ddq, reference=reference, memory=memory)
        moves = find_moving_rows(own)
        of_joints = []
        for joint, (positions, _) in enumerate(self._layout):
            at = np.flatnonzero(moves[:, joint])
            # Several times as fast as one index of rows and columns.
            of_joints.append((at, np.take(entries, positions, axis=1, mode="clip")[at]))
        return self._add_inner_products(own, of_joints)

    def _add_inner_products(self, motion: Motion, of_joints: Sequence[tuple[IntArray, FloatArray]]) -> _MotionRows:
        c, shape = self.n_columns, (BLOCKS + 1, len(self.joints))
        inner, right, measured = np.zeros((*shape, c, c)), np.zeros((*shape, c)), np.zeros(shape)
        for joint, ((at, rows), (_, columns)) in enumerate(zip(of_joints, self._layout, strict=True)):
            both = np.column_stack([rows, motion.tau[at, joint]])  # one product costs less than one for each
            products = np.stack([both[part].T @ both[part] for part in _list_blocks(motion, at)])
            inner[:-1, joint, columns[:, None], columns] = products[:, :-1, :-1]
            right[:-1, joint, columns], measured[:-1, joint] = products[:, :-1, -1], products[:, -1, -1]
        for sums in (inner, right, measured):
            sums[-1] = sums[:-1].sum(axis=0)
        return _MotionRows(motion, inner, tuple(of_joints), right, measured)

    def _fit_all_but_each(self, grams: GramMatrices, noise: FloatArray) -> FloatArray:
        """Return the parameters (blocks + 1, c) of all blocks but each, and of all.

        Of those that the motion does not determine, the smallest.
        """
        c, weights = self.n_columns, _compute_weights(noise)
        normal = LEAVE_ONE_OUT @ (weights @ grams.inner[:-1].reshape(BLOCKS, len(self.joints), c * c))
        return _solve_normal_equations(normal.reshape(-1, c, c), LEAVE_ONE_OUT @ (weights @ grams.right[:-1]))

    def _fit_all(self, grams: GramMatrices, noise: FloatArray) -> FloatArray:
        """Return the parameters (blocks + 1, c) of all blocks, for each of them."""
        c, weights = self.n_columns, _compute_weights(noise)
        normal = (weights @ grams.inner[-1].reshape(len(self.joints), c * c)).reshape(1, c, c)
        values = _solve_normal_equations(normal, weights[None, :] @ grams.right[-1])
        return np.broadcast_to(values, (BLOCKS + 1, c))

    def _is_driven_by_friction(self, grams: GramMatrices, values: FloatArray, joint: int, rest: float) -> bool:
        """Tell whether a joint's friction surely gives it energy, and more than the unexplained torque could be."""
        friction, sign = self._friction_columns[joint]
        whole, own = grams.inner[-1, joint], values[:, friction]
        work = own @ whole[sign, friction]
        dry = values[:, sign] * whole[sign, sign]
        # Each fit leaves one block out, so the scatter of the fits gives the jackknife's standard error.
        least_work, least_dry = (_DRIVES * np.sqrt((BLOCKS - 1) * part.var()) for part in (work, dry))
        # A wrong sign turns dry friction round, too. Where that takes more than friction gives in all, the torque is
        # logged early, or at one point of each step of a servo's command.
        if work.mean() >= -least_work or dry.mean() > max(least_dry, -work.mean()):
            return False
        # Friction that is small beside the residual may have any sign.
        size = np.einsum("bi,ik,bk->b", own, whole[np.ix_(friction, friction)], own)
        return bool(np.median(size) > 0.25 * rest)

    @cached_property
    def _friction_columns(self) -> list[tuple[list[int], int]]:
        """Columns of each joint's friction, and that of its dry friction, which is 1 or -1."""
        columns = [self._observation.columns[k] for k in self._independent]
        frictions = []
        for name in (self._robot.joint_names[joint] for joint in self.joints):
            own = [
                k for k, column in enumerate(columns) if column.link == name and get_effect(column.effect).is_friction
            ]
            frictions.append((own, next(k for k in own if get_role(columns[k]) == "dry")))
        return frictions


def _solve_normal_equations(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solutions (k, c) of normal matrices (k, c, c) and right sides (k, c)."""
    # Columns of equal size, so that the ridge does not depend on units.
    scale = np.sqrt(np.maximum(np.einsum("bii->bi", normal), np.finfo(float).tiny))
    scaled = normal / (scale[:, :, None] * scale[:, None, :]) + _RIDGE * np.eye(normal.shape[-1])
    return np.asarray(np.linalg.solve(scaled, (right / scale)[:, :, None])[:, :, 0] / scale)


def _multiply_by_torque(motion: Motion, joint: int, at: IntArray, rows: FloatArray) -> FloatArray:
    """Return [Wᵀτ τᵀτ] (blocks + 1, p + 1) of a joint in each block, and in all."""
    tau, products = motion.tau[at, joint], np.empty((BLOCKS + 1, rows.shape[1] + 1))
    for k, part in enumerate(_list_blocks(motion, at)):
        products[k, :-1], products[k, -1] = tau[part] @ rows[part], tau[part] @ tau[part]
    products[-1] = products[:-1].sum(axis=0)
    return products


def _list_blocks(motion: Motion, at: IntArray) -> list[slice]:
    """Return where the rows with these numbers are in each block: a run of them, as blocks are in the order of time."""
    edges = np.searchsorted(motion.block[at], np.arange(BLOCKS + 1))
    return [slice(first, last) for first, last in pairwise(edges)]


def find_moving_rows(motion: Motion) -> BoolArray:
    """Return where each joint moves (m, n)."""
    return np.asarray(np.abs(motion.dq) > _SLOW * np.sqrt((motion.dq**2).mean(axis=0)))


def _compute_weights(noise: FloatArray) -> FloatArray:
    """Return the weight of each joint (n,), zero where its noise is infinite."""
    # Relative to the largest noise: torques may be in any unit, and squares of their inverses may overflow.
    return np.asarray((noise[np.isfinite(noise)].max(initial=0.0) / noise) ** 2)


def find_moving_joints(motion: Motion) -> BoolArray:
    """Return which joints move, and have a torque that changes (n,): the others tell nothing."""
    return np.asarray(~find_joints_at_rest(motion.dq) & (motion.tau != motion.tau[:1]).any(axis=0))


def find_joints_at_rest(dq: FloatArray) -> BoolArray:
    """Return which joints (n,) do not move beside the others, by velocities (m, n)."""
    speed = np.sqrt((dq**2).mean(axis=0))
    return np.asarray(speed <= _STILL * speed.max(initial=0.0))
