"""What a campaign wants to know, and its errors: of torque over a region, of parameters, of effects.

The error of a joint has two parts. The uncertainty of the parameters falls with every run. What the model lacks does
not: it shows as a residual above the noise floor. Both are relative to the torque that the region needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from dynident.advice.campaign_request import CampaignRequest
from dynident.advice.payload_goal import name_load_parameters, select_payload_errors
from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis import Diagnosis
from dynident.diagnosis.candidates.candidate_pool import find_places
from dynident.diagnosis.comparison.measured_against_predicted import compare
from dynident.diagnosis.comparison.noise_floor import judge
from dynident.diagnosis.diagnosis_request import check_candidates
from dynident.effects import EffectChoice, get_effect
from dynident.errors import DynidentError
from dynident.estimation.parameter_covariance import compute_sandwich_covariance
from dynident.excitation import CriterionChoice, Design
from dynident.excitation.criteria.design_criterion import select_parameters
from dynident.excitation.criteria.prediction_region import Region, collect_region
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.design_result import expect_recording
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.recordings.row_storage import load_stored_samples
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.observation_matrix import FurtherSignals, RegressorInputs
from dynident.robot import Robot

CONFIDENCE = 0.95
"""Probability with which the true error stays below the stated one."""
# Draws from the distribution of the parameters: the quantile of an error is then known to about 3 % of itself.
_DRAWS = 1000
_PLANNED_SAMPLES = 2000
# A recording follows a planned motion where so many of its postures are within this share of each joint's travel of a
# planned one, and where the travel of each joint and the median of their speeds are at least this part of the planned.
# Joints with less travel than the fourth (rad or m) stand; samples above the fifth part of the top speed move.
_ON_PATH, _NEAR, _LEAST_PART, _STANDS, _MOVES = 0.9, 0.1, 0.7, 1e-3, 0.05
_PROPOSED_BY_LINES = ("angle_spectrum", "time_spectrum")
# Directions of the covariance below this share of the largest, columns of unit norm, are known exactly.
_EXACT = 1e-14


class ErrorMeasure(Protocol):
    """What a covariance of the parameters means for the targets of a campaign: joints, parameters, a load."""

    def compute_errors(self, covariance: FloatArray, freedom: float) -> FloatArray:
        """Return the relative errors (k,) of the targets that the truth stays below with 95 % probability."""


@dataclass(frozen=True, eq=False)
class ParameterErrors:
    """Relative errors of chosen parameters.

    Parameters
    ----------
    indices : (k,)
        Columns of the parameters in the model.
    values : (k,)
        Their values.
    freedom : (k,)
        Degrees of freedom of their variances.
    """

    indices: IndexArray
    values: FloatArray
    freedom: FloatArray

    def compute_errors(self, covariance: FloatArray, freedom: float) -> FloatArray:
        """Return the half-widths (k,) of the 95 % intervals over the values, with each one's own freedom."""
        deviations = np.sqrt(np.maximum(np.diag(covariance)[self.indices], 0.0))
        sizes = np.maximum(np.abs(self.values), np.finfo(float).tiny)
        return np.asarray(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, self.freedom) * deviations / sizes)


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


def select_parameter_errors(identification: Identification, names: Sequence[str]) -> ParameterErrors:
    """Select the parameters of a model whose errors count.

    Parameters
    ----------
    identification : Identification
        The identified model.
    names : sequence of str
        Names of base parameters.

    Returns
    -------
    ParameterErrors
        Their errors.

    Raises
    ------
    DynidentError
        Where the model does not have one of them (any more: effects that are added may regroup parameters).
    """
    places = {column.name: k for k, column in enumerate(identification.model.kept)}
    absent = [name for name in names if name not in places]
    if absent:
        raise DynidentError(
            f"the model has no base parameter {', '.join(absent)}; it has: {', '.join(places)}. Was the torque of the "
            "joint recorded?",
            pointer="/parameters",
        )
    indices = np.array([places[name] for name in names], dtype=np.intp)
    return ParameterErrors(indices, identification.values[indices], identification.statistics.freedom[indices])


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
    # A load that the model has in some runs is there.
    further = FurtherSignals(runs=np.ones(len(observation.runs)))
    entries = observation.evaluate(
        q, dq, ddq, reference=identification.estimate.reference, memory=memory, further=further
    )
    rows = np.zeros((len(q), observation.robot.n, observation.n_columns))
    rows[:, observation.entry_rows, observation.entry_columns] = entries
    return rows


def compute_parameter_errors(identification: Identification, measure: ErrorMeasure) -> FloatArray:
    """Return the relative errors (k,) of the targets that uncertain parameters cause, with 95 % probability."""
    return measure.compute_errors(
        _compute_covariance(identification, measure), identification.statistics.median_freedom
    )


def _compute_covariance(identification: Identification, measure: ErrorMeasure) -> FloatArray:
    """Return the covariance of the parameters that a measure counts with.

    Of a parameter it is that of its interval in all tables: its spread over blocks of time. These are few, and say
    poorly how uncertain a sum over many parameters is. For the torque, the correlation of the residuals is pooled over
    parameters and joints instead.
    """
    if not isinstance(measure, RegionRows):
        return identification.statistics.covariance
    training, solution = identification.data.training, identification.estimate.solution
    return compute_sandwich_covariance(training, solution, _pool_inflation(identification))


def _pool_inflation(identification: Identification) -> FloatArray:
    """Return by how much each joint's rows (n,) overstate the information: half way from its own to that of all.

    A joint's own factor, from a dozen blocks of time, is by chance up to twice too large or too small.
    """
    counts, effective = identification.data.training.row_counts, identification.statistics.effective_rows
    own = np.divide(counts, effective, out=np.ones(len(counts)), where=effective > 0)
    return np.asarray(np.sqrt(own * np.exp(np.log(own).mean())))


def predict_errors(
    identification: Identification, measure: ErrorMeasure, design: Design, last: Recording, repetitions: float = 1.0
) -> FloatArray:
    """Return the relative errors (k,) of the targets that uncertain parameters will cause after a planned motion.

    The planned motion counts with the rows that its recording will have: filtered, without ends, halts and reversals.
    Their noise and its correlation are those of the rows so far.

    Parameters
    ----------
    identification : Identification
        The model as it is.
    measure : ErrorMeasure
        What the covariance means for the targets.
    design : Design
        The planned motion.
    last : Recording
        The last run: the next one is sampled as often, with the same load.
    repetitions : float
        How often the motion will be made.

    Returns
    -------
    (k,)
        Relative errors, with 95 % probability.
    """
    statistics, solution = identification.statistics, identification.estimate.solution
    planned = expect_recording(design, last)
    inputs = RegressorInputs((planned,), identification.preprocessing, identification.estimate.reference)
    reduction = reduce_recordings(identification.model.observation, inputs)
    inflation = _pool_inflation(identification)
    size = (reduction.n_columns, reduction.n_columns)
    gained, spread = np.zeros(size), np.zeros(size)
    inflated = inflation * (statistics.noise / solution.noise) ** 2
    for equation, sigma, excess in zip(reduction.equations, solution.noise, inflated, strict=True):
        if not len(equation.counts):
            continue
        w, place = equation.whole_factor[:, :-1], np.ix_(equation.columns, equation.columns)
        information = repetitions * (w.T @ w) / sigma**2
        gained[place] += information
        spread[place] += excess * information
    # B' = (WᵀW + G)⁻¹ is the update times (WᵀW)⁻¹, by Woodbury with G = LLᵀ: (WᵀW)⁻¹ may be singular where
    # constraints hold, and is not inverted.
    values, vectors = np.linalg.eigh(gained)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    seen = solution.normal_inverse @ root
    update = np.eye(len(values)) - seen @ np.linalg.solve(np.eye(len(values)) + root.T @ seen, root.T)
    bread = update @ solution.normal_inverse
    pooled = compute_sandwich_covariance(identification.data.training, solution, inflation)
    left = update @ pooled @ update.T + bread @ spread @ bread.T
    # The uncertainty over blocks of time is as many times larger than the pooled one as it is now.
    covariances = _compute_covariance(identification, measure), pooled, 0.5 * (left + left.T)
    now, of_pooled, then = (measure.compute_errors(covariance, statistics.median_freedom) for covariance in covariances)
    ratio = np.divide(now, of_pooled, out=np.ones_like(now), where=np.isfinite(now + of_pooled) & (of_pooled > 0))
    return np.asarray(ratio * then)


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
    tree = scipy.spatial.cKDTree(planned / travel)
    distances, _ = tree.query(recorded.q / travel, p=np.inf)
    if np.mean(distances <= _NEAR) < _ON_PATH:
        return False
    # Of the samples that move alone: a recording may begin long before the motion.
    slowest = _MOVES * np.abs(design.dq).max(axis=0)
    moved = travel > _STANDS
    if not moved.any():
        return True
    # Slower is slower on all joints; filters take the speed of a single one that shakes.
    speeds = _compute_moving_rms(recorded.dq, slowest) / _compute_moving_rms(design.dq, slowest).clip(_STANDS)
    # Filters cut the ends of a motion off, where a joint may be farthest out.
    columns = load_stored_samples(recording).columns
    is_wide = np.array([np.ptp(columns[f"q_{name}"]) for name in recording.joint_names]) >= _LEAST_PART * travel
    return bool(is_wide[moved].all() and np.median(speeds[moved]) >= _LEAST_PART)


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


def list_targets(request: CampaignRequest, joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return what the errors of a campaign are of: joints, parameters, effects or quantities of a load, by name.

    Parameters
    ----------
    request : CampaignRequest
        What is to be reached.
    joints : tuple of str
        Names of the robot's joints.
    """
    named = {"parameters": request.parameters, "effects": request.decide, "payload": request.quantities}
    return named.get(request.goal, joints)


def check_targets(robot: Robot, request: CampaignRequest) -> None:
    """Raise `DynidentError` where the motions of a campaign cannot show the targets of its goal."""
    design = request.design
    is_torque = design.model == "dynamic" and request.choices.model == "dynamic"
    if design.kind != "optimized" or not is_torque or design.trajectory.joints:
        raise DynidentError(
            'a campaign plans motions of all joints, of the kind "optimized" for the dynamic model, since runs of '
            "other kinds do not add up; leave kind, model and joints out of the design",
            pointer="/design",
        )
    needy = [choice.effect for choice in request.choices.effects if not is_of_motion(choice)]
    if needy:
        raise DynidentError(
            f"{', '.join(needy)} depends on more than the motion (temperature, time of the session, or run), so "
            "that its torque in the region is not known; leave it out of the campaign",
            pointer="/choices/effects",
        )
    if request.goal == "parameters":
        effects = request.choices.effects
        names = build_design_model(robot, effects).parameter_names
        unknown = [name for name in request.parameters if name not in names]
        if unknown or not request.parameters:
            absent = f"there is no base parameter {', '.join(unknown)}" if unknown else "no parameter is named"
            raise DynidentError(f"{absent}; there are: {', '.join(names)}", pointer="/parameters")
    if request.goal == "payload":
        name_load_parameters(robot, request)
    if request.goal == "effects":
        try:
            check_candidates(request.decide)
        except DynidentError as error:
            error.pointer = "/decide"
            raise
        if not request.decide:
            raise DynidentError("no effect is named; name those that have to show", pointer="/decide")
        for name in request.decide:
            _check_decidable(robot, request.choices.effects, EffectChoice(name))


def _check_decidable(robot: Robot, effects: Sequence[EffectChoice], choice: EffectChoice) -> None:
    """Raise `DynidentError` for an effect that is in the first model, or that no motion alone finds or rules out."""
    effect, why = get_effect(choice.effect), ""
    if any(known.effect == choice.effect for known in effects):
        why = "is in the first model already; name its parameters as a goal instead"
    elif not is_of_motion(choice):
        why = "depends on more than the motion, so that no motion alone decides it"
    elif effect.proposal in _PROPOSED_BY_LINES or effect.is_transient:
        # Of what is looked for only where the residual suggests it, nobody knows which size would have shown.
        why = "is looked for where the residual suggests it, and cannot be ruled out"
    if not why:
        try:
            model = build_design_model(robot, (*effects, choice))
            select_parameters(model, CriterionChoice("separation", effects=(choice,)), {})
        except DynidentError as error:
            why = f"cannot be a goal: {error.detail}"
    if why:
        raise DynidentError(f"{choice.effect} {why}", pointer="/decide")


def is_of_motion(choice: EffectChoice) -> bool:
    """Return whether the motion alone determines an effect's torque: only then it has one at a state of a region."""
    effect = get_effect(choice.effect)
    return not (effect.needs_temperature or effect.needs_session or effect.in_some_runs or choice.runs)


def build_measure(request: CampaignRequest, region: Region, identification: Identification) -> ErrorMeasure | None:
    """Return what the covariance of a model means for a campaign; None for effects, and for a load before its runs."""
    if request.goal == "effects":
        return None
    if request.goal == "payload":
        return select_payload_errors(identification, request)
    if request.goal == "parameters":
        return select_parameter_errors(identification, request.parameters)
    return compute_region_rows(identification, region)


def compute_effect_errors(diagnosis: Diagnosis, effects: Sequence[str], robot: Robot) -> FloatArray:
    """Return the smallest size (k,) that would have shown wherever an effect may act, as a share of the usual.

    It is 0 where the effect was found, and infinite where these recordings would have shown no size of it.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis of all runs.
    effects : sequence of str
        Ids of the effects.
    robot : Robot
        The robot.
    """
    shares = {
        (limit.effect, place): limit.share for limit in diagnosis.detection_limits for place in limit.joints or ("",)
    }
    found = {(choice.effect, place) for choice in diagnosis.recommended for place in choice.joints or ("",)}

    def find_worst(name: str) -> float:
        effect = get_effect(name)
        joints = [robot.tree.joint_names[j] for j in find_places(effect, robot)] if effect.scope == "joint" else [""]
        return max(
            (0.0 if (name, joint) in found else shares.get((name, joint), np.inf) for joint in joints), default=np.inf
        )

    return np.array([find_worst(name) for name in effects])


def compute_target_errors(
    request: CampaignRequest, identification: Identification, diagnosis: Diagnosis, measure: ErrorMeasure | None
) -> FloatArray:
    """Return the errors (k,) of the targets of a goal after a run; infinite of a load that was not mounted yet."""
    robot = identification.model.robot
    if measure is not None:
        return compute_parameter_errors(identification, measure)
    if request.goal == "effects":
        return compute_effect_errors(diagnosis, request.decide, robot)
    return np.full(len(list_targets(request, robot.joint_names)), np.inf)
