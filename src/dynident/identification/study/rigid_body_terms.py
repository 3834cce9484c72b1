"""Gravity, mass matrix, Coriolis matrix and friction of an identified model, as functions of the state.

All of them are evaluations of the observation matrix, whose torque is linear in the base parameters: no link needs a
mass of its own, which the torque does not determine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.effects import get_effect
from dynident.errors import DynidentError
from dynident.identification.study.result import Estimate


def compute_gravity(estimate: Estimate, q: FloatArray) -> FloatArray:
    """Return the torque (m, n) that holds the links at positions q (m, n), in N m or N."""
    rest = np.zeros_like(q)
    return _evaluate_inertia(estimate, q, rest, rest)


def compute_mass_matrix(estimate: Estimate, q: FloatArray) -> FloatArray:
    """Return the mass matrix (m, n, n) of links and rotors at positions q (m, n), in kg m², kg m or kg."""
    n = q.shape[1]
    rest = np.zeros_like(q)
    gravity = _evaluate_inertia(estimate, q, rest, rest)
    # Column by column: the torque of a unit acceleration of one joint, without that of gravity.
    columns = [_evaluate_inertia(estimate, q, rest, rest + unit) - gravity for unit in np.eye(n)]
    return np.stack(columns, axis=-1)


def compute_coriolis_matrix(estimate: Estimate, q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the Coriolis matrix C (m, n, n) by Christoffel symbols; C q̇ is the Coriolis and centrifugal torque.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.
    q, dq : (m, n)
        Positions and velocities, in rad or m and s.

    Returns
    -------
    (m, n, n) array
        With it the rate of the mass matrix minus 2 C is skew-symmetric.
    """
    n = q.shape[1]
    rest = np.zeros_like(q)
    gravity = _evaluate_inertia(estimate, q, rest, rest)

    def compute_torque(velocity: FloatArray) -> FloatArray:
        return _evaluate_inertia(estimate, q, velocity, rest) - gravity

    # The torque h is quadratic in the velocity, and its symmetric bilinear form has the Christoffel symbols as
    # coefficients. Column k of C is that form of q̇ and the unit vector e_k: (h(q̇ + e_k) - h(q̇) - h(e_k)) / 2.
    torque = compute_torque(dq)
    columns = [(compute_torque(dq + unit) - torque - compute_torque(rest + unit)) / 2.0 for unit in np.eye(n)]
    return np.stack(columns, axis=-1)


def compute_friction(estimate: Estimate, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Return the torque (m, n) of the effects that are friction; hysteresis slides steadily.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations, in rad or m and s.

    Returns
    -------
    (m, n) array
        Torques in N m, or forces in N.

    Raises
    ------
    DynidentError
        For friction that depends on temperature, on the time of the session or on the run.
    """
    observation = estimate.model.observation
    is_friction = np.array([get_effect(column.effect).is_friction for column in observation.columns], dtype=bool)
    for choice in estimate.model.effects:
        effect = get_effect(choice.effect)
        if effect.is_friction and (effect.needs_temperature or effect.needs_session or choice.runs):
            raise DynidentError(
                f"{choice.effect} depends on more than the motion (time of the session, temperature or run): its "
                "friction is no function of position and velocity",
                pointer="/effects",
            )
    entries = observation.evaluate(
        q, dq, ddq, reference=estimate.reference, memory=observation.compute_sliding_states(dq)
    )
    return observation.compute_torque(entries, np.where(is_friction, estimate.values, 0.0))


def _evaluate_inertia(estimate: Estimate, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    observation = estimate.model.observation
    entries = observation.evaluate(
        q, dq, ddq, reference=estimate.reference, memory=np.zeros((len(q), observation.n_memory))
    )
    return observation.compute_torque(entries, np.where(_find_inertial(estimate), estimate.values, 0.0))


def _find_inertial(estimate: Estimate) -> NDArray[np.bool_]:
    return np.array([get_effect(column.effect).is_inertia for column in estimate.model.kept], dtype=bool)
