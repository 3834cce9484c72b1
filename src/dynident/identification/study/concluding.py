"""A model on reduced data solved, judged and described."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from dynident.arrays import FloatArray
from dynident.estimation import Linearised, Reduction, errors, noise_levels
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.checks import check_reduction, check_torque
from dynident.identification.equations.data import Data
from dynident.identification.fit import Fit
from dynident.identification.parameters.inertia import smallest_inertia_eigenvalue
from dynident.identification.problem import Problem
from dynident.identification.shapes.shape_constants import looked_at_shapes, shape_constants
from dynident.identification.strategies.by_name import fit
from dynident.identification.study.estimate import Estimate
from dynident.identification.study.reduced_data import ReducedData
from dynident.identification.study.result import Identification
from dynident.identification.study.warnings import warnings_of
from dynident.regressors.model import Model


@dataclass(frozen=True, eq=False)
class Part:
    """A model is a part of a larger one, `whole`: its columns are the whole's times `weights` (b, b')."""

    whole: Model
    weights: FloatArray


def conclude(
    model: Model,
    choices: IdentificationChoices,
    data: Data,
    reduced: ReducedData,
    part_of: Part | None = None,
    shaped: Callable[[FloatArray], Reduction | None] | None = None,
) -> Identification:
    """Solve, judge and describe a model on reduced data.

    Parameters
    ----------
    data : Data
        What the model is solved from.
    reduced : ReducedData
        The same as it is kept, with the held-out data, and without `shaped`.
    part_of : Part, optional
        A larger model: what is compiled for that one serves.
    shaped : function, optional
        Gives the joints' torques in the model's columns and, behind them, those of `shape_columns` at parameters (b,).
    """
    problem = Problem.of(model, choices, data)
    check_reduction(model, data.equations, problem.known)
    if choices.model != "base_wrench":
        check_torque(model, data.torque)
    data = problem.data
    reduced = replace(reduced, equations=data.equations, training=data.torque)
    found = fit(choices, problem)
    values = found.solution.values
    with_shapes = None if shaped is None else shaped(values)
    if with_shapes is not None:
        with_shapes = with_shapes.weighing_turns(data.weights)
    looked = None if with_shapes is None else _with_shapes_uncertain(problem, found, with_shapes)
    if part_of is None:
        smallest = smallest_inertia_eigenvalue(model, values)
    else:
        smallest = smallest_inertia_eigenvalue(part_of.whole, part_of.weights @ values)
    certain = not choices.least_squares_of_torque
    estimate = Estimate.of(
        model,
        reduced,
        data.reference,
        found.solution,
        found.statistics if certain or looked is None else looked.of_parameters,
        standard=found.standard,
        shape_constants=shape_constants(model, looked),
    )
    result = Identification(
        estimate=estimate,
        choices=choices,
        data=replace(reduced, shaped=with_shapes),
        fit=errors(data.torque, values),
        held_out=None if reduced.held_out is None else errors(reduced.held_out, values),
        worst_inertia_eigenvalue=smallest,
        warnings=(),
    )
    return replace(result, warnings=found.warnings + warnings_of(result))


def _with_shapes_uncertain(problem: Problem, found: Fit, with_shapes: Reduction) -> Linearised | None:
    """What the joints' torques say of the shape constants, whatever rows the parameters were solved from."""
    data, solution = problem.data, found.solution
    if data.equations is not data.torque:
        solution = replace(solution, noise=noise_levels(data.torque, solution.values))
    return looked_at_shapes(problem.model, solution, problem.covariance, with_shapes)
