"""Feasible parameters: fit positive definite pseudo-inertias, and find the feasible ones nearest to an estimate.

Holds how far feasible parameters may raise the error (1.02).

The standard parameters φ are the unknowns and the base parameters are β = G φ. So the data are fitted as well as by any
parameters that a real robot could have: the pseudo-inertia of every link and payload has no negative eigenvalue, and no
rotor inertia is negative, nor friction where it is Coulomb and viscous alone. The data determine β alone. Of the φ that
give it, those nearest to the description are taken; the distance is measured by how far descriptions usually are off
(`robot.pseudo_inertia`), and without a prior this decides nothing that the data can decide. With the entropic
prior the distance from the description's bodies is part of the cost (`prior.entropic`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import Reduction, Solution, compute_errors, compute_noise_levels, solve_weighted, statistics
from dynident.estimation.constrained_least_squares import ConstrainedSolution
from dynident.estimation.least_squares import are_weights_settled, compute_correlated_noise
from dynident.estimation.residual_correlation import join_dependent_blocks
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.estimation_problem_options import DescriptionTrust
from dynident.identification.estimators.feasible_problem import (
    WEAK,
    FeasibleProblem,
    StandardPrior,
    build_problem,
    build_standard_prior,
    find_resisting_speeds,
)
from dynident.identification.standard_parameters import StandardParameters, find_bodies
from dynident.number_format import format_percent
from dynident.parallel import defer
from dynident.regressors.model_structure import Model

_ROUNDS = 20
"""Rounds of weighing by the residual, at most."""

# Newton's method: predicted decrease of the cost, in squared standard deviations, at which it ends; share of the
# decrease that a step has to reach; shortest step; and most steps.
_SETTLED, _PAYS, _SHORTEST, _MOST_STEPS = 1e-10, 1e-4, 1e-9, 100
FREE = 1.02
"""Times the error of the fit up to which feasible parameters cost nothing. Of 20 models of eight real machines, plain
and extended ones, those below have a held-out error that rises by 0.5 % at most or falls; above, it rises by up to 9 %.
"""

# Weight of the description in what the data leave open, where only the distance is wanted: it must not add to it. With
# the usual 0.03 feasible parameters of a real arm seem eleven standard deviations off, with this 0.1.
_TO_COMPARE = 1e-5
# Distance in standard deviations of all parameters together within which two estimates are the same: feasible estimates
# of nine real machines are at 0.14 at most, by rounding; those of plain least squares at 6.9 at least.
_FEASIBLE = 0.2


def solve_feasible(request: Problem) -> Fit:
    """Return weighted least squares over all parameters that a real robot can have.

    Standard deviations take the constraints that hold the solution back as certain.

    Parameters
    ----------
    request : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        With standard parameters, and warnings about the constraints that are active.

    Raises
    ------
    DynidentError
        Where the data, with what is known beside them, do not determine the base parameters, or where nothing that is
        possible was found.
    """
    model, data, known = request.model, request.data, request.known
    unconstrained = solve_weighted(data.equations, known)
    believed = build_standard_prior(model, request.trust, unconstrained)
    speeds = find_resisting_speeds(model, data.speeds)
    problem = build_problem(model, data.equations, known, believed.approximate_at(believed.belief.mean), speeds)
    # Beside a prior rows count as information: correlated ones must not count as independent samples.
    is_weighed = known is not None and known.has_rows
    joined = join_dependent_blocks(data.equations, unconstrained)

    def compute_levels(fit: Solution) -> FloatArray:
        if is_weighed:
            return compute_correlated_noise(data.equations, fit, joined)
        return compute_noise_levels(data.equations, fit.values)

    noise = unconstrained.noise
    converged = False
    for _ in range(_ROUNDS):
        if believed.entropic is None:
            constrained = problem.solve(noise)
        else:
            problem, constrained = minimise_entropic_cost(model, problem, believed, noise, speeds)
        # The noise depends on the residual, and that on the weights by the noise: iterate until both agree.
        before, noise = noise, compute_levels(problem.to_solution(constrained, noise))
        if converged := are_weights_settled(data.equations, before, noise):
            break
    solution = replace(problem.to_solution(constrained, noise), converged=converged)
    return Fit(
        solution,
        defer(lambda: statistics(data.equations, solution, request.covariance)),
        _list_warnings(model, problem, constrained, data.equations, unconstrained),
        problem.to_standard_parameters(constrained, noise),
    )


@dataclass(frozen=True, eq=False)
class NearestFeasible:
    """The feasible parameters nearest to estimated ones.

    Parameters
    ----------
    values : (b,)
        The feasible base parameters.
    standard : StandardParameters
        Standard parameters with these base parameters.
    distance : float
        Distance of the estimated parameters from them, in their own standard deviations.
    limits : tuple of str
        Names of the active constraints.
    """

    values: FloatArray
    standard: StandardParameters
    distance: float
    limits: tuple[str, ...]

    @property
    def is_feasible(self) -> bool:
        """Whether the estimated parameters themselves are feasible."""
        return self.distance <= _FEASIBLE


def find_nearest_feasible(
    model: Model,
    equations: Reduction,
    solution: Solution,
    trust: DescriptionTrust,
    weak: float = _TO_COMPARE,
    speeds: FloatArray | None = None,
) -> NearestFeasible:
    """Find the parameters of a robot that can exist nearest to those of a solution, whatever estimated it.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    equations : Reduction
        That the solution is from.
    solution : Solution
        Estimated base parameters.
    trust : DescriptionTrust
        Prior from the description, if any, and how far it is trusted.
    weak : float
        What a usual error of the description counts for in what the data leave open, in standard deviations.
    speeds : (n,), optional
        Largest recorded speeds in rad/s or m/s, up to which all friction together must resist.

    Returns
    -------
    NearestFeasible
        The parameters, and their distance from the solution.

    Raises
    ------
    DynidentError
        Where nothing that is possible was found.
    """
    # Without the prior: the distance shall be one from what the data say, and the description only fills in the rest.
    believed = build_standard_prior(model, replace(trust, prior=None), solution)
    problem = build_problem(model, equations, solution.known, believed.approximate_at(believed.belief.mean), speeds)
    constrained = problem.solve_nearest_to(solution, weak)
    values = problem.to_base_parameters(constrained)
    # The factor is the root of the information matrix, so this is the distance in standard deviations.
    distance = float(np.linalg.norm(solution.factor @ (values - solution.values)))
    names = problem.bound_names
    limits = [model.columns[k].name for k in constrained.zeros]
    limits += dict.fromkeys(names[place] for place in constrained.edges)
    return NearestFeasible(values, problem.to_standard_parameters(constrained, solution.noise), distance, tuple(limits))


def move_where_free(model: Model, equations: Reduction, fitted: Fit, trust: DescriptionTrust) -> Fit:
    """Move a fit to the nearest feasible parameters where its error grows by less than `FREE`; else leave it.

    The covariance stays. The feasible set holds the truth and is convex, so that moving to it brings no estimate
    farther from the truth, measured by that covariance, and intervals of the same width hold it as often.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    equations : Reduction
        Equations that the solution is from.
    fitted : Fit
        The fit.
    trust : DescriptionTrust
        Prior from the description, if any, and how far it is trusted.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.
    """
    # An effect of some runs alone, such as a payload, is a difference between runs, and the question is whether it
    # exists at all. Constrained to a body that can exist, it would always seem to.
    if not find_bodies(model.columns) or any(column.runs for column in model.columns):
        return fitted
    try:
        nearest = find_nearest_feasible(model, equations, fitted.solution, trust, WEAK)
    except DynidentError:
        return fitted
    before, after = (compute_errors(equations, values).rms_total for values in (fitted.solution.values, nearest.values))
    if after > FREE * before:
        return fitted
    # Parameters of bodies that can exist, with no limit reached, stay exactly as they are. Others are moved: to the
    # limits that are reached, or where the solver stopped a little before them and no limit is named.
    if nearest.is_feasible and not nearest.limits:
        return fitted.with_changes(standard=nearest.standard)
    return fitted.with_changes(solution=replace(fitted.solution, values=nearest.values), standard=nearest.standard)


def minimise_entropic_cost(
    model: Model,
    problem: FeasibleProblem,
    believed: StandardPrior,
    noise: FloatArray,
    speeds: FloatArray | None = None,
) -> tuple[FeasibleProblem, ConstrainedSolution]:
    """Minimise the cost with the entropic prior by Newton's method.

    The cost is convex. The divergence is a barrier like a logarithm's, so Newton's method with steps that are cut back
    until they pay converges from anywhere. Every step is a least-squares problem of the same kind.

    Returns
    -------
    tuple of FeasibleProblem and ConstrainedSolution
        The problem at the minimum, and its solution.
    """
    prior, unit = believed.entropic, problem.unit
    assert prior is not None
    data, right = problem.build_rows(noise, None, problem.rest[:0])

    def compute_cost(values: FloatArray) -> float:
        divergence = prior.compute_cost(unit * values)
        return float(np.sum((data @ values - right) ** 2)) + divergence

    # Bodies of the prior start at the description, where the cost is finite; all other parameters at the constrained
    # least-squares solution.
    values = problem.solve(noise).values
    values[prior.columns] = believed.belief.mean[prior.columns] / unit[prior.columns]
    for _ in range(_MOST_STEPS):
        problem = build_problem(model, problem.equations, problem.known, believed.approximate_at(unit * values), speeds)
        constrained = problem.solve(noise)
        # The minimiser of the normal approximation is Newton's step, as the approximation has the slope and curvature
        # of the cost.
        step = constrained.values - values
        rows, goal = problem.build_rows(noise, problem.known, problem.rest)
        slope = 2.0 * float((rows @ values - goal) @ (rows @ step))
        # The slope along the step says what it would still gain: below this it has settled.
        if slope > -_SETTLED:
            return problem, replace(constrained, values=np.asarray(values))
        share, before = 1.0, compute_cost(values)
        # Backtracking (Armijo): halve the step until the cost falls by a share of what its slope promises.
        while compute_cost(values + share * step) > before + _PAYS * share * slope and share > _SHORTEST:
            share *= 0.5
        values = values + share * step
        if not np.isfinite(compute_cost(values)):
            break
    raise DynidentError(
        "the search for the physically feasible parameters nearest to the description did not converge: a prior_error "
        f"of {prior.share:g} may be too large. Give a smaller one, or use the prior description",
        pointer="/prior",
        title="Not converged",
    )


def _list_warnings(
    model: Model,
    problem: FeasibleProblem,
    constrained: ConstrainedSolution,
    equations: Reduction,
    unconstrained: Solution,
) -> tuple[str, ...]:
    """Name the active constraints, and what feasibility costs in the residual."""
    sentences = []
    at_zero = [model.columns[k].name for k in constrained.zeros]
    if at_zero:
        sentences.append(f"Held at zero, because negative values are not physically possible: {', '.join(at_zero)}.")
    at_edge = [problem.bound_names[place] for place in constrained.edges if place < len(problem.bodies)]
    pushed = dict.fromkeys(problem.bound_names[p] for p in constrained.edges if p >= len(problem.bodies))
    if at_edge:
        sentences.append(
            f"Held at the limit of physical feasibility (no part of a body has negative mass): {', '.join(at_edge)}."
        )
    if pushed:
        sentences.append(f"Held where it would drive the motion at some speed: {', '.join(pushed)}.")
    if sentences:
        sentences.append("The standard deviations assume that these limits are exact.")
    # A constraint that costs much says that the data contradict the model, or do not determine it.
    before = compute_errors(equations, unconstrained.values).rms_total
    after = compute_errors(equations, problem.to_base_parameters(constrained)).rms_total
    if before > 0 and after > FREE * before:
        sentences.append(
            "Physical feasibility increases the residual of the fit by "
            f"{format_percent(after / before - 1, decimals=0)}: without it the data give parameters that no robot has, "
            "because the motion does not determine them or an effect is missing."
        )
    return tuple(sentences)
