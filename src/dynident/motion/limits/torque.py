"""What limits of torque ask of a model of the robot."""

from __future__ import annotations

from typing import Protocol

from dynident.arrays import FloatArray


class TorqueModel(Protocol):
    """A model that predicts the torque of a motion."""

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Torque (m, n) at q, q̇, q̈ (m, n); `DynidentError` where it is not known."""
