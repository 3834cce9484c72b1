"""Metadata and revisions from bodies; views of recordings, checks, inspected files and raw signals."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.array_types import FloatArray
from dynident.identification.column_inference import Inspection, inspect_file
from dynident.identification.robot_recording_import import build_recorded_joints
from dynident.recordings import (
    Check,
    Recording,
    RecordingError,
    RecordingMetadata,
    Revision,
    open_recording,
    phase_shares,
)
from dynident.recordings.joint_phases import find_phases
from dynident.recordings.raw_signals import RecordedSignals, RobotFile
from dynident.robot import Robot
from dynident_service.measurements import wire_types as wire
from dynident_service.measurements.wire_types import (
    MeasurementMetadata,
    RawSignals,
    RevisionRequest,
    Standstills,
    StandstillsOfJoint,
)
from dynident_service.problems import Problem, ProblemField, show_remedies, to_problem
from dynident_service.shared.field_by_field import from_view, to_body, to_json_numbers, to_request, to_view
from dynident_service.shared.wire_types import to_plain_json
from dynident_service.storage.repository_values import Resource

if TYPE_CHECKING:
    # The command line uses this module, too, where no object store is installed.
    from dynident_service.storage.object_store import ObjectStore


def inspect_upload(source: Path, robot: Robot, metadata: wire.ImportMetadata, sha256: str) -> wire.ImportResult:
    """Inspect an uploaded file and propose metadata; what the user states wins over what is guessed."""
    stated_metadata = to_request(metadata, RecordingMetadata)
    inspection = inspect_file(source, robot, stated_metadata.rate)
    assert inspection.proposal is not None
    proposed = replace(
        stated_metadata,
        # What the user has stated stands: guesses only fill what is left open.
        columns={**inspection.proposal.columns, **stated_metadata.columns},
        units={**inspection.proposal.units, **stated_metadata.units},
        effort_kind=inspection.proposal.effort_kind,
    )
    # A question about the columns of one kind, as tau1…, is answered by any stated key of that kind.
    answered = {key.rstrip("0123456789") for key in (*stated_metadata.columns, *stated_metadata.units)}
    view = describe_inspection(inspection, sha256)
    questions = [
        question
        for question in view.questions
        if question.field.rpartition("/")[2].rstrip("0123456789") not in answered
    ]
    document = to_plain_json(to_body(MeasurementMetadata, proposed, robot_id=metadata.robot_id))
    return wire.ImportResult(**{**view.model_dump(), "questions": questions, "proposed": document})


def describe_inspection(inspection: Inspection, sha256: str) -> wire.InspectionView:
    """Build the view of an inspection; without a proposal it has no guesses and questions."""
    proposal = inspection.proposal
    questions = [
        to_view(
            wire.QuestionView,
            question,
            choices=question.choices or None,
            remedies=show_remedies(question.remedies),
        )
        for question in (proposal.questions if proposal else ())
    ]
    return to_view(
        wire.InspectionView,
        inspection,
        sha256=sha256,
        guesses=[
            to_view(wire.GuessView, guess, remedies=show_remedies(guess.remedies))
            for guess in (proposal.guesses if proposal else ())
        ],
        questions=questions,
        effort_kind=proposal.effort_kind if proposal else "unknown",
        preview=to_view(wire.PreviewView, inspection),
    )


def open_raw_signals(
    path: Path, robot: Robot, metadata: MeasurementMetadata, signal_names: list[str]
) -> RecordedSignals:
    """Open signals of a file; `RecordingError` for a signal that the file does not have."""
    return RecordedSignals(RobotFile(path, to_recording_metadata(metadata), build_recorded_joints(robot)), signal_names)


def thin_raw_signals(signals: RecordedSignals, points: int, start: float | None, end: float | None) -> RawSignals:
    """Build the view of signals thinned for plots; start and end in s."""
    total, rows = signals.thin_rows(points, start, end)
    return RawSignals(
        units=signals.units,
        t=to_json_numbers(rows.t),
        signals={name: to_json_numbers(rows.values[:, k]) for k, name in enumerate(signals.names)},
        n_samples=total,
        available=list(signals.available),
    )


def stream_raw_signals(signals: RecordedSignals, start: float | None, end: float | None) -> Iterator[bytes]:
    """Yield all samples as JSON of the form of `RawSignals`, signal by signal, so that memory stays bounded."""
    # The JSON is put together by hand, because a file may be larger than memory. Each signal is read on its own, so the
    # file is passed once for the time and once for each signal.
    yield f'{{"units": {json.dumps(signals.units)}, "t": ['.encode()
    total = 0
    for block in signals.rows((), start, end):
        yield _encode_numbers(block.t, first=not total)
        total += len(block.t)
    yield b'], "signals": {'
    for index, name in enumerate(signals.names):
        yield f"{', ' if index else ''}{json.dumps(name)}: [".encode()
        for number, block in enumerate(signals.rows((name,), start, end)):
            yield _encode_numbers(block.values[:, 0], first=not number)
        yield b"]"
    yield f'}}, "n_samples": {total}, "available": {json.dumps(signals.available)}}}'.encode()


def describe_standstills(recording: Recording) -> Standstills:
    """Return the intervals of time in which each joint of a recording stands."""
    segments = find_phases(recording).halts
    return Standstills(
        joints=[
            StandstillsOfJoint(
                joint=name,
                standing=[
                    (float(start), float(end))
                    for halts in (segment[k] for segment in segments)
                    for start, end in zip(halts.starts[halts.sticks], halts.ends[halts.sticks], strict=True)
                ],
            )
            for k, name in enumerate(recording.joint_names)
        ]
    )


def _encode_numbers(values: FloatArray, *, first: bool) -> bytes:
    # The brackets of a block are left out: all blocks together are one list.
    text = json.dumps(to_json_numbers(values))[1:-1]
    return (text if first else f", {text}").encode()


def to_recording_metadata(metadata: wire.MeasurementMetadata) -> RecordingMetadata:
    """Convert metadata of a body; `RecordingError` for an impossible window or delay."""
    return to_request(metadata, RecordingMetadata, **metadata.model_dump(include={"payload"}))


def to_revision(revision_request: RevisionRequest) -> Revision:
    """Convert a revision of a body."""
    return to_request(revision_request, Revision)


def show_revision(revision: Revision) -> RevisionRequest:
    """Build the view of a revision, with the fields that it changes."""
    return RevisionRequest.model_validate({name: getattr(revision, name) for name in revision.changes})


def apply_revision(metadata: wire.MeasurementMetadata, revision_request: RevisionRequest) -> wire.MeasurementMetadata:
    """Return the metadata of a file after a revision."""
    after = to_revision(revision_request).apply_to(to_recording_metadata(metadata))
    return to_body(wire.MeasurementMetadata, after, robot_id=metadata.robot_id)


def restore_checks(views: Sequence[wire.CheckView]) -> tuple[Check, ...]:
    """Restore checks from their views."""
    return tuple(
        from_view(Check, view, apply=None if view.apply is None else to_revision(view.apply)) for view in views
    )


def describe_recording(recording: Recording, checks: Sequence[Check], sha256: str) -> wire.MeasurementResult:
    """Build the view of a recording and its checks."""
    segments = [
        to_view(
            wire.SegmentView,
            segment,
            end_time=segment.start_time + (segment.length - 1) * recording.period,
            n_samples=segment.length,
        )
        for segment in recording.segments
    ]
    return to_view(
        wire.MeasurementResult,
        recording,
        sha256=sha256,
        joints=recording.joint_names,
        segments=segments,
        phases=to_view(wire.PhasesView, phase_shares(recording)),
        checks=show_checks(checks),
    )


def show_checks(checks: Sequence[Check]) -> list[wire.CheckView]:
    """Build the views of checks, with the revision that cures each where one is known."""
    return [
        to_view(
            wire.CheckView,
            check,
            apply=None if check.apply is None else show_revision(check.apply),
            remedies=(remedies := show_remedies(check.remedies)),
            remedy=remedies[0] if remedies else None,
        )
        for check in checks
    ]


def describe_file_problem(error: RecordingError) -> Problem:
    """Build the problem document for an unusable file: column, row or time, and all checks."""
    problem = to_problem(error)
    # A pointer to metadata starts with "/" and lies below the form field; a column of the file is named as it is.
    pointer = f"/metadata{error.pointer}" if error.pointer.startswith("/") else error.pointer
    remedies = show_remedies(error.remedies) or None
    field = ProblemField(pointer=pointer, detail=error.detail, row=error.row, time=error.time, remedies=remedies)
    checks = [check.model_dump() for check in show_checks(error.checks)]
    return problem.model_copy(update={"errors": [field], "checks": checks or None})


def open_stored_recording(resource: Resource, objects: ObjectStore) -> Recording:
    """Open the recording of a stored measurement."""
    return open_recording(objects.fetch_file(resource.objects["recording"].key))
