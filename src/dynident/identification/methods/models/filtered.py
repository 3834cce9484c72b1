"""Rows of the filtered dynamic model [12.28], with `pole`."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import EquationType


@dataclass(frozen=True)
class Filtered(EquationType):
    """Rows of the filtered dynamic model [12.28], with `pole`."""

    name = "filtered"
    label = "filtered dynamic"
    words = "As the dynamic model, but without accelerations [12.28]: for noisy encoders."
    brief = "without accelerations"
    place = 2
    by_joint = True
