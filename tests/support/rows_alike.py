"""Which rows of recordings are the same but for the digits with which they were written."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray


def outline_rows(rows: Sequence[tuple[FloatArray, FloatArray]]) -> object:
    """What is the same of rows that were written with so many digits, and another where any sample is.

    Means, sizes, and sums with drawn weights: a sample that is off by a fiftieth of its signal's size changes them.
    """
    values = np.vstack([np.hstack(signals) for signals in rows]) if rows else np.zeros((0, 0))
    if not values.size or not np.isfinite(values).all():
        return rows
    middle, size = values.mean(axis=0), values.std(axis=0) + np.finfo(float).tiny
    sums = np.random.default_rng(0).normal(size=(8, len(values))) @ ((values - middle) / size) / np.sqrt(len(values))
    # Means are told in sizes: of a periodic signal only rounding may be left of them.
    return len(values), [f"{one:.4f}" for one in (*sums.ravel(), *(middle / size))], [f"{one:.5g}" for one in size]
