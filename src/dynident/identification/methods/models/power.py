"""Rows of the power model [12.51]."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import EquationType


@dataclass(frozen=True)
class Power(EquationType):
    """Rows of the power model [12.51]."""

    name = "power"
    label = "power"
    words = (
        "One row for each instant [12.51]: no interval to choose, no infinite gain for offsets; needs a more exciting "
        "motion."
    )
    brief = "energy's rate"
    place = 4
