"""Predict torque with its interval, and gravity, mass matrix, Coriolis matrix and friction at given states.

Refuses what a state does not determine (friction that depends on temperature, for example).

Gravity, mass matrix and Coriolis matrix are evaluations of the observation matrix, whose torque is linear in the base
parameters: no link needs a mass of its own, which the torque does not determine.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.effects import LINKS, get_effect
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.identification.identified_models.identification_result import Estimate
from dynident.regressors.observation_matrix import NOTHING_FURTHER, FurtherSignals, Observation


@dataclass(frozen=True, eq=False)
class PredictedTorque:
    """Torque of a motion, and how sure it is.

    The intervals hold where the model does: what it lacks is in neither, outside the motion that it was identified
    from.

    Parameters
    ----------
    torque : (m, n)
        Predicted torque in N m or N. NaN, as all of the interval, for a joint whose torque was not recorded: the model
        has no equation of it.
    se_mean : (m, n)
        Standard deviation of the model's own torque √(w C wᵀ), from the covariance C of the parameters.
    mean_half_width : (m, n)
        Half-width of the interval of the model's own torque: the standard deviation times a quantile of Student's t,
        with the median of the parameters' degrees of freedom.
    half_width : (m, n)
        Half-width of the interval of what would be measured, behind the filters of the identification: the root of the
        sum of squares of `mean_half_width` and of the noise of the joint's residual times its own quantile.
    level : float
        Probability of the intervals.
    """

    torque: FloatArray
    se_mean: FloatArray
    mean_half_width: FloatArray
    half_width: FloatArray
    level: float

    @property
    def lower(self) -> FloatArray:
        """Lower end of the interval of what would be measured, N m or N."""
        return np.asarray(self.torque - self.half_width)

    @property
    def upper(self) -> FloatArray:
        """Upper end of the interval of what would be measured, N m or N."""
        return np.asarray(self.torque + self.half_width)

    def __repr__(self) -> str:
        return (
            f"PredictedTorque(shape {self.torque.shape}; .torque, .lower and .upper: {100 * self.level:.4g} % interval "
            "of what would be measured; .mean_half_width and .se_mean: of the model's own torque)"
        )


def predict(
    estimate: Estimate,
    q: FloatArray,
    dq: FloatArray,
    ddq: FloatArray,
    *,
    level: float = 0.95,
    t: FloatArray | None = None,
    is_steady: bool = False,
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
    t : (m,), optional
        Times of the samples in s, counted from the start of the session. With them the derivatives of the acceleration
        are formed, which some effects depend on.
    is_steady : bool
        Whether each sample stands for itself, with hysteresis that slides steadily in the direction of its velocity.

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
    _check_effects(estimate, has_time=t is not None)
    if is_steady:
        memory = observation.compute_sliding_states(dq)
    else:
        # Hysteresis starts from its initial state and is carried along the path, so the order of the rows counts.
        memory = MemoryStates(observation.memory).push(observation.robot.positions(q))
    entries = observation.evaluate(
        q,
        dq,
        ddq,
        reference=estimate.reference,
        memory=memory,
        further=NOTHING_FURTHER if t is None else differentiate_acceleration(ddq, t),
    )
    torque = observation.compute_torque(entries, estimate.values)
    deviation = compute_prediction_deviation(observation, entries, estimate.statistics.covariance)
    quantile, of_noise = estimate.statistics.prediction_quantiles(level)
    mean = quantile * deviation
    has_torque = observation.robot.has_torque
    wide = np.hypot(mean, of_noise * estimate.noise)
    torque, deviation, mean, wide = (np.where(has_torque, part, np.nan) for part in (torque, deviation, mean, wide))
    return PredictedTorque(torque, deviation, mean, wide, level)


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
        if values.ndim != 2 or values.shape != (len(motion[0]), n) or not len(values):
            raise DynidentError(
                f"{name} has the shape {values.shape}; all three must have the shape (samples, {n}), with one sample "
                "or more",
                pointer=f"/{name}",
            )
        if not np.isfinite(values).all():
            raise DynidentError(f"{name} contains a value that is not finite", pointer=f"/{name}")
    if not 0 < level < 1:
        raise DynidentError(f"level is {level}; give a probability between 0 and 1, usually 0.95", pointer="/level")


def _check_effects(estimate: Estimate, *, has_time: bool) -> None:
    signals = estimate.model.signals
    for column in estimate.model.kept if not has_time else ():
        # Derivatives of the acceleration, and the period, are not among the arguments.
        if ca.depends_on(column.torque, ca.vertcat(signals.dddq, signals.ddddq, signals.period)):
            raise DynidentError(
                f"{column.effect} depends on derivatives of the acceleration or on the sampling period; give the times "
                "of the samples as well, or export the model (JSON, C code, CasADi): the export takes these as "
                "arguments",
                pointer="/effects",
            )
    for choice in estimate.model.effects:
        effect = get_effect(choice.effect)
        without_time = effect.needs_session and not has_time
        if effect.needs_temperature or without_time or choice.runs or effect.in_some_runs:
            raise DynidentError(
                f"{choice.effect} depends on more than the motion (time of the session, temperature or run); compare "
                "the model with a recording instead, because a recording contains them",
                pointer="/effects",
            )


def differentiate_acceleration(ddq: FloatArray, t: FloatArray) -> FurtherSignals:
    """Return what effects may depend on besides q, dq and ddq: time, period, and derivatives by central differences.

    Parameters
    ----------
    ddq : (m, n)
        Accelerations in rad/s² or m/s².
    t : (m,)
        Times in s, increasing.

    Returns
    -------
    FurtherSignals
        Without temperature and runs.
    """
    if len(t) < 2:
        return FurtherSignals(time=t)
    dddq = np.gradient(ddq, t, axis=0)
    return FurtherSignals(dddq=dddq, ddddq=np.gradient(dddq, t, axis=0), time=t, period=float(np.median(np.diff(t))))


def compute_gravity(estimate: Estimate, q: FloatArray) -> FloatArray:
    """Return the torque that holds the links at rest.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.
    q : (m, n)
        Positions, rad or m.

    Returns
    -------
    (m, n)
        Torque in N m, force in N.
    """
    rest = np.zeros_like(q)
    return _evaluate_inertia(estimate, q, rest, rest)


def compute_mass_matrix(estimate: Estimate, q: FloatArray) -> FloatArray:
    """Return the mass matrix of links and rotors.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.
    q : (m, n)
        Positions, rad or m.

    Returns
    -------
    (m, n, n)
        In kg m², kg m or kg.
    """
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
                "friction is not a function of position and velocity",
                pointer="/effects",
            )
    entries = observation.evaluate(
        q, dq, ddq, reference=estimate.reference, memory=observation.compute_sliding_states(dq)
    )
    return observation.compute_torque(entries, np.where(is_friction, estimate.values, 0.0))


def check_simulated(estimate: Estimate, mass: FloatArray) -> None:
    """Raise where a model gives no acceleration, with what helps.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.
    mass : (m, n, n)
        Its mass matrices.

    Raises
    ------
    DynidentError
        Where the torque of a joint was not recorded, or a mass matrix is not positive definite.
    """
    silent = estimate.model.robot.names_without_torque
    if silent:
        reason = f"the torque of {silent} was not recorded, so its friction is not known; record that of every joint"
    elif (np.linalg.eigvalsh(mass) > 0.0).all():
        return
    elif estimate.model.is_at_rest:
        reason = "the model is one of poses at rest, which show no inertia; identify from a motion"
    elif not any(choice.effect == LINKS.effect for choice in estimate.model.effects):
        reason = f"the model has no inertia of the links; identify with the effect {LINKS.effect}"
    else:
        reason = 'the mass matrix of this model is not positive definite here; identify with estimator="feasible"'
    raise DynidentError(reason, pointer="q", title="No forward dynamics")


def _evaluate_inertia(estimate: Estimate, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    observation = estimate.model.observation
    entries = observation.evaluate(
        q, dq, ddq, reference=estimate.reference, memory=np.zeros((len(q), observation.n_memory))
    )
    return observation.compute_torque(entries, np.where(_find_inertial(estimate), estimate.values, 0.0))


def _find_inertial(estimate: Estimate) -> NDArray[np.bool_]:
    return np.array([get_effect(column.effect).is_inertia for column in estimate.model.kept], dtype=bool)
