"""Sequences of rest-to-rest moves through intermediate points (§12.3.4.1), and their criterion values."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.excitation.criteria.criterion_values import CriterionValues
from dynident.excitation.criteria.design_criterion import DesignCriterion
from dynident.excitation.observation.design_model import DesignModel
from dynident.excitation.observation.observation_gradient import ObservationGradient
from dynident.excitation.optimising.period_sampling import choose_sign_rounding
from dynident.motion.collision.free_space import FreeSpace
from dynident.motion.limits.bounds import Bounds
from dynident.motion.moves.jerk_limited import plan_move
from dynident.motion.trajectories.motion import Piece

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
        self._nominal, self._n_parameters = model.nominal_values, model.n_parameters
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
            torque = np.abs(w @ self._nominal)
            within = (torque <= limits.torque).all() and (torque * np.abs(motion.dq) <= limits.power).all()
            if within and limits.are_follower_rates_kept(motion.q, motion.dq, motion.ddq):
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


def evaluate_moves(legs: Sequence[PlannedMove], yardstick: DesignCriterion) -> CriterionValues:
    """Return the values of moves by the true criteria.

    Parameters
    ----------
    legs : sequence of PlannedMove
        Moves, one after the other.
    yardstick : DesignCriterion
        Measure of a motion.
    """
    return yardstick.evaluate(stack_rows(legs), 1)
