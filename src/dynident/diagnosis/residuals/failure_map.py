"""Where a residual is large: over the position, the velocity, the load and the time of every joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.result import FailureSpot

_MAP_BINS = 16
_FEWEST_IN_MAP_BIN = 20


def build_failure_map(comparisons: Sequence[Comparison]) -> tuple[FailureSpot, ...]:
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
            spot = _find_worst_bin(residual, values, rms)
            if spot is not None:
                low, high, local_rms = spot
                spots.append(FailureSpot(name, variable, unit, low, high, local_rms, local_rms / rms))
    return tuple(sorted(spots, key=lambda spot: -spot.ratio))


def _find_worst_bin(residual: FloatArray, values: FloatArray, rms: float) -> tuple[float, float, float] | None:
    edges = _compute_edges(values)
    if edges is None:
        return None
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    counts = np.bincount(which, minlength=len(edges) - 1)
    squares = np.bincount(which, weights=residual**2, minlength=len(edges) - 1)
    local = np.where(counts >= _FEWEST_IN_MAP_BIN, np.sqrt(squares / np.maximum(counts, 1)), 0.0)
    k = int(np.argmax(local))
    return (float(edges[k]), float(edges[k + 1]), float(local[k])) if local[k] > rms else None


def _compute_edges(values: FloatArray) -> FloatArray | None:
    low, high = np.quantile(values, [0.005, 0.995])
    if not high - low > 1e-9 * max(1.0, abs(low), abs(high)):
        return None
    return np.linspace(low, high, _MAP_BINS + 1)
