"""Columns of many blocks of time, combined into uncorrelated ones of size one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray

_SEEN = 1e-9


@dataclass(frozen=True, eq=False)
class WhitenedColumns:
    """Columns (s, m, p) of s blocks with Σ WₛᵀWₛ = 1, and `spread` = Σ tr((WₛᵀWₛ)²), at most p.

    They are combinations of the columns that they were made of; directions that no block excites are left out.
    """

    rows: FloatArray
    spread: float

    @property
    def count(self) -> int:
        """Number of directions p."""
        return int(self.rows.shape[2])


def whiten_columns(w: FloatArray, factor: FloatArray) -> WhitenedColumns | None:
    """Whiten columns w (s, m, k) with the triangular factor (…, k) of all of them; None where all are zero."""
    _, singular, vt = np.linalg.svd(factor, full_matrices=False)
    is_excited = singular > _SEEN * singular[0] if singular[0] > 0 else np.zeros(len(singular), dtype=bool)
    if not is_excited.any():
        return None
    rows = w @ (vt[is_excited].T / singular[is_excited])
    grams = rows.transpose(0, 2, 1) @ rows
    return WhitenedColumns(rows, float(np.sum(grams * grams)))
