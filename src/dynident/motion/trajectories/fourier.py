"""Periodic exciting trajectories as Fourier series (Swevers et al. 1997) that start and end at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from dynident.array_types import FloatArray
from dynident.errors import DynidentError


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
