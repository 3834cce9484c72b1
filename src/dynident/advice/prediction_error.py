"""What a campaign wants to know, and its errors: of torque over a region, of parameters, of effects.

The error of a joint has two parts, relative to the torque that the region needs. The uncertainty of the parameters
falls with every run. What the model lacks does not: it shows as a residual above the noise floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from dynident.advice.campaign_request import CampaignRequest, list_targets
from dynident.advice.payload_goal import name_load_parameters, select_payload_errors
from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis import Diagnosis
from dynident.diagnosis.candidates.candidate_pool import find_places
from dynident.diagnosis.comparison.measured_against_predicted import compare
from dynident.diagnosis.comparison.noise_floor import judge
from dynident.diagnosis.diagnosis_request import check_candidates
from dynident.effects import EffectChoice, get_effect
from dynident.errors import DynidentError
from dynident.estimation.residual_correlation import (
    compute_sandwich_covariance,
    count_correlation_freedoms,
    count_pooled_freedom,
    pool_correlation_factors,
)
from dynident.excitation import CriterionChoice, Design
from dynident.excitation.criteria.design_criterion import select_parameters
from dynident.excitation.criteria.prediction_region import Region
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.design_result import expect_recording
from dynident.identification import Identification
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.low_pass_decimation import correlate_white_noise
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.observation_matrix import FurtherSignals, RegressorInputs
from dynident.robot import Robot

CONFIDENCE = 0.95
"""Probability with which the true error stays below the stated one."""
# Draws from the distribution of the parameters: the quantile of an error is then known to about 3 % of itself.
_DRAWS = 1000
_PROPOSED_BY_LINES = ("angle_spectrum", "time_spectrum")
# Directions of the covariance below this share of the largest, columns of unit norm, are known exactly.
_EXACT = 1e-14


class ErrorMeasure(Protocol):
    """What a covariance of the parameters means for the targets of a campaign: joints, parameters, a load."""

    def compute_errors(self, covariance: FloatArray) -> FloatArray:
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

    def compute_errors(self, covariance: FloatArray) -> FloatArray:
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
    freedom : float
        Degrees of freedom with which the covariance of the parameters is known.
    """

    moments: FloatArray
    torque: FloatArray
    freedom: float

    def compute_errors(self, covariance: FloatArray) -> FloatArray:
        """Return the relative errors (n,) that parameters of this covariance stay below, all joints together.

        Parameters
        ----------
        covariance : (b, b)
            Covariance of the parameters.

        Returns
        -------
        (n,)
            Rms errors of the predicted torque over the region, over its rms torque: of 100 draws of the parameters 95
            are below them on every joint. Each is the same multiple of its joint's own quantile.
        """
        scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        root = scale[:, None] * vectors * np.sqrt(np.where(values > _EXACT * values[-1], values, 0.0))
        # A fixed seed: the same covariance has the same error.
        rng = np.random.default_rng(0)
        errors = rng.standard_normal((_DRAWS, len(scale))) @ root.T
        # Student's t: the covariance itself is an estimate.
        errors *= np.sqrt(self.freedom / rng.chisquare(self.freedom, _DRAWS))[:, None]
        squares = np.einsum("da,jab,db->dj", errors, self.moments, errors, optimize=True)
        sizes = np.sqrt(np.maximum(squares, 0.0))
        own = np.quantile(sizes, CONFIDENCE, axis=0)
        shares = np.divide(sizes, own, out=np.zeros_like(sizes), where=own > 0)
        return np.asarray(own * np.quantile(shares.max(axis=1, initial=0.0), CONFIDENCE) / self.torque)


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
    freedom = count_pooled_freedom(*_compute_own_factors(identification))
    return RegionRows(moments, np.maximum(torque, identification.noise), freedom)


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


def _compute_covariance(identification: Identification, measure: ErrorMeasure, rate: float) -> FloatArray:
    """Return the covariance of the parameters that a measure counts with.

    Of a parameter it is that of its interval in all tables: its spread over blocks of time. These are few, and say
    poorly how uncertain a sum over many parameters is. For the torque, the correlation of the residuals is pooled over
    parameters and joints instead.
    """
    if not isinstance(measure, RegionRows):
        return identification.statistics.covariance
    training, solution = identification.data.training, identification.estimate.solution
    return compute_sandwich_covariance(training, solution, _pool_inflation(identification, rate))


def _pool_inflation(identification: Identification, rate: float) -> FloatArray:
    """Return by how much each joint's rows (n,), sampled at a rate (Hz), overstate the information, pooled over all."""
    factors, decimation = np.ones(identification.model.robot.n), identification.preprocessing.decimation
    correlation = correlate_white_noise(rate, identification.preprocessing.torque_cutoff)
    # The sum over the lags of rows: torque that varies slowly meets the noise of all of them alike.
    of_noise = float(correlation[len(correlation) // 2 % decimation :: decimation].sum())
    has_rows = _find_joints_with_rows(identification)
    if has_rows.any():
        factors[has_rows] = pool_correlation_factors(*_compute_own_factors(identification), of_noise)
    return factors


def _find_joints_with_rows(identification: Identification) -> BoolArray:
    training = identification.data.training
    return np.asarray((training.row_counts > 0) & (identification.statistics.effective_rows > 0))


def _compute_own_factors(identification: Identification) -> tuple[FloatArray, FloatArray]:
    """Return the factors of the joints with rows, as each one's residuals say, and the degrees of freedom of these."""
    training, effective = identification.data.training, identification.statistics.effective_rows
    freedom = count_correlation_freedoms(training, identification.estimate.solution)
    has_rows = _find_joints_with_rows(identification)
    return training.row_counts[has_rows] / effective[has_rows], freedom[has_rows]


def predict_errors(
    identification: Identification, measure: ErrorMeasure, design: Design, last: Recording, repetitions: float = 1.0
) -> FloatArray:
    """Return the relative errors (k,) of the targets that uncertain parameters will cause after a planned motion.

    The planned motion counts with the rows that its recording will have: filtered, without ends, halts and reversals,
    with noise and its correlation as so far.

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
    # A faster motion is filtered less: fewer of its rows are beside reversals, and a second tells as much as before.
    chosen = choose_preprocessing((last, planned)) if design.dq.any() else identification.preprocessing
    filters = identification.choices.preprocessing or chosen
    share = filters.decimation / identification.preprocessing.decimation
    inputs = RegressorInputs((planned,), filters, identification.estimate.reference)
    # Rows at reversals count less, as they do in the identification.
    equations = identification.data.training.equations
    weights = np.array([1.0 if e.weighted_rows is None else e.weighted_rows.weight for e in equations])
    reduction = reduce_recordings(identification.model.observation, inputs, by_phase=True).weight_groups(weights)
    inflation = _pool_inflation(identification, last.sampling_rate)
    size = (reduction.n_columns, reduction.n_columns)
    gained, spread = np.zeros(size), np.zeros(size)
    inflated = inflation * (statistics.noise / solution.noise) ** 2
    for equation, sigma, excess in zip(reduction.equations, solution.noise, inflated, strict=True):
        if not len(equation.counts):
            continue
        w, place = equation.whole_factor[:, :-1], np.ix_(equation.columns, equation.columns)
        information = repetitions * share * (w.T @ w) / sigma**2
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
    present = _compute_covariance(identification, measure, last.sampling_rate)
    covariances = present, pooled, 0.5 * (left + left.T)
    now, of_pooled, then = map(measure.compute_errors, covariances)
    ratio = np.divide(now, of_pooled, out=np.ones_like(now), where=np.isfinite(now + of_pooled) & (of_pooled > 0))
    return np.asarray(ratio * then)


@dataclass(frozen=True, eq=False)
class RunErrors:
    """What one recording says about a model.

    Parameters
    ----------
    predicted, seconds : (n,)
        Relative error of the predicted torque where joints move, and how long they do, s.
    excess, scatter : (n,)
        Mean square of the residual above that of the noise, (N m)² or N², and its standard deviation by chance.
    """

    predicted: FloatArray
    excess: FloatArray
    scatter: FloatArray
    seconds: FloatArray


def compute_lacking(errors: Sequence[RunErrors]) -> FloatArray:
    """Return the rms (n,) of the residual above the noise floor, N m or N, beyond what chance explains.

    A mean square of noise scatters: a short run of a joint whose torque is near its noise would seem to lack some per
    cent. Where nothing is lacking, it is zero with 95 % probability on all joints together. Runs count by their time.
    """
    seconds = np.maximum([run.seconds for run in errors], np.finfo(float).tiny)
    shares = seconds / seconds.sum(axis=0)
    excess = np.sum(shares * [run.excess for run in errors], axis=0)
    scatter = np.linalg.norm(shares * [run.scatter for run in errors], axis=0)
    # Joints that did not move have no residual that chance could raise.
    beyond_chance = scipy.special.ndtri(CONFIDENCE ** (1.0 / max(int(np.count_nonzero(scatter)), 1)))
    return np.asarray(np.sqrt(np.maximum(excess - beyond_chance * scatter, 0.0)))


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
        Errors of the prediction, and how much of them is more than noise.
    """
    comparison = compare(identification, recording)
    noise = judge(comparison, recording, identification.preprocessing).noise
    errors = comparison.moving_errors
    floor, seconds = noise.values**2, comparison.moving.sum(axis=0) * float(np.median(np.diff(comparison.t)))
    # Independent samples of filtered white noise.
    correlation = correlate_white_noise(recording.sampling_rate, identification.preprocessing.torque_cutoff)
    worth = np.maximum(seconds * recording.sampling_rate / float(correlation @ correlation), 1.0)
    # A floor from repetitions is a mean square that scatters itself.
    scatter = floor * np.sqrt((4.0 if noise.source == "repeated_periods" else 2.0) / worth)
    return RunErrors(errors.relative, errors.rms**2 - floor, scatter, seconds)


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
    request: CampaignRequest,
    identification: Identification,
    diagnosis: Diagnosis,
    measure: ErrorMeasure | None,
    rate: float,
) -> FloatArray:
    """Return the errors (k,) of the targets of a goal after a run; infinite of a load that was not mounted yet.

    They are those that uncertain parameters cause, with 95 % probability, from recordings sampled at a rate (Hz).
    """
    robot = identification.model.robot
    if measure is not None:
        return measure.compute_errors(_compute_covariance(identification, measure, rate))
    if request.goal == "effects":
        return compute_effect_errors(diagnosis, request.decide, robot)
    return np.full(len(list_targets(request, robot.joint_names)), np.inf)
