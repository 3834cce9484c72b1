"""Candidates with their scores."""

from __future__ import annotations

import numpy as np

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import (
    ScoredCandidate,
)


def judged(gains: np.ndarray, columns=(5,), name: str = "c", t: float = 5.0, **more) -> ScoredCandidate:
    one = np.ones((len(gains), 1))
    values = {
        "candidate": Candidate(name, (), (), columns), "joints": (0,), "before": one, "after": one, "drop": 0.5,
        "t": t,
        "gains": gains, "separability": 1.0, "amplitudes": np.ones(len(columns)), "share_improved": 1.0,
        "measured": np.ones(1), "after_weighted": np.ones(len(gains)),
    }  # fmt: skip
    return ScoredCandidate(**{**values, **more})
