"""What a residual looks like over the signals: where it is large, what it depends on, lines over a joint's angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from dynident.diagnosis.compare import Comparison
from dynident.diagnosis.result import FailureSpot
from dynident.recordings import Preprocessing, Recording, filtered_blocks, low_pass
from dynident.robot.model import FloatArray

_BINS = 16
_FEWEST = 20
_QUIET = 0.95


def noise_floor(recordings: Sequence[Recording], preprocessing: Preprocessing) -> FloatArray:
    """(n,): rms of the torque sensor's noise behind the parallel filter, N m or N.

    From second differences of the raw torque, which motion hardly reaches at a controller's sampling rate: white noise
    of variance σ² gives them 6 σ². The largest are left out, since friction jumps where a joint turns. Noise that the
    source has already low-passed is underestimated.
    """
    n = recordings[0].n
    squares, count = np.zeros(n), 0
    for recording in recordings:
        for block in filtered_blocks(recording, preprocessing):
            tau = block.tau[block.used]
            kept = int(_QUIET * (len(tau) - 2))
            if kept > 0:
                second = np.sort(np.diff(tau, 2, axis=0) ** 2, axis=0)
                squares += second[:kept].sum(axis=0)
                count += kept
    # What is left of a normal distribution's variance without its tails.
    edge = float(stats.norm.ppf(0.5 + 0.5 * _QUIET))
    share = 1.0 - 2.0 * edge * float(stats.norm.pdf(edge)) / _QUIET
    variance = squares / (6.0 * share * max(count, 1))
    taps = low_pass(recordings[0].sampling_rate, preprocessing.torque_cutoff)
    return np.asarray(np.sqrt(variance * float(taps @ taps)))


def failure_map(comparisons: Sequence[Comparison]) -> tuple[FailureSpot, ...]:
    """For every joint and variable, the bin where the residual is largest against the joint's own rms."""
    first = comparisons[0]
    spots = []
    for j, name in enumerate(first.joint_names):
        residual = np.concatenate([c.residual[:, j] for c in comparisons])
        rms = float(np.sqrt(np.mean(residual**2)))
        if rms == 0.0:
            continue
        revolute = first.units[j] == "N m"
        angle = "rad" if revolute else "m"
        for variable, values, unit in (
            ("position", np.concatenate([c.q[:, j] for c in comparisons]), angle),
            ("velocity", np.concatenate([c.dq[:, j] for c in comparisons]), f"{angle}/s"),
            ("load", np.concatenate([c.load[:, j] for c in comparisons]), first.units[j]),
            ("time", np.concatenate([c.t for c in comparisons]), "s"),
        ):
            spot = _worst_bin(residual, values, rms)
            if spot is not None:
                low, high, here = spot
                spots.append(FailureSpot(name, variable, unit, low, high, here, here / rms))
    return tuple(sorted(spots, key=lambda spot: -spot.ratio))


def _worst_bin(residual: FloatArray, values: FloatArray, rms: float) -> tuple[float, float, float] | None:
    edges = _edges(values)
    if edges is None:
        return None
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    counts = np.bincount(which, minlength=len(edges) - 1)
    squares = np.bincount(which, weights=residual**2, minlength=len(edges) - 1)
    local = np.where(counts >= _FEWEST, np.sqrt(squares / np.maximum(counts, 1)), 0.0)
    k = int(np.argmax(local))
    return (float(edges[k]), float(edges[k + 1]), float(local[k])) if local[k] > rms else None


def _edges(values: FloatArray) -> FloatArray | None:
    low, high = np.quantile(values, [0.005, 0.995])
    if not high - low > 1e-9 * max(1.0, abs(low), abs(high)):
        return None
    return np.linspace(low, high, _BINS + 1)
