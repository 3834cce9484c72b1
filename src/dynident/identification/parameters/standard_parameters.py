"""Standard parameters of an identified model with their uncertainty, and the bodies that they belong to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Column, Role, get_role
from dynident.regressors.model import Model
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


@dataclass(frozen=True, eq=False)
class StandardParameters:
    """Standard parameters (c,) in the order of `Model.columns`, and their standard deviations (c,).

    A deviation is infinite where neither data nor prior determine the parameter: its value is then one choice of many.
    """

    values: FloatArray
    standard_deviations: FloatArray

    def to_inertias(self, model: Model) -> FloatArray:
        """Return the inertial parameters (n, 10) of the links, in the order of `INERTIAL_NAMES`.

        They are zero where a link is left out.

        Parameters
        ----------
        model : Model
            The one that the values belong to.
        """
        inertias = np.zeros((model.robot.tree.n, 10))
        for body in find_bodies(model.columns):
            if body.link:
                inertias[model.robot.tree.joint_names.index(body.link)] = self.values[body.columns]
        return inertias
