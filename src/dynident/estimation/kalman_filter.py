"""One extended Kalman filter over motion and parameters (§12.8): its state, steps and noise.

How it is used to identify a robot is in identification/estimators/kalman.py.

The state is [q, v, χ], χ constant. The motion is driven by its acceleration a, which is known roughly; the position and
the torque are measured. Positions and velocities are staggered by half a period T (leapfrog): with v half a period
before q, a sample makes

    v' = v + T a,    q' = q + T v',    τ = Γ(q, v + T a / 2, a; χ) + noise,    Γ = W χ,

so that velocity and acceleration are the central differences of [12.16], and every torque sample enters a single step:
its noise stays white, as the filter assumes. Predicting the acceleration from the torque instead gives the same
filter where a is not known at all, but needs the inverse of an inertia matrix that is still being estimated, and takes
W at an acceleration that holds the noise of the torque: that biases the parameters (Ljung 1979). Here W is taken at the
rough acceleration, which is free of that noise.

Motion and parameters are kept separate (the two-stage filter of Friedland 1969, with the same estimates as the joint
state): an error of χ enters the estimate of the motion linearly. So every sample gives linear equations of χ
with white noise of size one, and the estimate is their least-squares solution, with the prior knowledge at the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import solve_triangular

from dynident.array_types import FloatArray
from dynident.estimation.least_squares import EstimationError, build_weighted_factor
from dynident.estimation.parameter_covariance import Statistics, compute_row_freedom
from dynident.estimation.prior_information import PriorInformation
from dynident.estimation.triangular_factors import Reduction


def compute_recursive_statistics(rows: Reduction, values: FloatArray, start: PriorInformation) -> Statistics:
    """Return the statistics of parameters χ (c,) that are the least-squares solution of `rows` and `start` together.

    Parameters
    ----------
    rows : Reduction
        Equations whose noise is of size one, if it is as assumed.
    values : (c,)
        Parameters χ.
    start : PriorInformation
        Prior knowledge, taken at its word.

    Returns
    -------
    Statistics
        Covariance with correlated residuals taken into account; `noise` is relative to the assumed one.

    Notes
    -----
    With B the inverse of all information and A_s, g_s = W_sᵀρ_s that of block s of one equation and its score,
    independent residuals of variance σ² have Σ g_sᵀ B g_s = σ² Σ [tr(B A_s) - tr((B A_s)²)]: the ratio is the variance
    that the equation counts with, at least that of its residual.
    """
    factor = build_weighted_factor(rows, np.ones(len(rows.equations)), start)[:-1, :-1]
    inverse = solve_triangular(factor, np.eye(rows.n_columns))
    known = start.factor @ inverse
    meat = known.T @ known
    effective, noise = np.zeros(len(rows.equations)), np.zeros(len(rows.equations))
    for j, equation in enumerate(rows.equations):
        w = equation.factors[:, :, :-1]
        rests = equation.factors[:, :, -1] - w @ values[equation.columns]
        w = w @ inverse[equation.columns]
        information = w.transpose(0, 2, 1) @ w
        scores = (rests[:, None, :] @ w)[:, 0]
        count = float(equation.counts.sum())
        variance = float(np.sum(rests * rests)) / max(count, 1.0)
        expected = float(np.trace(information, axis1=1, axis2=2).sum() - np.sum(information * information))
        # Correlated residuals make the score larger than independent ones would. Smaller is chance and is not used.
        counted = max(variance, float(np.sum(scores * scores)) / expected if expected > 0 else 0.0)
        meat += counted * information.sum(axis=0)
        effective[j] = count * variance / counted if counted > 0 else count
        noise[j] = np.sqrt(variance)
    covariance = inverse @ meat @ inverse.T
    return Statistics(
        0.5 * (covariance + covariance.T), effective, noise, compute_row_freedom(effective, rows.n_columns)
    )


@dataclass(frozen=True, eq=False)
class TorqueSlopes:
    """Torque at one state, with its derivatives.

    Parameters
    ----------
    torque : (n,)
        Γ, N m or N.
    by_position, by_velocity, by_acceleration : (n, n)
        Derivatives of Γ by q, q̇ and q̈.
    by_parameters : (n, c)
        Derivative by χ: the rows of W.
    """

    torque: FloatArray
    by_position: FloatArray
    by_velocity: FloatArray
    by_acceleration: FloatArray
    by_parameters: FloatArray


class TorqueModel(Protocol):
    """Torque of a motion, linear in its parameters."""

    def __call__(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, values: FloatArray) -> TorqueSlopes:
        """Evaluate at one state q, dq, ddq (n,) with parameters χ (c,)."""
        ...


@dataclass(frozen=True, eq=False)
class KalmanNoise:
    """Noise of one sample as the filter assumes it, all white.

    Parameters
    ----------
    position, torque : (n,)
        Standard deviations of the measurements.
    acceleration : (n,)
        Standard deviation of the rough acceleration: above its true error, lest it count as a measurement.
    """

    position: FloatArray
    torque: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True, eq=False)
class KalmanSample:
    """What one sample tells about χ.

    Parameters
    ----------
    rows : (2 n, c + 1)
        Rows of [W | Y] with white noise of size one if it is as assumed: first those of the torques, then the
        positions.
    surprise : float
        Mean square of the innovation over the equations, in units of what the filter expected; one where the assumed
        noise is right.
    """

    rows: FloatArray
    surprise: float


class KalmanFilter:
    """Estimates χ recursively, sample by sample.

    Parameters
    ----------
    model : TorqueModel
        Torque of a motion, with its derivatives.
    period : float
        Sampling period T, s.
    noise : KalmanNoise
        Standard deviations of measurements and of the rough acceleration.
    values, covariance : (c,), (c, c)
        Prior estimate of χ.
    """

    def __init__(
        self, model: TorqueModel, period: float, noise: KalmanNoise, values: FloatArray, covariance: FloatArray
    ) -> None:
        n = self._n = len(noise.position)
        self._model = model
        self._period = period
        self._noise = noise
        self.values = np.array(values)
        self.covariance = np.array(covariance)
        self.motion = np.zeros(2 * n)
        self._motion_covariance = np.zeros((2 * n, 2 * n))
        # How far the estimate of the motion would move for a unit change of χ.
        self._sensitivity = np.zeros((2 * n, len(values)))
        self._pending: tuple[FloatArray, FloatArray, FloatArray] | None = None
        # Leapfrog: v' = v + T a comes first, and q' = q + T v' then holds T² a. This matrix maps (q, v, a) to (q', v').
        identity, zero = np.eye(n), np.zeros((n, n))
        self._step = np.block(
            [[identity, period * identity, period**2 * identity], [zero, identity, period * identity]]
        )
        self._measured = np.diag(np.concatenate([noise.torque, noise.position]) ** 2)

    def begin(
        self,
        before: FloatArray,
        q: FloatArray,
        tau: FloatArray,
        acceleration: FloatArray,
        doubt: FloatArray | None = None,
    ) -> None:
        """Begin an uninterrupted segment at its second sample.

        Parameters
        ----------
        before : (n,)
            Position of the first sample.
        q, tau, acceleration : (n,)
            Position, torque and rough acceleration of the second sample.
        doubt : (n,), optional
            Factor on the usual torque noise of each equation at this sample; one where it is left out.
        """
        n, variance = self._n, self._noise.position**2
        # The velocity is that of the half period before this sample: the difference of the two positions.
        self.motion = np.concatenate([q, (q - before) / self._period])
        positions, velocities = range(n), range(n, 2 * n)
        self._motion_covariance = np.zeros((2 * n, 2 * n))
        self._motion_covariance[positions, positions] = variance
        self._motion_covariance[velocities, velocities] = 2.0 * variance / self._period**2
        # The velocity rests on the position of this sample too.
        shared = variance / self._period
        self._motion_covariance[positions, velocities] = self._motion_covariance[velocities, positions] = shared
        self._sensitivity = np.zeros((2 * n, len(self.values)))
        self._pending = np.array(tau), np.array(acceleration), np.ones(self._n) if doubt is None else np.array(doubt)

    def step(
        self, q: FloatArray, tau: FloatArray, acceleration: FloatArray, doubt: FloatArray | None = None
    ) -> KalmanSample:
        """Process the next sample.

        Parameters
        ----------
        q, tau, acceleration, doubt : (n,)
            Position, torque, rough acceleration and noise factor, as in `begin`.

        Returns
        -------
        KalmanSample
            Equations from the sample before, whose torque can be used now that the position after it is known.

        Raises
        ------
        EstimationError
            Where the estimates are no longer finite.
        """
        if self._pending is None:
            raise ValueError("start a segment before its second sample")
        sample = self._correct(q, *self._pending)
        self._pending = np.array(tau), np.array(acceleration), np.ones(self._n) if doubt is None else np.array(doubt)
        return sample

    def _correct(self, q: FloatArray, tau: FloatArray, acceleration: FloatArray, doubt: FloatArray) -> KalmanSample:
        """Use the torque at the state's own instant and the position one period later, and move on to that."""
        n, period = self._n, self._period
        # The rough acceleration is a third part of the state, with an error of its own that is new at every sample.
        moving = np.concatenate([self.motion, acceleration])
        covariance = np.zeros((3 * n, 3 * n))
        covariance[: 2 * n, : 2 * n] = self._motion_covariance
        covariance[range(2 * n, 3 * n), range(2 * n, 3 * n)] = self._noise.acceleration**2
        owed = np.vstack([self._sensitivity, np.zeros((n, len(self.values)))])

        mean = moving[n : 2 * n] + 0.5 * period * acceleration
        slopes = self._model(moving[:n], mean, acceleration, self.values)
        # The velocity at the sample is v + T a / 2: the acceleration enters the torque through it as well.
        by_acceleration = slopes.by_acceleration + 0.5 * period * slopes.by_velocity
        by_motion = np.vstack([np.hstack([slopes.by_position, slopes.by_velocity, by_acceleration]), self._step[:n]])
        # Friedland's second stage: the innovation depends on χ directly and through the motion's estimate, which was
        # made with the values of χ at the time.
        by_values = by_motion @ owed
        by_values[:n] += slopes.by_parameters
        innovation = np.concatenate([tau - slopes.torque, q - self._step[:n] @ moving])

        cross = covariance @ by_motion.T
        # Covariance of the innovation if χ were known (`spread`), and with the uncertainty of χ (`expected`).
        spread = by_motion @ cross + self._measured * np.concatenate([doubt**2, np.ones(n)])
        of_values = self.covariance @ by_values.T
        expected = by_values @ of_values + spread
        if not (np.isfinite(innovation).all() and np.isfinite(expected).all()):
            raise EstimationError("the state is not finite any more")
        # Whitened by the motion's part of the covariance alone, these are ordinary least-squares rows of χ.
        whiten = _compute_whitening(spread)
        rows = whiten @ np.column_stack([by_values, innovation + by_values @ self.values])

        surprise = float(innovation @ np.linalg.solve(expected, innovation)) / n
        # First the parameters from the whole innovation; then the motion from what they leave of it.
        gain = np.linalg.solve(expected, of_values.T).T
        change = gain @ innovation
        self.values = self.values + change
        self.covariance = _symmetrise(self.covariance - gain @ of_values.T)
        gain = np.linalg.solve(spread, cross.T).T
        moving = moving + owed @ change + gain @ (innovation - by_values @ change)
        self.motion = self._step @ moving
        self._sensitivity = self._step @ (owed - gain @ by_values)
        self._motion_covariance = _symmetrise(self._step @ (covariance - gain @ cross.T) @ self._step.T)
        return KalmanSample(rows, surprise)


def _compute_whitening(spread: FloatArray) -> FloatArray:
    """Return a matrix (m, m) that whitens noise with this covariance, each row as near to its own as can be."""
    size = np.sqrt(np.diag(spread))
    # The symmetric root of the correlation matrix, unlike a Cholesky factor, does not mix equations by their order.
    eigenvalues, vectors = np.linalg.eigh(spread / np.outer(size, size))
    if not eigenvalues[0] > 0:
        raise EstimationError("the filter's covariance is not positive any more")
    return np.asarray((vectors / np.sqrt(eigenvalues)) @ vectors.T / size)


def _symmetrise(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))
