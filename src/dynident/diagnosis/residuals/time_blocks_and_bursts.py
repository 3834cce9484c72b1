"""Number blocks of time that are long against the residual's correlation, and find bursts far above the rest.

Holds into how many blocks the recordings are cut (30).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.estimation.row_weights import estimate_robust_scale

# Of bursts: power over its median, averaging window (s), gap that ends one (s), number, and largest share of all rows.
_BURST_RATIO, _BURST_WINDOW, _BURST_GAP, _MOST_BURSTS, _LONGEST_BURSTS = 16.0, 0.1, 0.3, 3, 0.2


def find_bursts(comparison: Comparison) -> list[tuple[int, float, float]]:
    """Find intervals where the residual is far above the rest of the recording: (segment index, start, end in s)."""
    residual = np.where(comparison.counted_rows, comparison.residual, np.nan)
    silent = ~comparison.counted_rows.any(axis=0)
    usual = estimate_robust_scale(np.where(silent, 0.0, residual))
    # Where a joint stands, its torque says nothing of what else pulls at it.
    power = np.nan_to_num((residual / np.maximum(usual, 1e-300)) ** 2).sum(axis=1) / max(residual.shape[1], 1)
    if len(power) < 20:
        return []
    period = float(np.median(np.diff(comparison.t)))
    width = max(1, round(_BURST_WINDOW / period))
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    hot = np.flatnonzero(smooth > _BURST_RATIO * max(float(np.median(smooth)), 1.0))
    # What fills a fifth of the recording is no burst but a wrong model.
    if not len(hot) or len(hot) > _LONGEST_BURSTS * len(power):
        return []
    gap = (np.diff(comparison.t[hot]) > _BURST_GAP) | (np.diff(comparison.segment[hot]) != 0)
    parts = np.split(hot, np.flatnonzero(gap) + 1)
    # The strongest bursts first, since only a few are tried.
    parts.sort(key=lambda part: -float(power[part].sum()))
    return [
        (int(comparison.segment[part[0]]), float(comparison.t[part[0]]), float(comparison.t[part[-1]]))
        for part in parts[:_MOST_BURSTS]
        if len(part) > 2
    ]


# Number of blocks in all.
_BLOCKS = 30


def number_blocks(comparisons: Sequence[Comparison]) -> NDArray[np.intp]:
    """Return the number (m,) of the block that every row of all comparisons is in."""
    length = sum(float(c.t[-1] - c.t[0]) for c in comparisons) / _BLOCKS
    offset, numbers = 0, []
    for c in comparisons:
        numbers.append(offset + np.floor((c.t - c.t[0]) / max(length, 1e-9)).astype(np.intp))
        offset = int(numbers[-1][-1]) + 1
    return np.concatenate(numbers)


def compute_median_error(errors: FloatArray) -> float:
    """Return the median of squared errors (s,) over the blocks that have any; 0 where none has.

    Blocks without rows leave none: where many passive joints rub, those in which none of them turns are few.
    """
    positive = errors[errors > 0.0]
    return float(np.median(positive)) if len(positive) else 0.0
