"""Bursts: short stretches of time in which the residual is far above the rest."""

from __future__ import annotations

import numpy as np

from dynident.diagnosis.comparing.compare import Comparison
from dynident.estimation.robust import estimate_robust_scale

_BURST_RATIO, _BURST_WINDOW, _BURST_GAP, _MOST_BURSTS, _LONGEST_BURSTS = 16.0, 0.1, 0.3, 3, 0.2


def find_bursts(comparison: Comparison) -> list[tuple[int, float, float]]:
    """Stretches where the residual is far above the rest of the recording: (segment index, from, to in s)."""
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
