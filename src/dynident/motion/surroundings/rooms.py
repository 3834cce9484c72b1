"""Slack of all constraints on a posture besides the ranges of the driven joints, combined for the optimiser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.arrays import FloatArray


class Slack(Protocol):
    """Slack at m postures: `values` (m, K), negative where a constraint is violated."""

    @property
    def values(self) -> FloatArray:
        """Slack (m, K)."""
        ...

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂values (m, K)."""
        ...


class Constraints(Protocol):
    """Slack of constraints as a function of the posture."""

    @property
    def count(self) -> int:
        """Number of constraints K."""
        ...

    def evaluate(self, q: FloatArray) -> Slack:
        """Return the slack at postures q (m, n)."""
        ...

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest slack (m,) at postures q (m, n)."""
        ...


@dataclass(frozen=True, eq=False)
class _JoinedSlack:
    parts: tuple[Slack, ...]

    @property
    def values(self) -> FloatArray:
        """Slack (m, K) of all parts."""
        return np.concatenate([part.values for part in self.parts], axis=1)

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂values (m, K)."""
        ends = np.cumsum([part.values.shape[1] for part in self.parts])[:-1]
        pieces = np.split(gradient, ends, axis=1)
        return np.asarray(sum(part.pull_back(piece) for part, piece in zip(self.parts, pieces, strict=True)))


@dataclass(frozen=True, eq=False)
class JoinedConstraints:
    """Several kinds of constraints."""

    parts: tuple[Constraints, ...]

    @property
    def count(self) -> int:
        """Number of constraints K."""
        return sum(part.count for part in self.parts)

    def evaluate(self, q: FloatArray) -> Slack:
        """Return the slack at postures q (m, n)."""
        return _JoinedSlack(tuple(part.evaluate(q) for part in self.parts))

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest slack (m,) at postures q (m, n)."""
        return np.asarray(np.min([part.find_least(q) for part in self.parts], axis=0))
