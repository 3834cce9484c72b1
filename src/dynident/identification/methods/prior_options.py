"""The priors that can be chosen: inertias of the description, or entropic distance of bodies, with their options."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.base_classes import Prior


@dataclass(frozen=True)
class EntropicDescription(Prior):
    """The bodies of the robot's description, the same in every frame."""

    name = "description_entropic"
    label = "the description's bodies (entropic)"
    words = "Uses the bodies of the description, independent of the frame; needs the estimator physically feasible."
    brief = "bodies, independent of the frame; with --estimator feasible"
    place = 2
    called = "description (entropic)"
    of_bodies = True


@dataclass(frozen=True)
class Description(Prior):
    """The inertias of the robot's description."""

    name = "description"
    label = "the description's inertias"
    words = "Uses the inertias of the robot's description with their usual errors: for small motions."
    brief = "its inertias"
    place = 1
    called = "description"
