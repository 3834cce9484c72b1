"""Identification by an extended Kalman filter with the parameters as states (§12.8, [Guglielmi 87], [Poignet 00])."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation import (
    EstimationError,
    PriorInformation,
    Solution,
    Statistics,
    build_prior,
    build_weighted_factor,
    compute_errors,
    compute_noise_levels,
    compute_row_freedom,
    statistics,
    weighted,
)
from dynident.estimation.kalman_filter import KalmanNoise, compute_recursive_statistics
from dynident.identification.equations.reduce_data import Data
from dynident.identification.estimators.kalman_pass import KalmanRun, TorqueFunction, divergence_error, run_filter
from dynident.identification.fit import Fit
from dynident.identification.problem import Problem
from dynident.recordings import Recording, choose_preprocessing, filtered_blocks
from dynident.recordings.spectra import estimate_spectra
from dynident.regressors.filtered_rows import reduce_recordings
from dynident.regressors.model import Model

START_SHARES = (0.25, 0.5, 1.0)
"""Shares of the data for the filter's initial parameters; the first share that determines them is used."""

# Factor on the initial standard deviations: those of a short recording are unreliable, and the filter sees the same
# samples again.
_DOUBT = 5.0
# Standard deviation of the acceleration over its own size: the filtered acceleration is where the model is linearised,
# and no measurement.
_UNKNOWN = 10.0
# Position noise is not believed to be less than this, rad or m.
_LEAST_NOISE = 1e-6
# Largest torque error at the end, over that of the initial parameters, and in addition to it, for the filter not to
# have diverged.
_WORSE, _ALLOWED = 1.5, 0.01


@dataclass(frozen=True, eq=False)
class _FilterStart:
    """Start of the filter: prior on χ, the share of the data that it comes from, and its residual (n,)."""

    share: float
    known: PriorInformation
    residual: FloatArray


def estimate_by_kalman_filter(problem: Problem) -> Fit:
    """Estimate with an extended Kalman filter: state [q, q̇, χ], measured positions and torques, χ constant.

    Initial parameters come from the beginning of the data by weighted least squares, with widened deviations. Position
    noise is taken from the spectrum of the positions, torque noise from that of the torque and from the residual of the
    initial parameters. The filter goes through all of the data, unfiltered; it is linearised at the acceleration of the
    filtered motion.

    Standard deviations are not those of the filter, which takes its noises for white and known. The residuals of its
    equations of the parameters are judged as those of least squares are, with their correlation in time, joint by
    joint.

    Parameters
    ----------
    problem : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    DynidentError
        Where an effect has no place in the filter, the data do not determine the parameters, or the filter diverges.
    """
    model, data, known = problem.model, problem.data, problem.known
    torque = TorqueFunction(model)
    # The filter is linearised at a filtered acceleration, so there has to be a position filter.
    if data.preprocessing.position_cutoff is None:
        data = replace(data, preprocessing=choose_preprocessing(data.recordings))
    initial = _solve_beginning(model, data, known)
    run = run_filter(torque, model, data, initial.known, estimate_noise(data, initial.residual))
    values = run.values[-1]
    before, after = (compute_errors(data.torque, chi).relative_total for chi in (run.values[0], values))
    # Written so that an error that is no number counts as divergence.
    if not after <= _WORSE * before + _ALLOWED:
        raise divergence_error(
            f"its parameters end with a torque error of {after:.1%}, those it began with had {before:.1%}"
        )
    noise = compute_noise_levels(data.equations, values)
    solution = Solution(values, noise, build_weighted_factor(data.equations, noise, known)[:-1, :-1], known)
    # Every instant has two rows, of the torque and of the position. As the acceleration is unknown, they are worth one.
    uncertainty = compute_recursive_statistics(run.rows, values, initial.known)
    worth = 0.5 * uncertainty.effective_rows
    uncertainty = Statistics(uncertainty.covariance, worth, noise, compute_row_freedom(worth, len(values)))
    late = _count_changing(run, uncertainty)
    return Fit(
        replace(solution, converged=not late), uncertainty, _list_warnings(run, uncertainty, initial.share, late)
    )


def _count_changing(run: KalmanRun, uncertainty: Statistics) -> int:
    """Return how many parameters changed by more than a standard deviation over the last tenth of the data."""
    before = run.values[int(0.9 * len(run.times))]
    change = np.abs(run.values[-1] - before) / np.maximum(uncertainty.standard_deviations, np.finfo(float).tiny)
    return int(np.count_nonzero(change > 1.0))


def estimate_noise(data: Data, residual: FloatArray) -> KalmanNoise:
    """Return the noises from the spectra of the recordings, and from the residual (n,) of the initial parameters."""
    spectra_of_all = [estimate_spectra(recording) for recording in data.recordings]
    # White noise of density S over the band up to half the rate has the variance S times that band.
    position = np.max([np.sqrt(spectrum.noise * 0.5 * spectrum.rate) for spectrum in spectra_of_all], axis=0)
    # The torque's noise is the floor of its spectrum at high frequencies, where no motion is left.
    floors = [
        np.sqrt(np.median(spectrum.torque[spectrum.frequency > 0.3 * spectrum.rate], axis=0) * 0.5 * spectrum.rate)
        for spectrum in spectra_of_all
    ]
    blocks = [block for recording in data.recordings for block in filtered_blocks(recording, data.preprocessing)]
    squares = np.sum([np.sum(block.ddq[block.used] ** 2, axis=0) for block in blocks], axis=0)
    used = sum(int(np.count_nonzero(block.used)) for block in blocks)
    return KalmanNoise(
        np.maximum(position, _LEAST_NOISE),
        # What the model leaves counts as noise, too: the filter would otherwise trust the torque too much.
        np.maximum(np.max(floors, axis=0), residual),
        _UNKNOWN * np.sqrt(squares / max(used, 1)),
    )


def _cut_beginning(recordings: tuple[Recording, ...], share: float) -> tuple[Recording, ...]:
    """Return the first share of the data in seconds."""
    spans = [(recording, start, end) for recording in recordings for start, end in _iterate_spans(recording)]
    remaining = share * sum(end - start for _, start, end in spans)
    windows: dict[int, list[tuple[float, float]]] = {}
    for recording, start, end in spans:
        # Spans are used up in their order until the share is reached.
        cut = min(end, start + remaining)
        remaining = max(0.0, remaining - (end - start))
        if cut - start > recording.period:
            windows.setdefault(id(recording), []).append((start, cut))
    return tuple(r.with_windows(tuple(windows[id(r)])) for r in recordings if id(r) in windows)


def _iterate_spans(recording: Recording) -> Iterator[tuple[float, float]]:
    """Yield the first and last time of the used part of every segment, s."""
    for segment in recording.segments:
        start, end = segment.start_time, segment.start_time + segment.length * recording.period
        for low, high in recording.windows or ((start, end),):
            if min(end, high) > max(start, low):
                yield max(start, low), min(end, high)


def _solve_beginning(model: Model, data: Data, known: PriorInformation | None) -> _FilterStart:
    """Solve the beginning of the data by weighted least squares; a prior keeps its certainty."""
    # As little of the data as determines the parameters: the filter shall learn from the rest.
    for share in START_SHARES:
        first = _cut_beginning(data.recordings, share)
        try:
            beginning = reduce_recordings(model.observation, first, data.preprocessing, data.reference)
            solution = weighted(beginning, known)
            break
        except EstimationError:
            if share == START_SHARES[-1]:
                raise
    # The filter needs a covariance of full rank, which one from blocks of time may not have.
    uncertainty = statistics(beginning, solution, "by_joint")
    c = len(solution.values)
    start = build_prior(solution.values, uncertainty.covariance * _DOUBT**2, np.arange(c), c)
    if known is not None:
        # Widening divides the prior's rows by the factor, too. Adding this much of them gives them their full weight
        # again.
        undoubted = np.sqrt(1.0 - 1.0 / _DOUBT**2)
        start = start.combine_with(PriorInformation(undoubted * known.factor, undoubted * known.right))
    return _FilterStart(share, start, uncertainty.noise)


def _list_warnings(run: KalmanRun, uncertainty: Statistics, share: float, changing: int) -> tuple[str, ...]:
    own = np.maximum(run.deviations[-1], np.finfo(float).tiny)
    sentences = [
        f"The Kalman filter began with the first {share:.0%} of the data and saw {run.times[-1]:.1f} s. Its standard "
        f"deviations are {np.median(uncertainty.standard_deviations / own):.2g} times those of its own covariance "
        "(median), which takes what it leaves for white noise of the size that it expects.",
    ]
    if changing:
        sentences.append(
            f"{changing} parameters still changed by more than a standard deviation over the last "
            "tenth of the data: the filter has not converged; a longer recording helps."
        )
    return tuple(sentences)
