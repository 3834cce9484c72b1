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
    """A rigid body of the model.

    Parameters
    ----------
    name : str
        Name of the link or payload.
    link : str
        Joint that moves it; "" for what a link carries.
    columns : (10,)
        Numbers of its parameters, in the order of `INERTIAL_NAMES`.
    """

    name: str
    link: str
    columns: IndexArray


def find_bodies(columns: Sequence[Column]) -> tuple[Body, ...]:
    """Return the bodies among a model's columns; a body that is not there whole cannot be judged and is left out.

    Parameters
    ----------
    columns : sequence of Column
        Columns of a model, before they are grouped to base parameters.

    Returns
    -------
    tuple of Body
        Links first met first, payloads among them.
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
    """Standard parameters of a model.

    Parameters
    ----------
    values : (c,)
        The parameters in the order of `Model.columns`, each in its unit.
    standard_deviations : (c,)
        Their standard deviations. One is infinite where neither data nor prior determine the parameter: its value is
        then one choice of many.
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

        Returns
        -------
        array (n, 10)
            In kg m², kg m and kg.
        """
        inertias = np.zeros((model.robot.tree.n, 10))
        for body in find_bodies(model.columns):
            if body.link:
                inertias[model.robot.tree.joint_names.index(body.link)] = self.values[body.columns]
        return inertias
