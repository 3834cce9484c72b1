"""Essential parameters of a model and its strongly correlated ones, as sentences; estimation/ has the algorithms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import (
    CovarianceName,
    Errors,
    Reduction,
    Solution,
    Statistics,
    compute_errors,
    eliminate_parameters,
    solve,
    statistics,
)
from dynident.estimation.backward_elimination import Stop, WaldTest, compute_wald_test
from dynident.estimation.parameter_correlation import (
    NOT_DETERMINED,
    Collinearity,
    CorrelatedPair,
    WeakDirection,
    find_collinearity,
)
from dynident.estimation.parameter_covariance import compute_null_space, compute_pooled_statistics, find_occupied_blocks
from dynident.estimation.residual_correlation import FEWEST_BLOCKS, join_dependent_blocks
from dynident.identification.description_prior import check_unique
from dynident.identification.identification_choices import EssentialChoices
from dynident.identification.identified_models.identification_result import Estimate, Identification
from dynident.identification.shape_constant_intervals import linearise_shapes
from dynident.identification.standard_parameters import compute_smallest_inertia_eigenvalue
from dynident.parallel import single_threaded
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.schema.fields import check_value

MOST_SENTENCES = 10
_MOST_PARTS = 5


@dataclass(frozen=True, eq=False)
class ParameterDependence:
    """Dependence of the parameters of a model.

    Parameters
    ----------
    names : tuple of str
        Names of the base parameters.
    correlation : (b, b)
        Correlation of their estimates, for a heat map.
    sentences : tuple of str
        What is determined only together, worst first.
    dependence : Collinearity
        What the analysis found, in numbers.
    """

    names: tuple[str, ...]
    correlation: FloatArray
    sentences: tuple[str, ...]
    dependence: Collinearity


@single_threaded
def parameter_dependence(identification: Identification, most: int = MOST_SENTENCES) -> ParameterDependence:
    """Say which parameters the motion determines only together.

    Parameters
    ----------
    identification : Identification
        The identified model.
    most : int
        Largest number of sentences.

    Returns
    -------
    ParameterDependence
        The correlation of the parameters, and sentences about the worst of it.
    """
    names = tuple(column.name for column in identification.model.kept)
    analysis = find_collinearity(identification.estimate.solution, _compute_motion_statistics(identification), most)
    sentences = [_describe_direction(direction, names) for direction in analysis.directions]
    sentences += [_describe_pair(pair, names) for pair in analysis.pairs]
    return ParameterDependence(names, analysis.correlation, tuple(sentences[:most]), analysis)


def _compute_motion_statistics(identification: Identification) -> Statistics:
    """Return the statistics that show how the motion couples the estimates."""
    if identification.choices.covariance == "independent" or identification.estimate.not_essential:
        return identification.statistics
    # A covariance from a few blocks of time has a low rank and makes up correlations; a pooled one does not.
    return compute_pooled_statistics(identification.data.equations, identification.estimate.solution)


def _describe_pair(pair: CorrelatedPair, names: tuple[str, ...]) -> str:
    first_name, second_name = names[pair.first], names[pair.second]
    # A negative correlation leaves the sum certain, a positive one the difference.
    rather = "sum" if pair.correlation < 0 else "difference"
    return (
        f"{first_name} and {second_name} are determined only together (correlation {pair.correlation:.2f}). Each "
        f"divided by its standard deviation, their {rather} is known better than either."
    )


def _describe_direction(direction: WeakDirection, names: tuple[str, ...]) -> str:
    # The largest part leads with the factor one; the others are relative to it.
    text = names[direction.parts[0][0]]
    for number, factor in direction.parts[1:_MOST_PARTS]:
        size = abs(factor)
        text += f" {'+' if factor > 0 else '-'} {'' if abs(size - 1) < 0.005 else f'{size:.2g} '}{names[number]}"
    if len(direction.parts) > _MOST_PARTS:
        text += f" and {len(direction.parts) - _MOST_PARTS} more"
    how = "is not determined" if direction.ratio >= NOT_DETERMINED else "is hardly determined"
    return f"{text} {how}: this motion shows it {direction.ratio:.0f} times less than the best-determined combination."


@dataclass(frozen=True, eq=False)
class EssentialStep:
    """One step of the backward elimination: a parameter that was taken out.

    Parameters
    ----------
    name : str
        Name of the parameter.
    relative_deviation : float
        Relative standard deviation of the parameter before it went, a fraction.
    ratio : float
        Ratio of the largest to the smallest relative standard deviation of all parameters before it went.
    p_value : float
        Probability that noise alone would be as large as all that is taken out so far.
    fit : Errors
        Errors of the smaller model on the data of the fit.
    held_out : Errors or None
        Errors of the smaller model on held-out data.
    fit_moving : Errors
        As `fit`, where each joint moves.
    held_out_moving : Errors or None
        As `held_out`, where each joint moves.
    """

    name: str
    relative_deviation: float
    ratio: float
    p_value: float
    fit: Errors
    held_out: Errors | None
    fit_moving: Errors
    held_out_moving: Errors | None


@dataclass(frozen=True, eq=False)
class EssentialPath:
    """The steps from the identified parameters to the essential ones.

    Parameters
    ----------
    essential : tuple of str
        Names of the parameters that remain.
    steps : tuple of EssentialStep
        The steps in the order of elimination.
    stop : str
        Why the elimination ended: "ratio" (the rule is met), "test" (the next step would remove more than noise
        explains) or "last" (one parameter is left).
    ratio : float
        Ratio of the largest to the smallest relative standard deviation that remains.
    refused : str or None
        The parameter that would have been next where the test ended the elimination.
    identification : Identification
        The model with the essential parameters estimated anew, the others zero.
    """

    essential: tuple[str, ...]
    steps: tuple[EssentialStep, ...]
    stop: Stop
    ratio: float
    refused: str | None
    identification: Identification

    @property
    def reason(self) -> str:
        """Why the elimination ended, in a sentence."""
        count = f"{len(self.essential)} of {len(self.essential) + len(self.steps)} parameters are essential"
        if self.stop == "ratio":
            return f"{count}: their relative standard deviations differ by at most a factor of {self.ratio:.2g}."
        if self.stop == "last":
            return f"{count}: no other parameter can be removed."
        return (
            f"{count}. The next one, {self.refused}, is kept: without it the error would increase by more than noise "
            f"explains. (The relative standard deviations still differ by a factor of {self.ratio:.3g}.)"
        )


@single_threaded
def essential_parameters(identification: Identification, ratio: float = EssentialChoices.ratio) -> EssentialPath:
    """Find the essential parameters of an identified model by backward elimination [Pham and Gautier 1991].

    All on the reduced data, by least squares weighted as the identification was.

    Parameters
    ----------
    identification : Identification
        The identified model.
    ratio : float
        Largest over smallest relative standard deviation at which the elimination ends; above 1 (§12.7).

    Returns
    -------
    EssentialPath
        The parameters that remain, the steps that led there, and the model with them.

    Raises
    ------
    EstimationError
        Where the data do not determine the model.
    """
    check_value(EssentialChoices, "ratio", ratio)
    equations, names = identification.data.equations, [column.name for column in identification.model.kept]
    full = _solve_plainly(identification)
    # The test is about many parameters at a time: a covariance from blocks of time alone has not the rank for it.
    path = eliminate_parameters(equations, full, compute_pooled_statistics(equations, full), ratio)
    held_out = identification.data.held_out
    steps = tuple(
        EssentialStep(
            names[step.removed],
            step.relative_deviation,
            step.ratio,
            step.p_value,
            compute_errors(identification.data.training, step.values),
            None if held_out is None else compute_errors(held_out, step.values),
            compute_moving_errors(identification.data.training, step.values),
            None if held_out is None else compute_moving_errors(held_out, step.values),
        )
        for step in path.eliminations
    )
    return EssentialPath(
        essential=tuple(name for k, name in enumerate(names) if k not in path.removed),
        steps=steps,
        stop=path.stop,
        ratio=path.ratio,
        refused=None if path.refused is None else names[path.refused.removed],
        identification=_restrict_to_essential(identification, full, path.removed),
    )


def _solve_plainly(identification: Identification) -> Solution:
    """Return least squares with the noise and the prior of an identification, whatever estimator that used."""
    equations, solution = identification.data.equations, identification.estimate.solution
    return solve(equations, solution.noise, solution.known)


@single_threaded
def compare_nested(larger: Identification, smaller: Identification) -> WaldTest:
    """Test whether what a model has beyond a smaller one is more than noise.

    The smaller model's parameters are those of the larger one under linear conditions: parameters of effects that it
    lacks are zero, and parameters that it takes as known have their values. The test is on the estimates of the larger
    model where that is robust, and else on weighted least squares of its rows, without the limits of bodies that can
    exist. The covariance is the one that was chosen for it; that over blocks of time has as many degrees of freedom as
    there are blocks, and the test is Hotelling's.

    Parameters
    ----------
    larger, smaller : Identification
        Models of the same recordings with the same filters, the effects of one among those of the other.

    Returns
    -------
    WaldTest
        F test of the conditions.

    Raises
    ------
    DynidentError
        Where the models are of other data, or the smaller one is no part of the larger one.
    """
    _check_same_data(larger, smaller)
    _check_same_knowledge(larger, smaller)
    own, known = larger.model, _list_known(smaller)
    assumed = set(_list_known(larger))
    keys = [column.key for column in own.columns]
    names = [column.name for column in own.kept]
    strangers = [column.name for column in smaller.model.columns if column.key not in keys]
    strangers += [name for name in known if name not in names]
    if strangers or not assumed <= set(known):
        missing = ", ".join(strangers or sorted(assumed - set(known)))
        raise DynidentError(
            f"the smaller model is no part of the larger one, which does not have {missing} as a parameter to "
            "estimate; give models of which one has all effects of the other, with the same constants, or compare "
            "held-out errors",
            pointer="restricted",
            title="Models that are not nested",
        )
    present = {column.key for column in smaller.model.columns}
    tested = {name: pair for name, pair in known.items() if name not in assumed}
    free = [k for k, column in enumerate(own.columns) if column.key in present]
    equations, kind = larger.data.equations, larger.choices.covariance
    # Essential parameters are least squares without the weights of rows, and the others have no deviation.
    if larger.choices.solver.robust and not larger.estimate.not_essential:
        full, uncertainty = larger.estimate.solution, larger.statistics
    else:
        full = _solve_plainly(larger)
        uncertainty = statistics(equations, full, kind)
    # Parameters in units of their standard deviations: kg and kg m² would not compare.
    deviations = np.where(full.is_held, 1.0, np.maximum(uncertainty.standard_deviations, np.finfo(float).tiny))
    grouping = own.base.grouping / deviations[:, None]
    reached = grouping[:, free]
    sizes = np.linalg.norm(reached, axis=0)
    # Functions of the parameters that nothing in the smaller model can change.
    functions = compute_null_space((reached / np.where(sizes > 0, sizes, 1.0)).T).T
    # Parameters that the smaller model knows, each a condition of its own.
    fixed = np.eye(len(deviations))[[names.index(name) for name in tested]]
    n_zero, functions = len(functions), np.vstack([functions, fixed])
    if not len(functions):
        raise DynidentError(
            "both models have the same parameters, so there is nothing to test",
            pointer="restricted",
            title="Models that are not nested",
        )
    covariance = functions @ (uncertainty.covariance / np.outer(deviations, deviations)) @ functions.T
    values = functions @ (full.values / deviations)
    for row, (name, (value, error)) in enumerate(tested.items(), n_zero):
        unit = deviations[names.index(name)]
        values[row] -= value / unit
        covariance[row, row] += (error / unit) ** 2
    return _test_conditions(larger, values, covariance, float(uncertainty.freedom.min()))


def compute_test_of_values(identification: Identification, values: Mapping[str, float | str]) -> WaldTest:
    """Test whether parameters of a model have given values, or are equal to others, all at once.

    Parameters
    ----------
    identification : Identification
        The model; its own estimates and their covariance are tested.
    values : mapping of str to float or str
        By name of a base parameter, its value or the name of another one that it is equal to.

    Returns
    -------
    WaldTest
        F test of the estimates minus these values; Hotelling's with a covariance over blocks of time.

    Raises
    ------
    DynidentError
        For a parameter that was not estimated, or too few blocks of time.
    """
    names, uncertainty = [column.name for column in identification.model.kept], identification.statistics
    conditions, right = np.zeros((len(values), len(names))), [0.0 if isinstance(v, str) else v for v in values.values()]
    for row, (name, value) in enumerate(values.items()):
        for term, sign in ((name, 1.0), *(((value, -1.0),) if isinstance(value, str) else ())):
            check_unique(term, names, "values")
            conditions[row, names.index(term)] = sign
    if np.linalg.matrix_rank(conditions) < len(values):
        raise DynidentError("values says one thing twice; leave out what follows from the rest", pointer="values")
    tested = conditions.any(axis=0)
    fixed = [names[k] for k in np.flatnonzero(tested) if uncertainty.standard_deviations[k] == 0]
    if fixed:
        raise DynidentError(
            f"{', '.join(fixed)} was held or set and not estimated, so there is nothing to test",
            title="Not estimated",
        )
    difference, freedom = conditions @ identification.values - right, float(uncertainty.freedom[tested].min())
    covariance = conditions @ uncertainty.covariance @ conditions.T
    # One value is tested as its interval is, lest the two contradict each other.
    test = compute_wald_test if len(values) == 1 else partial(_test_conditions, identification)
    return test(difference, covariance, freedom)


def _test_conditions(
    identification: Identification, values: FloatArray, covariance: FloatArray, freedom: float
) -> WaldTest:
    """Test whether functions of estimates are zero, with the degrees of freedom that their covariance is known with."""
    kind, solution = identification.choices.covariance, identification.estimate.solution
    blocks = int(find_occupied_blocks(join_dependent_blocks(identification.data.equations, solution)).sum())
    if kind != "by_time_and_joints" or blocks < FEWEST_BLOCKS:
        return compute_wald_test(values, covariance, freedom)
    if blocks <= len(values):
        raise DynidentError(
            f"the recordings have {blocks} blocks of time, too few to test {len(values)} conditions at once; record "
            "longer, or compare errors on held-out data",
            pointer="values",
            title="Too little data",
        )
    return compute_wald_test(values, covariance, blocks - 1.0, from_blocks=True)


def _check_same_data(larger: Identification, smaller: Identification) -> None:
    # Recordings of one name may hold other samples; files of earlier versions and poses have no digests.
    has_digests = larger.data.digests and smaller.data.digests
    ways = [
        (
            sorted(model.data.digests if has_digests else model.data.measurement_names),
            model.preprocessing,
            model.choices.model,
            model.choices.weigh_turns,
        )
        for model in (larger, smaller)
    ]
    if ways[0] != ways[1]:
        raise DynidentError(
            "the models are of other recordings, filters, equations or weights, so a test of what one has beyond the "
            "other does not apply: identify both from the same recordings with filters=model.filters, or compare their "
            "errors on held-out data",
            pointer="restricted",
            title="Models that are not nested",
        )


def _list_known(identification: Identification) -> dict[str, tuple[float, float]]:
    """Return the known values of a model with their standard deviations, by name."""
    return {name: (value, error) for name, value, error in identification.choices.trust.known}


def _check_same_knowledge(larger: Identification, smaller: Identification) -> None:
    """Raise where models use other values of what both know, or the description in other ways."""
    own, known = _list_known(larger), _list_known(smaller)
    others = [name for name in own if name in known and own[name] != known[name]]
    priors = [replace(model.choices.trust, known=()) for model in (larger, smaller)]
    # Its usual error counts for nothing without the description.
    if others or (priors[0] != priors[1] and any(prior.prior for prior in priors)):
        reason = (
            f"have different known values or errors of {', '.join(others)}"
            if others
            else "use the description in different ways"
        )
        raise DynidentError(
            f"the models {reason}, so neither is part of the other: identify both with the same, or compare their "
            "errors on held-out data",
            pointer="restricted",
            title="Models that are not nested",
        )


def _restrict_to_essential(identification: Identification, full: Solution, removed: tuple[int, ...]) -> Identification:
    """Return the model with the parameters `removed` set to zero and the others estimated anew."""
    # All are essential: the model stays as it is, with its own estimator's solution.
    if not removed:
        return identification
    c = identification.model.n_parameters
    essential = np.array([k for k in range(c) if k not in removed], dtype=np.intp)
    solution, fitted = _solve_essential(
        identification.data.equations, full, essential, identification.choices.covariance
    )
    fitted = _compute_statistics_with_shapes(identification, solution, essential) or fitted
    # Parameters that are set to zero have no variance, and infinite degrees of freedom: they are constants now.
    values, covariance, freedom = np.zeros(c), np.zeros((c, c)), np.full(c, np.inf)
    freedom[essential] = fitted.freedom
    values[essential] = solution.values
    covariance[np.ix_(essential, essential)] = fitted.covariance
    estimate = Estimate.from_solution(
        identification.model,
        identification.data,
        identification.estimate.reference,
        replace(full, values=values),
        Statistics(covariance, fitted.effective_rows, fitted.noise, freedom),
        not_essential=removed,
        shape_constants=identification.shape_constants,
    )
    # Parameters at zero may make the inertia matrix indefinite, which has to be known of the smaller model.
    smallest = compute_smallest_inertia_eigenvalue(identification.model, values)
    held_out = identification.data.held_out
    return replace(
        identification,
        estimate=estimate,
        fit=compute_errors(identification.data.training, values),
        held_out=None if held_out is None else compute_errors(held_out, values),
        worst_inertia_eigenvalue=smallest,
    )


def _compute_statistics_with_shapes(
    identification: Identification, solution: Solution, essential: NDArray[np.intp]
) -> Statistics | None:
    """Return the statistics of the essential parameters with the shape constants uncertain; None where they are not."""
    shaped, choices = identification.data.shaped, identification.choices
    # Shape constants were linearised about least squares of the torques; other estimates have no such covariance.
    if shaped is None or not choices.is_least_squares_of_torque:
        return None
    constants = np.arange(identification.model.n_parameters, shaped.n_columns)
    data = shaped.select_columns(np.concatenate([essential, constants]))
    looked = linearise_shapes(identification.model, solution, choices.covariance, data)
    return None if looked is None else looked.parameter_statistics


def _solve_essential(
    equations: Reduction, full: Solution, essential: NDArray[np.intp], covariance: CovarianceName
) -> tuple[Solution, Statistics]:
    """Solve for the essential parameters alone, numbered in `essential`."""
    # Parameters that are set to zero drop out of the rows of the prior as well.
    known = None if full.known is None else full.known.select_columns(essential)
    smaller = equations.select_columns(essential)
    solution = solve(smaller, full.noise, known)
    return solution, statistics(smaller, solution, covariance)
