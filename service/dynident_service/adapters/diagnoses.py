"""Diagnoses between the contract and the science."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from dynident.diagnosis import Diagnosis, FailureSpot, NextExperiment, RankedEffect, UnknownPattern
from dynident.diagnosis.result import Invisible
from dynident_service.adapters.effects import choices_of, show_choice
from dynident_service.adapters.identifications import finite, numbers
from dynident_service.models import diagnoses as wire
from dynident_service.models.designs import DesignRequest


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


def diagnosis_of(stored: Mapping[str, Any]) -> Diagnosis:
    """Make the diagnosis of a stored result."""
    result = wire.DiagnosisResult.model_validate(stored)
    return Diagnosis(
        verdict=result.verdict,
        summary=result.summary,
        noise_floor=np.array(result.noise_floor, dtype=np.float64),
        residual_rms=np.array(result.residual_rms, dtype=np.float64),
        candidates=tuple(_ranked(one) for one in result.candidates),
        recommended=choices_of(result.recommended),
        unknown=tuple(
            UnknownPattern(joint=one.joint, variable=one.variable, share=_number(one.share)) for one in result.unknown
        ),
        not_visible=tuple(Invisible(one.effect, tuple(one.joints), one.reason) for one in result.not_visible),
        failure_map=tuple(
            FailureSpot(**{**one.model_dump(), "ratio": _number(one.ratio)}) for one in result.failure_map
        ),
        next_experiment=None if result.next_experiment is None else _advice(result.next_experiment),
    )


def _ranked(one: wire.Candidate) -> RankedEffect:
    return RankedEffect(
        rank=one.rank,
        effect=one.effect,
        joints=tuple(one.joints),
        error_before=_number(one.error_before),
        error_after=_number(one.error_after),
        error_drop=_number(one.error_drop),
        t_value=_number(one.t_value),
        p_value=_number(one.p_value),
        significant=one.significant,
        evidence=one.evidence,
        equivalent=tuple(one.equivalent),
        separability=_number(one.separability),
        shape=tuple(sorted(one.shape_parameters.items())),
    )


def _advice(one: wire.NextExperiment) -> NextExperiment:
    body = DesignRequest.model_validate(one.design)
    kind: Literal["optimized", "constant_velocity"] = (
        "constant_velocity" if body.kind == "constant_velocity" else "optimized"
    )
    return NextExperiment(reason=one.reason, kind=kind, effects=choices_of(body.effects or ()))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
