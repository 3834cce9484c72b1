"""Interface of the model that limits of torque need."""

from __future__ import annotations

from typing import Protocol

from dynident.arrays import FloatArray


class TorqueModel(Protocol):
    """A model that predicts the torque of a motion."""

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque at q, q̇, q̈ (m, n); raise `DynidentError` where it is not known."""
