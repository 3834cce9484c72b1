"""An extended Kalman filter whose state holds the parameters beside the motion (§12.8), a sample at a time.

State [q, q̇, χ], positions measured, torque the input, χ a constant that may wander a little. One step of the motion is
the implicit midpoint rule: with q' = q + T (q̇ + q̇') / 2 the new velocity solves

    Γ(q_m, q̇_m, (q̇' - q̇) / T; χ) = τ_m,    Γ = W χ,

at the middle of the step. It is of second order, and stable however stiff friction is near rest; by the theorem of
implicit functions its Jacobians need those of Γ alone, ∂Γ/∂χ being W itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.estimation.factors import FloatArray
from dynident.estimation.least_squares import EstimationError

_NEWTON = 8
_CLOSE = 1e-10


@dataclass(frozen=True, eq=False)
class TorqueSlopes:
    """Γ (n,) and its derivatives by q, q̇, q̈ (n, n each) and by χ: W (n, c)."""

    torque: FloatArray
    by_position: FloatArray
    by_velocity: FloatArray
    by_acceleration: FloatArray
    by_parameters: FloatArray


class TorqueModel(Protocol):
    """Torque, linear in its parameters, of a motion."""

    def __call__(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, values: FloatArray) -> TorqueSlopes:
        """Evaluate at one state q, dq, ddq (n,) with parameters χ (c,)."""
        ...


@dataclass(frozen=True, eq=False)
class KalmanNoise:
    """What the filter takes for noise, all white.

    `position` (n,), `torque` (n,): standard deviations of a sample; `wander` (c,): of χ over a second.
    """

    position: FloatArray
    torque: FloatArray
    wander: FloatArray


class KalmanFilter:
    """Estimates of χ that follow the samples as they come.

    Parameters
    ----------
    model : TorqueModel
    period : float
        Sampling period T, s.
    noise : KalmanNoise
    values, covariance : (c,), (c, c)
        What is known of χ beforehand.
    """

    def __init__(
        self, model: TorqueModel, period: float, noise: KalmanNoise, values: FloatArray, covariance: FloatArray
    ) -> None:
        self._model = model
        self._period = period
        self._noise = noise
        self._n = len(noise.position)
        n, c = self._n, len(values)
        self.state = np.concatenate([np.zeros(2 * n), values])
        self.covariance = np.zeros((2 * n + c, 2 * n + c))
        self.covariance[2 * n :, 2 * n :] = covariance
        self._torque: FloatArray | None = None
        self._acceleration = np.zeros(n)

    @property
    def values(self) -> FloatArray:
        """χ (c,) as far as the samples go."""
        return np.asarray(self.state[2 * self._n :])

    @property
    def values_covariance(self) -> FloatArray:
        """(c, c): of the error of χ, if the noise is what it was taken for."""
        return np.asarray(self.covariance[2 * self._n :, 2 * self._n :])

    def begin(self, q: FloatArray, dq: FloatArray, tau: FloatArray, velocity_deviation: FloatArray) -> None:
        """Begin an unbroken stretch at its first sample; velocities (n,) known to so much. χ is kept."""
        n = self._n
        self.state[:n], self.state[n : 2 * n] = q, dq
        self.covariance[: 2 * n] = 0.0
        self.covariance[:, : 2 * n] = 0.0
        self.covariance[range(2 * n), range(2 * n)] = np.concatenate([self._noise.position, velocity_deviation]) ** 2
        self._torque = np.array(tau)
        self._acceleration = np.zeros(n)

    def step(self, q: FloatArray, tau: FloatArray) -> FloatArray:
        """Take the next sample: position and torque (n,); gives the innovation (n,) in its standard deviations.

        Raises
        ------
        EstimationError
            Where the equation of motion has no solution any more.
        """
        if self._torque is None:
            raise ValueError("begin a stretch before its second sample")
        self._predict(0.5 * (self._torque + tau))
        self._torque = np.array(tau)
        return self._correct(q)

    def _predict(self, tau: FloatArray) -> None:
        """The motion one period on, and its Jacobian."""
        n, period = self._n, self._period
        q, velocity, values = self.state[:n], self.state[n : 2 * n], self.state[2 * n :]
        after = velocity + period * self._acceleration
        for _ in range(_NEWTON):
            slopes = self._model(*_middle(q, velocity, after, period), values)
            inner = slopes.by_position * (0.25 * period) + 0.5 * slopes.by_velocity
            slope = inner + slopes.by_acceleration / period
            change = _solved(slope, tau - slopes.torque)
            after = after + change
            if np.abs(change).max() <= _CLOSE * (1.0 + np.abs(after).max()):
                break
        size = len(self.state)
        # ∂q̇'/∂(q, q̇, χ, τ) from ∂Γ = 0.
        by_state = np.hstack([slopes.by_position, inner - slopes.by_acceleration / period, slopes.by_parameters])
        rates = -_solved(slope, by_state)
        by_torque = _solved(slope, np.diag(self._noise.torque))
        rows = np.empty((2 * n, size))
        rows[n:] = rates
        rows[:n] = 0.5 * period * rates
        rows[:n, :n] += np.eye(n)
        rows[:n, n : 2 * n] += 0.5 * period * np.eye(n)
        shaken = np.vstack([0.5 * period * by_torque, by_torque])
        moved = rows @ self.covariance
        cross = moved[:, 2 * n :]
        self.covariance[: 2 * n, : 2 * n] = moved @ rows.T + shaken @ shaken.T
        self.covariance[: 2 * n, 2 * n :] = cross
        self.covariance[2 * n :, : 2 * n] = cross.T
        parameters = range(2 * n, size)
        self.covariance[parameters, parameters] += self._noise.wander**2 * period
        self.state[:n] = q + 0.5 * period * (velocity + after)
        self._acceleration = (after - velocity) / period
        self.state[n : 2 * n] = after

    def _correct(self, q: FloatArray) -> FloatArray:
        """The measured position; the covariance kept symmetric."""
        n = self._n
        spread = self.covariance[:n, :n] + np.diag(self._noise.position**2)
        innovation = q - self.state[:n]
        if not (np.isfinite(innovation).all() and np.isfinite(spread).all()):
            raise EstimationError("the state is not finite any more")
        gain = np.linalg.solve(spread, self.covariance[:n]).T
        self.state = self.state + gain @ innovation
        self.covariance = self.covariance - gain @ self.covariance[:n]
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        return np.asarray(innovation / np.sqrt(np.diag(spread)))


def _middle(
    q: FloatArray, velocity: FloatArray, after: FloatArray, period: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    mean = 0.5 * (velocity + after)
    return q + 0.5 * period * mean, mean, (after - velocity) / period


def _solved(slope: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(slope, right))
    except np.linalg.LinAlgError:
        raise EstimationError("the equation of motion has become singular") from None
