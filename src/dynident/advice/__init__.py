"""The experiment that would decide what the data could not."""

from dynident.advice.next_experiment import advise
from dynident.advice.result import AdvisedDiagnosis, NextExperiment, Separation

__all__ = [
    "AdvisedDiagnosis",
    "NextExperiment",
    "Separation",
    "advise",
]
