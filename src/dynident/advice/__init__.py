"""The experiment that would decide what a diagnosis leaves open."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_getattr

if TYPE_CHECKING:
    from dynident.advice.discriminating_experiments import AdvisedDiagnosis, NextExperiment, Separation
    from dynident.advice.next_experiment import advise

__all__ = [
    "AdvisedDiagnosis",
    "NextExperiment",
    "Separation",
    "advise",
]

if not TYPE_CHECKING:
    # The types of results are read without the planning of motions.
    __getattr__ = make_lazy_getattr(__name__)
