"""Strategy "friction first": runs of constant velocity give friction, joint by joint, then the rest (§12.3.3 ii).

Holds which runs count as such.

Whatever the rest of the robot is, the torque of a joint that alone moves is the sum of its friction, a gravity torque
of the form a + b cos q + c sin q (a constant on a sliding joint) and an inertia times its acceleration. These four
terms are projected out of the rows rather than predicted, anew for every posture of the other joints. So no inertial
parameter has to be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.effects import ReferenceParameters, get_effect
from dynident.errors import DynidentError, Remedy
from dynident.estimation import EquationFactors, Reduction
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.methods.base_classes import StrategyChoices
from dynident.identification.strategies.sequential import StepEstimates, check_estimator, conclude_steps, take_step
from dynident.recordings import Preprocessing, Recording, SampleBlock, choose_preprocessing, filtered_blocks
from dynident.regressors.dynamic_model_rows import SampleFunction
from dynident.regressors.model_structure import Model

# Seconds: the longest piece, which is a block of the covariance, and the shortest one that is used.
_PIECE, _SHORTEST = 1.0, 0.1
# The other joints stand in the same posture where they differ by no more than this (rad, m).
_SAME_POSTURE = 0.02
# Share of the largest singular value below which a direction of the four gravity and inertia columns is rounding.
_RANK = 1e-6

_SLOWEST = 5e-3
"""Speed in rad/s or m/s below which a joint may as well stick."""

_STILL = 2e-3
"""Speed in rad/s or m/s that filtered noise gives a joint at rest."""

_STILL_SHARE = 0.02
"""Share of the moving joint's speed that the others may have: a controller does not hold them perfectly."""

_DOUBLING = 0.25
"""Seconds in which the speed may double at the earliest: slower changes than that are nearly none."""


def find_sole_mover(dq: FloatArray, ddq: FloatArray) -> IntArray:
    """Return which joint alone moves at nearly constant velocity.

    Parameters
    ----------
    dq, ddq : (m, n)
        Filtered velocities (rad/s, m/s) and accelerations.

    Returns
    -------
    (m,) of int
        -1 if none does.
    """
    speed = np.abs(dq)
    first = np.argmax(speed, axis=1)
    rows = np.arange(len(speed))
    fastest = speed[rows, first]
    others = speed.copy()
    others[rows, first] = 0.0
    # A joint that is held shows noise at any speed, and gives way the more, the faster the other one moves. A robot of
    # one joint has no others: it counts as alone.
    alone = others.max(axis=1, initial=0.0) <= np.maximum(_STILL, _STILL_SHARE * fastest)
    # As a product: the acceleration of a joint at rest may be zero.
    steady = np.abs(ddq[rows, first]) * _DOUBLING <= fastest
    is_sole: BoolArray = alone & steady & (fastest >= _SLOWEST)
    return np.where(is_sole, first, -1).astype(np.int64)


@dataclass(frozen=True, eq=False)
class FrictionPiece:
    """A piece of a stroke, in which a single joint moves in one direction.

    Parameters
    ----------
    joint : int
        Number of the joint.
    velocity : float
        Mean velocity in rad/s or m/s.
    posture : (int, array)
        Number of the recording, and positions of the other joints.
    rows : (m, 4 + k + 1)
        Rows of [gravity, inertia | friction | torque].
    """

    joint: int
    velocity: float
    posture: tuple[int, FloatArray]
    rows: FloatArray


@dataclass(frozen=True, eq=False)
class FrictionRuns:
    """Equations of the joints' friction alone, and the velocities that they come from.

    Parameters
    ----------
    equations : Reduction
        The equations, over all parameters of a model.
    velocities : tuple of arrays
        Velocities of every joint, one a piece; none where a joint never moved alone.
    """

    equations: Reduction
    velocities: tuple[FloatArray, ...]


@dataclass
class _Collector:
    """Collect the pieces of one recording, from rows as they arrive."""

    number: int
    longest: int
    shortest: int
    open: list[FloatArray] = field(default_factory=list)
    length: int = 0
    joint: int = -1
    posture: FloatArray = field(default_factory=lambda: np.empty(0))
    velocities: list[FloatArray] = field(default_factory=list)
    pieces: list[FrictionPiece] = field(default_factory=list)

    def push(self, joint: int, q: FloatArray, velocity: FloatArray, rows: FloatArray) -> None:
        """Add rows of one stroke that follow those before, or begin a new piece after `close`."""
        while len(rows):
            if not self.length:
                self.joint, self.posture = joint, np.delete(q[0], joint)
            # A stroke that is longer than a piece is cut: a new piece begins where the last one is full.
            n_missing = self.longest - self.length
            self.open.append(rows[:n_missing])
            self.velocities.append(velocity[:n_missing])
            self.length += len(rows[:n_missing])
            q, velocity, rows = q[n_missing:], velocity[n_missing:], rows[n_missing:]
            if self.length >= self.longest:
                self.close()

    def close(self) -> None:
        """End the piece that is being collected."""
        if self.length >= self.shortest:
            velocity = float(np.mean(np.concatenate(self.velocities)))
            self.pieces.append(FrictionPiece(self.joint, velocity, (self.number, self.posture), np.vstack(self.open)))
        self.open, self.velocities, self.length = [], [], 0


def find_friction_columns(model: Model, joint: int) -> list[int]:
    """Return the numbers of the parameters that are this joint's friction.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    joint : int
        Number of the joint, from 0.
    """
    name = model.robot.joint_names[joint]
    return [k for k, c in enumerate(model.kept) if c.link == name and get_effect(c.effect).is_friction]


def find_friction_runs(
    model: Model, recordings: Sequence[Recording], preprocessing: Preprocessing | None, reference: ReferenceParameters
) -> FrictionRuns:
    """Find all motions of single joints in recordings, and reduce them to rows of friction alone.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    recordings : sequence of Recording
        Recordings of the robot.
    preprocessing : Preprocessing, optional
        Its position filter is used; each recording's own choice where none is given. Torque is not filtered: the
        regression averages it.
    reference : ReferenceParameters
        What loads are predicted with.

    Returns
    -------
    FrictionRuns
        Equations of friction alone, and the velocities that they come from.
    """
    pieces: list[FrictionPiece] = []
    for number, recording in enumerate(recordings):
        chosen = preprocessing or choose_preprocessing([recording])
        # Every sample counts: a filter of the torque would only correlate them.
        plain = replace(chosen, torque_cutoff=None, decimation=1)
        pieces += _collect_pieces(model, recording, number, plain, reference)
    equations, velocities = [], []
    for joint in range(model.robot.n):
        own = [piece for piece in pieces if piece.joint == joint]
        equations.append(_build_equation(find_friction_columns(model, joint), own))
        velocities.append(np.array([piece.velocity for piece in own]))
    # Pieces have no common time, so their blocks have no spans.
    spans = np.zeros((max((len(e.counts) for e in equations), default=0), 2))
    return FrictionRuns(Reduction(model.n_parameters, tuple(equations), spans), tuple(velocities))


def _collect_pieces(
    model: Model, recording: Recording, number: int, preprocessing: Preprocessing, reference: ReferenceParameters
) -> list[FrictionPiece]:
    """Return the pieces of one recording in which a single joint moves in one direction."""
    entries_of = SampleFunction(model.observation, reference, recording)
    layouts = [_get_layout(model, joint) for joint in range(model.robot.n)]
    longest, shortest = (max(2, round(seconds * recording.sampling_rate)) for seconds in (_PIECE, _SHORTEST))
    collector = _Collector(number, longest, shortest)
    before = (-1, 0.0)
    for block in filtered_blocks(recording, preprocessing):
        entries = entries_of(block)
        # Samples at which several joints move, or none does, belong to no piece.
        movers = np.where(block.used, find_sole_mover(block.dq, block.ddq), -1)
        signs = np.sign(block.dq[np.arange(len(movers)), movers])
        # A stroke ends where another joint moves or the direction changes, as Coulomb friction jumps there.
        borders = np.flatnonzero((np.diff(movers) != 0) | (np.diff(signs) != 0)) + 1
        for part in np.split(np.arange(len(movers)), borders):
            joint, now = int(movers[part[0]]), (int(movers[part[0]]), float(signs[part[0]]))
            if now != before or (block.starts_segment and part[0] == 0):
                collector.close()
            before = now
            if joint >= 0:
                own = _build_rows(model, joint, block, entries[:, layouts[joint]])[part]
                collector.push(joint, block.q[part], block.dq[part, joint], own)
    # The last stroke ends with the recording.
    collector.close()
    return collector.pieces


def _build_rows(model: Model, joint: int, block: SampleBlock, friction: FloatArray) -> FloatArray:
    """Return rows (m, 4 + k + 1): 1, cos q, sin q, q̈ | friction | torque."""
    q = block.q[:, joint]
    revolute = model.robot.joints[joint].kind == "revolute"
    waves = [np.cos(q), np.sin(q)] if revolute else [np.zeros(len(q))] * 2
    return np.column_stack([np.ones(len(q)), *waves, block.ddq[:, joint], friction, block.tau[:, joint]])


def _get_layout(model: Model, joint: int) -> list[int]:
    """Return the places of the joint's friction among the entries of its row."""
    positions, columns = model.observation.joint_entries(joint)
    where = dict(zip(columns.tolist(), positions.tolist(), strict=True))
    return [where[k] for k in find_friction_columns(model, joint)]


def _build_equation(columns: list[int], pieces: Sequence[FrictionPiece]) -> EquationFactors:
    """Return the factors of friction and torque of one joint's pieces, without what gravity and inertia explain."""
    size = len(columns) + 1
    numbers = np.array(columns, dtype=np.intp)
    cleared: list[FloatArray] = []
    for group in _group_by_posture(pieces):
        rows = np.vstack([piece.rows for piece in group])
        nuisance, rest = rows[:, :4], rows[:, 4:]
        # Project gravity and inertia out of the rows of one posture (Frisch, Waugh and Lovell). An orthonormal basis
        # from the SVD copes with columns that depend on each other over a short stroke.
        sizes = np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300)
        basis_vectors, singular, _ = np.linalg.svd(nuisance / sizes, False)
        basis = basis_vectors[:, singular > _RANK * singular[0]]
        rest = rest - basis @ (basis.T @ rest)
        borders = np.cumsum([len(piece.rows) for piece in group])[:-1]
        cleared += np.split(rest, borders)
    factors = np.zeros((len(cleared), size, size))
    for k, rows in enumerate(cleared):
        # A triangular factor a piece: the pieces are the blocks of the covariance.
        r = np.linalg.qr(rows, mode="r")
        factors[k, : len(r)] = r
    return EquationFactors(numbers, factors, np.array([len(rows) for rows in cleared], dtype=np.intp))


def _group_by_posture(pieces: Sequence[FrictionPiece]) -> list[list[FrictionPiece]]:
    """Group pieces of the same recording with the other joints in the same posture."""
    groups: list[list[FrictionPiece]] = []
    for piece in pieces:
        # Few postures occur, so comparing with each of them is quick enough.
        for group in groups:
            number, posture = group[0].posture
            if number == piece.posture[0] and np.all(np.abs(posture - piece.posture[1]) <= _SAME_POSTURE):
                group.append(piece)
                break
        else:
            groups.append([piece])
    return groups


# Dry and viscous friction are told apart where the fast motion is at least so many times as fast as the slow one. Ramps
# at the ends, a fifth of the time on either side, do not count.
_SPEEDS, _ENDS = 1.5, 0.2
# A friction parameter is left to the whole robot's motion only where the runs determine it this much worse: otherwise
# friction's own runs are believed.
_PATIENCE = 30.0
# A parameter is named as undetermined where more than this share of it lies outside what the runs determine.
_OPEN = 0.1


def solve_separate_friction(choices: StrategyChoices, problem: Problem) -> Fit:
    """Find the friction of every joint that moves alone somewhere, then all other parameters with it known.

    The runs are those of the recordings with the role "friction", or else any that are found in the data. Friction
    keeps the values that these runs give, and their uncertainty is carried into the other parameters. Parameters that
    the runs determine much worse than the whole robot's motion does (load-dependent friction where the load hardly
    changes) are left to that motion.

    Parameters
    ----------
    choices : StrategyChoices
        What is identified, and how.
    problem : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    DynidentError
        Where no joint with friction in the model ever moves alone, or for an estimator that cannot be taken in steps.
    """
    estimator, model, data = choices.solver, problem.model, problem.data
    check_estimator(estimator)
    sources = data.friction or data.recordings
    if not sources:
        raise DynidentError(
            "the reduced data do not contain the runs of single joints; identify from the recordings again",
            pointer="/strategy",
            title="Recordings needed",
        )
    runs = find_friction_runs(model, sources, choices.preprocessing, data.reference)
    solvable = [j for j in range(model.robot.n) if len(runs.velocities[j]) and find_friction_columns(model, j)]
    if not solvable:
        remedy = Remedy("role", "friction")
        raise DynidentError(
            "no joint with friction in the model moves alone at constant velocity in "
            f"{', '.join(r.name for r in sources)}; record each joint alone at several constant speeds in both "
            f"directions, with {remedy}, or choose the global strategy",
            pointer="/recordings",
            title="No friction runs",
            remedies=(remedy,),
        )
    both = Reduction(model.n_parameters, runs.equations.equations + data.equations.equations, data.equations.spans)
    # First friction from its own runs, then the rest with it known.
    alone = take_step(estimator, problem, runs.equations, StepEstimates.empty(model.n_parameters), both, _PATIENCE)
    rest = take_step(estimator, problem, data.equations, alone.findings)
    return conclude_steps(data, (alone, rest), problem.covariance, _list_warnings(model, runs, alone.findings))


def _list_warnings(model: Model, runs: FrictionRuns, findings: StepEstimates) -> tuple[str, ...]:
    """Return warnings about joints without runs, with poor ones, and about parameters that the runs leave open."""
    sentences = []
    names = model.robot.joint_names
    without = [
        names[j] for j in range(model.robot.n) if find_friction_columns(model, j) and not len(runs.velocities[j])
    ]
    if without:
        sentences.append(
            f"No run shows {', '.join(without)} moving alone at constant velocity: their friction is identified "
            "together with the inertial parameters."
        )
    for j, velocities in enumerate(runs.velocities):
        columns = find_friction_columns(model, j)
        if not columns or not len(velocities):
            continue
        # Each piece counts with its number of samples.
        speeds = np.repeat(np.abs(velocities), runs.equations.equations[j].counts)
        slow, fast = np.quantile(speeds, (_ENDS, 1 - _ENDS))
        if not ((velocities > 0).any() and (velocities < 0).any()):
            sentences.append(
                f"{names[j]} moves alone in one direction only: Coulomb friction cannot be separated from gravity. "
                "Record both directions."
            )
        elif fast < _SPEEDS * slow:
            sentences.append(
                f"{names[j]} moves alone at only one speed, {fast:.3g}: the data hardly show how its friction depends "
                "on speed. Record several speeds."
            )
    undetermined = _list_undetermined(model, runs, findings)
    if undetermined:
        sentences.append(
            f"The friction runs alone do not determine {', '.join(undetermined)}: all recordings together determine "
            "these, with the combinations that the friction runs give."
        )
    return tuple(sentences)


def _list_undetermined(model: Model, runs: FrictionRuns, findings: StepEstimates) -> list[str]:
    """Return the names of friction parameters of joints that move alone which the runs leave undetermined."""
    columns = [k for j, v in enumerate(runs.velocities) if len(v) for k in find_friction_columns(model, j)]
    functions = findings.functions[:, columns]
    sizes = np.linalg.norm(functions, axis=0)
    # The rows of Q span what the runs determine. The squared length of a parameter's row is the share of it that is
    # known.
    known = np.linalg.qr((functions / np.where(sizes > 0, sizes, 1.0)).T)[0]
    missing = 1.0 - np.sum(known * known, axis=1)
    return [model.kept[k].name for k, share in zip(columns, missing, strict=True) if share > _OPEN]
