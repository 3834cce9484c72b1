"""Recordings: import of uploaded files, views of recordings and of their checks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.identification.robot_recordings import import_for_robot
from dynident.recordings import (
    Check,
    Recording,
    RecordingError,
    open_recording,
    phase_shares,
)
from dynident.robot import Robot
from dynident_service.adapters.answers import to_view
from dynident_service.adapters.revisions import show_revision, to_recording_metadata
from dynident_service.models import measurements as wire
from dynident_service.problems import Problem, ProblemField, to_problem
from dynident_service.storage.records import Resource

if TYPE_CHECKING:
    # The command line uses this module, too, where no object store is installed.
    from dynident_service.storage.objects import ObjectStore


def import_file(
    source: Path, destination: Path, robot: Robot, metadata: wire.MeasurementMetadata
) -> tuple[Recording, tuple[Check, ...]]:
    """Check an uploaded file and write it as a recording.

    Parameters
    ----------
    source, destination : Path
        The uploaded file, and where the recording is written.
    robot : Robot
        The robot.
    metadata : MeasurementMetadata
        What the user states about the file.

    Returns
    -------
    recording : Recording
        The recording.
    checks : tuple of Check
        What was checked, with warnings.

    Raises
    ------
    RecordingError
        Where the file cannot be used.
    """
    return import_for_robot(
        robot,
        source,
        destination,
        to_recording_metadata(metadata),
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
        to_view(wire.CheckView, check, apply=None if check.apply is None else show_revision(check.apply))
        for check in checks
    ]


def describe_file_problem(error: RecordingError) -> Problem:
    """Build the problem document for an unusable file: column, row or time, and all checks."""
    problem = to_problem(error)
    # A pointer to metadata starts with "/" and lies below the form field; a column of the file is named as it is.
    pointer = f"/metadata{error.pointer}" if error.pointer.startswith("/") else error.pointer
    field = ProblemField(pointer=pointer, detail=error.detail, row=error.row, time=error.time)
    checks = [check.model_dump() for check in show_checks(error.checks)]
    return problem.model_copy(update={"errors": [field], "checks": checks or None})


def open_stored_recording(resource: Resource, objects: ObjectStore) -> Recording:
    """Open the recording of a stored measurement."""
    return open_recording(objects.fetch_file(resource.objects["recording"].key))
