"""Fit the parameters of a model that is built already, judge the result, and put it together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import LinearisedSolution, Reduction, compute_errors, compute_noise_levels
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.checks import check_reduction, check_torque
from dynident.identification.equations.reduce_data import Data, reduce_to_rows, reduce_torque
from dynident.identification.fit import Fit
from dynident.identification.parameters.inertia_matrix import compute_smallest_inertia_eigenvalue
from dynident.identification.problem import Problem
from dynident.identification.shapes.shape_columns import build_shape_columns, list_shape_variables
from dynident.identification.shapes.shape_constants import judge_shape_constants, linearise_shapes
from dynident.identification.strategies.dispatch import solve_by_strategy
from dynident.identification.study.estimate import Estimate
from dynident.identification.study.model_warnings import list_warnings
from dynident.identification.study.reduced_data import ReducedData
from dynident.identification.study.result import NONE_IN_MEMORY, Identification, RowsInMemory
from dynident.progress import Progress, scale_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model
from dynident.regressors.row_cache import reduce_with_columns


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
    reduced = replace(reduced, equations=data.equations, training=data.torque)
    fitted = solve_by_strategy(choices, problem)
    values = fitted.solution.values
    # Columns of the shape constants are derivatives of the torque, so they need the parameters that were just found.
    with_shapes = None if shaped is None else shaped(values)
    if with_shapes is not None:
        with_shapes = with_shapes.weight_reversals(data.reversal_weights)
    looked = None if with_shapes is None else _linearise_shapes(problem, fitted, with_shapes)
    if model.is_at_rest:
        # Of the inertia matrix poses say nothing, so that what it is made of must not be judged.
        smallest = float("nan")
    elif part_of is None:
        smallest = compute_smallest_inertia_eigenvalue(model, values)
    else:
        smallest = compute_smallest_inertia_eigenvalue(part_of.whole, part_of.weights @ values)
    # The linearised covariance holds only for least squares of the joints' torques; other fits keep their own.
    certain = not choices.is_least_squares_of_torque
    estimate = Estimate.from_solution(
        model,
        reduced,
        data.reference,
        fitted.solution,
        fitted.statistics if certain or looked is None else looked.parameter_statistics,
        standard=fitted.standard,
        shape_constants=judge_shape_constants(model, looked),
    )
    result = Identification(
        estimate=estimate,
        choices=choices,
        data=replace(reduced, shaped=with_shapes),
        fit=compute_errors(data.torque, values),
        held_out=None if reduced.held_out is None else compute_errors(reduced.held_out, values),
        worst_inertia_eigenvalue=smallest,
        warnings=(),
    )
    return replace(result, warnings=fitted.warnings + list_warnings(result))


def _linearise_shapes(problem: Problem, fitted: Fit, with_shapes: Reduction) -> LinearisedSolution | None:
    """Linearise the joints' torques about the shape constants, whatever rows the parameters were solved from."""
    data, solution = problem.data, fitted.solution
    # The noise of power or energy rows says nothing of a torque in N m, so it is estimated from the torque rows.
    if data.equations is not data.torque:
        solution = replace(solution, noise=compute_noise_levels(data.torque, solution.values))
    return linearise_shapes(problem.model, solution, problem.covariance, with_shapes)


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
    share = 0.9 * len(recordings) / (len(recordings) + len(validation))
    training = reduce_to_rows(
        model,
        choices.row_options,
        recordings,
        preprocessing,
        reference,
        scale_progress(progress, 0.0, share),
        known.training,
    )
    held_out = None
    if validation:
        held_out = reduce_torque(
            model, validation, preprocessing, reference, scale_progress(progress, share, 0.9), known.held_out
        )
    progress(0.9, "solving")
    solve_progress = scale_progress(progress, 0.9, 1.0)

    def reduce_shapes(values: FloatArray) -> Reduction | None:
        places = list_shape_variables(model.effects)
        if not places:
            return None
        columns = build_shape_columns(model, values, places)
        # The rows of the fit alone: shape constants are judged by the data that the parameters come from.
        ordinary = training.recordings
        return reduce_with_columns(model, columns, ordinary, preprocessing, reference, solve_progress, training.rows)

    data = ReducedData(
        training.equations,
        training.torque,
        # Held-out errors count every row alike, so that they can be compared between models with other weights.
        None if held_out is None else held_out.torque.with_fixed_weights,
        None,
        preprocessing,
        tuple(recording.name for recording in recordings),
        tuple(recording.name for recording in validation),
    )
    identified = finalise_identification(model, choices, training, data, shaped=reduce_shapes)
    return replace(identified, in_memory=RowsInMemory(training.rows, None if held_out is None else held_out.rows))
