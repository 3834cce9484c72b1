"""Motion of all joints: families of periodic trajectories, rest, sequences of pieces; the most samples.

Periodic exciting trajectories start and end at rest: Fourier series (Swevers et al. 1997) and B-splines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy
from scipy.linalg import null_space, solve_triangular

from dynident.array_types import FloatArray
from dynident.errors import DynidentError

DEGREE = 5
"""Degree of the splines: the fourth derivative, which some effects need, is then still continuous."""

# A coefficient moves velocities as much as one of a Fourier series does: ∫ (2π cos 2πu)² du.
_MEAN_SQUARE = (2 * np.pi) ** 2 / 2
_QUADRATURE = 12
"""Quadrature points per interval: more than enough to integrate squares of polynomials of degree 4 exactly."""


@dataclass(frozen=True)
class BSplineFamily:
    """q(t) = q0 + Σ_i x_i B_i(t) for each joint, with q̇ = q̈ = 0 at the border of the period.

    Of a clamped spline of degree 5 the first three and the last three control points are one posture: that is rest.
    The remaining m = intervals coefficients of a joint are free. The shapes B_i have no mean, and their velocities
    are orthonormal: offsets and shapes, slow and fast ones, then have similar effects, which helps the optimiser.

    Parameters
    ----------
    intervals : int
        Number of polynomial pieces of a period.
    period : float
        Period, s.
    """

    intervals: int
    period: float

    def __post_init__(self) -> None:
        if self.intervals < 2:
            raise DynidentError(
                f"intervals is {self.intervals}; a spline that starts and ends at rest needs at least 2",
                pointer="/trajectory/intervals",
            )
        if not (np.isfinite(self.period) and self.period > 0):
            raise DynidentError(
                f"the period is {self.period} s; it must be a positive number", pointer="/trajectory/duration"
            )

    @property
    def n_coefficients(self) -> int:
        """Number of free coefficients m of one joint; the first is the offset q0."""
        return self.intervals

    @property
    def waves(self) -> int:
        """Number of waves in a period; two intervals make one."""
        return (self.intervals + 1) // 2

    @property
    def highest_frequency(self) -> float:
        """Frequency of these waves, Hz."""
        return self.waves / self.period

    def with_period(self, period: float) -> BSplineFamily:
        """Return the family of the same paths with another period (s)."""
        return replace(self, period=period)

    @cached_property
    def _splines(self) -> tuple[scipy.interpolate.BSpline, ...]:
        """Shapes (m - 1) over u = t / period from 0 to 1, and their four derivatives."""
        ends = (np.zeros(DEGREE), np.linspace(0.0, 1.0, self.intervals + 1), np.ones(DEGREE))
        # Clamped: with end knots of full multiplicity the curve begins and ends at its outermost control points.
        knots = np.concatenate(ends)
        # Without the three control points at either end, all shapes and two derivatives of theirs are zero at the
        # border.
        control = np.eye(self.intervals + DEGREE)[:, 3:-3]
        # The integral of a B-spline is the width of its support over its degree plus one.
        means = (knots[DEGREE + 1 :] - knots[: -DEGREE - 1])[3:-3] / (DEGREE + 1)
        plain = scipy.interpolate.BSpline(knots, control - means, DEGREE)
        velocity = plain.derivative()(self._nodes[0])
        gram = (velocity * self._nodes[1][:, None]).T @ velocity / _MEAN_SQUARE
        # Gram-Schmidt on the velocities, by the Cholesky factor of their inner products.
        lower = np.linalg.cholesky(gram)
        shapes = scipy.interpolate.BSpline(knots, solve_triangular(lower, (control - means).T, lower=True).T, DEGREE)
        return tuple(shapes.derivative(order) if order else shapes for order in range(5))

    @property
    def _nodes(self) -> tuple[FloatArray, FloatArray]:
        """Points in [0, 1] and weights of a quadrature over all intervals."""
        places, weights = np.polynomial.legendre.leggauss(_QUADRATURE)
        first = np.arange(self.intervals)[:, None]
        u = (first + 0.5 * (places + 1.0)) / self.intervals
        return u.ravel(), np.tile(0.5 * weights / self.intervals, self.intervals)

    def basis(self, t: FloatArray) -> FloatArray:
        """Return values (5, len(t), m) such that q and its four derivatives are `basis(t)[d] @ x`."""
        # Clipped, because the quotient may round to slightly more than one, where the spline would be extrapolated.
        u = np.clip(np.mod(t, self.period) / self.period, 0.0, 1.0)
        values = np.zeros((5, len(t), self.n_coefficients))
        values[0, :, 0] = 1.0
        for order, spline in enumerate(self._splines):
            values[order, :, 1:] = spline(u) / self.period**order
        return values


@dataclass(frozen=True)
class FourierFamily:
    """q(t) = q0 + Σ_k a_k sin kωt + b_k cos kωt for each joint, with q̇ = q̈ = 0 at the border of the period.

    Rest at the border is two linear conditions a joint, Σ k a_k = 0 and Σ k² b_k = 0. They are eliminated: the
    coefficients x (m, n), m = 2 harmonics - 1, are free, q and its derivatives are linear in them, and no harmonic
    above the last one appears however often the period is repeated.

    Parameters
    ----------
    harmonics : int
        Number of harmonics of the fundamental frequency ω = 2π / period.
    period : float
        Period, s.
    """

    harmonics: int
    period: float

    def __post_init__(self) -> None:
        if self.harmonics < 2:
            raise DynidentError(
                f"harmonics is {self.harmonics}; a motion that starts and ends at rest needs at least 2",
                pointer="/trajectory/harmonics",
            )
        if not (np.isfinite(self.period) and self.period > 0):
            raise DynidentError(
                f"the period is {self.period} s; it must be a positive number", pointer="/trajectory/duration"
            )

    @property
    def n_coefficients(self) -> int:
        """Number of free coefficients m of one joint; the first is the offset q0."""
        return 2 * self.harmonics - 1

    @property
    def waves(self) -> int:
        """Number of the last harmonic."""
        return self.harmonics

    @property
    def highest_frequency(self) -> float:
        """Frequency of the last harmonic, Hz."""
        return self.harmonics / self.period

    def with_period(self, period: float) -> FourierFamily:
        """Return the family of the same paths with another period (s)."""
        return replace(self, period=period)

    @cached_property
    def _free_amplitudes(self) -> tuple[FloatArray, FloatArray]:
        """Sine and cosine amplitudes (harmonics, harmonics - 1) for unit free coefficients.

        The k-th amplitude is measured in 1/k: positions, velocities and accelerations then have similar effects, which
        helps the optimiser.
        """
        k = np.arange(1.0, self.harmonics + 1)
        scale = 1.0 / k
        # The null spaces are the amplitudes that keep velocity (sines) and acceleration (cosines) zero at the border.
        sine = scale[:, None] * null_space((k * scale)[None, :])
        cosine = scale[:, None] * null_space((k**2 * scale)[None, :])
        return sine, cosine

    def basis(self, t: FloatArray) -> FloatArray:
        """Return values (5, len(t), m) such that q and its four derivatives are `basis(t)[d] @ x`."""
        omega = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        # Reduced to one period first: the sine of a large phase loses digits.
        phase = np.outer(np.mod(t, self.period), omega)
        sin, cos = np.sin(phase), np.cos(phase)
        sine, cosine = self._free_amplitudes
        values = np.zeros((5, len(t), self.n_coefficients))
        values[0, :, 0] = 1.0
        middle = self.harmonics
        derivatives = ((sin, cos), (cos, -sin), (-sin, -cos), (-cos, sin), (sin, cos))
        for order, (of_sine, of_cosine) in enumerate(derivatives):
            weight = omega**order
            values[order, :, 1:middle] = (of_sine * weight) @ sine
            values[order, :, middle:] = (of_cosine * weight) @ cosine
        return values


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
