"""Families of periodic trajectories, as designs see them: a linear map from coefficients to a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.arrays import FloatArray
from dynident.motion.trajectories.motion import Motion


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
    """One trajectory of a family with coefficients x (m, n), repeated `periods` times."""

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
