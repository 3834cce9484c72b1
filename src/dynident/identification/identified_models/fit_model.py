"""Fit a built model to reduced data and make the result, with its warnings (poor fit, few equations, …)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import DEFAULT_EFFECTS, LINKS, ReferenceParameters, get_effect, get_role
from dynident.estimation import Reduction, compute_errors, find_outlying_spans
from dynident.estimation.residual_correlation import FEWEST_BLOCKS, find_equations_in_few_blocks
from dynident.identification.equations.model_and_data_checks import check_reduction, check_torque
from dynident.identification.equations.reduced_recordings import Data, ReducedData, reduce_to_rows, reduce_torque
from dynident.identification.estimation_problem import Problem, ShapeUncertainty
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.identified_models.identification_result import (
    NONE_IN_MEMORY,
    Estimate,
    Identification,
    IdentifiedParameter,
    RowsInMemory,
)
from dynident.identification.identified_models.other_conditions import describe_other_conditions, warn_of_friction_signs
from dynident.identification.shape_constant_intervals import judge_shape_constants
from dynident.identification.shape_refinement import reduce_with_shapes
from dynident.identification.standard_parameters import compute_smallest_inertia_eigenvalue
from dynident.identification.strategies.solve_by_strategy import solve_by_strategy
from dynident.identification.thresholds import (
    DETERMINED,
    EQUATIONS_PER_PARAMETER,
    LARGEST_CONDITION_NUMBER,
    LOAD_AND_GAINS,
    OVERFIT,
)
from dynident.number_format import format_percent
from dynident.parallel import defer
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import CachedRows

if TYPE_CHECKING:
    from dynident.identification.identified_models.identification_result import Estimate, Identification

OF_COMMANDS = (
    "The torque was not recorded, but computed from the commands of servos: if the drive gains are wrong by one "
    "factor, so is all of the model."
)

_MISFIT = 0.2
"""Share of the torque left by the fit, above which the data are doubted; sound arms leave 3 to 15 %."""

_MOST_NAMED = 12
"""Uncertain parameters that are named; the others are counted."""


def list_warnings(identification: Identification) -> tuple[str, ...]:
    """Return all that is doubtful about a result, most important first.

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    tuple of str
        Sentences for the user.
    """
    slow = describe_slow_motion(identification.parameters)
    sentences = (
        [f"{slow} Use the model at such speeds only, and record a faster motion for the dynamics."] if slow else []
    )
    # Poses at rest have no inertia matrix; their eigenvalue is not a number and says nothing.
    if not identification.inertia_matrix_positive_definite and np.isfinite(identification.worst_inertia_eigenvalue):
        sentences.append(
            "The inertia matrix is not positive definite in every posture: these parameters are not physically "
            "possible. Use them only for prediction near the recorded motion."
        )
    sentences += _warn_of_no_links(identification)
    sentences += _warn_of_disturbance(identification)
    sentences += _warn_of_misfit(identification)
    sentences += _warn_of_unsettled(identification)
    sentences += _warn_of_other_equations(identification)
    sentences += _warn_of_excitation(identification)
    sentences += _warn_of_overfit(identification)
    sentences += warn_of_friction_signs(identification)
    sentences += _warn_of_missing_torque(identification)
    sentences += _warn_of_load(identification)
    sentences += [OF_COMMANDS] if identification.data.from_commands else []
    # Effects that dissolved in others are still in the torque, but have no parameter of their own.
    absorbed = [f"{column.effect} ({column.name})" for column in identification.model.absorbed_columns]
    if absorbed:
        sentences.append(f"Left out, because they cannot be separated from other parameters: {', '.join(absorbed)}.")
    return tuple(sentences)


def _warn_of_no_links(identification: Identification) -> list[str]:
    """Warn of a list of effects that replaced the usual ones, where it was probably meant to add to them."""
    chosen = [choice.effect for choice in identification.choices.effects]
    if LINKS.effect in chosen:
        return []
    return [
        f"The model has no links: its effects are {', '.join(dict.fromkeys(chosen))} alone. To add to the usual "
        f"effects ({', '.join(choice.effect for choice in DEFAULT_EFFECTS)}), name default as well."
    ]


def _warn_of_load(identification: Identification) -> list[str]:
    """Say what the mass of a load rests on."""
    loads = [column.name for column in identification.model.kept if get_role(column) == "load"]
    return [f"{', '.join(loads)}: a load is only as right as the drive gains. {LOAD_AND_GAINS}"] if loads else []


def _warn_of_missing_torque(identification: Identification) -> list[str]:
    """Say what is not known of joints whose torque was not recorded."""
    model = identification.model
    if not model.robot.joints_without_torque:
        return []
    hidden = _join_names([column.name for column in model.hidden_columns])
    return [
        f"The torque of {model.robot.names_without_torque} was not recorded. The motion is used, but "
        "parameters that only the joint's own equation shows are not identifiable from this "
        f"data{f' ({hidden})' if hidden else ''}. For such a joint the model predicts only the torque of the links, "
        "and no data checked it."
    ]


def _warn_of_disturbance(identification: Identification) -> list[str]:
    """Warn of seconds in which something else than the robot acted, or of a drift: no error shows that they act."""
    outlying = find_outlying_spans(identification.data.training)
    if outlying.drifts:
        return [
            "What the model leaves of the torque changes slowly over the time of the data, as friction of a robot does "
            "that warms up. A diagnosis names the effect; or record a warm robot, or its temperatures as well."
        ]
    return [
        f"From {span.start:.1f} to {span.end:.1f} s of the data something else acted: there the residual is "
        f"{np.sqrt(span.ratio):.0f} times that of all other rows in a fit without these seconds. Possible causes are "
        "a contact, a load that was picked up, a brake, a collision, or a clock jump. A diagnosis shows the cause and "
        "the exact time. Leave these seconds out."
        for span in outlying.spans
    ]


def _warn_of_misfit(identification: Identification) -> list[str]:
    """Warn of a fit that leaves much of the torque it was made from: mostly the data are wrong, not the effects."""
    # Where joints move: rows at rest of drives that are off say nothing of columns and description.
    errors = identification.fit_judged
    share = errors.relative_total
    if not identification.choices.rows.by_joint or share <= _MISFIT:
        return []
    # The joint with the largest residual in N m: it tells where to look.
    worst = identification.model.robot.joint_names[int(np.argmax(errors.rms))]
    return [
        f"Even in the fit {format_percent(share, decimals=0)} of the torque is unexplained, most on {worst}: check the "
        "order, signs and units of the columns, the joint axes and gravity in the description, loads that the "
        "description does not contain, and flexible joints."
    ]


_LEAST_DETERMINED = 0.1
"""Share of the moments of inertia below which a motion counts as too slow: sweeps at 0.04 to 0.1 rad/s determine none
of an arm's 28, designed motions a third of them."""

_INERTIA, FIRST_MOMENT = "kg m²", "kg m"


def describe_slow_motion(parameters: Sequence[IdentifiedParameter]) -> str | None:
    """Describe a motion that determines first moments of the links, but hardly any moment of inertia.

    Parameters
    ----------
    parameters : sequence of IdentifiedParameter
        The base parameters of a model.

    Returns
    -------
    str or None
        A sentence; None where the motion shows inertia, or gravity is not determined either.
    """
    inertias, moments = (
        [
            parameter.judgement == "determined"
            for parameter in parameters
            if parameter.unit == unit and parameter.judgement != "held"
        ]
        for unit in (_INERTIA, FIRST_MOMENT)
    )
    if not inertias or not any(moments) or sum(inertias) >= _LEAST_DETERMINED * len(inertias):
        return None
    counted = f"hardly any inertia ({sum(inertias)} of {len(inertias)} moments of inertia are determined)"
    if not any(get_effect(parameter.effect).is_friction for parameter in parameters):
        # What friction leaves unexplained makes every estimate uncertain, however fast the motion is.
        return f"The model shows gravity, but {counted}: it has no friction, or the motion is too slow or too short."
    return f"The motion shows gravity and friction, but {counted}: it is too slow or too short."


def _warn_of_unsettled(identification: Identification) -> list[str]:
    """Warn of iterations that have not settled, where the estimator does not say so itself."""
    if identification.converged or identification.choices.solver.tells_convergence:
        return []
    return [
        f"The weighting ({identification.choices.solver.name}) did not converge: the estimates still change from one "
        "iteration to the next. Too few rows for many parameters, or joints without residual, cause this; compare "
        "with ols."
    ]


def _warn_of_other_equations(identification: Identification) -> list[str]:
    """Say what the errors of torque mean where the torques were not what was fitted."""
    model = identification.choices.model
    if model in ("energy", "power"):
        return [
            f"The {model} model has one equation and does not minimise the torque errors (§12.6): compare its torque "
            "errors on validation data with those of the dynamic model."
        ]
    if model == "base_wrench":
        sentence = (
            "The base wrench shows only the links: friction and rotors are not in this model, so the torque errors "
            "contain all of these. The small reaction of rotating rotors counts as part of the links."
        )
        if not identification.inertia_matrix_positive_definite:
            sentence += (
                " Check the sign of the wrench: it is the wrench of the base on the robot, so at rest its force "
                "points up."
            )
        return [sentence]
    return []


def _warn_of_excitation(identification: Identification) -> list[str]:
    sentences = []
    condition = identification.equilibrated_condition_number
    # Columns of equal size: otherwise the units of the parameters decide, and not the motion.
    if condition > LARGEST_CONDITION_NUMBER:
        help_is = "Record an exciting trajectory (a design)"
        help_is += "." if identification.choices.prior else ' or use a prior (prior: "description").'
        sentences.append(
            f"The condition number of W with columns of equal size is {condition:.0f}: the motion alone does not "
            f"determine the model well. {help_is}"
        )
    names = identification.model.robot.joint_names
    if few := [names[k] for k in find_equations_in_few_blocks(identification.data.equations) if k < len(names)]:
        sentences.append(
            f"Less than {FEWEST_BLOCKS} blocks of time show the motion of {', '.join(few)}: whether rows depend on "
            "each other cannot be told, and standard deviations may be too small. A longer motion helps."
        )
    if not identification.model.is_at_rest and identification.equations_per_parameter < EQUATIONS_PER_PARAMETER:
        sentences.append(
            f"There are {identification.equations_per_parameter:.0f} equations per parameter after decimation; "
            f"{EQUATIONS_PER_PARAMETER:.0f} are recommended (§12.7). A longer recording helps."
        )
    return sentences + _warn_of_uncertain(identification.estimate)


def _warn_of_uncertain(estimate: Estimate) -> list[str]:
    """Warn of parameters that the data do not determine; those that may as well be zero do no harm by it."""
    parameters = estimate.parameters
    unsure = [f"{p.name} ({p.link})" if p.link else p.name for p in parameters if p.judgement == "uncertain"]
    if not unsure:
        return []
    zero = sum(p.judgement == "zero_in_interval" for p in parameters)
    others = f" {zero} more are not significantly different from zero." if zero else ""
    return [
        f"{len(unsure)} of {len(parameters)} parameters are uncertain (standard deviation above "
        f"{format_percent(DETERMINED, decimals=0)} of the value, or known from the prior rather than from the data): "
        f"{_join_names(unsure)}.{others}"
    ]


def _join_names(names: Sequence[str]) -> str:
    return ", ".join(names[:_MOST_NAMED]) + (f" and {len(names) - _MOST_NAMED} more" * (len(names) > _MOST_NAMED))


def is_worse_on_held_out(identification: Identification) -> bool:
    """Return whether held-out data have a clearly larger error than the fit: something differs in them.

    Parameters
    ----------
    identification : Identification
        The identified model.
    """
    held_out = identification.held_out_judged
    return held_out is not None and held_out.relative_total > OVERFIT * identification.fit_judged.relative_total


def _warn_of_overfit(identification: Identification) -> list[str]:
    held_out, fit = identification.held_out_judged, identification.fit_judged
    if held_out is None:
        return [
            "There is no validation data: the errors are those of the fit and make the model look better than it is. "
            "Give a recording that the fit does not use."
        ]
    # A model may fit noise as well. Held-out data show it, because their noise is another.
    if is_worse_on_held_out(identification):
        reason = describe_other_conditions(identification) or (
            "the data do not determine the model, or the validation motion shows effects that the identification "
            "motion did not show, such as another load."
        )
        return [
            f"The error on validation data is {format_percent(held_out.relative_total, decimals=1)}, but "
            f"{format_percent(fit.relative_total, decimals=1)} in the fit: {reason}"
        ]
    return []


@dataclass(frozen=True, eq=False)
class SubmodelRelation:
    """Relation of a smaller model to a larger one.

    Parameters
    ----------
    whole : Model
        The larger model.
    weights : (b, b')
        The smaller model's columns are the larger one's times these.
    """

    whole: Model
    weights: FloatArray


def finalise_identification(
    model: Model,
    choices: IdentificationChoices,
    data: Data,
    reduced: ReducedData,
    part_of: SubmodelRelation | None = None,
    shaped: Callable[[FloatArray], Reduction | None] | None = None,
) -> Identification:
    """Solve, judge and describe a model on reduced data.

    Parameters
    ----------
    model : Model
        The robot with the effects that are identified.
    choices : IdentificationChoices
        What is identified, and how.
    data : Data
        Equations that the parameters are solved from.
    reduced : ReducedData
        The same data as it is stored, with the held-out data, and without `shaped`.
    part_of : SubmodelRelation, optional
        A larger model, whose compiled functions are used for this one.
    shaped : function, optional
        Takes parameters (b,), and returns the joints' torques in the model's columns, followed by the columns of
        `shape_columns`.

    Returns
    -------
    Identification
        The identified model, judged and with its warnings.

    Raises
    ------
    DynidentError
        Where the data do not determine the parameters, or the choices do not fit each other.
    """
    problem = Problem.from_choices(model, choices, data)
    # Checked before solving, so that a message can name parameters and joints.
    check_reduction(model, data.equations, problem.known)
    # The wrench does not use the joints' torques to fit, so a dead torque does no harm there.
    if choices.model != "base_wrench":
        check_torque(model, data.torque)
    # The problem has given the rows at reversals their weights: from here on only these weighted rows count.
    data = problem.data
    reduced = reduced.with_changes(equations=data.equations, training=data.torque)
    fitted = solve_by_strategy(choices, problem)
    values = fitted.solution.values
    shapes = ShapeUncertainty.from_fit(problem, fitted, shaped)
    reduced = reduced.with_changes(shaped=defer(lambda: shapes.reduction))

    def find_smallest_eigenvalue() -> float:
        if model.is_at_rest:
            # Of the inertia matrix poses say nothing, so that what it is made of must not be judged.
            return float("nan")
        if part_of is None:
            return compute_smallest_inertia_eigenvalue(model, values)
        return compute_smallest_inertia_eigenvalue(part_of.whole, part_of.weights @ values)

    estimate = Estimate.from_solution(
        model,
        reduced,
        data.reference,
        fitted.solution,
        # The linearised covariance holds only for least squares of the joints' torques; other fits keep their own.
        defer(lambda: shapes.statistics if choices.is_least_squares_of_torque else fitted.statistics),
        standard=fitted.standard,
        shape_constants=defer(lambda: judge_shape_constants(model, shapes.linearisation)),
    )
    if choices.solver.robust:
        estimate = estimate.with_robust_noise()
    result = Identification(
        estimate=estimate,
        choices=choices,
        data=reduced,
        fit=compute_errors(data.torque, values),
        held_out=None if reduced.held_out is None else compute_errors(reduced.held_out, values),
        worst_inertia_eigenvalue=defer(find_smallest_eigenvalue),
        warnings=(),
    )
    return result.with_changes(warnings=defer(lambda: fitted.warnings + list_warnings(result)))


def is_read_again(recordings: Sequence[Recording], rows: CachedRows | None) -> bool:
    """Tell whether rows with shape constants are read from files, which may be gone or others when somebody asks."""
    return rows is None or any(recording.path is not None for recording in recordings)


def identify_model(
    model: Model,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    choices: IdentificationChoices,
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress,
    known: RowsInMemory = NONE_IN_MEMORY,
) -> Identification:
    """Identify the parameters of a model that is built already, with everything decided.

    Parameters
    ----------
    model : Model
        The robot with the effects that are identified.
    recordings, validation : sequence of Recording
        Data that parameters are fitted to, and data that no parameter sees.
    choices : IdentificationChoices
        What is identified, and how; nothing in them is left open.
    preprocessing : Preprocessing
        Filters for all recordings.
    reference : ReferenceParameters
        What torque is predicted with; any where no effect needs the load.
    progress : Progress
        Called with the fraction done and a message.
    known : RowsInMemory, optional
        Of a model that this one extends, for the same recordings and validation data.

    Returns
    -------
    Identification
        The identified model, judged and with its warnings.

    Raises
    ------
    DynidentError
        Where the data do not determine the parameters.
    """
    # Progress by the number of recordings: reducing them takes nearly all of the time.
    inputs = RegressorInputs(recordings, preprocessing, reference)
    share = 0.9 * len(recordings) / (len(recordings) + len(validation))
    training = reduce_to_rows(
        model,
        choices.row_options,
        inputs,
        scale_progress(progress, 0.0, share),
        known.training,
    )
    held_out = None
    if validation:
        held_out = reduce_torque(
            model, replace(inputs, recordings=validation), scale_progress(progress, share, 0.9), known.held_out
        )
    progress(0.9, "solving")
    at_once = is_read_again(recordings, training.rows)
    later = scale_progress(progress, 0.9, 1.0) if at_once else ignore_progress

    def reduce_shapes(values: FloatArray) -> Reduction | None:
        # The rows of the fit alone: shape constants are judged by the data that the parameters come from.
        return reduce_with_shapes(model, values, training.inputs, training.rows, later)

    data = ReducedData(
        training.equations,
        training.torque,
        # Nothing weights these rows: held-out errors count every row alike, in all models.
        None if held_out is None else held_out.torque,
        None,
        preprocessing,
        tuple(recording.name for recording in recordings),
        tuple(recording.name for recording in validation),
        speeds=training.speeds,
        from_commands=any(recording.torque_from_commands for recording in (*recordings, *validation)),
    )
    identified = finalise_identification(model, choices, training, data, shaped=reduce_shapes)
    if at_once:
        _ = identified.data.shaped
    held_out_rows = None if held_out is None else held_out.rows
    return identified.with_changes(in_memory=RowsInMemory(training.rows, held_out_rows))
