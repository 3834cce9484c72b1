"""Rows of the dynamic model [12.18]."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import EquationType


@dataclass(frozen=True)
class Dynamic(EquationType):
    """Rows of the dynamic model [12.18]."""

    name = "dynamic"
    label = "dynamic"
    words = "A row for each joint and instant [12.18]: excites most. The usual choice."
    brief = "joints' torques"
    place = 1
    by_joint = True
