"""Diagnoses between the contract and the science."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynident.diagnosis import Diagnosis, FailureSpot, NextExperiment, RankedEffect, UnknownPattern
from dynident.diagnosis.result import Change, ChangedValue, Invisible, Separation
from dynident.effects import EffectChoice
from dynident_service.adapters.designs import design_request, show_request
from dynident_service.adapters.effects import choices_of, show_choice
from dynident_service.adapters.identifications import finite, numbers
from dynident_service.models import diagnoses as wire
from dynident_service.models.designs import DesignRequest


def describe_diagnosis(found: Diagnosis, robot_id: str, measurement_ids: Sequence[str] = ()) -> wire.DiagnosisResult:
    """Describe a diagnosis of measurements for the wire; without their ids where they are no resources."""
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
                shape_parameters=dict(one.choice.shape),
                runs=list(one.choice.runs),
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
        next_experiment=None
        if found.next_experiment is None
        else show_next(found.next_experiment, robot_id, measurement_ids),
        changes=None if found.changes is None else [show_change(one) for one in found.changes],
    )


def show_change(one: Change) -> wire.Change:
    """Show what differs from the baseline."""
    return wire.Change(
        **_changed(one.main).model_dump(),
        effect=one.choice.effect,
        joints=list(one.choice.joints),
        shape_parameters=dict(one.choice.shape),
        runs=list(one.choice.runs),
        p_value=finite(one.p_value),
        evidence=one.evidence,
        equivalent=list(one.equivalent),
        more=[_changed(value) for value in one.more],
    )


def _changed(one: ChangedValue) -> wire.ChangedValue:
    low, high = one.interval
    return wire.ChangedValue(
        parameter=one.parameter, value=one.value, unit=one.unit, interval=(finite(low), finite(high)), before=one.before
    )


def _change(one: wire.Change) -> Change:
    return Change(
        choice=EffectChoice(
            one.effect, tuple(one.joints), tuple(sorted(one.shape_parameters.items())), tuple(one.runs)
        ),
        main=_value(one),
        more=tuple(_value(value) for value in one.more),
        p_value=_number(one.p_value),
        evidence=one.evidence,
        equivalent=tuple(one.equivalent),
    )


def _value(one: wire.ChangedValue) -> ChangedValue:
    low, high = one.interval
    ends = (-math.inf if low is None else low, math.inf if high is None else high)
    return ChangedValue(one.parameter, one.value, one.unit, ends, one.before)


def show_next(advice: NextExperiment, robot_id: str, measurement_ids: Sequence[str] = ()) -> wire.NextExperiment:
    """Show a proposed experiment, its design ready to be posted and to count the data at hand as earlier runs."""
    body = show_request(advice.design, robot_id).model_dump(mode="json", exclude_defaults=True)
    if measurement_ids:
        body["earlier_ids"] = list(measurement_ids)
    return wire.NextExperiment(
        reason=advice.reason,
        # The kind is a default, but nobody should have to know that.
        design={"robot_id": robot_id, "kind": advice.design.kind, **body},
        present_separation=_separation(advice.present_separation),
        expected_separation=_separation(advice.expected_separation),
        instructions=list(advice.instructions),
    )


def _separation(found: Separation | None) -> wire.Separation | None:
    if found is None:
        return None
    return wire.Separation(
        parameter=found.parameter,
        unit=found.unit,
        share=found.share,
        standard_deviation=finite(found.standard_deviation),
        t_value=None if found.t_value is None else finite(found.t_value),
    )


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
        next_experiment=None if result.next_experiment is None else advice_of(result.next_experiment),
        changes=None if result.changes is None else tuple(_change(one) for one in result.changes),
    )


def _ranked(one: wire.Candidate) -> RankedEffect:
    return RankedEffect(
        rank=one.rank,
        choice=EffectChoice(
            one.effect, tuple(one.joints), tuple(sorted(one.shape_parameters.items())), tuple(one.runs)
        ),
        error_before=_number(one.error_before),
        error_after=_number(one.error_after),
        error_drop=_number(one.error_drop),
        t_value=_number(one.t_value),
        p_value=_number(one.p_value),
        significant=one.significant,
        evidence=one.evidence,
        equivalent=tuple(one.equivalent),
        separability=_number(one.separability),
    )


def advice_of(one: wire.NextExperiment) -> NextExperiment:
    """Make the proposed experiment of a stored result."""
    return NextExperiment(
        reason=one.reason,
        design=design_request(DesignRequest.model_validate(one.design)),
        present_separation=_stored_separation(one.present_separation),
        expected_separation=_stored_separation(one.expected_separation),
        instructions=tuple(one.instructions),
    )


def _stored_separation(one: wire.Separation | None) -> Separation | None:
    if one is None:
        return None
    deviation = float("inf") if one.standard_deviation is None else one.standard_deviation
    return Separation(one.parameter, one.unit, one.share, deviation, one.t_value)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
