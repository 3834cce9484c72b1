"""The parts of the choices: what rows, and what the prior, are asked for."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.bases import Prior


@dataclass(frozen=True)
class RowsAsked:
    """What rows are made of recordings: the name of their model, and what its equations need.

    `pole` is a of [12.29] in rad/s, for the filtered model, `interval` t_b - t_a of [12.43] in s, for the energy model;
    None where the data decide. `tolerance` and `weighted`, for the base's wrench: which columns count as dependent, and
    whether what it alone shows is fitted with its six equations weighed by their noise.
    """

    model: str
    pole: float | None
    interval: float | None
    tolerance: float
    weighted: bool


@dataclass(frozen=True)
class Trust:
    """How far the inertias of the robot's description are believed.

    `prior` is the kind of belief, None where the data alone count; `free_links`, by their joints, are those that it is
    not believed of, and `error` is the share by which the others are usually off.
    """

    prior: Prior | None
    free_links: tuple[str, ...]
    error: float

    @property
    def of_bodies(self) -> bool:
        """Whether a distance between bodies that can exist is what is believed."""
        return self.prior is not None and self.prior.of_bodies
