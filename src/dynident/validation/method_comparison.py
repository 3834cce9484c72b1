"""Validation by comparison of methods on the same data; when two methods agree (error within 1.15 times)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import Errors, Reduction, compute_errors, compute_relative_change
from dynident.identification import Identification
from dynident.identification.equations.reduced_recordings import Data, reduce_to_rows, reduce_torque
from dynident.identification.estimation_problem import Problem
from dynident.identification.estimation_problem_options import ModelName
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.strategies.solve_by_strategy import solve_by_strategy
from dynident.identification.thresholds import ValidationOutcome
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording
from dynident.regressors.errors_by_phase import compute_moving_errors, select_judged_errors
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.validation.validation_request import Method, available_methods

# A method agrees where its error is within this factor of the best one's …
_AS_GOOD = 1.15
# … and its parameters differ by no more than this, root mean square, in units of their standard deviations.
_FAR = 3.0
# A torque that differs by more than so many standard deviations is not explained by them.
_SURE = 2.0


@dataclass(frozen=True, eq=False)
class MethodResult:
    """What a method finds on the data that all of them share.

    Fields are None where there is no result.

    Parameters
    ----------
    method : Method
        The method.
    values : (b,) or None
        Its base parameters.
    standard_deviations : (b,) or None
        Their standard deviations.
    fit : Errors or None
        Torque errors on the data of the fit.
    held_out : Errors or None
        Torque errors on the validation data; on the identification's own data where there is none.
    distance : (b,) or None
        Distance of every parameter from the reference method's, in units of the combined standard deviation of both.
    torque_distance : float or None
        Distance of the predicted torque from the reference method's, as a share of the measured torque.
    torque_deviation : float or None
        What the uncertainty of its own parameters makes of `torque_distance`.
    seconds : float
        Time that the solution took in s, the reduction of the data not counted.
    warnings : tuple of str
        Warnings of the solution.
    problem : str
        Why there is no result, else "".
    fit_moving : Errors or None
        As `fit`, on the rows where each joint moves.
    held_out_moving : Errors or None
        As `held_out`, on the rows where each joint moves.
    """

    method: Method
    values: FloatArray | None
    standard_deviations: FloatArray | None
    fit: Errors | None
    held_out: Errors | None
    distance: FloatArray | None
    torque_distance: float | None
    torque_deviation: float | None
    seconds: float
    warnings: tuple[str, ...]
    problem: str = ""
    fit_moving: Errors | None = None
    held_out_moving: Errors | None = None

    @property
    def held_out_judged(self) -> Errors | None:
        """The errors that methods are compared by: where each joint moves; on all rows where none does."""
        if self.held_out is None or self.held_out_moving is None:
            return self.held_out
        return select_judged_errors(self.held_out_moving, self.held_out)

    @property
    def distance_rms(self) -> float | None:
        """Root mean square of the distance over all parameters."""
        return None if self.distance is None else float(np.sqrt(np.mean(self.distance**2)))

    @property
    def farthest(self) -> int | None:
        """The parameter that is farthest from the reference method's."""
        return None if self.distance is None else int(np.argmax(self.distance))


@dataclass(frozen=True, eq=False)
class MethodsValidation:
    """All methods on the same data.

    Parameters
    ----------
    parameters : tuple of str
        Names of the base parameters, in the order of the model.
    results : tuple of MethodResult
        One entry a method; the first one with a result is what the others are compared with.
    held_out : bool
        Whether errors are those of data that no parameter saw.
    judged : ValidationOutcome
        Whether the methods agree, and the reason.
    """

    parameters: tuple[str, ...]
    results: tuple[MethodResult, ...]
    held_out: bool
    judged: ValidationOutcome


@single_threaded
def validate_methods(
    identification: Identification,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    methods: Sequence[Method] | None = None,
    progress: Progress = ignore_progress,
) -> MethodsValidation:
    """Identify the same effects from the same recordings by different methods, and compare the results.

    The recordings are reduced once for every equation type; strategies and estimators are small algebra on that, unless
    they go through the samples themselves.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        What the model was identified from.
    validation : sequence of Recording
        Data that no parameter sees.
    methods : sequence of Method, optional
        All that are available where none are given.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    MethodsValidation
        The results of all methods, in their order.

    Raises
    ------
    DynidentError
        For methods that are not available, or no recording.
    """
    if not recordings:
        raise DynidentError("give the measurements that the model was identified from", pointer="/recordings")
    chosen = tuple(dict.fromkeys(methods)) if methods else available_methods(identification.choices)
    for method in chosen:
        # Raise for an impossible method now, not after minutes of work on those before it.
        method.apply_to(identification.choices)
    model, reference = identification.model, identification.estimate.reference
    preprocessing = identification.preprocessing
    held_out_data = (
        reduce_torque(model, RegressorInputs(validation, preprocessing, reference), scale_progress(progress, 0.0, 0.1))
        if validation
        else None
    )
    # Reduced once for each kind of rows. An error is kept, too, so that each method of that kind tells it.
    data: dict[tuple[ModelName, bool], Data | DynidentError] = {}
    results: list[MethodResult] = []
    for number, method in enumerate(chosen):
        share = scale_progress(progress, 0.1 + 0.9 * number / len(chosen), 0.1 + 0.9 * (number + 1) / len(chosen))
        # The name of the method appears before its data are reduced, which takes longest.
        share(0.0, method.words)
        choices = method.apply_to(identification.choices)
        # What the wrench alone shows is taken out of its equations with the estimator's weights.
        kind = (method.model, method.model == "base_wrench" and method.estimator == "ols")
        if kind not in data:
            data[kind] = _reduce_recordings(identification, choices, recordings, share)
        results.append(_run_method(identification, choices, method, data[kind], held_out_data, results))
    judged = judge_methods(identification, results, held_out_data is not None)
    names = tuple(column.name for column in model.kept)
    return MethodsValidation(names, tuple(results), held_out_data is not None, judged)


def _reduce_recordings(
    identification: Identification, choices: IdentificationChoices, recordings: Sequence[Recording], progress: Progress
) -> Data | DynidentError:
    """Return the recordings reduced to the rows of an equation type, or why they cannot be."""
    try:
        return reduce_to_rows(
            identification.model,
            choices.row_options,
            RegressorInputs(recordings, identification.preprocessing, identification.estimate.reference),
            progress,
        )
    except DynidentError as error:
        return error


def _run_method(
    identification: Identification,
    choices: IdentificationChoices,
    method: Method,
    data: Data | DynidentError,
    held_out_data: Data | None,
    before: Sequence[MethodResult],
) -> MethodResult:
    start = perf_counter()
    try:
        if isinstance(data, DynidentError):
            raise data
        estimate = solve_by_strategy(choices, Problem.from_choices(identification.model, choices, data))
    # A method that fails is a result: the others are still compared.
    except DynidentError as error:
        return MethodResult(
            method, None, None, None, None, None, None, None, perf_counter() - start, (), problem=error.detail
        )
    values, deviations = estimate.solution.values, estimate.statistics.standard_deviations
    # Taken here: the errors below cost the same for every method.
    seconds = perf_counter() - start
    torque_rows = data.torque if held_out_data is None else held_out_data.torque
    solved = ((result.values, result.standard_deviations) for result in before)
    # The first method that has a result is the reference. For itself all distances are zero.
    others, doubts = next(((v, d) for v, d in solved if v is not None and d is not None), (values, deviations))
    return MethodResult(
        method=method,
        values=values,
        standard_deviations=deviations,
        fit=compute_errors(data.torque, values),
        held_out=compute_errors(torque_rows, values),
        distance=_compute_distance(values - others, np.hypot(deviations, doubts)),
        torque_distance=compute_relative_change(torque_rows, values - others),
        torque_deviation=_compute_torque_deviation(torque_rows, estimate.statistics.covariance),
        seconds=seconds,
        warnings=estimate.warnings,
        fit_moving=compute_moving_errors(data.torque, values),
        held_out_moving=compute_moving_errors(torque_rows, values),
    )


def _compute_distance(gap: FloatArray, deviations: FloatArray) -> FloatArray:
    """Return (b,): a difference of parameters in units of its standard deviations; 0 where there is none."""
    # Zero over zero is no distance: the reference method, and parameters that are fixed alike.
    size = np.abs(gap)
    return np.asarray(np.where(size > 0, size / np.maximum(deviations, np.finfo(float).tiny), 0.0))


def _compute_torque_deviation(reduction: Reduction, covariance: FloatArray) -> float:
    """Return √tr(W C Wᵀ) / ||Y||: the relative uncertainty of the torque for parameters of this covariance."""
    squares = measured = 0.0
    for equation in reduction.equations:
        k = len(equation.columns)
        # The factor stands for all rows: W C Wᵀ and R C Rᵀ have the same trace.
        w = equation.whole_factor[:, :k]
        squares += float(np.einsum("ij,jk,ik->", w, covariance[np.ix_(equation.columns, equation.columns)], w))
        measured += float(equation.whole_factor[:, k] @ equation.whole_factor[:, k])
    return float(np.sqrt(max(squares, 0.0) / measured)) if measured > 0 else 0.0


def judge_methods(identification: Identification, results: Sequence[MethodResult], held_out: bool) -> ValidationOutcome:
    """Judge whether the methods agree.

    They do not where one predicts worse than its uncertainty explains, or has other parameters.

    Parameters
    ----------
    identification : Identification
        The identified model.
    results : sequence of MethodResult
        Results of the methods, the reference first.
    held_out : bool
        Whether the errors are those of data that no parameter saw.

    Returns
    -------
    ValidationOutcome
        Pass, fail, or not evaluated with fewer than two results to compare; and the reason.
    """
    solved = [result for result in results if result.held_out is not None]
    if len(solved) < 2:
        reasons = "; ".join(f"{result.method.words}: {result.problem}" for result in results if result.problem)
        return ValidationOutcome(
            "not_evaluated", "Fewer than two methods gave a result" + (f" ({reasons})." if reasons else ".")
        )
    on = "on held-out data" if held_out else "on the identification's own data"
    totals = [result.held_out_judged.relative_total for result in solved if result.held_out_judged is not None]
    best = min(totals)
    # Only methods that minimise what is compared, the torque errors, and that these data determine well enough, count.
    compared: list[tuple[MethodResult, float]] = []
    worse, others, uncertain = [], [], []
    for result, total in zip(solved, totals, strict=True):
        words = f"{result.method.words} ({format_percent(total, decimals=1)})"
        if total <= _AS_GOOD * best:
            compared.append((result, total))
        # The first method is that of the model, which is judged, and never set aside.
        elif result is not solved[0] and _is_explained_by_uncertainty(result):
            own = format_percent(result.torque_deviation or 0.0, decimals=1)
            uncertain.append(f"{words.removesuffix(')')}, own uncertainty {own})")
        elif result is solved[0] or _is_comparable(identification, result):
            compared.append((result, total))
            worse.append(words)
        else:
            others.append(words)
    far = [
        f"{result.method.words} ({result.distance_rms:.1f}, most in {identification.model.kept[result.farthest].name})"
        for result, _ in compared
        if result.distance_rms is not None and result.farthest is not None and result.distance_rms > _FAR
        if _is_comparable(identification, result)
    ]
    aside = ""
    if uncertain:
        # Neither for nor against the model: their own parameters are too uncertain on these data.
        aside += (
            " No evidence, because their larger error is within their own uncertainty on these data: "
            f"{', '.join(uncertain)}."
        )
    if others:
        aside += f" The larger error of {', '.join(others)} comes from its equations on these data, not from the model."
    if len(compared) < 2:
        return ValidationOutcome("not_evaluated", f"Fewer than two methods can be compared.{aside}")
    range_text = (
        f"{len(compared)} methods predict {on} with errors from {format_percent(best, decimals=1)} to "
        f"{format_percent(max(total for _, total in compared), decimals=1)}"
    )
    if not worse and not far:
        return ValidationOutcome(
            "pass",
            f"{range_text}, and their parameters agree within {_FAR:.0f} standard deviations (root mean square)."
            f"{aside}",
        )
    complaints = []
    if worse:
        complaints.append(
            f"worse than the best by more than {format_percent(_AS_GOOD - 1, decimals=0)}: {', '.join(worse)}"
        )
    if far:
        complaints.append(
            f"parameters off by more than {_FAR:.0f} standard deviations (root mean square): {', '.join(far)}"
        )
    return ValidationOutcome("fail", f"{range_text}; {'; '.join(complaints)}.{aside}")


def _is_comparable(identification: Identification, result: MethodResult) -> bool:
    """Return whether a method minimises torque errors (§12.6), or has the model's own equation type."""
    return result.method.model in ("dynamic", "filtered", identification.choices.model)


def _is_explained_by_uncertainty(result: MethodResult) -> bool:
    """Return whether a method's torque differs by no more than its own uncertainty allows."""
    distance, deviation = result.torque_distance, result.torque_deviation
    return distance is not None and deviation is not None and distance <= _SURE * deviation
