"""Solve an estimation problem by the chosen strategy and estimator, and collect their notes."""

from __future__ import annotations

from dataclasses import replace

from dynident.errors import DynidentError
from dynident.estimation.least_squares import EstimationError
from dynident.estimation.parameter_covariance import find_prior_dominated
from dynident.identification.equations.model_and_data_checks import STANDING_SHOWS_NO_MASS
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.estimators.feasible import move_where_free
from dynident.identification.identification_choices import IdentificationChoices
from dynident.regressors.model_structure import Model


def solve_by_strategy(choices: IdentificationChoices, problem: Problem) -> Fit:
    """Solve by the chosen strategy with the chosen estimator.

    Parameters
    ----------
    choices : IdentificationChoices
        What is identified, and how.
    problem : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    DynidentError
        Where the choices do not fit each other, or the data do not allow them.
    """
    # Choices that do not fit are refused before the work, which may take minutes.
    _check_compatible(choices, problem)
    try:
        fitted = choices.plan.solve(choices, problem)
    except EstimationError as error:
        if not problem.model.robot.contacts or error.title != "Not identifiable":
            raise
        raise EstimationError(
            f"{error.detail}. {STANDING_SHOWS_NO_MASS}", pointer=error.pointer, title=error.title
        ) from error
    # Results of several steps are left alone: moved to bodies that can exist, they would no longer agree with the
    # equations of every step.
    if choices.solver.possible_where_free and choices.plan.at_once:
        fitted = move_where_free(problem.model, problem.data.equations, fitted, choices.trust)
    if choices.prior is not None:
        fitted = _add_prior_warning(problem.model, problem.data, fitted)
    friction = problem.data.friction
    if not friction or choices.plan.friction_runs:
        return fitted
    names = ", ".join(recording.name for recording in friction)
    unused = f"Not used: {names}. Friction tests (role friction) are used only by the strategy separate_friction."
    return replace(fitted, warnings=(*fitted.warnings, unused))


def _check_compatible(choices: IdentificationChoices, problem: Problem) -> None:
    """Raise where the prior or the estimator does not go with the strategy, the model or the data."""
    # A prior on sums of parameters ties steps together that are taken one after the other.
    if choices.prior is not None and not choices.plan.at_once:
        raise DynidentError(
            f"the prior is about sums of parameters, but the {choices.strategy} strategy estimates them one after the "
            "other; choose the global strategy, or leave the prior out",
            pointer="/prior",
            title="Choices that do not fit",
        )
    if not (choices.solver.simulates and choices.plan.at_once):
        return
    if choices.model != "dynamic":
        raise DynidentError(
            f"{choices.solver.name} integrates the dynamic model, so it works only with the model dynamic, not "
            f"{choices.model}",
            pointer="/estimator",
        )
    if not problem.data.recordings:
        raise DynidentError(
            f"{choices.solver.name} needs the recordings themselves, not only their reduced rows: identify again from "
            "the recordings",
            pointer="/estimator",
        )


def _add_prior_warning(model: Model, data: Data, fit: Fit) -> Fit:
    """Return the fit with one more warning, the first: what in it rests on the prior rather than on the data."""
    owed = find_prior_dominated(data.equations, fit.solution)
    names = [column.name for column, rests in zip(model.kept, owed, strict=True) if rests]
    warning = (
        "The inertias of the description are used as data here, each with the usual error of descriptions: this is an "
        "assumption, and the standard deviations depend on it."
    )
    if names:
        warning += f" The data determine these parameters less than the prior does: {', '.join(names)}."
    return replace(fit, warnings=(warning, *fit.warnings))
