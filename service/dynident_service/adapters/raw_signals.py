"""Signals of an uploaded file as they were recorded, and standstills of a recording, as views."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from dynident.arrays import FloatArray
from dynident.identification.robot_recordings import build_recorded_joints
from dynident.recordings import Recording
from dynident.recordings.as_recorded import RecordedSignals, RobotFile
from dynident.recordings.phases import find_phases
from dynident.robot import Robot
from dynident_service.adapters.answers import to_json_numbers
from dynident_service.adapters.revisions import to_recording_metadata
from dynident_service.models.measurements import MeasurementMetadata, RawSignals, Standstills, StandstillsOfJoint


def open_raw_signals(path: Path, robot: Robot, metadata: MeasurementMetadata, signal_names: list[str]) -> RecordedSignals:
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
    yield f'}}, "n_samples": {total}}}'.encode()


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
    text = json.dumps(to_json_numbers(values))[1:-1]
    return (text if first else f", {text}").encode()
