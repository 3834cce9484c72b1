"""Compare, find where the model fails, rank what is missing, advise the next experiment."""

from dynident.diagnosis.compare import Comparison, WorstStretch, compare
from dynident.diagnosis.diagnose import diagnose
from dynident.diagnosis.result import Diagnosis, FailureSpot, NextExperiment, RankedEffect, UnknownPattern

__all__ = [
    "Comparison",
    "Diagnosis",
    "FailureSpot",
    "NextExperiment",
    "RankedEffect",
    "UnknownPattern",
    "WorstStretch",
    "compare",
    "diagnose",
]
