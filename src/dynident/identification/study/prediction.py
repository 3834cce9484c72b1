"""Predict the torque of an identified model, with its interval."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import get_effect
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.identification.study.result import Estimate
from dynident.regressors.observation import Observation


@dataclass(frozen=True, eq=False)
class PredictedTorque:
    """Torque of a motion, and how sure it is.

    The intervals hold where the model does: what it lacks is in neither, outside the motion that it was identified
    from.

    Parameters
    ----------
    torque : (m, n)
        Predicted torque in N m or N.
    mean_half_width : (m, n)
        Half-width of the interval of the model's own torque, from the covariance of the parameters.
    half_width : (m, n)
        Half-width of the interval of what would be measured, behind the filters of the identification: the residual
        noise comes on top.
    level : float
        Probability of the intervals.
    """

    torque: FloatArray
    mean_half_width: FloatArray
    half_width: FloatArray
    level: float


def predict(
    estimate: Estimate, q: FloatArray, dq: FloatArray, ddq: FloatArray, *, level: float = 0.95
) -> PredictedTorque:
    """Predict torque along a motion, in its order: hysteresis remembers the path.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations, in rad or m and s.
    level : float
        Probability of the intervals.

    Returns
    -------
    PredictedTorque
        The torque with its intervals.

    Raises
    ------
    DynidentError
        For arrays that do not fit, a level outside (0, 1), or effects that depend on more than the motion.
    """
    observation = estimate.model.observation
    _check_inputs(estimate, (q, dq, ddq), level)
    entries = observation.evaluate(
        q,
        dq,
        ddq,
        reference=estimate.reference,
        # Hysteresis starts from its initial state and is carried along the path, so the order of the rows counts.
        memory=MemoryStates(observation.memory).push(observation.robot.positions(q)),
    )
    torque = observation.compute_torque(entries, estimate.values)
    deviation = compute_prediction_deviation(observation, entries, estimate.statistics.covariance)
    quantile, of_noise = estimate.statistics.prediction_quantiles(level)
    mean = quantile * deviation
    return PredictedTorque(torque, mean, np.hypot(mean, of_noise * estimate.noise), level)


def compute_prediction_deviation(observation: Observation, entries: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the standard deviation (m, n) of predicted torque that the uncertainty of parameters causes.

    Parameters
    ----------
    observation : Observation
        The model's entries of W, and where they stand.
    entries : (m, k)
        As an evaluation of the observation matrix gives them, filtered or not.
    covariance : (b, b)
        Of the parameters.

    Returns
    -------
    array (m, n)
        Standard deviations in N m or N.
    """
    deviation = np.empty((len(entries), observation.robot.n))
    for joint in range(observation.robot.n):
        positions, columns = observation.joint_entries(joint)
        row = entries[:, positions]
        variance = np.einsum("ij,jk,ik->i", row, covariance[np.ix_(columns, columns)], row, optimize=True)
        # Rounding may take a variance that is nearly zero below it.
        deviation[:, joint] = np.sqrt(np.maximum(variance, 0.0))
    return deviation


def _check_inputs(estimate: Estimate, motion: tuple[FloatArray, FloatArray, FloatArray], level: float) -> None:
    n = estimate.model.robot.n
    for name, values in zip(("q", "dq", "ddq"), motion, strict=True):
        if values.ndim != 2 or values.shape != (len(motion[0]), n):
            raise DynidentError(
                f"{name} has the shape {values.shape}; all three must have the shape (samples, {n})", pointer=f"/{name}"
            )
        if not np.isfinite(values).all():
            raise DynidentError(f"{name} contains a value that is not finite", pointer=f"/{name}")
    if not 0 < level < 1:
        raise DynidentError(f"level is {level}; give a probability between 0 and 1, usually 0.95", pointer="/level")
    signals = estimate.model.signals
    for column in estimate.model.kept:
        # Derivatives of the acceleration, and the period, are not among the arguments.
        if ca.depends_on(column.torque, ca.vertcat(signals.dddq, signals.ddddq, signals.period)):
            raise DynidentError(
                f"{column.effect} depends on derivatives of the acceleration or on the sampling period; compare the "
                "model with a recording instead, or export it (JSON, C code, CasADi): the export takes these as "
                "arguments",
                pointer="/effects",
            )
    for choice in estimate.model.effects:
        effect = get_effect(choice.effect)
        if effect.needs_temperature or effect.needs_session or choice.runs or effect.in_some_runs:
            raise DynidentError(
                f"{choice.effect} depends on more than the motion (time of the session, temperature or run); compare "
                "the model with a recording instead, because a recording contains them",
                pointer="/effects",
            )
