"""Find held-out recordings that share samples or a repeated motion with those of the fit.

Holds the correlation that tells a copy, and the share that is reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.repeated_motion import (
    Repeat,
    compute_repeated_share,
    find_common_repeats,
    load_tracks,
)
from dynident.number_format import format_percent
from dynident.recordings import Recording
from dynident.recordings.raw_signals import SHARED, SampleHashes
from dynident.recordings.signal_spectra import find_used_runs

COPIED = 0.996
"""Correlation of what is fast in the torques of two intervals with one motion, from which on they are one recording.
Noise is in it: that of a copy comes again, that of another run is its own. Copies that were cut or shifted have 1.000
where the motion has no periods; those sampled down by a third 0.99, by two thirds 0.89: these are told as repetitions,
which they are as well. Other runs of one motion have up to 0.963, periods of a filtered log up to 0.994."""

MOSTLY = 0.5
"""Share of the moving time of held-out data from which on what they have in common decides what they show."""

# Widths (s) of the two moving averages whose difference is the fast part of the torque.
_FAST, _SLOW = 0.04, 0.3
# Step (s) of the times that are compared, longest time (s), and fewest of them.
_STEP = 0.01
_LONGEST = 30.0
_FEW = 50


@dataclass(frozen=True)
class DataOverlap:
    """Overlap of a held-out recording with one of the fit.

    Parameters
    ----------
    held_out : str
        Name of the held-out recording.
    fitted : str
        Name of the recording of the fit.
    kind : {"copied", "repeated"}
        Whether the samples are the same, or only the motion is repeated.
    share : float
        Share of the held-out recording's moving time, 0 to 1.
    """

    held_out: str
    fitted: str
    kind: Literal["copied", "repeated"]
    share: float

    def __str__(self) -> str:
        if self.kind == "copied":
            says = "the error of the fit" if self.share >= MOSTLY else "partly the error of the fit"
            return (
                f"{self.held_out} holds the same samples as {self.fitted}, which the model was fitted to "
                f"({format_percent(self.share, decimals=0)} of its motion): the held-out error is {says}. Give a "
                "recording that was made independently."
            )
        return (
            f"{self.held_out} repeats the motion of {self.fitted} ({format_percent(self.share, decimals=0)}): the "
            "held-out error holds for this motion only, not for other motions."
        )


def find_overlaps(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> tuple[DataOverlap, ...]:
    """Find what each held-out recording has in common with those of the fit, as far as it decides what they show.

    The same samples are found however short the windows are; the same motion, and samples that were filtered or
    resampled,
    in what lasts a second or more. Only what lies inside the windows counts: another part of the same file is another
    recording.

    Parameters
    ----------
    fitted, held_out : sequence of Recording
        Recordings that the model was fitted to, and those that it is tested on.

    Returns
    -------
    tuple of DataOverlap
        Overlaps, in the order of the held-out recordings.
    """
    if not held_out:
        return ()
    known = [(other, load_tracks(other), SampleHashes.from_recording(other)) for other in fitted]
    overlaps = []
    for recording in held_out:
        own, samples = load_tracks(recording), SampleHashes.from_recording(recording)
        for other, fitted_tracks, fitted_hashes in known:
            # Exact copies are found by hashes of the samples, which is cheap. Only then are motions compared.
            shared = samples.measure_share_in(fitted_hashes)
            if shared > SHARED:
                overlaps.append(DataOverlap(recording.name, other.name, "copied", shared))
                continue
            share = compute_repeated_share(own, fitted_tracks)
            if share < MOSTLY:
                continue
            kind: Literal["copied", "repeated"] = "repeated"
            if correlate_fast_torque(recording, other, find_common_repeats(own, fitted_tracks)) > COPIED:
                kind = "copied"
            overlaps.append(DataOverlap(recording.name, other.name, kind, share))
    return tuple(overlaps)


def correlate_fast_torque(tried: Recording, fitted: Recording, repeats: Sequence[Repeat]) -> float:
    """Return the correlation of the fast part of the torques during the same motion; 0 where there is too little.

    Parameters
    ----------
    tried, fitted : Recording
        The held-out recording and the one of the fit.
    repeats : sequence of Repeat
        Where `tried` repeats the motion of `fitted`.

    Returns
    -------
    float
        Median of the joints' correlations, -1 to 1.
    """
    if not repeats:
        return 0.0
    # The longest repetition has the most noise to compare.
    longest = max(repeats, key=lambda repeat: repeat.duration)
    # The moving averages need so much of the recording on either side.
    start, end = longest.start + _SLOW, min(longest.end, longest.start + _LONGEST) - _SLOW
    t = np.arange(start, end, _STEP)
    if len(t) < _FEW:
        return 0.0
    own, other = _filter_fast_torque(tried, t), _filter_fast_torque(fitted, t + longest.lag)
    if own is None or other is None:
        return 0.0
    sizes = np.sqrt((own**2).sum(axis=0) * (other**2).sum(axis=0))
    moving = sizes > 0
    # The median: one joint with hardly any noise of its own must not decide.
    return float(np.median((own * other).sum(axis=0)[moving] / sizes[moving])) if moving.any() else 0.0


def _filter_fast_torque(recording: Recording, t: FloatArray) -> FloatArray | None:
    """Return the torques (m, n) at times t without their slow part; None where the recording does not span them."""
    for first, length in find_used_runs(recording):
        segment = next(s for s in recording.segments if s.first_row <= first < s.first_row + s.length)
        begin = segment.start_time + (first - segment.first_row) * recording.period
        times: FloatArray = begin + np.arange(length + 1, dtype=np.float64) * recording.period
        # The averages reach half their width beyond the times on either side.
        if times[0] > t[0] - 0.5 * _SLOW or times[-1] < t[-1] + 0.5 * _SLOW:
            continue
        tau = np.concatenate([rows.tau for rows in recording.source.rows(first, length, 65_536)])
        # Moving averages at any time from one cumulative sum: their difference is a band-pass that needs no common
        # clock.
        integral = np.concatenate([np.zeros((1, recording.n)), np.cumsum(tau, axis=0) * recording.period])
        return _compute_moving_mean(times, integral, t, _FAST) - _compute_moving_mean(times, integral, t, _SLOW)
    return None


def _compute_moving_mean(times: FloatArray, integral: FloatArray, t: FloatArray, width: float) -> FloatArray:
    """Return the mean (m, n) over `width` s about each of t, from integrals from the beginning."""
    return np.stack(
        [
            (np.interp(t + 0.5 * width, times, column) - np.interp(t - 0.5 * width, times, column)) / width
            for column in integral.T
        ],
        axis=1,
    )
