"""Find the columns of a model that are the ten inertial parameters of one body: of a link, or of what it carries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import IndexArray
from dynident.effects import Column, Role, get_role
from dynident.robot.model import INERTIAL_NAMES


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body of the model. `columns` (10,) are its parameters in the order of `INERTIAL_NAMES`.

    `link` is the joint that moves it; empty for what a link carries.
    """

    name: str
    link: str
    columns: IndexArray


def find_bodies(columns: Sequence[Column]) -> tuple[Body, ...]:
    """Return the bodies among a model's columns; a body that is not there whole cannot be judged and is left out.

    Parameters
    ----------
    columns : sequence of Column

    Returns
    -------
    tuple of Body
    """
    groups: dict[tuple[Role, str, tuple[str, ...]], list[int]] = {}
    for k, column in enumerate(columns):
        role = get_role(column)
        if role in ("link", "load"):
            groups.setdefault((role, column.link, column.runs), []).append(k)
    return tuple(
        Body(link, link, np.array(members))
        if role == "link"
        else Body(_name_payload(link, runs), "", np.array(members))
        for (role, link, runs), members in groups.items()
        # A body with fixed or missing parameters has no whole pseudo-inertia.
        if len(members) == len(INERTIAL_NAMES)
    )


def _name_payload(link: str, runs: Sequence[str]) -> str:
    return f"payload on {link}" + (f" in {', '.join(runs)}" if runs else "")
