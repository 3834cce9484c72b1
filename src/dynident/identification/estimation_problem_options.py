"""Options of an estimation problem that concern rows and prior: types without numerics.

They follow from the choices of an identification, and what makes equations and priors knows nothing else of these. Like
the choices they load no numerics.
"""

from __future__ import annotations

from dataclasses import dataclass

ModelName = str


@dataclass(frozen=True)
class RowOptions:
    """Options of the rows that are made of recordings: the name of their model, and what its equations need.

    `pole` is a of [12.29] in rad/s, for the filtered model, `interval` t_b - t_a of [12.43] in s, for the energy model;
    None where the data decide. `tolerance` and `weighted` are for the base's wrench: which columns count as dependent,
    and whether what it alone shows is fitted with its six equations weighed by their noise.
    """

    model: str
    pole: float | None
    interval: float | None
    tolerance: float
    weighted: bool


@dataclass(frozen=True)
class DescriptionTrust:
    """Trust in the inertias of the robot's description, and in single parameters that are known.

    `prior` is its name, None where the data alone count; `free_links`, by their joints, are those that it does not hold
    for, and `error` is the share by which the others are usually off. `of_bodies`: the prior is a distance between
    bodies that can exist. `known` has single parameters that are known by themselves: name, value and standard
    deviation, zero for an exact value.
    """

    prior: str | None
    free_links: tuple[str, ...]
    error: float
    of_bodies: bool = False
    known: tuple[tuple[str, float, float], ...] = ()
