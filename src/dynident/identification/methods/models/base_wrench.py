"""Six rows from a force-torque sensor under the base."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import EquationType


@dataclass(frozen=True)
class BaseWrench(EquationType):
    """Six rows from a force-torque sensor under the base."""

    name = "base_wrench"
    label = "base wrench"
    words = "Six rows from a force-torque sensor under the base: free of joint friction."
    brief = "a sensor under the base"
    place = 5
