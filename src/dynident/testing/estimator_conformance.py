"""`check_estimator`: test that an estimator of another package keeps all rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.methods.base_classes import Estimator
from dynident.number_format import format_percent
from dynident.regressors.model_structure import Model
from dynident.simulation.true_effects import list_drive_effects
from dynident.testing.trial_arm import TrialRecordings, build_trial_arm, record_trial, require

_NOISE = 0.2
"""Noise of the torque in N m."""
_LARGEST_ERROR = 0.03
"""Largest relative error of the estimates' torque: filters and the smooth sign of friction cause some of it."""


def check_estimator(estimator: Estimator, choices: IdentificationChoices | None = None) -> tuple[str, ...]:
    """Check an estimator on recordings of a small arm whose parameters are known.

    The estimates must be one finite number for each base parameter, near the truth. Their covariance must be finite,
    symmetric and positive semidefinite. The same data must give the same estimates and stay unchanged. More data must
    make the standard deviations smaller.

    Parameters
    ----------
    estimator : Estimator
        One of `identification.methods.estimator_options`, or another of its kind.
    choices : IdentificationChoices, optional
        Other choices for the identification; the default ones otherwise.

    Returns
    -------
    tuple of str
        What was checked, and the results.

    Raises
    ------
    ConformanceError
        If a requirement does not hold; the message tells which.
    """
    chosen = replace(choices or IdentificationChoices(), estimator=estimator)
    trial = record_trial(list_drive_effects(build_trial_arm()), noise=_NOISE)
    # The usual estimator goes first: it reduces the data, on which the tested one is then called directly.
    start = identify(trial.robot, trial.recordings, [], IdentificationChoices(effects=chosen.effects))
    few = identify(
        trial.robot,
        trial.recordings[:1],
        [],
        IdentificationChoices(effects=chosen.effects, preprocessing=start.preprocessing),
    )
    data = _reduce_data(start, trial)
    problem = _build_problem(start, chosen, data)
    # Factors are shared by all estimators of a comparison: one that changes them would spoil the others.
    rows_before = [equation.whole_factor.copy() for equation in data.equations.equations]
    fit = estimator.solve(problem)
    report = [
        _check_values(start.model, fit, data, _compute_true_parameters(start.model, trial)),
        _check_statistics(start.model, fit),
    ]
    changed = [
        not np.array_equal(a, e.whole_factor) for a, e in zip(rows_before, data.equations.equations, strict=True)
    ]
    require(not any(changed), "the estimator has changed the data that it was given")
    again = estimator.solve(problem)
    require(
        np.allclose(again.solution.values, fit.solution.values, rtol=1e-9, atol=1e-12),
        "the same data give other estimates the second time: draw random numbers from a fixed seed",
    )
    report.append(_check_more_data(estimator.solve(_build_problem(few, chosen, _reduce_data(few, trial, 1))), fit))
    return tuple(report)


def _reduce_data(identification: Identification, trial: TrialRecordings, runs: int | None = None) -> Data:
    return identification.data.to_data(identification.estimate.reference, trial.recordings[:runs])


def _build_problem(identification: Identification, choices: IdentificationChoices, data: Data) -> Problem:
    return Problem(identification.model, data, None, choices.covariance, choices.trust)


def _compute_true_parameters(model: Model, trial: TrialRecordings) -> FloatArray:
    """Return the true base parameters (b,) of the trial arm."""
    assert trial.robot.inertias is not None
    links = trial.robot.inertias.reshape(-1)
    drives = {(effect.effect, effect.joint, name): value for effect in trial.effects for name, value in effect.values}
    standard, inertial = np.zeros(len(model.columns)), 0
    for k, column in enumerate(model.columns):
        value_of_column = drives.get((column.effect, column.link, column.parameter))
        # Columns of the links come in the order of the description; those of drives are found by their names.
        if value_of_column is None and inertial < len(links):
            value_of_column, inertial = float(links[inertial]), inertial + 1
        standard[k] = value_of_column or 0.0
    return np.asarray(model.base.grouping @ standard)


def _check_values(model: Model, fit: Fit, data: Data, truth: FloatArray) -> str:
    values = fit.solution.values
    require(values.shape == (model.n_parameters,), f"{values.shape} estimates for {model.n_parameters} base parameters")
    require(np.isfinite(values).all(), "some estimates are not finite")
    squares = whole = 0.0
    for equation in data.torque.equations:
        rows, k = equation.whole_factor, len(equation.columns)
        squares += float(np.linalg.norm(rows[:, :k] @ (values - truth)[equation.columns]) ** 2)
        whole += float(np.linalg.norm(rows[:, k]) ** 2)
    off = float(np.sqrt(squares / whole))
    require(
        off <= _LARGEST_ERROR,
        f"on the data the torque of the estimates differs by {format_percent(off, decimals=1)} from that of the true "
        "parameters",
    )
    return f"the torque of the estimates differs by {format_percent(off)} from the true torque"


def _check_statistics(model: Model, fit: Fit) -> str:
    b, covariance = model.n_parameters, fit.statistics.covariance
    require(covariance.shape == (b, b), f"the covariance has the shape {covariance.shape}, not {(b, b)}")
    require(np.isfinite(covariance).all(), "the covariance is not finite")
    size = float(np.abs(covariance).max())
    require(np.allclose(covariance, covariance.T, atol=1e-9 * size), "the covariance is not symmetric")
    # Scale to correlations: otherwise the units of the parameters decide which eigenvalue counts as negative.
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    least = float(np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min())
    require(least >= -1e-6, f"the covariance has a negative direction ({least:.2g} of its diagonal)")
    # The eigenvalues above are only good to rounding; variances must not be negative at all.
    require((np.diag(covariance) >= 0).all(), "some variances are negative")
    require(fit.statistics.standard_deviations.shape == (b,), "there is not one standard deviation for each parameter")
    return f"{b} parameters with a covariance"


def _check_more_data(few: Fit, many: Fit) -> str:
    if few.solution.values.shape != many.solution.values.shape:
        return "one run determines fewer parameters than two"
    # By the square root of the data about 0.7 is expected; anything below 1 will do.
    surer = float(np.median(many.statistics.standard_deviations / few.statistics.standard_deviations))
    require(surer < 1.0, f"twice the data give standard deviations {surer:.2f} times as large")
    return f"twice the data: standard deviations {surer:.2f} times as large"
