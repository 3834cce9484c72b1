"""Sequences of moves between points: draw them at random, evaluate their criterion, improve them by variations.

The criterion is not smooth in the points: a move's path changes where another joint or limit becomes the slowest. So
random sequences are tried, then the best of them are improved by accepted variations.
A move depends on its two ends alone, so a varied point costs two moves, as in exchange algorithms of optimal design
(Fedorov 1972); the size of the variations follows the share of those that succeed (Rechenberg's one-fifth rule).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.excitation.criteria.design_criterion import DesignCriterion
from dynident.excitation.criteria.optimality_criteria import CriterionValues
from dynident.excitation.design_observation_matrix import DesignModel, ObservationGradient
from dynident.excitation.optimisation.design_problem import Budget, choose_sign_rounding
from dynident.motion.collision.free_space import FreeSpace
from dynident.motion.jerk_limited_moves import plan_move
from dynident.motion.joint_trajectories import Piece
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError
from dynident.progress import Progress

# Smallest share of the velocity and acceleration limits: slower moves take long and show little inertia.
_SMALLEST_SHARE = 0.2
_FRESH = 0.1
"""Probability that a point is drawn again instead of being moved."""


class PointSpace(Protocol):
    """Sequences to search in."""

    def draw(self, rng: np.random.Generator) -> PointSequence:
        """Return a random sequence."""

    def redraw(self, sequence: PointSequence, k: int, rng: np.random.Generator) -> PointSequence:
        """Return another one, drawn because the move to point k breaks a limit."""

    def vary(self, sequence: PointSequence, rng: np.random.Generator, size: float) -> PointSequence:
        """Return a neighbour; `size` is in shares of the ranges."""


@dataclass(frozen=True, eq=False)
class FreePoints:
    """Sequences of free points, with free shares of the velocity and acceleration limits.

    Parameters
    ----------
    bounds : Bounds
        Limits of the motion.
    postures : (m, n)
        Postures that points are drawn from, rad or m.
    count : int
        Number of points.
    fastest : float
        Largest share of the velocity and acceleration limits.
    """

    bounds: Bounds
    postures: FloatArray
    count: int
    fastest: float = 1.0

    def draw(self, rng: np.random.Generator) -> PointSequence:
        """Return random postures that can be held."""
        points = self.postures[rng.integers(len(self.postures), size=self.count)]
        shares = self.fastest * rng.uniform(_SMALLEST_SHARE, 1.0, (self.count, 2))
        return PointSequence(points, shares)

    def redraw(self, sequence: PointSequence, k: int, rng: np.random.Generator) -> PointSequence:
        """Return a sequence with another point k.

        Everything begins from the first point: instead of it, the last one is drawn again.
        """
        points = sequence.points.copy()
        points[k if k else -1] = self.postures[rng.integers(len(self.postures))]
        return PointSequence(points, sequence.shares)

    def vary(self, sequence: PointSequence, rng: np.random.Generator, size: float) -> PointSequence:
        """Return a sequence with one point moved, and other shares for the two moves that it belongs to.

        Parameters
        ----------
        sequence : PointSequence
            The sequence.
        rng : np.random.Generator
            Generator of all that is drawn.
        size : float
            Size of the variation as a share of the ranges.
        """
        points, shares = sequence.points.copy(), sequence.shares.copy()
        k = int(rng.integers(self.count))
        # Now and then a point is drawn anew, so that the search can leave a place where small changes gain nothing.
        if rng.random() < _FRESH:
            points[k] = self.postures[rng.integers(len(self.postures))]
        else:
            points[k] = _clip_posture(
                self.bounds, points[k] + size * self.bounds.half_range * rng.standard_normal(len(points[k]))
            )
        # A point belongs to two moves: the one to it and the one from it.
        touched = [k, (k + 1) % self.count]
        shares[touched] += self.fastest * size * rng.standard_normal((2, 2))
        low, high = _SMALLEST_SHARE * self.fastest, self.fastest
        return PointSequence(points, np.clip(shares, low, high))


@dataclass(frozen=True, eq=False)
class TwoPoints:
    """Sequences back and forth between two points around a free posture, as fast as the limits allow.

    Parameters
    ----------
    bounds : Bounds
        Limits of the motion.
    postures : (m, n)
        Postures that the middle is drawn from, rad or m.
    shortest : (n,)
        Shortest way of each joint, rad or m; zero for one that is locked.
    longest : (n,)
        Longest way of each joint, rad or m.
    """

    bounds: Bounds
    postures: FloatArray
    shortest: FloatArray
    longest: FloatArray

    def draw(self, rng: np.random.Generator) -> PointSequence:
        """Return a sequence around a random posture that can be held."""
        way = rng.uniform(self.shortest, self.longest) * rng.choice([-1.0, 1.0], len(self.shortest))
        return self._build_around(self.postures[rng.integers(len(self.postures))], way)

    def redraw(self, sequence: PointSequence, k: int, rng: np.random.Generator) -> PointSequence:
        """Return a sequence around another posture."""
        return self.draw(rng)

    def vary(self, sequence: PointSequence, rng: np.random.Generator, size: float) -> PointSequence:
        """Return a sequence around a nearby posture, by other distances.

        Parameters
        ----------
        sequence : PointSequence
            The sequence.
        rng : np.random.Generator
            Generator of all that is drawn.
        size : float
            Size of the variation as a share of the ranges.
        """
        middle = sequence.points.mean(axis=0) + size * self.bounds.half_range * rng.standard_normal(len(self.shortest))
        way = sequence.points[1] - sequence.points[0]
        length = np.abs(way) + size * self.longest * rng.standard_normal(len(way))
        sign = np.where(rng.random(len(way)) < _FRESH, -1.0, 1.0) * np.where(way < 0, -1.0, 1.0)
        return self._build_around(
            _clip_posture(self.bounds, middle), sign * np.clip(length, self.shortest, self.longest)
        )

    def _build_around(self, middle: FloatArray, way: FloatArray) -> PointSequence:
        # The middle stays so far from the ends of the range that both points lie within it.
        spare = self.bounds.half_range - np.abs(way) / 2
        centre = np.clip(middle, self.bounds.middle - spare, self.bounds.middle + spare)
        return PointSequence(np.stack([centre - way / 2, centre + way / 2]), np.ones((2, 2)))


def _clip_posture(bounds: Bounds, posture: FloatArray) -> FloatArray:
    """Return a posture moved inside the position limits."""
    return np.clip(posture, bounds.position_low, bounds.position_high)


_REDRAWN = 20
"""Number of times that a point may be drawn again."""
# Sizes of the variations as shares of the ranges: the first, the smallest and the largest.
_FIRST_SIZE, _SMALLEST_SIZE, _LARGEST_SIZE = 0.2, 0.005, 0.5
_GROWTH = 1.3
"""Growth of the variations after a success; four failures undo it."""


@dataclass(frozen=True, eq=False)
class EvaluatedSequence:
    """A sequence that keeps the limits, and its criterion values.

    Parameters
    ----------
    sequence : PointSequence
        The points, and the shares of the limits.
    values : CriterionValues
        Criterion values of its moves.
    """

    sequence: PointSequence
    values: CriterionValues


def draw_sequences(
    space: PointSpace,
    legs: MovePlanner,
    design_criterion: DesignCriterion,
    *,
    count: int,
    rng: np.random.Generator,
    progress: Progress,
    enough: Callable[[], bool] = lambda: False,
) -> list[EvaluatedSequence]:
    """Return `count` random sequences that keep the limits, best first; fewer where `enough` says so once there is one.

    Parameters
    ----------
    space : PointSpace
        Sequences to search in.
    legs : MovePlanner
        Plans the moves of sequences.
    design_criterion : DesignCriterion
        Measure of a motion.
    count : int
        Number of sequences to draw.
    rng : np.random.Generator
        Generator of all that is drawn.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    enough : callable
        Asked before each draw; True ends the drawing once there is a sequence.

    Raises
    ------
    ImpossibleLimitsError
        None of many keeps the limits.
    """
    sequences: list[EvaluatedSequence] = []
    for index in range(count):
        if sequences and enough():
            break
        progress(index / count, f"random sequence {index + 1} of {count}")
        sequence = _draw_within_limits(space, legs, rng)
        moves = legs.plan_sequence(sequence)
        if moves is not None:
            sequences.append(EvaluatedSequence(sequence, evaluate_moves(moves, design_criterion)))
    if not sequences:
        raise ImpossibleLimitsError(
            f"None of {count} random sequences of moves, each point drawn up to {_REDRAWN} times, stays within the "
            "limits of torque and clearance; relax these limits, or use fewer points.",
            pointer="/limits",
            title="Impossible limits",
        )
    return sorted(sequences, key=lambda candidate: candidate.values.criterion)


def _draw_within_limits(space: PointSpace, legs: MovePlanner, rng: np.random.Generator) -> PointSequence:
    """Return a random sequence, point after point drawn again until the moves keep the limits, or many times."""
    sequence = space.draw(rng)
    # A sequence that still breaks a limit after so many draws is given up by the caller.
    for _ in range(_REDRAWN * len(sequence.points)):
        k = legs.find_first_broken(sequence)
        if k is None:
            break
        # Only the point that a broken move leads to is drawn again: a whole new sequence would seldom keep every limit
        # at once.
        sequence = space.redraw(sequence, k, rng)
    return sequence


def improve_sequence(
    first: PointSequence,
    space: PointSpace,
    legs: MovePlanner,
    design_criterion: DesignCriterion,
    *,
    variations: int,
    rng: np.random.Generator,
    budget: Budget,
    progress: Progress,
) -> tuple[PointSequence, bool]:
    """Return the sequence after so many variations, and whether the time allowed all of them.

    Parameters
    ----------
    first : PointSequence
        The sequence to begin with, which keeps the limits.
    space : PointSpace
        Sequences to search in.
    legs : MovePlanner
        Plans the moves of sequences.
    design_criterion : DesignCriterion
        Measure of a motion.
    variations : int
        Number of variations to try.
    rng : np.random.Generator
        Generator of all that is drawn.
    budget : Budget
        Time and number of starts.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    """
    criterion = design_criterion.smooth_criterion
    # The first sequence was drawn within the limits, so that its moves exist.
    moves = legs.plan_sequence(first)
    assert moves is not None
    best, value, size = first, criterion(stack_rows(moves))[0], _FIRST_SIZE
    for index in range(variations):
        if budget.is_spent:
            return best, False
        progress(index / variations, f"variation {index + 1}: criterion {np.exp(value):.4g}")
        neighbour = space.vary(best, rng, size)
        moves = legs.plan_sequence(neighbour)
        # A neighbour that breaks a limit is worse than any that keeps them all.
        reached = np.inf if moves is None else criterion(stack_rows(moves))[0]
        if reached < value:
            best, value, size = neighbour, reached, min(_GROWTH * size, _LARGEST_SIZE)
        else:
            size = max(size * _GROWTH**-0.25, _SMALLEST_SIZE)
    return best, True


# Samples of a move during the search.
_SAMPLES_OF_A_MOVE = 16
_FIRST_LOOKS, _LOOK_EVERY = 9, 0.08
"""Along a straight way, for what the robot must stay clear of: so many, then so close (rad, m)."""
# Moves that are kept, and the factor and number of attempts by which a move is slowed down for its torque.
_REMEMBERED = 4096
_SLOWER, _ATTEMPTS = 1.25, 8


@dataclass(frozen=True, eq=False)
class PointSequence:
    """A sequence of postures, in each of which the arm comes to rest.

    Parameters
    ----------
    points : (P, n)
        Postures, visited one after the other and round again, rad or m.
    shares : (P, 2)
        Shares of the velocity and of the acceleration limits that the move to each point may use.
    """

    points: FloatArray
    shares: FloatArray

    def slow_down(self, factor: float) -> PointSequence:
        """Return the same points at smaller shares of the limits."""
        return replace(self, shares=factor * self.shares)


@dataclass(frozen=True, eq=False)
class PlannedMove:
    """The move to a point, and the rows of W along it.

    Parameters
    ----------
    piece : Piece
        The move.
    rows : (m n, b)
        Rows whose WᵀW is ∫ WᵀW dt over the move.
    """

    piece: Piece
    rows: FloatArray


class MovePlanner:
    """Plans the moves of sequences within all limits, each of them once.

    Torque and clearance are checked on few samples: the sequence that is chosen in the end is verified closely.

    Parameters
    ----------
    bounds : Bounds
        Limits of the motion.
    model : DesignModel
        Its columns must not depend on the path travelled: each move is evaluated by itself.
    rate : float
        Sampling rate, Hz.
    """

    def __init__(self, bounds: Bounds, model: DesignModel, rate: float) -> None:
        self._bounds, self._rate = bounds, rate
        self._observed = ObservationGradient(model, _SAMPLES_OF_A_MOVE, choose_sign_rounding(model, bounds))
        self._model, self._nominal, self._n_parameters = model, model.nominal_values, model.n_parameters
        self._counted = model.counted[:, None]
        self._known: dict[bytes, PlannedMove | None] = {}

    def restrict_to_joints(self, moving: BoolArray) -> MovePlanner:
        """Return the same where only the equations of some joints (n,) count."""
        legs = copy(self)
        legs._counted, legs._known = moving[:, None], {}
        return legs

    def plan_sequence(self, sequence: PointSequence) -> tuple[PlannedMove, ...] | None:
        """Return the moves to each point, the one to the first from the last; None where one breaks a limit."""
        legs: list[PlannedMove] = []
        for k in range(len(sequence.points)):
            leg = self._plan_to(sequence, k)
            if leg is None:
                return None
            legs.append(leg)
        return tuple(legs)

    def find_first_broken(self, sequence: PointSequence) -> int | None:
        """Return the first point to which no move keeps the limits; None where all do."""
        # The way to the first point comes last, since it starts at the last point.
        ways = range(1, len(sequence.points) + 1)
        return next((k % len(ways) for k in ways if self._plan_to(sequence, k % len(ways)) is None), None)

    def _plan_to(self, sequence: PointSequence, k: int) -> PlannedMove | None:
        return self._get_move(sequence.points[k - 1], sequence.points[k], sequence.shares[k])

    def _get_move(self, start: FloatArray, end: FloatArray, share: FloatArray) -> PlannedMove | None:
        # Bit-wise equal ends: a move comes again only when a variation left both of its ends alone.
        key = start.tobytes() + end.tobytes() + share.tobytes()
        if key not in self._known:
            # Variations rarely come back to old moves, so a plain reset bounds the memory well enough.
            if len(self._known) >= _REMEMBERED:
                self._known.clear()
            self._known[key] = self._plan_move(start, end, share)
        return self._known[key]

    def _plan_move(self, start: FloatArray, end: FloatArray, share: FloatArray) -> PlannedMove | None:
        limits = self._bounds
        if limits.space is not None and not _is_clear(start, end, limits.space):
            return None
        slow = replace(limits, velocity=share[0] * limits.velocity, acceleration=share[1] * limits.acceleration)
        # A move that takes too much torque may still be made more slowly.
        for attempt in range(_ATTEMPTS):
            piece = plan_move(start, end, slow, self._rate, slowness=_SLOWER**attempt)
            step = piece.duration / _SAMPLES_OF_A_MOVE
            motion = piece.evaluate(step * np.arange(0.5, _SAMPLES_OF_A_MOVE))
            # Samples lie in the middle of equal intervals: the sum over them is the integral by the midpoint rule.
            w = self._observed.evaluate(motion.q, motion.dq, motion.ddq, motion.dddq, np.zeros_like(motion.q))
            torque = np.abs(
                w @ self._nominal
                if self._model.expected is None
                else self._model.torque(motion.q, motion.dq, motion.ddq)
            )
            within = (torque <= limits.torque).all() and (torque * np.abs(motion.dq) <= limits.power).all()
            if within and limits.are_rates_and_balance_kept(motion.q, motion.dq, motion.ddq):
                # The square root, because rows enter WᵀW squared.
                rows = np.sqrt(step) * w[:, :, : self._n_parameters] * self._counted
                return PlannedMove(piece, rows.reshape(-1, self._n_parameters))
        return None


def _is_clear(start: FloatArray, end: FloatArray, space: FreeSpace) -> bool:
    """Return whether a straight path is clear, by a coarse check first, which most paths fail, and then a close one."""
    way = end - start
    closely = max(_FIRST_LOOKS, int(np.ceil(np.abs(way).max() / _LOOK_EVERY)) + 1)
    return all(
        bool((space.compute_least_slack(start + np.linspace(0.0, 1.0, looks)[:, None] * way) >= 0).all())
        for looks in (_FIRST_LOOKS, closely)
    )


def stack_rows(legs: Sequence[PlannedMove]) -> FloatArray:
    """Return rows (m n, b) that stand for W / √N of moves one after the other."""
    total = sum(leg.piece.duration for leg in legs)
    rows: FloatArray = np.concatenate([leg.rows for leg in legs]) / np.sqrt(total)
    return rows


def evaluate_moves(legs: Sequence[PlannedMove], design_criterion: DesignCriterion) -> CriterionValues:
    """Return the values of moves by the true criteria.

    Parameters
    ----------
    legs : sequence of PlannedMove
        Moves, one after the other.
    design_criterion : DesignCriterion
        Measure of a motion.
    """
    return design_criterion.evaluate(stack_rows(legs), 1)
