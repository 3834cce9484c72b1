"""Strategy "sequential" [12.22]-[12.24]: link by link from the terminal one, or the wrist and then the shoulder.

Holds when a parameter is left to a later step.

A step finds linear functions of the parameters: single parameters as a rule, combinations where its equations do not
tell some parameters apart. As in [12.24], later steps do not correct the estimates of earlier ones. Two things keep
errors from accumulating. Earlier estimates enter as measurements with their own covariance, so that rows in which they
are uncertain count for less (the weighted solution that [Gautier 97] proposes). And a function that a step determines
much worse than the later steps will is left to them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh, solve_triangular

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import (
    EquationFactors,
    EstimationError,
    PriorInformation,
    Reduction,
    Solution,
    Statistics,
    build_prior,
    build_weighted_factor,
    compute_pooled_statistics,
    compute_row_freedom,
    count_effective_rows,
    describe_fit,
)
from dynident.estimation.parameter_covariance import (
    MOST_FREEDOM,
    CovarianceName,
    estimate_cluster_covariance,
    has_enough_blocks,
)
from dynident.estimation.residual_correlation import compute_rests, compute_scores, join_dependent_blocks
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, Estimator, StepsName, StrategyChoices
from dynident.robot.robot_model import Robot

# Share of the largest singular value, columns of equal size, below which a direction is rounding alone.
_ROUNDING_SHARE = 1e-8
# Share of the largest noise that every equation has at least: an exact equation would drown all others in rounding.
_LEAST_NOISE = 1e-6

PATIENCE = 2.0
"""A function is left to later steps where its standard deviation from this step alone is more than so many times that
from this step and all later ones. Values from 1.5 to 3 gave the same errors; without it they grew to 1.4 times those of
the global strategy."""


@dataclass(frozen=True, eq=False)
class ErrorSource:
    """What one step's rows have to do with the errors of estimates.

    Parameters
    ----------
    gain : (m, k)
        Errors of the functions that are known, for the rows' scores Wᵀρ / noise² (c,), or for errors whose
        `covariance` (k, k) is known.
    equations : Reduction
        The rows.
    noise : (n,)
        What they were weighted by.
    covariance : (k, k), optional
        For rows that share no blocks of time with the others: of the functions that they gave.
    freedom : float
        Degrees of freedom that this covariance is known with, at least.
    """

    gain: FloatArray
    equations: Reduction
    noise: FloatArray
    covariance: FloatArray | None = None
    freedom: float = MOST_FREEDOM


@dataclass(frozen=True, eq=False)
class StepEstimates:
    """Estimates of linear functions of the parameters.

    Parameters
    ----------
    functions : (m, c)
        The functions.
    values : (m,)
        Their estimates.
    covariance : (m, m)
        Covariance of the estimates, with one correlation factor for each equation: it weighs them against later rows.
    sources : tuple of ErrorSource
        What each step's rows have to do with the errors of the estimates.
    """

    functions: FloatArray
    values: FloatArray
    covariance: FloatArray
    sources: tuple[ErrorSource, ...] = ()

    @classmethod
    def empty(cls, n_columns: int) -> StepEstimates:
        """Return the empty findings before the first step."""
        return cls(np.zeros((0, n_columns)), np.zeros(0), np.zeros((0, 0)))

    @property
    def is_complete(self) -> bool:
        """Whether all parameters are determined."""
        return bool(self.functions.shape[0] == self.functions.shape[1])

    @property
    def inverse(self) -> FloatArray:
        """Inverse (c, c) of the functions, once all parameters are determined."""
        # Columns of equal size first: parameters in kg and kg m² make the inverse ill-conditioned otherwise.
        scale = np.linalg.norm(self.functions, axis=0)
        return np.asarray(np.linalg.inv(self.functions / scale) / scale[:, None])

    def to_parameters(self) -> tuple[FloatArray, FloatArray]:
        """Return χ (c,) and its covariance (c, c), once all parameters are determined."""
        covariance = self.inverse @ self.covariance @ self.inverse.T
        return self.inverse @ self.values, 0.5 * (covariance + covariance.T)

    def to_information(self, n_columns: int) -> PriorInformation | None:
        """Return what is known, as equations of variables whose first are these functions."""
        if not len(self.values):
            return None
        return build_prior(self.values, self.covariance, np.arange(len(self.values)), n_columns)

    def add_estimates(self, new: StepEstimates, cross: FloatArray, gain: FloatArray) -> StepEstimates:
        """Add what a step found: k functions, their covariance and gain (k, m) with the m earlier estimates."""
        m = len(self.values)
        earlier = (replace(source, gain=np.vstack([source.gain, gain @ source.gain])) for source in self.sources)
        own = (replace(source, gain=np.pad(source.gain, [(m, 0), (0, 0)])) for source in new.sources)
        return StepEstimates(
            np.vstack([self.functions, new.functions]),
            np.concatenate([self.values, new.values]),
            np.block([[self.covariance, cross.T], [cross, new.covariance]]),
            (*earlier, *own),
        )


@dataclass(frozen=True, eq=False)
class Step:
    """Result of one step.

    Parameters
    ----------
    findings : StepEstimates
        All findings up to the step.
    fit : Fit or None
        Its fit; None where its equations told nothing new.
    """

    findings: StepEstimates
    fit: Fit | None


def take_step(
    estimator: Estimator,
    problem: Problem,
    equations: Reduction,
    findings: StepEstimates,
    to_come: Reduction | None = None,
    patience: float = PATIENCE,
) -> Step:
    """Find what these equations tell beyond what is known.

    Parameters
    ----------
    estimator : Estimator
        Solves the equations of the step.
    problem : Problem
        Equations of the data, and prior knowledge.
    equations : Reduction
        Rows of the step, over all parameters of the model.
    findings : StepEstimates
        Of earlier steps, from other equations: their errors are taken to be independent of these rows.
    to_come : Reduction, optional
        Rows of this step and of all that follow, in any order; without it nothing is left to later steps.
    patience : float
        How many times surer the rows to come have to be of a function for it to be left to them.

    Returns
    -------
    Step
        All findings up to the step, and its fit.
    """
    split = _split_functions(equations, findings, to_come, patience)
    m, k, n_found = len(findings.values), len(split.functions), split.n_found
    # These equations tell nothing that is not known already.
    if not n_found:
        return Step(findings, None)
    # New coordinates: first the known functions, then those of this step. The pseudoinverse expresses the parameters
    # in them.
    whole = np.vstack([findings.functions, split.functions]) / split.scale
    coordinates = np.linalg.pinv(whole) / split.scale[:, None]
    changed = equations.combine_columns(coordinates)
    data, known = replace(problem.data, equations=changed), findings.to_information(m + k)
    is_shared = np.array_equal(equations.spans, problem.data.equations.spans)
    kind = problem.covariance if is_shared or problem.covariance == "independent" else "by_joint"
    fit = estimator.solve(replace(problem, data=data, known=known, covariance=kind))
    new, solution = slice(m, m + n_found), fit.solution
    # Later steps take this covariance as a measurement error, so it has to have full rank. A covariance from a few
    # blocks of time would not.
    is_independent = problem.covariance == "independent"
    covariance = compute_pooled_statistics(changed, solution, is_independent=is_independent).covariance[new, new]
    # The estimate moves with the error of what is known as (RᵀR)⁻¹ Fᵀε does, ε the known part's error in units of its
    # standard deviation; FᵀF is the inverse of its covariance.
    moves = solution.normal_inverse[new]
    gain = np.zeros((n_found, m)) if known is None else (moves @ known.factor.T @ known.factor)[:, :m]
    if is_shared:
        source = ErrorSource(moves @ coordinates.T, equations, solution.noise)
    else:
        own = fit.statistics
        freedom = float(own.freedom[new].min())
        source = ErrorSource(np.eye(n_found), equations, solution.noise, own.covariance[new, new], freedom)
    estimates = StepEstimates(split.functions[:n_found], solution.values[new], covariance, (source,))
    return Step(findings.add_estimates(estimates, moves[:, :m], gain), fit)


def conclude_steps(
    data: Data, steps: Sequence[Step], covariance: CovarianceName, warnings: tuple[str, ...] = ()
) -> Fit:
    """Return the fit once all steps are taken; noise and factor are those of all equations with the final parameters.

    Parameters
    ----------
    data : Data
        Recordings reduced to the model's columns.
    steps : sequence of Step
        All steps, in their order.
    covariance : str
        Which correlations of the residuals are accounted for, see `estimation.statistics`.
    warnings : tuple of str
        Warnings of the strategy.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    EstimationError
        Where the steps together leave a parameter undetermined.
    """
    equations, findings = data.equations, steps[-1].findings
    if not findings.is_complete:
        raise EstimationError(
            f"the steps determine {len(findings.values)} combinations of the {equations.n_columns} parameters; use "
            "the global strategy, or record motions that determine the others",
            pointer="/strategy",
            title="Not identifiable",
        )
    values, pooled = findings.to_parameters()
    fits = [step.fit for step in steps if step.fit is not None]
    solution = replace(describe_fit(equations, values), converged=all(fit.solution.converged for fit in fits))
    worth = count_effective_rows(equations, solution)
    statistics = Statistics(pooled, worth, solution.noise, compute_row_freedom(worth, len(values)))
    joined = join_dependent_blocks(equations, solution)
    if has_enough_blocks(joined, covariance):
        statistics = _replace_by_spread(statistics, joined, solution, findings, covariance)
    return Fit(solution, statistics, (*warnings, *(warning for fit in fits for warning in fit.warnings)))


def _replace_by_spread(
    pooled: Statistics, joined: Reduction, solution: Solution, findings: StepEstimates, kind: CovarianceName
) -> Statistics:
    """Return statistics by how far the estimates move when blocks of time are left out, through all steps."""
    # In coordinates in which the normal equations of all rows are one, as `estimate_cluster_covariance` takes scores.
    to_scores = np.linalg.inv(solution.root).T
    c = joined.n_columns
    scores = [np.zeros((len(equation.counts), c)) for equation in joined.equations]
    apart, doubt = np.zeros((c, c)), np.zeros(c)
    for source in findings.sources:
        moves = findings.inverse @ source.gain
        if source.covariance is not None:
            part = moves @ source.covariance @ moves.T
            apart += part
            doubt += np.diag(part) ** 2 / source.freedom
            continue
        # A step takes the rows of some equations. What several steps take adds up.
        for k in np.flatnonzero(source.equations.row_counts):
            equation = joined.equations[k]
            own = compute_scores(equation.factors[:, :, :-1], compute_rests(equation, solution.values))
            scores[k] += own @ (moves.T @ to_scores)[equation.columns] / source.noise[k] ** 2
    spread = estimate_cluster_covariance(joined, solution, kind, scores, is_ordered=True)
    covariance = spread.covariance + apart
    # Of a sum of variances (Welch).
    doubt += np.diag(spread.covariance) ** 2 / spread.freedom
    freedom = np.diag(covariance) ** 2 / np.maximum(doubt, np.finfo(float).tiny)
    return replace(pooled, covariance=covariance, freedom=np.clip(freedom, 1.0, MOST_FREEDOM))


@dataclass(frozen=True, eq=False)
class _Split:
    """Functions (k, c) that rows depend on and that are not known; the first `n_found` are for this step to find.

    `scale` (c,): size of every column.
    """

    functions: FloatArray
    n_found: int
    scale: FloatArray


def _split_functions(
    equations: Reduction, findings: StepEstimates, to_come: Reduction | None, patience: float
) -> _Split:
    """Find the unknown functions that equations depend on, and which of them are left to the rows to come."""
    # What each equation leaves by itself: weights that are known before anything is estimated.
    noise = np.array([equation.own_noise for equation in equations.equations])
    later = np.array([equation.own_noise for equation in to_come.equations] if to_come is not None else [])
    largest = max(float(noise.max(initial=0.0)), float(later.max(initial=0.0)))
    factor = build_weighted_factor(equations, _to_relative_noise(noise, largest))[:-1, :-1]
    norms = np.linalg.norm(factor, axis=0)
    nonzero = norms > _ROUNDING_SHARE * norms.max(initial=0.0)
    scale = np.where(nonzero, norms, 1.0)
    # Orthonormal bases of the functions that are known, and of all others, columns of equal size.
    others = np.split(np.linalg.qr((findings.functions / scale).T, mode="complete")[0], [len(findings.values)], 1)[1]
    # The part of the equations that the known functions do not explain; its singular vectors are the functions to
    # find.
    rest = np.where(nonzero, factor / scale, 0.0) @ others
    _, singular, directions = np.linalg.svd(rest)
    clear = singular > _ROUNDING_SHARE * np.sqrt(max(float(np.count_nonzero(nonzero)), 1.0))
    singular, directions = singular[clear], directions[: len(singular)][clear]
    if to_come is None or not len(directions):
        return _Split(directions @ others.T * scale, len(directions), scale)
    together = np.linalg.qr(
        build_weighted_factor(to_come, _to_relative_noise(later, largest))[:-1, :-1] / scale @ others, mode="r"
    )
    # A root of the covariance of the functions that all rows to come would leave.
    half = solve_triangular(together, directions.T, trans="T")
    # A generalised eigenvalue problem gives functions that are independent of each other both in this step and in all
    # rows to come. An eigenvalue is the share of the information about a function that this step has.
    share, basis = eigh(np.diag(singular**2), np.linalg.inv(half.T @ half))
    functions = np.linalg.solve(basis, directions)[::-1]
    functions /= np.linalg.norm(functions, axis=1)[:, None]
    # The share of the information is the square of the ratio of standard deviations.
    return _Split(functions @ others.T * scale, int(np.count_nonzero(share >= patience**-2)), scale)


def _to_relative_noise(noise: FloatArray, largest: float) -> FloatArray:
    return np.maximum(noise / largest, _LEAST_NOISE) if largest > 0 else np.ones(len(noise))


_LONGEST_WRIST = 3


def solve_sequentially(choices: StrategyChoices, problem: Problem) -> Fit:
    """Find the parameters of the terminal link from its joint's equation, then those of the links before it.

    Parameters
    ----------
    choices : StrategyChoices
        `steps` names the order.
    problem : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    DynidentError
        For an estimator that needs all equations at once, or a model whose equations are not the joints'.
    """
    check_stepwise(choices)
    model, data = problem.model, problem.data
    findings = StepEstimates.empty(model.n_parameters)
    steps: list[Step] = []
    to_come = set(range(model.robot.n))
    for joints in iterate_steps(model.robot, choices.steps):
        # A joint's equation holds only the links behind it, so from the terminal one on every step adds few unknowns.
        own, later = select_joints(data.equations, joints), select_joints(data.equations, tuple(to_come))
        step = take_step(choices.solver, problem, own, findings, later)
        to_come -= set(joints)
        findings = step.findings
        steps.append(step)
    return conclude_steps(data, steps, problem.covariance)


def iterate_steps(robot: Robot, steps: StepsName) -> Iterator[tuple[int, ...]]:
    """Yield the joints whose equations make each step, the terminal ones first.

    Parameters
    ----------
    robot : Robot
        The robot.
    steps : str
        "link_by_link" or "wrist_then_shoulder".
    """
    if steps == "link_by_link":
        yield from ((joint,) for joint in reversed(range(robot.n)))
        return
    # A wrist is light. Identified together with the shoulder, its parameters would drown in the shoulder's noise.
    wrist = find_wrist_joints(robot)
    if wrist:
        yield wrist
    yield tuple(joint for joint in range(robot.n) if joint not in wrist)


def find_wrist_joints(robot: Robot) -> tuple[int, ...]:
    """Return the last three joints of every arm, but not more than half of its joints."""
    wrist = []
    for joint in range(robot.n):
        # Depth of the last joint of this arm; how many joints come after this one decides whether it belongs to the
        # wrist.
        behind = max(len(robot.list_ancestors(other)) for other in robot.list_subtree(joint))
        after = behind - len(robot.list_ancestors(joint))
        if after < min(_LONGEST_WRIST, behind // 2):
            wrist.append(joint)
    return tuple(wrist)


def select_joints(reduction: Reduction, joints: tuple[int, ...]) -> Reduction:
    """Return the same data with the rows of some joints alone; the other equations are empty.

    Parameters
    ----------
    reduction : Reduction
        Factors of W and the torque, one equation a joint.
    joints : tuple of int
        Numbers of the joints, from 0.
    """
    equations = tuple(
        equation if joint in joints else EquationFactors(equation.columns[:0], np.zeros((0, 1, 1)), equation.counts[:0])
        for joint, equation in enumerate(reduction.equations)
    )
    return Reduction(reduction.n_columns, equations, reduction.spans)


def check_stepwise(choices: StrategyChoices) -> None:
    """Raise where an estimator or a model cannot be taken joint by joint.

    Parameters
    ----------
    choices : StrategyChoices
        What is identified, and how.

    Raises
    ------
    DynidentError
    """
    check_estimator(choices.solver)
    if not choices.rows.by_joint:
        raise DynidentError(
            f"the {choices.model} model has no separate equation for each joint, so joints cannot be identified one "
            f"after another; choose from {', '.join(MODELS.names_with('by_joint'))}, or the global strategy",
            pointer="/strategy",
            title="Choices that do not fit",
        )


def check_estimator(estimator: Estimator) -> None:
    """Raise where an estimator cannot be taken in steps.

    Raises
    ------
    DynidentError
    """
    # An estimator that simulates, or that needs all bodies, cannot solve a part of the equations.
    if not estimator.in_steps:
        raise DynidentError(
            f"{estimator.name} cannot work in steps; choose from {', '.join(ESTIMATORS.names_with('in_steps'))}, or "
            "the global strategy",
            pointer="/estimator",
            title="Choices that do not fit",
        )
