"""Identification by an extended Kalman filter with the parameters as states (§12.8, [Guglielmi 87], [Poignet 00])."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.estimation import (
    EstimationError,
    Information,
    Solution,
    Statistics,
    errors,
    freedom_of_rows,
    known_values,
    noise_levels,
    statistics,
    weighted,
    weighted_factor,
)
from dynident.estimation.kalman import KalmanNoise
from dynident.estimation.recursive import recursive_statistics
from dynident.identification.equations.data import Data
from dynident.identification.estimators.kalman_run import KalmanRun, diverged, run_filter
from dynident.identification.estimators.torque_function import TorqueFunction
from dynident.identification.fit import Fit
from dynident.identification.problem import Problem
from dynident.recordings import Recording, choose_preprocessing, filtered_blocks
from dynident.recordings.spectra import spectra
from dynident.regressors.model import Model
from dynident.regressors.stream import reduce_recordings

START = (0.25, 0.5, 1.0)
"""Shares of the data that the filter's initial parameters come from: the first that determines them."""

# The initial standard deviations are widened so many times: a short recording misjudges its own, and the filter sees
# the same samples again.
_DOUBT = 5.0
# The acceleration of the filtered motion is taken to be off by so many times its own size: for a place to linearise at,
# not for a measurement.
_UNKNOWN = 10.0
# Position noise is not believed to be less than this, rad or m.
_LEAST_NOISE = 1e-6
# Torque error at the end over that of the initial parameters, and what is allowed beside it.
_WORSE, _ALLOWED = 1.5, 0.01


@dataclass(frozen=True, eq=False)
class _Initial:
    """What the filter begins with: what is known of χ, the share of the data it is from, its residual (n,)."""

    share: float
    known: Information
    residual: FloatArray


def kalman(problem: Problem) -> Fit:
    """Estimate with an extended Kalman filter: state [q, q̇, χ], measured positions and torques, χ constant.

    Initial parameters come from the beginning of the data by weighted least squares, widely doubted. The noises:
    position noise from the spectrum of the positions, torque noise from that of the torque and from the residual of the
    initial parameters. The filter goes through all of the data, unfiltered; it is linearised at the acceleration of the
    filtered motion.

    Standard deviations are not those of the filter, which takes its noises for white and known: what its equations of
    the parameters leave is judged as the residuals of least squares are, with its correlation in time, joint by joint.

    Raises
    ------
    DynidentError
        Where an effect has no place in the filter, the data do not determine the parameters, or the filter diverges.
    """
    model, data, known = problem.model, problem.data, problem.known
    torque = TorqueFunction(model)
    if data.preprocessing.position_cutoff is None:
        data = replace(data, preprocessing=choose_preprocessing(data.recordings))
    initial = _initial(model, data, known)
    run = run_filter(torque, model, data, initial.known, noise_of(data, initial.residual))
    values = run.values[-1]
    before, after = (errors(data.torque, chi).relative_total for chi in (run.values[0], values))
    if not after <= _WORSE * before + _ALLOWED:
        raise diverged(f"its parameters end with a torque error of {after:.1%}, those it began with had {before:.1%}")
    noise = noise_levels(data.equations, values)
    solution = Solution(values, noise, weighted_factor(data.equations, noise, known)[:-1, :-1], known)
    # Two rows an instant, of the torque and of the position: as much as one where the acceleration is unknown.
    found = recursive_statistics(run.rows, values, initial.known)
    worth = 0.5 * found.effective_rows
    found = Statistics(found.covariance, worth, noise, freedom_of_rows(worth, len(values)))
    late = _still_changing(run, found)
    return Fit(replace(solution, converged=not late), found, _said(run, found, initial.share, late))


def _still_changing(run: KalmanRun, found: Statistics) -> int:
    """How many parameters changed by more than a standard deviation over the last tenth of the data."""
    before = run.values[int(0.9 * len(run.times))]
    change = np.abs(run.values[-1] - before) / np.maximum(found.standard_deviations, np.finfo(float).tiny)
    return int(np.count_nonzero(change > 1.0))


def noise_of(data: Data, residual: FloatArray) -> KalmanNoise:
    """Noises from the spectra of the recordings, and from the residual (n,) of the initial parameters."""
    found = [spectra(recording) for recording in data.recordings]
    position = np.max([np.sqrt(one.noise * 0.5 * one.rate) for one in found], axis=0)
    floors = [np.sqrt(np.median(one.torque[one.frequency > 0.3 * one.rate], axis=0) * 0.5 * one.rate) for one in found]
    blocks = [block for recording in data.recordings for block in filtered_blocks(recording, data.preprocessing)]
    squares = np.sum([np.sum(block.ddq[block.used] ** 2, axis=0) for block in blocks], axis=0)
    used = sum(int(np.count_nonzero(block.used)) for block in blocks)
    return KalmanNoise(
        np.maximum(position, _LEAST_NOISE),
        np.maximum(np.max(floors, axis=0), residual),
        _UNKNOWN * np.sqrt(squares / max(used, 1)),
    )


def _beginning(recordings: tuple[Recording, ...], share: float) -> tuple[Recording, ...]:
    """The first share of the data in seconds."""
    spans = [(recording, start, end) for recording in recordings for start, end in _spans(recording)]
    left = share * sum(end - start for _, start, end in spans)
    windows: dict[int, list[tuple[float, float]]] = {}
    for recording, start, end in spans:
        cut = min(end, start + left)
        left = max(0.0, left - (end - start))
        if cut - start > recording.period:
            windows.setdefault(id(recording), []).append((start, cut))
    return tuple(r.with_windows(tuple(windows[id(r)])) for r in recordings if id(r) in windows)


def _spans(recording: Recording) -> Iterator[tuple[float, float]]:
    """First and last time of what is used of every segment, s."""
    for segment in recording.segments:
        start, end = segment.start_time, segment.start_time + segment.length * recording.period
        for low, high in recording.windows or ((start, end),):
            if min(end, high) > max(start, low):
                yield max(start, low), min(end, high)


def _initial(model: Model, data: Data, known: Information | None) -> _Initial:
    """Weighted least squares on the beginning of the data; what was known beside the data is not doubted."""
    for share in START:
        first = _beginning(data.recordings, share)
        try:
            beginning = reduce_recordings(model.observation, first, data.preprocessing, data.reference)
            solution = weighted(beginning, known)
            break
        except EstimationError:
            if share == START[-1]:
                raise
    # Of full rank, as what is known beforehand has to be.
    found = statistics(beginning, solution, "by_joint")
    c = len(solution.values)
    start = known_values(solution.values, found.covariance * _DOUBT**2, np.arange(c), c)
    if known is not None:
        undoubted = np.sqrt(1.0 - 1.0 / _DOUBT**2)
        start = start.and_also(Information(undoubted * known.factor, undoubted * known.right))
    return _Initial(share, start, found.noise)


def _said(run: KalmanRun, found: Statistics, share: float, changing: int) -> tuple[str, ...]:
    own = np.maximum(run.deviations[-1], np.finfo(float).tiny)
    said = [
        f"The Kalman filter began with the first {share:.0%} of the data and saw {run.times[-1]:.1f} s. Its standard "
        f"deviations are {np.median(found.standard_deviations / own):.2g} times those of its own covariance (median), "
        "which takes what it leaves for white noise of the size that it expects.",
    ]
    if changing:
        said.append(
            f"{changing} parameters still changed by more than a standard deviation over the last "
            "tenth of the data: the filter has not converged; a longer recording helps."
        )
    return tuple(said)
