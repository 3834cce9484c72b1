"""Candidates with their scores, and products of columns from triangular factors."""

from __future__ import annotations

import numpy as np

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.candidates.time_blocks_and_folds import Products
from dynident.estimation import Reduction


def judged(gains: np.ndarray, columns=(5,), name: str = "c", t: float = 5.0, **more) -> ScoredCandidate:
    one = np.ones((len(gains), 1))
    values = {
        "candidate": Candidate(name, (), (), columns), "joints": (0,), "before": one, "after": one, "drop": 0.5,
        "t": t,
        "gains": gains, "separability": 1.0, "amplitudes": np.ones(len(columns)), "share_improved": 1.0,
        "measured": np.ones(1), "after_weighted": np.ones(len(gains)),
    }  # fmt: skip
    return ScoredCandidate(**{**values, **more})


def products_from_reduction(reduction: Reduction) -> Products:
    """Return inner products from the triangular factors of one run."""
    grams, position = [], []
    for equation in reduction.equations:
        # RᵀR are the products of the rows that were reduced to R.
        grams.append(equation.factors.transpose(0, 2, 1) @ equation.factors)
        where = np.full(reduction.n_columns, -1, dtype=np.intp)
        where[equation.columns] = np.arange(len(equation.columns))
        position.append(where)
    counts = np.array([equation.counts for equation in reduction.equations]).T.astype(np.float64)
    return Products.from_grams(grams, position, counts, np.zeros(len(counts), dtype=np.intp))
