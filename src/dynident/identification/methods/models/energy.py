"""Rows of the energy model [12.43], with `interval`."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import EquationType


@dataclass(frozen=True)
class Energy(EquationType):
    """Rows of the energy model [12.43], with `interval`."""

    name = "energy"
    label = "energy"
    words = "One row for each interval [12.43]: neither accelerations nor filters matter; needs a more exciting motion."
    brief = "over intervals"
    place = 3
