"""Baseline: what random motions reach, which an optimised one must exceed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.excitation.criteria.values import CriterionValues


@dataclass(frozen=True)
class Baseline:
    """The best of `count` random motions by the chosen criterion, and the median condition number."""

    count: int
    best: CriterionValues
    median_condition_number: float


def compute_baseline(values: Sequence[CriterionValues]) -> Baseline:
    """Return the baseline from the values of random motions."""
    best = min(values, key=lambda motion_values: motion_values.criterion)
    return Baseline(len(values), best, float(np.median([motion_values.condition_number for motion_values in values])))
