"""Solve an estimation problem by the chosen strategy and estimator, and collect their notes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import stdtr

from dynident.errors import DynidentError
from dynident.estimation.least_squares import EstimationError, solve_weighted
from dynident.estimation.parameter_covariance import find_prior_dominated, statistics
from dynident.identification.description_prior import build_prior
from dynident.identification.equations.model_and_data_checks import STANDING_SHOWS_NO_MASS
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.estimators.feasible import move_where_free
from dynident.identification.identification_choices import IdentificationChoices
from dynident.regressors.model_structure import Model

# Probability that data which agree with a known value seem to contradict it.
_CONTRADICTED = 1e-3


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
    if choices.known:
        fitted = fitted.with_changes(warnings=(*_doubt_known(choices, problem), *fitted.warnings))
    friction = problem.data.friction
    if not friction or choices.plan.friction_runs:
        return fitted
    names = ", ".join(recording.name for recording in friction)
    unused = f"Not used: {names}. Friction tests (role friction) are used only by the strategy separate_friction."
    return fitted.with_changes(warnings=(*fitted.warnings, unused))


def _check_compatible(choices: IdentificationChoices, problem: Problem) -> None:
    """Raise where the prior or the estimator does not go with the strategy, the model or the data."""
    # A prior on sums of parameters ties steps together that are taken one after the other.
    if (choices.prior is not None or choices.known) and not choices.plan.at_once:
        pointer, subject = "/prior", "the prior is about sums of parameters"
        if choices.prior is None:
            pointer, subject = "/known", "known values are held while all parameters are estimated at once"
        raise DynidentError(
            f"{subject}, but the {choices.strategy} strategy estimates them one after the "
            f"other; choose the global strategy, or leave {pointer[1:]} out",
            pointer=pointer,
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


def _doubt_known(choices: IdentificationChoices, problem: Problem) -> list[str]:
    """Return warnings about known parameters that the data contradict."""
    model, trust = problem.model, choices.trust
    names = [column.name for column in model.kept]
    warnings: list[str] = []
    try:
        without = build_prior(model, replace(trust, known=()))
        free = solve_weighted(problem.data.equations, without)
        certainty = statistics(problem.data.equations, free, choices.covariance)
    except EstimationError:
        # Without the known values the data determine too little to contradict them.
        return warnings
    for name, value, error in trust.known:
        if name not in names:
            continue
        estimate = float(free.values[names.index(name)])
        deviation = float(certainty.standard_deviations[names.index(name)])
        distance = abs(estimate - value) / float(np.hypot(deviation, error))
        if 2.0 * float(stdtr(certainty.median_freedom, -distance)) < _CONTRADICTED:
            warnings.append(
                f"The data contradict the known {name} = {value:.4g}: by themselves they give {estimate:.4g}, with a "
                f"standard deviation of {deviation:.2g}."
            )
    return warnings


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
    return fit.with_changes(warnings=(warning, *fit.warnings))
