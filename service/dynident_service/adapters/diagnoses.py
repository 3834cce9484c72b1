"""Diagnoses between the contract and the science."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis.result import Change, ChangedValue
from dynident_service.adapters.answers import known, shown
from dynident_service.adapters.designs import design_request, show_request
from dynident_service.models import diagnoses as wire
from dynident_service.models.designs import DesignRequest


def describe_diagnosis(
    found: AdvisedDiagnosis, robot_id: str, measurement_ids: Sequence[str] = ()
) -> wire.DiagnosisResult:
    """Describe a diagnosis of measurements for the wire; without their ids where they are no resources."""
    advice = found.next_experiment
    return shown(
        wire.DiagnosisResult,
        found,
        next_experiment=None if advice is None else show_next(advice, robot_id, measurement_ids),
        changes=None if found.changes is None else [show_change(one) for one in found.changes],
    )


def show_change(one: Change) -> wire.Change:
    """Show what differs from the baseline, the number that says how large it is first."""
    return shown(wire.Change, one, **shown(wire.ChangedValue, one.main).model_dump())


def show_next(advice: NextExperiment, robot_id: str, measurement_ids: Sequence[str] = ()) -> wire.NextExperiment:
    """Show a proposed experiment, its design ready to be posted and to count the data at hand as earlier runs."""
    body = show_request(advice.design, robot_id).model_dump(mode="json", exclude_defaults=True)
    if measurement_ids:
        body["earlier_ids"] = list(measurement_ids)
    # The kind is a default, but nobody should have to know that.
    return shown(wire.NextExperiment, advice, design={"robot_id": robot_id, "kind": advice.design.kind, **body})


def diagnosis_of(stored: Mapping[str, object]) -> AdvisedDiagnosis:
    """Make the diagnosis of a stored result."""
    told = wire.DiagnosisResult.model_validate(stored)
    return known(
        AdvisedDiagnosis,
        told,
        next_experiment=None if told.next_experiment is None else advice_of(told.next_experiment),
        changes=None
        if told.changes is None
        else tuple(known(Change, one, main=known(ChangedValue, one)) for one in told.changes),
    )


def advice_of(told: wire.NextExperiment) -> NextExperiment:
    """Make the proposed experiment of a stored result."""
    return known(NextExperiment, told, design=design_request(DesignRequest.model_validate(told.design)))
