"""Compare, find where the model fails, rank what is missing, advise the next experiment."""

from dynident.diagnosis.comparing.autocorrelation import Autocorrelation, autocorrelation
from dynident.diagnosis.comparing.compare import Comparison, WorstStretch, compare
from dynident.diagnosis.comparing.judging import Judgement, RepeatedMotion, judge
from dynident.diagnosis.comparing.noise import LackOfFit, NoiseFloor, floor_of
from dynident.diagnosis.comparing.spectrum import ResidualSpectrum, angle_spectrum, time_spectrum
from dynident.diagnosis.diagnose import diagnose
from dynident.diagnosis.evidence import Evidence, evidence
from dynident.diagnosis.result import (
    Change,
    ChangedValue,
    Diagnosis,
    FailureSpot,
    Invisible,
    NextExperiment,
    RankedEffect,
    UnknownPattern,
)

__all__ = [
    "Autocorrelation",
    "Change",
    "ChangedValue",
    "Comparison",
    "Diagnosis",
    "Evidence",
    "FailureSpot",
    "Invisible",
    "Judgement",
    "LackOfFit",
    "NextExperiment",
    "NoiseFloor",
    "RankedEffect",
    "RepeatedMotion",
    "ResidualSpectrum",
    "UnknownPattern",
    "WorstStretch",
    "angle_spectrum",
    "autocorrelation",
    "compare",
    "diagnose",
    "evidence",
    "floor_of",
    "judge",
    "time_spectrum",
]
