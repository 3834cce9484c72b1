"""Test whether the inertia matrix of an identified model is positive definite (§12.7)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters, get_effect
from dynident.regressors.model import Model
from dynident.regressors.observation import Observation
from dynident.robot.model import Robot

_POSTURES = 400


def compute_smallest_inertia_eigenvalue(
    model: Model, values: FloatArray, *, seed: int = 0, postures: FloatArray | None = None
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
    seed : int
        Of the random postures.
    postures : (m, n), optional
        Look at these instead.

    Returns
    -------
    float
        Not a number for a model without inertial parameters.
    """
    n = model.robot.n
    inertial = [k for k, c in enumerate(model.kept) if get_effect(c.effect).is_inertia]
    if not inertial:
        return float("nan")
    # Models that extend one another have their inertial columns in common.
    observation = model.observation
    while observation.parts is not None and inertial[-1] < observation.parts[0].n_columns:
        observation = observation.parts[0]
    inertial_values = np.zeros(observation.n_columns)
    inertial_values[inertial] = values[inertial]
    entries = (
        _evaluate_random_postures(observation, seed)
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
def _evaluate_random_postures(observation: Observation, seed: int) -> FloatArray:
    return _evaluate_unit_accelerations(observation, draw_postures(observation.robot, _POSTURES, seed))


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
