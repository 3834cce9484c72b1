"""Standard parameters of a model's links with uncertainty, and the smallest eigenvalue of its inertia matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Column, ReferenceParameters, Role, get_effect, get_role
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import Observation
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

_POSTURES = 400


def compute_smallest_inertia_eigenvalue(
    model: Model, values: FloatArray, *, postures: FloatArray | None = None
) -> float:
    """Return the smallest eigenvalue of A(q), scaled to a unit diagonal, over random postures.

    The postures are within the joints' limits. A value above zero is no proof for postures in between; one below zero
    proves that the model is not physical.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    values : (b,)
        Base parameters.
    postures : (m, n), optional
        Look at these instead.

    Returns
    -------
    float
        Not a number for a model without inertial parameters, and with contacts: the projected equations of a robot
        whose feet stand hold the mass matrix only in part.
    """
    n = model.robot.n
    inertial = [k for k, c in enumerate(model.kept) if get_effect(c.effect).is_inertia]
    if not inertial or model.robot.contacts:
        return float("nan")
    # Models that extend one another have their inertial columns in common.
    observation = model.observation
    while observation.parts is not None and inertial[-1] < observation.parts[0].n_columns:
        observation = observation.parts[0]
    inertial_values = np.zeros(observation.n_columns)
    inertial_values[inertial] = values[inertial]
    entries = (
        _evaluate_random_postures(observation)
        if postures is None
        else _evaluate_unit_accelerations(observation, postures)
    )
    torque = observation.compute_torque(entries, inertial_values)
    matrix = torque.reshape(n, -1, n).transpose(1, 2, 0)
    # Column j of A(q) is the torque for a unit acceleration of joint j. The mean with the transpose removes rounding.
    matrix = 0.5 * (matrix + matrix.transpose(0, 2, 1))
    diagonal = np.diagonal(matrix, axis1=1, axis2=2)
    # A diagonal entry below zero proves it already, and has no root to scale by.
    if np.any(diagonal <= 0):
        return float(diagonal.min())
    # A wrist's inertia is a thousandth of a shoulder's. Scaled to a unit diagonal, an impossible wrist shows as well.
    scale = 1.0 / np.sqrt(diagonal)
    return float(np.linalg.eigvalsh(matrix * scale[:, :, None] * scale[:, None, :]).min())


def draw_postures(robot: Robot, count: int, seed: int) -> FloatArray:
    """Draw postures (count, n) evenly from the joints' range.

    Parameters
    ----------
    robot : Robot
        The robot.
    count : int
        Number of postures.
    seed : int
        Of the random numbers.
    """
    return np.asarray(np.random.default_rng(seed).uniform(*get_joint_range(robot), (count, robot.n)))


def get_joint_range(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper ends (n,) of the joints' range: a full turn, or ± 1 m, where no limits are known."""
    ends = []
    for joint in robot.joints:
        turning = joint.kind == "revolute"
        low, high = joint.reach or ((-np.pi, np.pi) if turning else (-1.0, 1.0))
        # More than a turn to either side is the same posture again, and limits may be placeholders.
        ends.append((max(low, -2 * np.pi), min(high, 2 * np.pi)) if turning else (low, high))
    low, high = np.array(ends, dtype=np.float64).T
    return low, high


@lru_cache(maxsize=4)
def _evaluate_random_postures(observation: Observation) -> FloatArray:
    return _evaluate_unit_accelerations(observation, draw_postures(observation.robot, _POSTURES, 0))


def _evaluate_unit_accelerations(observation: Observation, q: FloatArray) -> FloatArray:
    """Return entries (n · postures, k) of W for a unit acceleration of each joint in turn, less those at rest."""
    n = observation.robot.n
    accelerations = np.repeat(np.vstack([np.zeros(n), np.eye(n)]), len(q), axis=0)
    entries = observation.evaluate(
        np.tile(q, (n + 1, 1)),
        np.zeros_like(accelerations),
        accelerations,
        reference=ReferenceParameters.massless(observation.robot),
        memory=np.zeros((len(accelerations), observation.n_memory)),
    ).reshape(n + 1, len(q), -1)
    # What does not depend on acceleration cancels.
    return np.asarray((entries[1:] - entries[0]).reshape(n * len(q), -1))


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
