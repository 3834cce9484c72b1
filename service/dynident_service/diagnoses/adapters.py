"""Views of diagnoses, evidence figures and series; stored ones read back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis import Diagnosis, Evidence
from dynident.diagnosis.ambiguities import Doubt
from dynident.diagnosis.diagnosis_result import Change, ChangedValue
from dynident.diagnosis.monitoring import ParameterTrack, Series, SeriesChange
from dynident.presentation.diagnosis_tables import build_diagnosis_tables, build_series_tables
from dynident.robot import Robot
from dynident_service.designs.wire_types import DesignRequest
from dynident_service.diagnoses import wire_types as wire
from dynident_service.problems import ProblemError, make_unusable
from dynident_service.shared.field_by_field import from_view, show_choice, show_tables, to_view
from dynident_service.shared.wire_types import Table, to_plain_json


def describe_diagnosis(diagnosis: Diagnosis, robot: str = "", doubts: Sequence[Doubt] = ()) -> wire.DiagnosisResult:
    """Build the view of a diagnosis; a proposed design is for the robot of this name."""
    advice = diagnosis.next_experiment if isinstance(diagnosis, AdvisedDiagnosis) else None
    return to_view(
        wire.DiagnosisResult,
        diagnosis,
        next_experiment=None if advice is None else show_next_experiment(advice, robot),
        doubts=[to_view(wire.Doubt, doubt) for doubt in doubts],
        changes=None if diagnosis.changes is None else [show_change(change) for change in diagnosis.changes],
        recommended=[
            wire.RecommendedEffect(**show_choice(choice).model_dump(), question=diagnosis.find_question(choice))
            for choice in diagnosis.recommended
        ],
    )


def show_change(change: Change) -> wire.Change:
    """Build the view of a change since the baseline; its main parameter stands at the top level."""
    return to_view(wire.Change, change, **to_view(wire.ChangedValue, change.main).model_dump())


def show_next_experiment(
    advice: NextExperiment,
    robot_id: str,
    measurement_ids: Sequence[str] = (),
    identification_id: str | None = None,
) -> wire.NextExperiment:
    """Build the view of a proposed experiment, whose design can be posted and complements the data at hand.

    The design complements these measurements and predicts torque by this model. On the command line there are no ids:
    measurements and models are files.
    """
    from dynident_service.designs.adapters import show_request

    # Only what differs from the defaults is stated: the proposal stays readable, and can be posted as it is.
    body = show_request(advice.design, robot_id).model_dump(mode="json", exclude_defaults=True)
    if measurement_ids:
        body["earlier_ids"] = list(measurement_ids)
    if identification_id is not None:
        body["identification_id"] = identification_id
    # Defaults are left out, except the kind: readers of the proposal should see what it is.
    return to_view(wire.NextExperiment, advice, design={"robot_id": robot_id, "kind": advice.design.kind, **body})


def restore_diagnosis(stored: Mapping[str, object]) -> AdvisedDiagnosis:
    """Restore a diagnosis from its stored result."""
    wire_result = wire.DiagnosisResult.model_validate(stored)
    return from_view(
        AdvisedDiagnosis,
        wire_result,
        next_experiment=None
        if wire_result.next_experiment is None
        else restore_next_experiment(wire_result.next_experiment),
        changes=None if wire_result.changes is None else tuple(map(_restore_change, wire_result.changes)),
    )


def restore_doubts(stored: Mapping[str, object]) -> tuple[Doubt, ...]:
    """Restore what a stored diagnosis leaves open."""
    return tuple(from_view(Doubt, doubt) for doubt in wire.DiagnosisResult.model_validate(stored).doubts)


def _restore_change(wire_change: wire.Change) -> Change:
    return from_view(Change, wire_change, main=from_view(ChangedValue, wire_change))


def build_stored_tables(stored: Mapping[str, object], joints: Sequence[str], units: Sequence[str]) -> list[Table]:
    """Build the tables of a stored diagnosis."""
    return show_tables(build_diagnosis_tables(restore_diagnosis(stored), joints, units))


def build_stored_series_tables(stored: Mapping[str, object], joints: Sequence[str]) -> list[Table]:
    """Build the tables of a stored series: what changed, and day by day the parameters that did."""
    view = wire.SeriesResult.model_validate(stored)
    changes = tuple(
        SeriesChange(_restore_change(change), *map(view.days.index, (change.since, change.earliest, change.latest)))
        for change in view.changes
    )
    tracks = tuple(
        from_view(ParameterTrack, course, intervals=np.array([course.lower, course.upper], dtype=float).T)
        for course in view.courses
    )
    series = from_view(Series, view, changes=changes, courses=tracks)
    return show_tables(build_series_tables(series, joints))


def restore_next_experiment(wire_experiment: wire.NextExperiment) -> NextExperiment:
    """Restore a proposed experiment from its view."""
    from dynident_service.designs.adapters import to_design_request

    return from_view(
        NextExperiment, wire_experiment, design=to_design_request(DesignRequest.model_validate(wire_experiment.design))
    )


def write_evidence(figures: Sequence[Evidence], robot: Robot) -> bytes:
    """Return all figures of a diagnosis as JSON, for the object store."""
    return json.dumps([to_plain_json(_show_figure(figure, figures, robot)) for figure in figures]).encode()


def read_evidence(content: bytes, rank: int, joint: str | None) -> wire.Evidence:
    """Read the figure of the candidate of a rank, by default for the joint on which it explains most.

    Raises a problem 404 where there is none of that rank, 422 where there is none for that joint.
    """
    figures = [figure for figure in json.loads(content) if figure["rank"] == rank]
    if not figures:
        raise ProblemError(404, f"There is no figure for the effect of rank {rank}.", title="No figure")
    joints: list[str] = figures[0]["joints"]
    joint_name = joints[0] if joint is None else joint
    if joint_name not in joints:
        raise make_unusable(
            f"there is no figure for {joint_name!r}; there are figures for: {', '.join(joints)}", "joint"
        )
    return wire.Evidence.model_validate(next(figure for figure in figures if figure["joint"] == joint_name))


def _show_figure(figure: Evidence, figures: Sequence[Evidence], robot: Robot) -> wire.Evidence:
    # The first joint of this list is the one that `read_evidence` shows when none is asked for.
    same = sorted((other for other in figures if other.rank == figure.rank), key=lambda other: -other.explained)
    return to_view(
        wire.Evidence,
        figure,
        joints=[other.joint for other in same],
        effort_unit=robot.joints[robot.joint_names.index(figure.joint)].effort_unit,
    )


def describe_series(series: Series) -> wire.SeriesResult:
    """Build the view of a series of days."""
    courses = [
        to_view(wire.Course, course, lower=course.intervals[:, 0], upper=course.intervals[:, 1])
        for course in series.courses
    ]
    return to_view(
        wire.SeriesResult,
        series,
        changes=[_show_series_change(series, change) for change in series.changes],
        courses=courses,
    )


def _show_series_change(series: Series, change: SeriesChange) -> wire.SeriesChange:
    days = {name: series.days[getattr(change, name)] for name in ("since", "earliest", "latest")}
    return wire.SeriesChange(**show_change(change.change).model_dump(), **days)
