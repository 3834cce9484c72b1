"""The inertias of the robot's description."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import Prior


@dataclass(frozen=True)
class Description(Prior):
    """The inertias of the robot's description."""

    name = "description"
    label = "the description's inertias"
    words = "Believes the robot's description as far as descriptions can usually be believed: for small motions."
    brief = "its inertias"
    place = 1
    called = "description"
