"""Compare, find where the model fails, rank what is missing, advise the next experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy import lazily

if TYPE_CHECKING:
    from dynident.diagnosis.comparing.autocorrelation import Autocorrelation, autocorrelation
    from dynident.diagnosis.comparing.compare import Comparison, WorstStretch, compare
    from dynident.diagnosis.comparing.judging import Judgement, RepeatedMotion, judge
    from dynident.diagnosis.comparing.noise import LackOfFit, NoiseFloor, floor_of
    from dynident.diagnosis.comparing.spectrum import ResidualSpectrum, angle_spectrum, time_spectrum
    from dynident.diagnosis.diagnosing import diagnose
    from dynident.diagnosis.evidenced import Evidence, evidence
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
    from dynident.diagnosis.stated import DiagnosisChoices

__all__ = [
    "Autocorrelation",
    "Change",
    "ChangedValue",
    "Comparison",
    "Diagnosis",
    "DiagnosisChoices",
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

if not TYPE_CHECKING:
    # What can be asked is declared in this room, too: who reads that does not wait for what answers it.
    __getattr__ = lazily(__name__)
