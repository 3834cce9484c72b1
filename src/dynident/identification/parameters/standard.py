"""Standard parameters of an identified model with their uncertainty: more than the data alone determine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.parameters.bodies import find_bodies
from dynident.regressors.model import Model


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
