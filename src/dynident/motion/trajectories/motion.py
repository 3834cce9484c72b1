"""Motion of all joints over time: pieces, sequences of them, and families of periodic trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError


class Family(Protocol):
    """Trajectories q = `basis(t)[0] @ x`, coefficients x (m, n), that rest at the border of their period.

    The first coefficient of every joint is a constant offset; without the others the arm stands still there.
    """

    @property
    def period(self) -> float:
        """Length of a period, s."""

    @property
    def n_coefficients(self) -> int:
        """Number of free coefficients m of one joint."""

    @property
    def waves(self) -> int:
        """How often a joint can go back and forth within a period: how closely it must be looked at."""

    @property
    def highest_frequency(self) -> float:
        """Frequency of these waves, Hz."""

    def basis(self, t: FloatArray) -> FloatArray:
        """Return values (5, len(t), m) such that q and its four derivatives are `basis(t)[d] @ x`."""

    def with_period(self, period: float) -> Family:
        """Return the family of the same paths with another period (s)."""


@dataclass(frozen=True, eq=False)
class PeriodicMotion:
    """One trajectory of a family, repeated for some periods.

    Parameters
    ----------
    family : Family
        Family of trajectories.
    x : (m, n)
        Coefficients of the family.
    periods : int
        Number of periods.
    """

    family: Family
    x: FloatArray
    periods: int = 1

    @property
    def duration(self) -> float:
        """Duration of all periods, s."""
        return self.family.period * self.periods

    def evaluate(self, t: FloatArray) -> Motion:
        """Return the motion at times t (m,)."""
        q, dq, ddq, dddq, _ = self.family.basis(t) @ self.x
        return Motion(t, q, dq, ddq, dddq)

    @property
    def start(self) -> FloatArray:
        """Posture (n,) at which it starts and ends, at rest."""
        posture: FloatArray = self.family.basis(np.zeros(1))[0, 0] @ self.x
        return posture


# Largest number of samples of a motion: positions and three derivatives of seven joints then take about a gigabyte.
MOST_SAMPLES = 5_000_000


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions of all joints and their derivatives at some times.

    Parameters
    ----------
    t : (m,)
        Times, s.
    q : (m, n)
        Positions, rad or m.
    dq : (m, n)
        Velocities, rad/s or m/s.
    ddq : (m, n)
        Accelerations, rad/s² or m/s².
    dddq : (m, n)
        Jerks, rad/s³ or m/s³.
    """

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    dddq: FloatArray


class Piece(Protocol):
    """A motion from time 0 to `duration`."""

    @property
    def duration(self) -> float:
        """Duration, s."""

    def evaluate(self, t: FloatArray) -> Motion:
        """Return the motion at times t (m,) between 0 and `duration`."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Standing still at a posture.

    Parameters
    ----------
    posture : (n,)
        The posture, rad or m.
    duration : float
        Duration, s.
    """

    posture: FloatArray
    duration: float = 0.0

    def evaluate(self, t: FloatArray) -> Motion:
        """Return the posture, at all times."""
        zero = np.zeros((len(t), len(self.posture)))
        return Motion(t, zero + self.posture, zero, zero, zero)


def sample_pieces(pieces: Sequence[Piece], rate: float) -> Motion:
    """Sample pieces of motion one after the other.

    The duration of each piece is a whole number of sampling periods, so that no sample falls between the grids of two
    of them. A border belongs to the piece that begins there; the last piece keeps its end.

    Parameters
    ----------
    pieces : sequence of Piece
        Pieces of the motion, each of which begins where the one before ends.
    rate : float
        Sampling rate, Hz.

    Returns
    -------
    Motion
        Samples of all pieces, with times from 0 on.
    """
    check_length(pieces, rate)
    parts: list[Motion] = []
    start = 0
    for piece in pieces:
        steps = count_steps(piece, rate)
        # Rounding of the last times must not evaluate a piece beyond its end.
        part = piece.evaluate(np.minimum(np.arange(steps) / rate, piece.duration))
        # Times are whole numbers over the rate: sums of durations would collect rounding errors.
        parts.append(Motion((start + np.arange(steps)) / rate, part.q, part.dq, part.ddq, part.dddq))
        start += steps
    # A piece has no sample at its end, which is the beginning of the next one; only the last piece needs it.
    end = pieces[-1].evaluate(np.array([pieces[-1].duration]))
    parts.append(Motion(np.array([start / rate]), end.q, end.dq, end.ddq, end.dddq))
    return concatenate_motions(parts)


def check_length(pieces: Sequence[Piece], rate: float) -> None:
    """Raise `DynidentError` where a sequence of pieces has more samples at `rate` (Hz) than can be handled.

    Parameters
    ----------
    pieces : sequence of Piece
        Pieces of the motion, one after the other.
    rate : float
        Sampling rate, Hz.
    """
    samples = sum(piece.duration for piece in pieces) * rate
    if samples > MOST_SAMPLES:
        raise DynidentError(
            f"the trajectory would have {samples:.3g} samples; at most {MOST_SAMPLES} can be designed: make it "
            "shorter, or sample it more slowly",
            pointer="/trajectory",
        )


def concatenate_motions(parts: Sequence[Motion]) -> Motion:
    """Concatenate samples into one motion."""
    return Motion(
        t=np.concatenate([part.t for part in parts]),
        q=np.concatenate([part.q for part in parts]),
        dq=np.concatenate([part.dq for part in parts]),
        ddq=np.concatenate([part.ddq for part in parts]),
        dddq=np.concatenate([part.dddq for part in parts]),
    )


def count_steps(piece: Piece, rate: float) -> int:
    """Return the number of sampling periods in a piece."""
    return round(piece.duration * rate)
