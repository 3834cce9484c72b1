"""How well an identified model predicts the torque over a region of states: now, and after a planned motion.

The error of a joint has two parts. The uncertainty of the parameters falls with every run. What the model lacks does
not: it shows as a residual above the noise floor. Both are relative to the torque that the region needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import compare
from dynident.diagnosis.comparison.noise_floor import judge
from dynident.excitation import Design
from dynident.excitation.criteria.prediction_region import Region, collect_region
from dynident.excitation.experiments.design_task import STANDSTILL_VELOCITY
from dynident.identification import Identification
from dynident.recordings import Recording

CONFIDENCE = 0.95
"""Probability with which the true error stays below the stated one."""
# Draws from the distribution of the parameters: the quantile of an error is then known to about 3 % of itself.
_DRAWS = 1000
# Samples of a planned motion that stand for all of it.
_PLANNED_SAMPLES = 2000
# A recording follows a planned motion where so many of its postures are within this share of each joint's travel of a
# planned one, and where travel and speed of each joint are at least this part of the planned ones. Joints with less
# travel than the fourth (rad or m) stand; samples above the fifth part of the top speed move.
_ON_PATH, _NEAR, _LEAST_PART, _STANDS, _MOVES = 0.9, 0.1, 0.7, 1e-3, 0.05
# Directions of the covariance below this share of the largest, columns of unit norm, are known exactly.
_EXACT = 1e-14


@dataclass(frozen=True, eq=False)
class RegionRows:
    """Second moments of a model's rows over a region, joint by joint.

    Parameters
    ----------
    moments : (n, b, b)
        Mean of wᵀw over the rows w of the region's states.
    torque : (n,)
        Rms of the predicted torque over the region, N m or N, at least the noise of the joint.
    """

    moments: FloatArray
    torque: FloatArray

    def compute_errors(self, covariance: FloatArray, freedom: float) -> FloatArray:
        """Return the relative errors (n,) that parameters of this covariance stay below with 95 % probability.

        Parameters
        ----------
        covariance : (b, b)
            Covariance of the parameters.
        freedom : float
            Degrees of freedom with which the covariance is known.

        Returns
        -------
        (n,)
            Quantile over draws of the rms error of the predicted torque over the region, over its rms torque.
        """
        scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        root = scale[:, None] * vectors * np.sqrt(np.where(values > _EXACT * values[-1], values, 0.0))
        # A fixed seed: the same covariance has the same error.
        rng = np.random.default_rng(0)
        errors = rng.standard_normal((_DRAWS, len(scale))) @ root.T
        # Student's t: the covariance itself is an estimate.
        errors *= np.sqrt(freedom / rng.chisquare(freedom, _DRAWS))[:, None]
        squares = np.einsum("da,jab,db->dj", errors, self.moments, errors, optimize=True)
        return np.asarray(np.quantile(np.sqrt(np.maximum(squares, 0.0)), CONFIDENCE, axis=0) / self.torque)


def compute_region_rows(identification: Identification, region: Region) -> RegionRows:
    """Evaluate a model's rows over a region.

    Parameters
    ----------
    identification : Identification
        The identified model.
    region : Region
        States whose torque shall be predicted.

    Returns
    -------
    RegionRows
        Moments of the rows, and the torque.
    """
    rows = evaluate_rows(identification, region.q, region.dq, region.ddq)
    torque = np.sqrt(((rows @ identification.values) ** 2).mean(axis=0))
    # Where the region needs hardly any torque of a joint, errors are relative to its noise.
    moments = np.einsum("mja,mjb->jab", rows, rows, optimize=True) / len(rows)
    return RegionRows(moments, np.maximum(torque, identification.noise))


def evaluate_rows(identification: Identification, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Return the rows of a model at states; friction that remembers its path has slid in the direction of motion.

    Parameters
    ----------
    identification : Identification
        The identified model.
    q, dq, ddq : (m, n)
        States: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).

    Returns
    -------
    (m, n, b)
        W at each state.
    """
    observation = identification.model.observation
    # Followers have no velocity of their own here: their state counts as positive.
    followers = np.ones((len(dq), len(observation.robot.positions(q[:1])[0]) - observation.robot.n))
    memory = observation.compute_sliding_states(np.concatenate([dq, followers], axis=1))
    entries = observation.evaluate(q, dq, ddq, reference=identification.estimate.reference, memory=memory)
    rows = np.zeros((len(q), observation.robot.n, observation.n_columns))
    rows[:, observation.entry_rows, observation.entry_columns] = entries
    return rows


def compute_parameter_errors(identification: Identification, rows: RegionRows) -> FloatArray:
    """Return the relative errors (n,) over a region that uncertain parameters cause, with 95 % probability."""
    statistics = identification.statistics
    return rows.compute_errors(statistics.covariance, statistics.median_freedom)


def predict_errors(
    identification: Identification, rows: RegionRows, design: Design, seconds: float, repetitions: float = 1.0
) -> FloatArray:
    """Return the relative errors (n,) over a region that uncertain parameters will cause after a planned motion.

    A second of the motion leaves as many rows as a second of the recordings so far, with the same noise, and the errors
    of correlated rows are as many times larger than those of independent ones as they are now.

    Parameters
    ----------
    identification : Identification
        The model as it is.
    rows : RegionRows
        Its rows over the region.
    design : Design
        The planned motion.
    seconds : float
        Length of the recordings that the model was identified from, s.
    repetitions : float
        How often the motion will be made.

    Returns
    -------
    (n,)
        Relative errors, with 95 % probability.
    """
    statistics, solution = identification.statistics, identification.estimate.solution
    inside = np.flatnonzero((design.t >= design.exciting[0]) & (design.t <= design.exciting[1]))
    samples = inside[:: max(1, len(inside) // _PLANNED_SAMPLES)]
    planned = evaluate_rows(identification, design.q[samples], design.dq[samples], design.ddq[samples])
    # The equation of a joint that stands tells nothing.
    planned *= (np.abs(design.dq[samples]) > STANDSTILL_VELOCITY)[:, :, None]
    # Rows that the filters will leave of the planned motion, in units of each joint's noise.
    duration = repetitions * (design.exciting[1] - design.exciting[0])
    weights = duration * identification.data.training.row_counts / seconds / identification.noise**2
    gained = np.einsum("mja,j,mjb->ab", planned, weights, planned, optimize=True) / len(planned)
    # (WᵀW + G)⁻¹ by Woodbury with G = LLᵀ: (WᵀW)⁻¹ may be singular where constraints hold, and is not inverted.
    values, vectors = np.linalg.eigh(gained)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    independent = solution.normal_inverse
    spread = independent @ root
    left = independent - spread @ np.linalg.solve(np.eye(len(values)) + root.T @ spread, spread.T)
    # Rows are correlated, so that the errors are larger than those of independent rows: by as much as they are now.
    freedom = statistics.median_freedom
    now, of_independent = (rows.compute_errors(part, freedom) for part in (statistics.covariance, independent))
    excess = np.divide(now, of_independent, out=np.ones_like(now), where=of_independent > 0)
    return np.asarray(excess * rows.compute_errors(0.5 * (left + left.T), freedom))


def follows_design(recording: Recording, design: Design) -> bool:
    """Return whether a recording is of a planned motion, however late it begins; only then its promise counts.

    Parameters
    ----------
    recording : Recording
        The recording.
    design : Design
        The planned motion.
    """
    recorded = collect_region([recording])
    travel = np.maximum(np.ptp(design.q, axis=0), np.finfo(float).tiny)
    planned = design.q[:: max(1, len(design.q) // _PLANNED_SAMPLES)]
    tree = cKDTree(planned / travel)
    distances, _ = tree.query(recorded.q / travel, p=np.inf)
    if np.mean(distances <= _NEAR) < _ON_PATH:
        return False
    # Of the samples that move alone: a recording may begin long before the motion.
    slowest = _MOVES * np.abs(design.dq).max(axis=0)
    is_fast = _compute_moving_rms(recorded.dq, slowest) >= _LEAST_PART * _compute_moving_rms(design.dq, slowest)
    is_wide = np.ptp(recorded.q, axis=0) >= _LEAST_PART * travel
    return bool((is_fast & is_wide)[travel > _STANDS].all())


def _compute_moving_rms(dq: FloatArray, slowest: FloatArray) -> FloatArray:
    """Return the rms speed (n,) of each joint's samples that are faster than `slowest` (n,)."""
    moves = np.abs(dq) > slowest
    return np.asarray(np.sqrt((moves * dq**2).sum(axis=0) / np.maximum(moves.sum(axis=0), 1)))


@dataclass(frozen=True, eq=False)
class RunErrors:
    """What one recording says about a model.

    Parameters
    ----------
    predicted : (n,)
        Relative error of the predicted torque where joints move; 0.05 is 5 %.
    lacking : (n,)
        Rms of the residual above the noise floor and the uncertainty of the parameters, N m or N: what the model lacks.
    """

    predicted: FloatArray
    lacking: FloatArray


def compare_with_run(identification: Identification, recording: Recording) -> RunErrors:
    """Return the errors of a model on a recording.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recording : Recording
        A recording, whether the model was fitted to it or not.

    Returns
    -------
    RunErrors
        Errors of the prediction, and what of them is neither noise nor uncertainty.
    """
    comparison = compare(identification, recording)
    floor = judge(comparison, recording, identification.preprocessing).noise.values
    errors = comparison.moving_errors
    moves = comparison.off_halts
    uncertain = np.where(moves, comparison.deviation**2, 0.0).sum(axis=0) / np.maximum(moves.sum(axis=0), 1)
    explained = floor**2 + uncertain
    return RunErrors(errors.relative, np.sqrt(np.maximum(errors.rms**2 - explained, 0.0)))
