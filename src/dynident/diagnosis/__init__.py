"""Compare, find where the model fails, rank what is missing, say what is left open."""

from dynident.diagnosis.comparing.autocorrelation import Autocorrelation, autocorrelation
from dynident.diagnosis.comparing.compare import Comparison, WorstStretch, compare
from dynident.diagnosis.comparing.judging import Judgement, RepeatedMotion, judge
from dynident.diagnosis.comparing.noise import LackOfFit, NoiseFloor, floor_of
from dynident.diagnosis.comparing.spectrum import ResidualSpectrum, angle_spectrum, time_spectrum
from dynident.diagnosis.diagnose import Examination, diagnose, examine
from dynident.diagnosis.doubts import Doubt
from dynident.diagnosis.evidence import Evidence, evidence
from dynident.diagnosis.result import (
    Change,
    ChangedValue,
    Diagnosis,
    FailureSpot,
    FrictionDifference,
    Invisible,
    RankedEffect,
    UnknownPattern,
)

__all__ = [
    "Autocorrelation",
    "Change",
    "ChangedValue",
    "Comparison",
    "Diagnosis",
    "Doubt",
    "Evidence",
    "Examination",
    "FailureSpot",
    "FrictionDifference",
    "Invisible",
    "Judgement",
    "LackOfFit",
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
    "examine",
    "floor_of",
    "judge",
    "time_spectrum",
]
