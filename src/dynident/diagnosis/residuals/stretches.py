"""Stretches of time: long against the correlation of a residual, so that what happens in them is independent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray
from dynident.diagnosis.comparing.compare import Comparison

_STRETCHES = 30


def number_blocks(comparisons: Sequence[Comparison]) -> NDArray[np.intp]:
    """Number (m,) of the stretch that every row of all comparisons is in."""
    length = sum(float(c.t[-1] - c.t[0]) for c in comparisons) / _STRETCHES
    offset, numbers = 0, []
    for c in comparisons:
        numbers.append(offset + np.floor((c.t - c.t[0]) / max(length, 1e-9)).astype(np.intp))
        offset = int(numbers[-1][-1]) + 1
    return np.concatenate(numbers)


def compute_t(gain: FloatArray) -> float:
    """t of the mean of a gain (s,) over stretches of time."""
    if len(gain) < 2:
        return 0.0
    spread = float(gain.std(ddof=1))
    return float(gain.mean() / (spread / np.sqrt(len(gain)))) if spread > 0 else 0.0


def compute_median_error(errors: FloatArray) -> float:
    """The median of squared errors (s,) over the stretches that have any; 0 where none has.

    Stretches without rows leave none: where many passive joints rub, those in which none of them turns are few.
    """
    positive = errors[errors > 0.0]
    return float(np.median(positive)) if len(positive) else 0.0
