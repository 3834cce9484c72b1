"""Identification by an extended Kalman filter with the parameters as states (§12.8, [Guglielmi 87], [Poignet 00])."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynident.errors import DynidentError
from dynident.estimation import (
    EstimationError,
    Information,
    Solution,
    Statistics,
    errors,
    noise_levels,
    statistics,
    weighted,
    weighted_factor,
)
from dynident.estimation.kalman import KalmanFilter, KalmanNoise
from dynident.identification.choices import IdentificationChoices
from dynident.identification.data import Data
from dynident.identification.estimators.simulating import check_simulable
from dynident.identification.estimators.torque_function import TorqueFunction
from dynident.identification.fit import Fit
from dynident.recordings import Preprocessing, Recording, choose_preprocessing, filtered_blocks
from dynident.recordings.spectra import spectra
from dynident.regressors.model import Model
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import FloatArray

START = 0.25
"""Share of the data that the filter's initial parameters come from, by weighted least squares; it sees the rest."""

# The initial standard deviations are widened so many times: a short recording misjudges its own.
_DOUBT = 5.0
# Wander of a parameter over a second, as a share of its initial standard deviation.
_WANDER = 1e-3
# Position noise is not believed to be less than this, rad or m.
_LEAST_NOISE = 1e-6
# An innovation beyond so many of its standard deviations, so many samples in a row, is divergence.
_LOST, _LOST_SAMPLES = 1e3, 50
# Variance of the innovations over what the filter takes it for, beyond which it does not describe the motion.
_OVERSTATED = 1e3
# Torque error at the end over that of the initial parameters, and what is allowed beside it.
_WORSE, _ALLOWED = 1.5, 0.01
_BATCH, _KEPT = 0.5, 200


@dataclass(frozen=True, eq=False)
class KalmanRun:
    """A filter's way through recordings.

    `times` (k,) in seconds of data that it has seen, `values` and `deviations` (k, b) of the parameters then, the
    last row at the end. `covariance` (b, b) is that of the filter; `overstated`: variance of the innovations,
    correlation included, over what the filter takes it for.
    """

    times: FloatArray
    values: FloatArray
    deviations: FloatArray
    covariance: FloatArray
    overstated: float


def kalman(model: Model, choices: IdentificationChoices, data: Data, known: Information | None = None) -> Fit:
    """Estimate with an extended Kalman filter: state [q, q̇, χ], measured positions, torque as input.

    Initial parameters come from the first quarter of the data by weighted least squares. Its noises: position noise
    from the spectrum of the positions, torque noise from that of the torque and from the residual of the initial
    parameters. The covariance of the filter is widened by what its innovations show.

    The filter takes the measured torque for what moves the robot. Its noise therefore biases inertia upwards, as the
    noise of encoders biases what least squares makes of W: small inertias beside large torque noise come out too large.

    Raises
    ------
    DynidentError
        Where an effect has no place in the filter, the first quarter does not determine the parameters, or the filter
        diverges.
    """
    check_simulable(model, choices, data)
    torque = TorqueFunction(model)
    first, rest = _split(data.recordings, START)
    initial, start = _initial(model, data, first, known)
    run = run_filter(torque, rest, start, initial.covariance * _DOUBT**2, noise_of(data, start, initial.noise))
    values = run.values[-1]
    before, after = (errors(data.torque, chi).relative_total for chi in (start, values))
    if not after <= _WORSE * before + _ALLOWED:
        raise _diverged(f"its parameters end with a torque error of {after:.1%}, those it began with had {before:.1%}")
    noise = noise_levels(data.equations, values)
    solution = Solution(values, noise, weighted_factor(data.equations, noise, known)[:-1, :-1], known)
    rows = statistics(data.equations, solution).effective_rows
    covariance = run.covariance * max(run.overstated, 1.0)
    return Fit(solution, Statistics(covariance, rows, noise), _said(run, covariance))


def noise_of(data: Data, start: FloatArray, residual: FloatArray) -> KalmanNoise:
    """Noises from the spectra of the recordings, and from the residual (n,) of the initial parameters."""
    found = [spectra(recording) for recording in data.recordings]
    position = np.max([np.sqrt(one.noise * 0.5 * one.rate) for one in found], axis=0)
    floors = [np.sqrt(np.median(one.torque[one.frequency > 0.3 * one.rate], axis=0) * 0.5 * one.rate) for one in found]
    return KalmanNoise(
        np.maximum(position, _LEAST_NOISE),
        np.maximum(np.max(floors, axis=0), residual),
        np.zeros(len(start)),
    )


def run_filter(
    torque: TorqueFunction,
    recordings: tuple[Recording, ...],
    values: FloatArray,
    covariance: FloatArray,
    noise: KalmanNoise,
) -> KalmanRun:
    """Let a filter that begins with χ (b,) and its covariance run through recordings.

    Raises
    ------
    EstimationError
        Where it diverges.
    """
    wander = KalmanNoise(noise.position, noise.torque, _WANDER * np.sqrt(np.diag(covariance)))
    kept: list[tuple[float, FloatArray, FloatArray]] = []
    batches: list[FloatArray] = []
    seen = 0.0
    for recording in recordings:
        one = KalmanFilter(torque, recording.period, wander, values, covariance)
        batch: list[FloatArray] = []
        lost = 0
        gap = max(1, round(sum(r.n_samples for r in recordings) / _KEPT))
        for k, (t, place, before, q, tau) in enumerate(_samples(recording)):
            if place == 0:
                continue
            if place == 1:
                one.begin(before, q, tau)
                batch = []
                continue
            innovation = _stepped(one, q, tau, t, recording.name)
            lost = lost + 1 if np.abs(innovation).max() > _LOST else 0
            if lost > _LOST_SAMPLES or not np.isfinite(one.values).all():
                raise _diverged(f"from t = {t:.2f} s of {recording.name} on it does not follow the positions any more")
            batch.append(innovation)
            if len(batch) * recording.period >= _BATCH:
                batches.append(np.sum(batch, axis=0) ** 2 / len(batch))
                batch = []
            seen += recording.period
            if k % gap == 0:
                kept.append((seen, one.values.copy(), np.sqrt(np.maximum(np.diag(one.values_covariance), 0.0))))
        values, covariance = one.values, one.values_covariance
    if not batches:
        raise DynidentError(
            "there are too few samples for a filter behind the first quarter of the data; use a longer recording",
            pointer="/measurement_ids",
            title="Too few samples",
        )
    overstated = float(np.mean(batches))
    if not overstated < _OVERSTATED:
        raise _diverged(f"its innovations vary {overstated:.2g} times as much as its noises say")
    kept.append((seen, values, np.sqrt(np.maximum(np.diag(covariance), 0.0))))
    times, way, deviations = (np.array(item) for item in zip(*kept, strict=True))
    return KalmanRun(times, way, deviations, covariance, overstated)


def _stepped(one: KalmanFilter, q: FloatArray, tau: FloatArray, t: float, name: str) -> FloatArray:
    try:
        return one.step(q, tau)
    except EstimationError as error:
        raise _diverged(f"at t = {t:.2f} s of {name} {error.detail}") from error


def _samples(recording: Recording) -> Iterator[tuple[float, int, FloatArray, FloatArray, FloatArray]]:
    """Time, place in its unbroken stretch, position before, q and tau (n,) of every used sample, unfiltered."""
    place = -1
    before = np.zeros(recording.n)
    for block in filtered_blocks(recording, Preprocessing(None, None)):
        if block.starts_segment:
            place = -1
        for k, used in enumerate(block.used):
            place = place + 1 if used else -1
            if used:
                yield float(block.t[k]), place, before, block.q[k], block.tau[k]
            before = block.q[k]


def _split(recordings: tuple[Recording, ...], share: float) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """The first share of the data in seconds, and the rest."""
    spans = [(recording, start, end) for recording in recordings for start, end in _spans(recording)]
    left = share * sum(end - start for _, start, end in spans)
    windows: dict[int, tuple[list[tuple[float, float]], list[tuple[float, float]]]] = {}
    for recording, start, end in spans:
        early, late = windows.setdefault(id(recording), ([], []))
        cut = min(end, start + left)
        left = max(0.0, left - (end - start))
        if cut - start > recording.period:
            early.append((start, cut))
        if end - cut > recording.period:
            late.append((cut, end))
    parts = [
        tuple(r.with_windows(tuple(windows[id(r)][which])) for r in recordings if windows[id(r)][which])
        for which in (0, 1)
    ]
    return parts[0], parts[1]


def _spans(recording: Recording) -> Iterator[tuple[float, float]]:
    """First and last time of what is used of every segment, s."""
    for segment in recording.segments:
        start, end = segment.start_time, segment.start_time + segment.length * recording.period
        for low, high in recording.windows or ((start, end),):
            if min(end, high) > max(start, low):
                yield max(start, low), min(end, high)


def _initial(
    model: Model, data: Data, first: tuple[Recording, ...], known: Information | None
) -> tuple[Statistics, FloatArray]:
    """Statistics and values of weighted least squares on the beginning of the data."""
    filters = data.preprocessing
    if filters.position_cutoff is None:
        filters = choose_preprocessing(data.recordings)
    try:
        beginning = reduce_recordings(model.observation, first, filters, data.reference)
        solution = weighted(beginning, known)
    except EstimationError as error:
        raise DynidentError(
            f"the first quarter of the data, which the filter begins with, does not determine the parameters: "
            f"{error.detail}. Use a longer recording, the prior description, or wls",
            pointer="/estimator",
            title="No initial values",
        ) from error
    return statistics(beginning, solution), solution.values


def _said(run: KalmanRun, covariance: FloatArray) -> tuple[str, ...]:
    said = [
        f"The Kalman filter began with the first quarter of the data and saw {run.times[-1]:.1f} s; its innovations "
        f"vary {run.overstated:.2g} times as much as its noises say, which its standard deviations are widened by. "
        "They rest on noises that were tuned, not measured, and noise of the torque makes small inertias too large: "
        "hold the result against that of wls.",
    ]
    late = run.values[int(0.9 * len(run.times))]
    change = np.abs(run.values[-1] - late) / np.maximum(np.sqrt(np.diag(covariance)), np.finfo(float).tiny)
    if change.max() > 1.0:
        said.append(
            f"{int(np.sum(change > 1.0))} parameters still changed by more than a standard deviation over the last "
            "tenth of the data: the filter has not converged; a longer recording helps."
        )
    return tuple(said)


def _diverged(how: str) -> EstimationError:
    return EstimationError(
        f"the Kalman filter diverged: {how}. Begin with better values (the prior description, a longer recording), or "
        "use wls",
        pointer="/estimator",
        title="Divergence",
    )
