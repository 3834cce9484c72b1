"""Compare a model with recordings, find where it fails, rank the missing effects, and list what stays open."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.diagnosis.ambiguities import Doubt
    from dynident.diagnosis.comparison.measured_against_predicted import Comparison, WorstInterval, compare
    from dynident.diagnosis.comparison.noise_floor import (
        Judgement,
        LackOfFit,
        NoiseFloor,
        RepeatedMotion,
        estimate_noise_floor,
        judge,
    )
    from dynident.diagnosis.comparison.residual_autocorrelation_and_spectra import (
        Autocorrelation,
        ResidualSpectrum,
        angle_spectrum,
        autocorrelation,
        time_spectrum,
    )
    from dynident.diagnosis.decision_levels import DecisionRules, Level
    from dynident.diagnosis.diagnose_model import Examination, diagnose, examine
    from dynident.diagnosis.diagnosis_request import DiagnosisChoices
    from dynident.diagnosis.diagnosis_result import (
        Change,
        ChangedValue,
        Conclusion,
        DetectionLimit,
        Diagnosis,
        FailureSpot,
        FrictionDifference,
        Invisible,
        RankedEffect,
        UnknownPattern,
    )
    from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason
    from dynident.diagnosis.partial_residuals import Evidence, evidence

__all__ = [
    "Autocorrelation",
    "CandidateOutcome",
    "Change",
    "ChangedValue",
    "Comparison",
    "Conclusion",
    "DecisionRules",
    "DetectionLimit",
    "Diagnosis",
    "DiagnosisChoices",
    "Doubt",
    "Evidence",
    "Examination",
    "FailureSpot",
    "FrictionDifference",
    "Invisible",
    "Judgement",
    "LackOfFit",
    "Level",
    "NoiseFloor",
    "RankedEffect",
    "Reason",
    "RepeatedMotion",
    "ResidualSpectrum",
    "UnknownPattern",
    "WorstInterval",
    "angle_spectrum",
    "autocorrelation",
    "compare",
    "diagnose",
    "estimate_noise_floor",
    "evidence",
    "examine",
    "judge",
    "time_spectrum",
]

if not TYPE_CHECKING:
    # Requests are declared in this package, too: reading one must not wait for the imports of the computation.
    __getattr__, __dir__ = make_lazy_exports(__name__)
