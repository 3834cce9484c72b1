"""Where to look for effects that no grid can offer: lines in the residual's spectra, bursts, groups of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import fft

from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.residuals.vibration import shaking
from dynident.identification import Identification
from dynident.recordings import Preprocessing, Recording
from dynident.robot.model import FloatArray, Robot

_MOST_ROWS = 20_000
_LINE_RATIO = 12.0
_LINES_A_JOINT = 2
_LOWEST_LINE, _HIGHEST_LINE = 2.0, 250.0
_BINS = 200
_LEAST_ANGLE, _BESIDE = 0.2, 0.4
# Bins: twenty times the width of a line, nine bins, since its side lobes are as high as how unevenly a motion dwells.
_SURROUNDINGS = 181
# Hz: slower than this, a motion's own lines hide everything else.
_SLOWEST_VIBRATION, _MOST_TIME_LINES, _TIME_LINE_RATIO = 1.0, 2, 6.0
_BURST_RATIO, _BURST_WINDOW, _BURST_GAP, _MOST_BURSTS, _LONGEST_BURSTS = 16.0, 0.1, 0.3, 3, 0.2
_MOST_GROUPS = 16


@dataclass(frozen=True)
class Leads:
    """Where to look for effects that a grid cannot offer, from the recordings and their residual.

    `angle_lines`: (joint index, cycles per radian) of lines in the residual over a joint's angle; `time_lines`: Hz of
    lines over time; `bursts`: (run label, from, to in s) of stretches far above the rest; `run_groups`: sets of runs
    that an effect may be limited to; `has_temperature`: whether all recordings have one; `session`: s that the clock
    of all recordings has run, 0 where it starts anew in each.
    """

    angle_lines: tuple[tuple[int, float], ...] = ()
    time_lines: tuple[float, ...] = ()
    bursts: tuple[tuple[str, float, float], ...] = ()
    run_groups: tuple[tuple[str, ...], ...] = ()
    has_temperature: bool = False
    session: float = 0.0

    @property
    def single_runs(self) -> list[tuple[str, ...]]:
        """Those groups that are one run each."""
        return [group for group in self.run_groups if len(group) == 1]


def find_leads(
    comparisons: Sequence[Comparison], recordings: Sequence[Recording], identification: Identification
) -> Leads:
    """What the residual of the model and the recordings themselves suggest."""
    lines = time_lines(comparisons, identification.preprocessing)
    signals, reference = identification.model.signals, identification.next_reference()
    return Leads(
        angle_lines=tuple(angle_lines(comparisons, identification.model.robot)),
        time_lines=tuple(shaking(comparisons, signals, reference, lines)),
        bursts=tuple(
            (recording.run_label(segment), start, end)
            for comparison, recording in zip(comparisons, recordings, strict=True)
            for segment, start, end in bursts(comparison)
        ),
        run_groups=tuple(run_groups(recordings)),
        has_temperature=all(recording.has_temperature for recording in recordings),
        session=session_length(recordings),
    )


def session_length(recordings: Sequence[Recording]) -> float:
    """Seconds from the first to the last sample; 0 where t starts anew in every recording, so that it is no clock."""
    spans = sorted(
        (segment.start_time, segment.start_time + segment.length * recording.period)
        for recording in recordings
        for segment in recording.segments
    )
    if any(after[0] < before[1] - 1e-6 for before, after in pairwise(spans)):
        return 0.0
    return spans[-1][1] - spans[0][0]


def run_groups(recordings: Sequence[Recording]) -> list[tuple[str, ...]]:
    """Sets of runs that something may have been attached in: those that say so, single ones, the first or last few."""
    labels = list(dict.fromkeys(label for recording in recordings for label in recording.run_labels))
    groups: list[tuple[str, ...]] = []
    if any(recording.payload is not None for recording in recordings):
        groups.append(())
    count = len(labels)
    wanted: list[tuple[str, ...]] = [(label,) for label in labels]
    wanted += [tuple(labels[:k]) for k in range(2, count)] + [tuple(labels[k:]) for k in range(1, count - 1)]
    for group in wanted if count > 1 else []:
        if group not in groups and len(group) < count:
            groups.append(group)
    return groups[:_MOST_GROUPS]


def angle_lines(comparisons: Sequence[Comparison], robot: Robot) -> list[tuple[int, float]]:
    """Lines in the spectrum of the residual over a joint's own angle: (joint index, cycles per radian)."""
    lines = []
    for j, joint in enumerate(robot.joints):
        if joint.kind != "revolute":
            continue
        q = np.concatenate([c.q[:, j] for c in comparisons])
        residual = np.concatenate([c.residual[:, j] for c in comparisons])
        low, span = float(q.min()), float(q.max() - q.min())
        if span < _LEAST_ANGLE:
            continue
        # The same as the sum over all rows, but for the rounding of q to a sixteenth of the shortest wave.
        n_bins = int(np.ceil(span * _HIGHEST_LINE / (2 * np.pi) * 16))
        place = np.minimum(((q - low) / span * n_bins).astype(np.intp), n_bins - 1)
        sums = np.bincount(place, weights=residual - residual.mean(), minlength=n_bins)
        size = fft.next_fast_len(9 * n_bins, real=True)
        k = 2 * np.pi * fft.rfftfreq(size, span / n_bins)
        shown = (k >= max(_LOWEST_LINE, 4 * np.pi / span)) & (k <= _HIGHEST_LINE)
        k, power = k[shown], np.abs(fft.rfft(sums, size)[shown]) ** 2
        found = _peaks(k, power, _LINE_RATIO)[:_LINES_A_JOINT]
        slow = _slow_wave(q, residual, low, span)
        found += [] if slow is None else [slow]
        # A wave beside each, so that what a line is off by is not taken for something else.
        lines += [(j, line + beside / span) for line in found for beside in (0.0, -_BESIDE, _BESIDE)]
    return lines


def _slow_wave(q: FloatArray, residual: FloatArray, low: float, span: float) -> float | None:
    """The wave of at most two cycles over the joint's range that explains most beside a parabola; None: none does.

    A spectrum cannot tell so few cycles from a trend.
    """
    waves = np.arange(_LOWEST_LINE, 4 * np.pi / span, 0.05 / span)
    place = np.minimum(((q - low) / span * _BINS).astype(np.intp), _BINS - 1)
    counts = np.bincount(place, minlength=_BINS).astype(np.float64)
    filled = counts > 0
    if not len(waves) or filled.sum() < 10:
        return None
    weight = np.sqrt(counts[filled])
    y = weight * np.bincount(place, weights=residual, minlength=_BINS)[filled] / counts[filled]
    x = (np.flatnonzero(filled) + 0.5) / _BINS
    trend = np.linalg.qr(weight[:, None] * np.vander(x, 3))[0]
    y = y - trend @ (trend.T @ y)
    gains = []
    for k in waves:
        angle = k * span * x
        wave = weight[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        wave = np.linalg.qr(wave - trend @ (trend.T @ wave))[0]
        gains.append(float(((wave.T @ y) ** 2).sum()))
    best = int(np.argmax(gains))
    return float(waves[best]) if gains[best] > 0.5 * float(y @ y) else None


def time_lines(comparisons: Sequence[Comparison], preprocessing: Preprocessing) -> list[float]:
    """Lines in the spectrum of all joints' residuals over time (Hz) that the motion itself does not have."""
    highest = preprocessing.torque_cutoff or 0.25 / float(np.median(np.diff(comparisons[0].t)))
    longest = max(float(c.t[-1] - c.t[0]) for c in comparisons)
    if longest <= 0.0 or highest <= _SLOWEST_VIBRATION:
        return []
    frequency = np.arange(_SLOWEST_VIBRATION, highest, 0.25 / longest)
    residual, motion = np.zeros(len(frequency)), np.zeros(len(frequency))
    for c in comparisons:
        spread = np.maximum(c.errors.rms, 1e-300)
        residual += _periodogram(c.t, c.residual / spread, frequency)
        motion += _periodogram(c.t, c.dq / np.maximum(c.dq.std(axis=0), 1e-300), frequency)
    moved = set(_peaks(frequency, motion, _LINE_RATIO))
    return [
        line
        for line in _peaks(frequency, residual, _TIME_LINE_RATIO)
        if all(abs(line - other) > 1.0 / longest for other in moved)
    ][:_MOST_TIME_LINES]


def _periodogram(t: FloatArray, values: FloatArray, frequency: FloatArray) -> FloatArray:
    """Power (k,) of signals (m, n), summed over them, at frequencies (k,)."""
    centred = values - values.mean(axis=0)
    step = max(1, len(t) // _MOST_ROWS)
    t, centred = t[::step], centred[::step]
    window = np.hanning(len(t))[:, None]
    power = np.empty(len(frequency))
    for first in range(0, len(frequency), 64):
        wave = np.exp(-2j * np.pi * np.outer(frequency[first : first + 64], t))
        power[first : first + 64] = (np.abs(wave @ (centred * window)) ** 2).sum(axis=1)
    return power / max(len(t), 1)


def _peaks(k: FloatArray, power: FloatArray, least: float) -> list[float]:
    """Peaks of at least so many times their surroundings, the highest first."""
    if len(power) < 3:
        return []
    width = min(_SURROUNDINGS, 2 * ((len(power) - 1) // 2) + 1)
    padded = np.pad(power, width // 2, mode="reflect")
    surrounding = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
    ratio = power / np.maximum(surrounding, np.finfo(float).tiny)
    inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    found = []
    for i in sorted((i for i in inner if ratio[i] > least), key=lambda i: -power[i]):
        a, b, c = power[i - 1], power[i], power[i + 1]
        shift = 0.5 * (a - c) / (a - 2 * b + c)
        found.append(float(k[i] + shift * (k[1] - k[0])))
    return found


def bursts(comparison: Comparison) -> list[tuple[int, float, float]]:
    """Stretches where the residual is far above the rest of the recording: (segment index, from, to in s)."""
    usual = np.median(np.abs(comparison.residual), axis=0) / 0.6745
    power = ((comparison.residual / np.maximum(usual, 1e-300)) ** 2).mean(axis=1)
    if len(power) < 20:
        return []
    period = float(np.median(np.diff(comparison.t)))
    width = max(1, round(_BURST_WINDOW / period))
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    hot = np.flatnonzero(smooth > _BURST_RATIO * max(float(np.median(smooth)), 1.0))
    if not len(hot) or len(hot) > _LONGEST_BURSTS * len(power):
        return []
    gap = (np.diff(comparison.t[hot]) > _BURST_GAP) | (np.diff(comparison.segment[hot]) != 0)
    parts = np.split(hot, np.flatnonzero(gap) + 1)
    parts.sort(key=lambda part: -float(power[part].sum()))
    return [
        (int(comparison.segment[part[0]]), float(comparison.t[part[0]]), float(comparison.t[part[-1]]))
        for part in parts[:_MOST_BURSTS]
        if len(part) > 2
    ]
