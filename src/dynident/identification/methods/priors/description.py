"""Priors from the robot's description: its inertias, or its bodies, the same in every frame."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import Prior


@dataclass(frozen=True)
class EntropicDescription(Prior):
    """The bodies of the robot's description, the same in every frame."""

    name = "description_entropic"
    label = "the description's bodies (entropic)"
    words = "Believes them as bodies, the same in every frame; goes with the estimator physically feasible."
    brief = "bodies, the same in every frame; with --estimator feasible"
    place = 2
    called = "description (entropic)"
    of_bodies = True


@dataclass(frozen=True)
class Description(Prior):
    """The inertias of the robot's description."""

    name = "description"
    label = "the description's inertias"
    words = "Believes the robot's description as far as descriptions can usually be believed: for small motions."
    brief = "its inertias"
    place = 1
    called = "description"
