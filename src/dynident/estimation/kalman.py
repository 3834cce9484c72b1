"""An extended Kalman filter whose state holds the parameters beside the motion (§12.8), a sample at a time.

State [q, v, χ], positions measured, torque the input, χ a constant that may wander a little. Positions and velocities
are staggered by half a period T (leapfrog): with v half a period before q, the new velocity v' solves

    Γ(q, (v + v') / 2, (v' - v) / T; χ) = τ,    Γ = W χ,    and q' = q + T v',

so that velocity and acceleration are the central differences of [12.16]. It is of second order, stable however stiff
friction is near rest, and every torque sample enters one step alone: its noise stays white, which the filter takes it
for (noise that is not biases its parameters, Ljung 1979). By the theorem of implicit functions the Jacobians need those
of Γ alone, ∂Γ/∂χ being W itself.
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

    def begin(self, before: FloatArray, q: FloatArray, tau: FloatArray) -> None:
        """Begin an unbroken stretch at its second sample q, tau (n,), `before` being the position of the first."""
        n = self._n
        self.state[:n], self.state[n : 2 * n] = q, (q - before) / self._period
        self.covariance[: 2 * n] = 0.0
        self.covariance[:, : 2 * n] = 0.0
        self.covariance[range(2 * n), range(2 * n)] = (
            np.concatenate([self._noise.position, np.sqrt(2.0) * self._noise.position / self._period]) ** 2
        )
        # The velocity rests on the position of this sample too.
        shared = self._noise.position**2 / self._period
        self.covariance[range(n), range(n, 2 * n)] = self.covariance[range(n, 2 * n), range(n)] = shared
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
        self._predict(self._torque)
        self._torque = np.array(tau)
        return self._correct(q)

    def _predict(self, tau: FloatArray) -> None:
        """The motion one period on, and its Jacobian."""
        n, period = self._n, self._period
        q, velocity, values = self.state[:n], self.state[n : 2 * n], self.state[2 * n :]
        after = velocity + period * self._acceleration
        for _ in range(_NEWTON):
            mean, acceleration = 0.5 * (velocity + after), (after - velocity) / period
            slopes = self._model(q, mean, acceleration, values)
            slope = 0.5 * slopes.by_velocity + slopes.by_acceleration / period
            change = _solved(slope, tau - slopes.torque)
            after = after + change
            if np.abs(change).max() <= _CLOSE * (1.0 + np.abs(after).max()):
                break
        size = len(self.state)
        # ∂v'/∂(q, v, χ, τ) from ∂Γ = 0.
        backward = 0.5 * slopes.by_velocity - slopes.by_acceleration / period
        by_state = np.hstack([slopes.by_position, backward, slopes.by_parameters])
        rates = -_solved(slope, by_state)
        by_torque = _solved(slope, np.diag(self._noise.torque))
        rows = np.empty((2 * n, size))
        rows[n:] = rates
        rows[:n] = period * rates
        rows[:n, :n] += np.eye(n)
        shaken = np.vstack([period * by_torque, by_torque])
        moved = rows @ self.covariance
        cross = moved[:, 2 * n :]
        self.covariance[: 2 * n, : 2 * n] = moved @ rows.T + shaken @ shaken.T
        self.covariance[: 2 * n, 2 * n :] = cross
        self.covariance[2 * n :, : 2 * n] = cross.T
        parameters = range(2 * n, size)
        self.covariance[parameters, parameters] += self._noise.wander**2 * period
        self.state[:n] = q + period * after
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


def _solved(slope: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(slope, right))
    except np.linalg.LinAlgError:
        raise EstimationError("the equation of motion has become singular") from None
