"""Diagnoses between the contract and the science."""

from __future__ import annotations

from typing import Any

from dynident.diagnosis import Diagnosis, NextExperiment
from dynident_service.adapters.effects import show_choice
from dynident_service.adapters.identifications import finite, numbers
from dynident_service.models import diagnoses as wire


def describe_diagnosis(found: Diagnosis, robot_id: str) -> wire.DiagnosisResult:
    """Describe a diagnosis for the wire."""
    return wire.DiagnosisResult(
        verdict=found.verdict,
        summary=found.summary,
        noise_floor=numbers(found.noise_floor),
        residual_rms=numbers(found.residual_rms),
        candidates=[
            wire.Candidate(
                rank=one.rank,
                effect=one.effect,
                joints=list(one.joints),
                error_before=finite(one.error_before),
                error_after=finite(one.error_after),
                error_drop=finite(one.error_drop),
                t_value=finite(one.t_value),
                p_value=finite(one.p_value),
                significant=one.significant,
                evidence=one.evidence,
                equivalent=list(one.equivalent),
                separability=finite(one.separability),
                shape_parameters=dict(one.shape),
            )
            for one in found.candidates
        ],
        recommended=[show_choice(one) for one in found.recommended],
        unknown=[
            wire.UnknownPattern(joint=one.joint, variable=one.variable, share=finite(one.share))
            for one in found.unknown
        ],
        not_visible=[
            wire.NotVisible(effect=one.effect, joints=list(one.joints), reason=one.reason) for one in found.not_visible
        ],
        failure_map=[
            wire.FailureSpot(
                joint=one.joint,
                variable=one.variable,
                unit=one.unit,
                low=one.low,
                high=one.high,
                rms=one.rms,
                ratio=finite(one.ratio),
            )
            for one in found.failure_map
        ],
        next_experiment=None if found.next_experiment is None else _next(found.next_experiment, robot_id),
    )


def _next(advice: NextExperiment, robot_id: str) -> wire.NextExperiment:
    design: dict[str, Any] = {
        "robot_id": robot_id,
        "kind": advice.kind,
        "effects": [show_choice(one).model_dump() for one in advice.effects],
    }
    return wire.NextExperiment(reason=advice.reason, design=design)
