"""What random motions reach: what an optimised one must be better than."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.excitation.criteria.values import CriterionValues


@dataclass(frozen=True)
class Baseline:
    """The best of `count` random motions by the criterion asked for, and the median condition number."""

    count: int
    best: CriterionValues
    median_condition_number: float


def baseline_of(values: Sequence[CriterionValues]) -> Baseline:
    """The baseline that the values of random motions stand for."""
    best = min(values, key=lambda one: one.criterion)
    return Baseline(len(values), best, float(np.median([one.condition_number for one in values])))
