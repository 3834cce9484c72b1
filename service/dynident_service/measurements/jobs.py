"""What child processes compute of recordings, while a request waits: checks, inspection, raw signals, standstills."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import RecordingError, open_recording
from dynident_service.measurements.adapters import (
    describe_file_problem,
    describe_recording,
    describe_standstills,
    inspect_upload,
    open_raw_signals,
    stream_raw_signals,
    thin_raw_signals,
    to_recording_metadata,
)
from dynident_service.measurements.wire_types import ImportMetadata, MeasurementMetadata
from dynident_service.problems import ProblemError
from dynident_service.robots.adapters import (
    restore_robot,
)
from dynident_service.shared.wire_types import to_plain_json


def import_measurement(
    source: str, destination: str, robot: Mapping[str, object], metadata: Mapping[str, object], sha256: str
) -> dict[str, object]:
    """Check a recorded file, write it as a recording, and return its description."""
    sent_metadata = MeasurementMetadata.model_validate(metadata)
    try:
        recording, checks = import_for_robot(
            restore_robot(robot), Path(source), Path(destination), to_recording_metadata(sent_metadata)
        )
    except RecordingError as error:
        # A problem can cross the pipe, with row or time and with all that was found in the file.
        raise ProblemError.from_problem(describe_file_problem(error)) from error
    return to_plain_json(describe_recording(recording, checks, sha256))


def inspect_file(
    source: str, robot: Mapping[str, object], metadata: Mapping[str, object], sha256: str
) -> dict[str, object]:
    """Return what the columns of a recorded file most probably are."""
    try:
        return to_plain_json(
            inspect_upload(Path(source), restore_robot(robot), ImportMetadata.model_validate(metadata), sha256)
        )
    except RecordingError as error:
        raise ProblemError.from_problem(describe_file_problem(error)) from error


def write_raw_signals(
    source: str,
    destination: str,
    robot: Mapping[str, object],
    metadata: Mapping[str, object],
    signals: list[str],
    start: float | None,
    end: float | None,
    points: int | None,
) -> None:
    """Write signals of a file as JSON.

    The interval is in seconds, None for the whole file; about so many `points` are written, None for all.
    """
    opened = open_raw_signals(Path(source), restore_robot(robot), MeasurementMetadata.model_validate(metadata), signals)
    with Path(destination).open("wb") as file:
        # All samples are written as they are read: they may be larger than the memory.
        if points is None:
            file.writelines(stream_raw_signals(opened, start, end))
        else:
            file.write(thin_raw_signals(opened, points, start, end).model_dump_json().encode())


def find_standstills(recording: str) -> dict[str, object]:
    """Return the intervals in which every joint of a stored recording stands still."""
    return to_plain_json(describe_standstills(open_recording(Path(recording))))
