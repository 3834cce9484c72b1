"""Estimate the noise floor (from repetitions or the sensor) and judge whether a residual is above it.

Holds the significance of the lack-of-fit test, and the ratio above which something is missing.

The floor follows from repetitions of the motion or from the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from scipy import special

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.comparison.repeated_motion import (
    Repeat,
    Track,
    compute_repeated_share,
    find_own_repeats,
    load_tracks,
    split_tracks,
)
from dynident.diagnosis.comparison.residual_autocorrelation_and_spectra import (
    autocorrelation,
    count_independent_squares,
)
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.recordings import Preprocessing, Recording, filtered_blocks, low_pass

# Share of a motion that has to repeat another, p-value of the lack of fit, and ratio to the noise floor, for a note.
_REPEATED = 0.5
_SURE = 0.01
_MISSING = 1.5


@dataclass(frozen=True)
class RepeatedMotion:
    """A motion that the model has seen.

    Parameters
    ----------
    name : str
        Name of the recording whose motion is repeated.
    share : float
        Share of the moving time that repeats it, 0 to 1.
    """

    name: str
    share: float


@dataclass(frozen=True, eq=False)
class Judgement:
    """The figures of a comparison that need more than the residual.

    Parameters
    ----------
    noise : NoiseFloor
        Noise floor of the recording.
    over_noise : (n,)
        Rms of the residual over the noise floor, where each joint moves.
    effective_samples : (n,)
        Number of independent samples that each joint's residual is worth.
    repeated : RepeatedMotion or None
        The motion of the identification that is repeated; None where there is none.
    notes : tuple of str
        What a user must know of all that, in sentences.
    """

    noise: NoiseFloor
    over_noise: FloatArray
    effective_samples: FloatArray
    repeated: RepeatedMotion | None
    notes: tuple[str, ...]


@single_threaded
def judge(
    comparison: Comparison,
    recording: Recording,
    preprocessing: Preprocessing,
    fitted: Sequence[Recording] = (),
) -> Judgement:
    """Compare a residual with the noise floor, and its motion with those that the model was fitted to.

    Parameters
    ----------
    comparison : Comparison
        The recording with the model's prediction.
    recording : Recording
        What was compared.
    preprocessing : Preprocessing
        The filters of the model.
    fitted : sequence of Recording
        What the model was fitted to; empty where the comparison is with one of these.

    Returns
    -------
    Judgement
        Noise floor, ratios to it, and notes.
    """
    noise = estimate_noise_floor(comparison, recording, preprocessing)
    rms = comparison.moving_errors.rms
    # A joint without noise, as in a simulation, is infinitely far above its floor.
    over = np.where(noise.values > 0, rms / np.where(noise.values > 0, noise.values, 1.0), np.inf)
    memory = [
        autocorrelation(comparison.t, comparison.segment, comparison.residual[:, j]).effective_samples
        for j in range(len(rms))
    ]
    repeated = _find_repeated_motion(comparison, recording, fitted)
    return Judgement(noise, over, np.array(memory), repeated, _word_notes(comparison, noise, over, repeated))


def _find_repeated_motion(
    comparison: Comparison, recording: Recording, fitted: Sequence[Recording]
) -> RepeatedMotion | None:
    own_tracks = split_tracks(comparison.t, comparison.segment, comparison.q)
    motions = [
        RepeatedMotion(other.name, compute_repeated_share(own_tracks, load_tracks(other)))
        for other in fitted
        # The same motion with another payload is new data: it does test the model.
        if other.payload == recording.payload
    ]
    most = max(motions, key=lambda motion: motion.share, default=None)
    return most if most is not None and most.share >= _REPEATED else None


def _word_notes(
    comparison: Comparison, noise: NoiseFloor, over: FloatArray, repeated: RepeatedMotion | None
) -> tuple[str, ...]:
    notes = []
    if repeated is not None:
        notes.append(
            f"{format_percent(repeated.share, decimals=0)} of this motion repeats the motion of {repeated.name}, from "
            "which the model was identified: the comparison tests noise, not generalisation. Compare with another "
            "motion."
        )
    if noise.source == "repeated_periods":
        notes.append(
            f"The noise floor is estimated from repeated periods: the motion repeats {noise.repetitions:.1f} times, "
            f"every {noise.period:.3g} s."
        )
    else:
        notes.append(
            "The noise floor is estimated from the high frequencies of the torque, because the motion does not "
            "repeat: it does not include slow disturbances. Record at least two periods of a motion for a better "
            "estimate."
        )
    fit = noise.lack_of_fit
    if fit is not None:
        wrong = [
            name
            for name, p, ratio in zip(comparison.joint_names, fit.p_value, over, strict=True)
            # Both: with very many rows a trifle is significant, and a large ratio alone may be chance.
            if p < _SURE and ratio > _MISSING
        ]
        if wrong:
            notes.append(
                f"The residual is larger than the noise on {', '.join(wrong)}: the model lacks an effect there."
            )
    return tuple(notes)


NoiseSource = Literal["repeated_periods", "high_frequency"]

# Fewest pairs of rows, degree of the interpolating spline, and share of the differences that count as quiet.
_FEWEST_PAIRS = 40
_DEGREE = 5
_QUIET = 0.95


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Test of whether a residual is more than noise, joint by joint.

    Parameters
    ----------
    f : (n,)
        Mean square of what is common to the repetitions over that of what differs between them; near 1 where nothing is
        missing.
    p_value : (n,)
        The p-value of that ratio, with as many degrees of freedom as the rows are worth.
    """

    f: FloatArray
    p_value: FloatArray


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Noise that no model of the motion can explain.

    Parameters
    ----------
    values : (n,)
        Rms of the noise behind the parallel filter, N m or N.
    source : NoiseSource
        Where it is from: repeated periods of the motion, or the high frequencies of the torque.
    period : float
        Period of the motion, s; 0 where it is not repeated.
    repetitions : float
        Number of times that the motion comes; 0 where it is not repeated.
    lack_of_fit : LackOfFit, optional
        Test of the model's residual, where the motion is repeated.
    """

    values: FloatArray
    source: NoiseSource
    period: float = 0.0
    repetitions: float = 0.0
    lack_of_fit: LackOfFit | None = None


def estimate_noise_floor(comparison: Comparison, recording: Recording, preprocessing: Preprocessing) -> NoiseFloor:
    """Estimate the noise floor of a recording, from repeated periods where it has them, else from high frequencies.

    Parameters
    ----------
    comparison : Comparison
        The recording with a model's prediction; the lack of fit is that model's.
    recording : Recording
        The recording itself, for its unfiltered torque.
    preprocessing : Preprocessing
        Filters of the model.

    Returns
    -------
    NoiseFloor
        The noise floor of each joint.
    """
    floor = estimate_noise_from_repetitions(comparison)
    return floor or NoiseFloor(estimate_sensor_noise([recording], preprocessing), "high_frequency")


def estimate_sensor_noise(recordings: Sequence[Recording], preprocessing: Preprocessing) -> FloatArray:
    """Estimate the rms (n,) of the torque sensor's noise behind the parallel filter, N m or N.

    From second differences of the raw torque, which motion hardly reaches at a controller's sampling rate: white noise
    of variance σ² gives them 6 σ². The largest are left out, since friction jumps at reversals. Noise that the
    source has already low-passed is underestimated.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one robot.
    preprocessing : Preprocessing
        Filters that the noise is to be known behind.

    Returns
    -------
    (n,)
        Rms of the noise, N m or N.
    """
    n = recordings[0].n
    squares, count = np.zeros(n), 0
    for recording in recordings:
        for block in filtered_blocks(recording, preprocessing):
            tau = block.tau[block.used]
            n_smallest = int(_QUIET * (len(tau) - 2))
            if n_smallest > 0:
                second = np.sort(np.diff(tau, 2, axis=0) ** 2, axis=0)
                squares += second[:n_smallest].sum(axis=0)
                count += n_smallest
    # What is left of a normal distribution's variance without its tails.
    edge = float(special.ndtri(0.5 + 0.5 * _QUIET))
    density = float(np.exp(-0.5 * edge**2) / np.sqrt(2.0 * np.pi))
    share = 1.0 - 2.0 * edge * density / _QUIET
    variance = squares / (6.0 * share * max(count, 1))
    # White noise behind a filter has its variance times the sum of the squared taps.
    taps = low_pass(recordings[0].sampling_rate, preprocessing.torque_cutoff)
    return np.asarray(np.sqrt(variance * float(taps @ taps)))


def estimate_noise_from_repetitions(comparison: Comparison) -> NoiseFloor | None:
    """Estimate the noise floor from intervals where the motion comes again; None where there are too few.

    Two torques of the same motion differ by the noise of both, so the floor is the rms of their difference over √2.
    Where the motion is not repeated exactly, the model takes out what that makes: of the differences of torque and of
    residual the smaller one counts, joint by joint.
    """
    runs = split_tracks(comparison.t, comparison.segment, comparison.q)
    repeats = find_own_repeats(runs)
    pairs = [_pair_repetition(comparison, runs, repeat) for repeat in repeats]
    if sum(len(measured[0]) for measured, _ in pairs) < _FEWEST_PAIRS:
        return None
    # The smaller of both counts: what the motion does not repeat exactly is in the torques, and what the model gets
    # wrong in the residuals.
    squares = [
        _compute_mean_square([second - first for first, second in signals]) for signals in zip(*pairs, strict=True)
    ]
    floor = np.sqrt(0.5 * np.minimum(*squares))
    longest = max(repeats, key=lambda repeat: repeat.duration)
    # Within one track the lag is the period; separate tracks are one period each.
    period = longest.lag if longest.a == longest.b else longest.duration
    repetitions = 1.0 + sum(r.duration for r in repeats) / period
    # A row between two others of its kind is in two pairs: its information counts once.
    once = repetitions / (2.0 * max(repetitions - 1.0, 1.0))
    fit = _test_lack_of_fit([rests for _, rests in pairs], once)
    return NoiseFloor(floor, "repeated_periods", period, repetitions, fit)


def _test_lack_of_fit(pairs: Sequence[tuple[FloatArray, FloatArray]], once: float) -> LackOfFit:
    """Test the residuals (m_i, n) of one pass and the next for lack of fit: their mean against their difference."""
    differences = [second - first for first, second in pairs]
    # A difference of two passes has twice the noise of one, and their mean half of it.
    noise = 0.5 * _compute_mean_square(differences)
    common = 2.0 * _compute_mean_square([0.5 * (first + second) for first, second in pairs])
    safe = np.where(noise > 0, noise, 1.0)
    f = np.where(noise > 0, common / safe, np.where(common > 0, np.inf, 1.0))
    freedom = once * np.array([count_independent_squares([d[:, j] for d in differences]) for j in range(len(f))])
    return LackOfFit(f, np.asarray(special.fdtrc(freedom, freedom, f)))


def _compute_mean_square(parts: Sequence[FloatArray]) -> FloatArray:
    return np.asarray((np.concatenate(parts) ** 2).mean(axis=0))


def _pair_repetition(
    comparison: Comparison, runs: Sequence[Track], repeat: Repeat
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Return torque (m, n), and residual (m, n), of the rows of a repetition, and of the same place the next time."""
    a, b = runs[repeat.a], runs[repeat.b]
    rows = np.flatnonzero((a.t >= repeat.start) & (a.t <= repeat.end))
    later = a.t[rows] + repeat.lag
    n = len(comparison.joint_names)
    signals = np.hstack([comparison.measured, comparison.counted_residual])
    # The next pass is sampled at other instants, so its signals are interpolated at those of the first.
    there = scipy.interpolate.make_interp_spline(b.t, signals[b.first : b.first + len(b.t)], _DEGREE)(later)
    here = signals[a.first + rows]
    return (here[:, :n], there[:, :n]), (here[:, n:], there[:, n:])
