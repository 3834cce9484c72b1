"""Motions that a robot can make: trajectories, limits, obstacles, and moves from rest to rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.motion.collision.surroundings import Box, Standing, Surroundings, ToolRange, Wall
    from dynident.motion.limits.bounds import ImpossibleLimitsError
    from dynident.motion.limits.limit_margins import Margin

__all__ = [
    "Box",
    "ImpossibleLimitsError",
    "Margin",
    "Standing",
    "Surroundings",
    "ToolRange",
    "Wall",
]

if not TYPE_CHECKING:
    # What a request says of surroundings and feet is declared in this package, too: who reads that does not wait for
    # the rest.
    __getattr__, __dir__ = make_lazy_exports(__name__)
