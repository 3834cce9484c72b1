"""Six rows from a force-torque sensor under the base."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import RowsModel


@dataclass(frozen=True)
class BaseWrench(RowsModel):
    """Six rows from a force-torque sensor under the base."""

    name = "base_wrench"
    label = "base wrench"
    words = "Six rows from a force-torque sensor under the base: free of joint friction."
    brief = "a sensor under the base"
    place = 5
