"""What child processes compute of recordings, while a request waits: checks, inspection, raw signals, standstills.

Also rows of recordings under way, and estimates from them.
"""

from __future__ import annotations

import json
import tempfile
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv as arrow_csv

from dynident.errors import DynidentError
from dynident.identification.identified_models.identification_result import LiveEstimate
from dynident.identification.identified_models.recursive_identification import RecursiveIdentification
from dynident.identification.robot_recording_import import build_recorded_joints, import_for_robot
from dynident.recordings import (
    Recording,
    RecordingError,
    StopReason,
    find_stop_reasons,
    list_fatal_findings,
    open_recording,
)
from dynident.robot import Robot
from dynident_service.designs.adapters import read_reference
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
from dynident_service.measurements.wire_types import (
    ImportMetadata,
    LiveEstimateView,
    LiveParameterView,
    MeasurementMetadata,
    StopReasonView,
)
from dynident_service.problems import ProblemError, make_unusable
from dynident_service.robots.adapters import (
    restore_robot,
)
from dynident_service.shared.field_by_field import replace_non_finite, to_json_numbers, to_view
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


MOST_COLUMNS = 1000
"""Columns that rows of a recording under way may have."""


def append_rows(stored: str | None, sent: str, media_type: str, first: int, destination: str) -> int:
    """Put rows that were sent behind those that are stored, and return the number of all.

    Rows that are there already have to be the same; where no other came, nothing is written.
    """
    table = _read_rows(Path(sent), media_type)
    if stored is None:
        if first:
            raise ProblemError(409, f"No rows have arrived, not {first}.", title="Rows are missing")
        pq.write_table(table, destination)
        return int(table.num_rows)
    before = pq.read_table(stored)
    if table.column_names != before.column_names:
        names = ", ".join(before.column_names)
        raise make_unusable(f"the rows have other columns than those before: {names}", "/", title="Other columns")
    if first > before.num_rows:
        detail = f"{before.num_rows} rows have arrived, not {first}; send the rows in between first."
        raise ProblemError(409, detail, title="Rows are missing")
    before, table = _share_types(before, table)
    common = min(before.num_rows - first, table.num_rows)
    # Compared as numbers: a NaN that is sent again is the same.
    for ours, theirs in zip(before.slice(first, common).columns, table.slice(0, common).columns, strict=True):
        if not np.array_equal(ours.to_numpy(), theirs.to_numpy(), equal_nan=True):
            detail = f"Rows from {first} on have arrived with other values; a retry sends the same rows."
            raise ProblemError(409, detail, title="Other rows")
    if common == table.num_rows:
        return int(before.num_rows)
    whole = pa.concat_tables([before, table.slice(common)])
    pq.write_table(whole.combine_chunks(), destination)
    return int(whole.num_rows)


def _share_types(before: pa.Table, table: pa.Table) -> tuple[pa.Table, pa.Table]:
    """Return both tables with integers in the columns in which one of them has numbers too large for floats."""
    large = [(a if pa.types.is_int64(a.type) else b) for a, b in zip(before.schema, table.schema, strict=True)]
    try:
        return before.cast(pa.schema(large)), table.cast(pa.schema(large))
    except pa.ArrowInvalid as error:
        raise make_unusable(
            f"a column has integers, but the new rows have fractions: {str(error)[:300]}",
            "/",
            title="Unusable rows",
        ) from error


def _read_rows(sent: Path, media_type: str) -> pa.Table:
    """Read rows as columns of numbers."""
    try:
        if media_type == "text/csv":
            table = arrow_csv.read_csv(sent)
        elif media_type == "application/json":
            columns = json.loads(sent.read_bytes())
            if not isinstance(columns, dict):
                raise make_unusable("give an object of columns, each a list of numbers", "/", title="Unusable rows")
            table = pa.table({name: _to_numbers(values) for name, values in columns.items()})
        elif media_type == "application/vnd.apache.parquet":
            table = pq.read_table(sent)
        else:
            detail = f"the content type is {media_type!r}; send application/json, text/csv or Parquet"
            raise ProblemError(415, detail, title="Unsupported media type")
        names = table.column_names
        if len(set(names)) < len(names) or not 0 < len(names) <= MOST_COLUMNS:
            raise make_unusable("columns need different names", "/", title="Unusable rows")
        numbers = pa.table({name: _to_numbers(table[name]) for name in names})
    # A body that was cut, text for a number, lists of other lengths, integers that no number can hold.
    except (pa.ArrowException, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise make_unusable(f"the rows cannot be read: {str(error)[:300]}", "/", title="Unusable rows") from error
    if not numbers.num_rows:
        raise make_unusable("there are no rows", "/", title="Unusable rows")
    return numbers


def _to_numbers(values: Any) -> pa.Array | pa.ChunkedArray:
    """Return a column as floating-point numbers; as integers where these are too large, such as ns since 1970."""
    try:
        return _cast(values, pa.float64())
    except pa.ArrowInvalid:
        return _cast(values, pa.int64())


def _cast(values: Any, kind: pa.DataType) -> pa.Array | pa.ChunkedArray:
    return values.cast(kind) if isinstance(values, (pa.Array, pa.ChunkedArray)) else pa.array(values, type=kind)


MOST_FOLLOWED = 4
"""Recordings under way whose factors a process remembers; others are read again from their first row."""
_followed: OrderedDict[str, RecursiveIdentification] = OrderedDict()


def estimate_rows(
    source: str,
    robot: Mapping[str, object],
    metadata: Mapping[str, object],
    identifier: str,
    count: int,
    before: int,
    is_final: bool,
    planned: str | None,
) -> dict[str, object]:
    """Estimate the parameters from the rows of a recording so far, and find out whether it is worth going on with."""
    restored = restore_robot(robot)
    stated = to_recording_metadata(MeasurementMetadata.model_validate(metadata))
    joints = build_recorded_joints(restored)
    with tempfile.TemporaryDirectory() as folder:
        try:
            recording, checks = import_for_robot(restored, Path(source), Path(folder) / "rows.parquet", stated)
        except RecordingError as error:
            # What the first seconds lack (no joint has moved yet) is no reason to stop: that is decided by name.
            fatal = list_fatal_findings(error.checks)
            reason = "A check refuses the rows so far." if fatal else error.detail
            return _show_estimate(restored, LiveEstimate(0.0, 0, 0, None, reason), count, fatal)
        reference = None if planned is None else read_reference(Path(planned), list(restored.joint_names))
        motion = None if reference is None else (reference.t, reference.q)
        reasons = find_stop_reasons(recording, checks, joints.known_limits, motion)
        return _show_estimate(
            restored, _follow(restored, recording, identifier, before / count, is_final), count, reasons
        )


def _follow(robot: Robot, recording: Recording, identifier: str, seen: float, is_final: bool) -> LiveEstimate:
    """Return the estimate; `seen` is the share of the rows that the last estimate was made of, in whatever process."""
    live = _followed.pop(identifier, None)
    try:
        if live is None:
            live = RecursiveIdentification(robot)
            if 0.0 < seen < 1.0:
                # So that the newest rows are predicted by the estimate before, as where the factors were remembered.
                live.push(_cut_recording(recording, round(seen * recording.n_samples)))
                live.estimate()
        if is_final:
            return live.finish(recording)
        live.push(recording)
        estimate = live.estimate()
    except DynidentError as error:
        return LiveEstimate(0.0, recording.n_samples, 0, None, error.detail)
    _followed[identifier] = live
    while len(_followed) > MOST_FOLLOWED:
        _followed.popitem(last=False)
    return estimate


def _cut_recording(recording: Recording, count: int) -> Recording:
    """Return the first rows of a recording."""
    segments = []
    for segment in recording.segments:
        if count > 0:
            segments.append(replace(segment, length=min(count, segment.length)))
        count -= segment.length
    return replace(recording, segments=tuple(segments))


def _show_estimate(robot: Robot, live: LiveEstimate, count: int, reasons: Sequence[StopReason]) -> dict[str, object]:
    parameters = () if live.estimate is None else live.estimate.parameters
    view = LiveEstimateView(
        rows=count,
        seconds=live.seconds,
        equations=live.n_rows,
        parameters=[
            to_view(LiveParameterView, parameter, standard_deviation=replace_non_finite(parameter.standard_deviation))
            for parameter in parameters
        ],
        reason=live.reason,
        joints=list(robot.joint_names),
        error=None if live.fit is None else to_json_numbers(live.fit.relative),
        predicted=None if live.predicted is None else to_json_numbers(live.predicted),
        stop=[to_view(StopReasonView, reason) for reason in reasons],
    )
    return to_plain_json(view)
