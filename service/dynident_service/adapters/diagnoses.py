"""Diagnoses, the figures behind their ranked effects, and series of days between the contract and the science."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis import Evidence
from dynident.diagnosis.result import Change, ChangedValue
from dynident.diagnosis.series import Series, SeriesChange
from dynident.robot import Robot
from dynident_service.adapters.answers import known, shown
from dynident_service.adapters.designs import design_request, show_request
from dynident_service.models import diagnoses as wire
from dynident_service.models.common import plain
from dynident_service.models.designs import DesignRequest
from dynident_service.problems import ProblemError, unusable


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


def write_evidence(found: Sequence[Evidence], robot: Robot) -> bytes:
    """Write all figures of a diagnosis."""
    return json.dumps([plain(_figure(one, found, robot)) for one in found]).encode()


def read_evidence(content: bytes, rank: int, joint: str | None) -> wire.Evidence:
    """Read the figure of a ranked effect on a joint, or on that which it explains most of.

    Raises
    ------
    ProblemError
        404 where there is none of that rank, 422 where there is none for that joint.
    """
    found = [one for one in json.loads(content) if one["rank"] == rank]
    if not found:
        raise ProblemError(404, f"There is no figure for the effect of rank {rank}.", title="No figure")
    joints: list[str] = found[0]["joints"]
    wanted = joints[0] if joint is None else joint
    if wanted not in joints:
        raise unusable(f"there is no figure for {wanted!r}; there are some for: {', '.join(joints)}", "joint")
    return wire.Evidence.model_validate(next(one for one in found if one["joint"] == wanted))


def _figure(one: Evidence, found: Sequence[Evidence], robot: Robot) -> wire.Evidence:
    same = sorted((other for other in found if other.rank == one.rank), key=lambda other: -other.explained)
    return shown(
        wire.Evidence,
        one,
        joints=[other.joint for other in same],
        effort_unit=robot.joints[robot.joint_names.index(one.joint)].effort_unit,
    )


def describe_series(found: Series) -> wire.SeriesResult:
    """Describe a series of days for the wire."""
    courses = [shown(wire.Course, one, lower=one.intervals[:, 0], upper=one.intervals[:, 1]) for one in found.courses]
    return shown(wire.SeriesResult, found, changes=[_change(found, one) for one in found.changes], courses=courses)


def _change(found: Series, one: SeriesChange) -> wire.SeriesChange:
    days = {name: found.days[getattr(one, name)] for name in ("since", "earliest", "latest")}
    return wire.SeriesChange(**show_change(one.change).model_dump(), **days)
