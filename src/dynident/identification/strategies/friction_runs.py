"""Rows that show the friction of a joint by itself: it alone moves, at nearly constant velocity.

Whatever the rest of the robot is, the torque of a joint that alone moves is the sum of its friction, a gravity torque
of the form a + b cos q + c sin q (a constant on a sliding joint) and an inertia times its acceleration. These four
terms are projected out of the rows rather than predicted, anew for every posture of the other joints. So no inertial
parameter has to be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters, get_effect
from dynident.estimation import EquationFactors, Reduction
from dynident.recordings import Preprocessing, Recording, SampleBlock, choose_preprocessing, filtered_blocks
from dynident.recordings.constant_velocity import find_sole_mover
from dynident.regressors.model import Model
from dynident.regressors.stream import SampleFunction

# Seconds: the longest piece, which is a block of the covariance, and the shortest one that is used.
_PIECE, _SHORTEST = 1.0, 0.1
# The other joints stand in the same posture where they differ by no more than this (rad, m).
_SAME_POSTURE = 0.02
# Share of the largest singular value below which a direction of the four gravity and inertia columns is rounding.
_RANK = 1e-6


@dataclass(frozen=True, eq=False)
class FrictionPiece:
    """A piece of a stroke: mean `velocity` (rad/s, m/s), `rows` (m, 4 + k + 1) [gravity, inertia | friction | Y]."""

    joint: int
    velocity: float
    posture: tuple[int, FloatArray]
    rows: FloatArray


@dataclass(frozen=True, eq=False)
class FrictionRuns:
    """Equations of the joints' friction alone, over all parameters of a model, and the velocities they come from.

    `velocities`: of every joint, one a piece; none where a joint never moved alone.
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
            room = self.longest - self.length
            self.open.append(rows[:room])
            self.velocities.append(velocity[:room])
            self.length += len(rows[:room])
            q, velocity, rows = q[room:], velocity[room:], rows[room:]
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
    joint : int
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
    recordings : sequence of Recording
    preprocessing : Preprocessing, optional
        Its position filter is used; each recording's own choice where none is given. Torque is not filtered: the
        regression averages it.
    reference : ReferenceParameters
        What loads are predicted with.

    Returns
    -------
    FrictionRuns
    """
    pieces: list[FrictionPiece] = []
    for number, recording in enumerate(recordings):
        chosen = preprocessing or choose_preprocessing([recording])
        plain = replace(chosen, torque_cutoff=None, decimation=1)
        pieces += _collect_pieces(model, recording, number, plain, reference)
    equations, velocities = [], []
    for joint in range(model.robot.n):
        own = [piece for piece in pieces if piece.joint == joint]
        equations.append(_build_equation(find_friction_columns(model, joint), own))
        velocities.append(np.array([piece.velocity for piece in own]))
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
        r = np.linalg.qr(rows, mode="r")
        factors[k, : len(r)] = r
    return EquationFactors(numbers, factors, np.array([len(rows) for rows in cleared], dtype=np.intp))


def _group_by_posture(pieces: Sequence[FrictionPiece]) -> list[list[FrictionPiece]]:
    """Group pieces of the same recording with the other joints in the same posture."""
    groups: list[list[FrictionPiece]] = []
    for piece in pieces:
        for group in groups:
            number, posture = group[0].posture
            if number == piece.posture[0] and np.all(np.abs(posture - piece.posture[1]) <= _SAME_POSTURE):
                group.append(piece)
                break
        else:
            groups.append([piece])
    return groups
