"""Which uses a model is fit for, and why or why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import LINKS
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.thresholds import (
    LARGEST_ERROR,
    LARGEST_OF_JOINT,
    LARGEST_OF_JOINT_TO_DETECT,
    LARGEST_TO_DETECT,
)

UseName = Literal["simulation", "feed_forward", "collision_detection", "payload"]
USES: tuple[UseName, ...] = ("simulation", "feed_forward", "collision_detection", "payload")

_LEAST_DETERMINED = 0.5
"""Share of the links' parameters that the data have to determine before a load is weighed against them."""


@dataclass(frozen=True)
class Use:
    """Whether a model is fit for a use, and the reason in a sentence or two."""

    use: UseName
    fit: bool
    reason: str


def uses_of(found: Identification, nothing_held_out: str, reservations: Sequence[str]) -> tuple[Use, ...]:
    """Judge each use by the held-out error.

    Parameters
    ----------
    nothing_held_out : str
        Why there is no held-out error to judge by; empty where there is one.
    reservations : sentences
        What holds of the held-out error whatever the use.
    """
    if nothing_held_out or found.held_out is None:
        reason = nothing_held_out or "There are no held-out data to judge by: give a recording that no parameter sees."
        return tuple(Use(name, False, reason) for name in USES)
    return tuple(_judged(found, found.held_out, name, reservations) for name in USES)


def joint_errors(found: Errors, moving: Errors | None) -> FloatArray:
    """(n,): relative error of each joint where it moves, on all rows where it never does; 0 where it has none."""
    there = found.counts > 0
    relative = np.where(there, found.relative, 0.0)
    if moving is None:
        return np.asarray(relative)
    return np.asarray(np.where(moving.counts > 0, moving.relative, relative))


def _judged(found: Identification, held_out: Errors, name: UseName, reservations: Sequence[str]) -> Use:
    strict = name in ("collision_detection", "payload")
    limit = LARGEST_TO_DETECT if strict else LARGEST_ERROR
    of_joint = LARGEST_OF_JOINT_TO_DETECT if strict else LARGEST_OF_JOINT
    error, joints = held_out.relative_total, found.model.robot.joint_names
    each = joint_errors(held_out, found.held_out_moving)
    against = []
    if not error <= limit:
        against.append(f"the held-out error is {error:.1%}, above {limit:.0%}")
    bad = [f"{joints[j]} ({each[j]:.0%})" for j in range(len(joints)) if not each[j] <= of_joint]
    if bad:
        against.append(f"where they move, joints are above {of_joint:.0%}: {', '.join(bad)}")
    against += _of_parameters(found, name)
    if against:
        reason = "; ".join(against)
        return Use(name, False, f"{reason[0].upper()}{reason[1:]}.")
    told = (
        f"The held-out error is {error:.1%} (up to {limit:.0%} will do), no joint above {of_joint:.0%} where it moves."
    )
    return Use(name, True, " ".join([told, *reservations]))


def _of_parameters(found: Identification, name: UseName) -> list[str]:
    against = []
    if name == "simulation" and not found.inertia_matrix_positive_definite:
        against.append(
            "the inertia matrix is not positive definite in every posture (the estimator feasible mends that)"
        )
    if name == "payload":
        links = [one for one in found.parameters if one.effect == LINKS.effect and one.judgement != "zero_in_interval"]
        sure = sum(one.judgement == "determined" for one in links)
        if not links or sure < _LEAST_DETERMINED * len(links):
            against.append(
                f"of the {len(links)} parameters of the links that are not zero the data determine {sure}: a load "
                "would be weighed against uncertain ones"
            )
    return against
