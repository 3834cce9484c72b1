"""Import a file or arrays as a `Recording`: time, columns, repair, resampling and storage in one pass."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np

from dynident.array_types import FloatArray, IntArray
from dynident.errors import Remedy
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings.all_checks import has_only_pauses, report_base, report_external_axes, run_checks
from dynident.recordings.base_motion import (
    ReactionSource,
    add_base_pose,
    exempt_integrals,
    find_reactions,
)
from dynident.recordings.columns_to_signals import (
    Column,
    Layout,
    check_surplus_columns,
    find_columns,
    mark_not_recorded,
)
from dynident.recordings.conditioning import Conditioning
from dynident.recordings.file_source import (
    FileSource,
    RawRows,
    RawSample,
    RawSource,
    Repair,
    SampleCollector,
    quote_remarks,
)
from dynident.recordings.formats import open_source
from dynident.recordings.metadata_revisions import exclude_from_windows
from dynident.recordings.pose_recordings import POSES, read_poses, report_poses, write_poses
from dynident.recordings.recording import (
    WRENCH_NAMES,
    ModelChecks,
    RecordedJoints,
    Recording,
    Segment,
    is_inside_windows,
)
from dynident.recordings.recording_metadata import Check, RecordingError, RecordingMetadata, Windows
from dynident.recordings.row_storage import ArraySink, ArraySource, ParquetSink, ParquetSource
from dynident.recordings.sampling_clock import TimeBase, TimeScan, check_time
from dynident.recordings.time_columns import RestartingSource
from dynident.recordings.torque_checks import find_torque_ranges
from dynident.recordings.uniform_segments import Segmenter
from dynident.recordings.units import format_time


def mark_empty_torques(layout: Layout, file: FileSource) -> Layout:
    """Mark torques without a number in any row of a file as not recorded.

    Not where motors act on several joints: each torque is then made of several columns. Nor where no torque holds a
    number, of which the checks say that nothing can be identified from it.

    Parameters
    ----------
    layout : Layout
        The columns of the file, matched with the joints.
    file : FileSource
        The user's file.

    Returns
    -------
    Layout
        The same columns, the empty torques among them as not recorded.
    """
    if layout.mixing is not None:
        return layout
    torques = Layout(t=layout.t, segment=None, q=layout.tau, tau=())
    holds_numbers = np.zeros(len(layout.tau), dtype=bool)
    for rows in file.rows(torques):
        holds_numbers |= np.isfinite(rows.values).any(axis=0)
        # As a rule the first rows show that every torque was recorded.
        if holds_numbers.all():
            return layout
    # Without any torque nothing is gained by marking: the rows are refused when they are read.
    if not holds_numbers.any():
        return layout
    tau = tuple(
        torque if recorded else mark_not_recorded(position)
        for torque, position, recorded in zip(layout.tau, layout.q, holds_numbers, strict=True)
    )
    empty = {int(joint) for joint in np.flatnonzero(~holds_numbers)}
    gains = None if layout.servo_gains is None else np.where(holds_numbers, layout.servo_gains, 0.0)
    silent = tuple(sorted(empty | set(layout.without_torque)))
    return replace(layout, tau=tau, without_torque=silent, servo_gains=gains)


def report_missing_torques(layout: Layout, joint_names: Sequence[str]) -> tuple[Check, ...]:
    """Return a warning that names the joints without torque, if there are any."""
    if not layout.without_torque:
        return ()
    names = [joint_names[joint] for joint in layout.without_torque]
    several = len(names) > 1
    listed = "All joints" if len(names) == len(joint_names) - layout.n_base else ", ".join(names)
    remedy = Remedy("locked_joints", {names[0]: 0})
    return (
        Check(
            "joint_torque",
            "warning",
            f"{listed} {'have' if several else 'has'} no torque: {'their' if several else 'its'} "
            f"equation{'s are' if several else ' is'} left out, {'their' if several else 'its'} motion is used. "
            f"Parameters that only {'these torques' if several else 'this torque'} would show "
            f"({'their' if several else 'its'} friction and drive inertia; for the first joint also its inertia) are "
            f"not identifiable. If a joint does not belong to the arm, such as a finger, lock it: {remedy}.",
            remedies=(remedy,),
        ),
    )


def import_recording(
    source_path: Path | str,
    destination_path: Path | str,
    joints: RecordedJoints,
    *,
    metadata: RecordingMetadata | None = None,
    against: ModelChecks | None = None,
    progress: Progress = ignore_progress,
) -> tuple[Recording, tuple[Check, ...]]:
    """Read a user's file, check it, and store it in SI units on a uniform grid as a canonical Parquet file.

    The file is read twice in blocks (the time column first) and never held in memory. The result appears at
    `destination_path` only when everything is in order; after an error nothing is left there.

    Parameters
    ----------
    source_path : path
        Where the user's file lies; the files of one recording are joined by +.
    destination_path : path
        Where the canonical Parquet file is to lie.
    joints : RecordedJoints
        What the columns are of.
    metadata : RecordingMetadata, optional
        What the user says of the file.
    against : ModelChecks, optional
        What a model of the robot says of order and signs of the columns; without it friction alone tells.
    progress : Progress
        Called with the share that is done and a few words.

    Returns
    -------
    recording : Recording
        The stored recording; its rows stay in the file.
    checks : tuple of Check
        What was found, the doubtful as warnings.

    Raises
    ------
    RecordingError
        For a file that cannot be used: says the column, the row or the time, and what to do. Its `checks` hold all
        that was found up to there.
    """
    metadata = metadata or RecordingMetadata()
    joint_names = tuple(joints.names)
    file = add_base_pose(open_source(Path(source_path), metadata.format, metadata.rate), joints, metadata)
    reactions = find_reactions(file.names, joints, metadata)
    with quote_remarks(file.remarks):
        layout, torque_source = find_columns(file.names, joints, metadata)
    # A torque column without any number would leave out every row: it counts as not recorded instead.
    layout = mark_empty_torques(layout, file)
    source = RestartingSource(ReactionSource(file, reactions, joints) if reactions or joints.project_contacts else file)
    destination = Path(destination_path)
    # In the same folder, so that the finished file takes its place in one step.
    with NamedTemporaryFile(dir=destination.parent, prefix=f".{destination.name}.", delete=False) as unfinished:
        temporary = Path(unfinished.name)
    try:
        # The uniform grid needs the period before the first row can be resampled.
        with quote_remarks(file.remarks):
            base = scan_time(source, layout, metadata.windows, scale_progress(progress, 0.0, 0.2))
        windows = exclude_from_windows(metadata.windows, metadata.exclude, base.first, base.last)
        poses = read_poses(source, layout, base)
        with ParquetSink(temporary, joint_names, layout.kinds) as sink:
            conditioning = Conditioning(layout, joints.known_limits, base, metadata.skip)
            if poses is None:
                segments, sample = _convert_rows(
                    source,
                    layout,
                    base,
                    replace(metadata, windows=windows),
                    sink,
                    scale_progress(progress, 0.2, 0.8),
                    conditioning,
                )
                ranges = find_torque_ranges(sample, layout, joints.known_limits, base.period)
            else:
                segments, ranges = write_poses(poses, sink), ()
            recording = Recording(
                name=metadata.name,
                joint_names=joint_names,
                sampling_rate=1.0 / base.period,
                segments=segments,
                source=_open_stored(temporary, joint_names, layout),
                windows=windows,
                role=metadata.role if poses is None else POSES,
                payload=metadata.payload,
                has_temperature=bool(layout.temperature),
                path=temporary,
                has_wrench=bool(layout.wrench),
                has_command=bool(layout.q_command),
                joints_without_torque=tuple(joint_names[joint] for joint in layout.without_torque),
                torque_from_commands=layout.servo_gains is not None,
                torque_ranges=ranges,
            )
            # The description stands behind the rows, because the segments are known only after the last of them.
            sink.describe(recording)
        surplus = check_surplus_columns(file.names, joints.n - joints.n_base, metadata)
        findings = [
            torque_source,
            *(Check("layout", "warning" if isinstance(remark, Repair) else "ok", remark) for remark in file.remarks),
            *([] if surplus is None else [surplus]),
            *report_missing_torques(layout, joint_names),
            *report_external_axes(file, layout),
            *report_base(joints, reactions),
        ]
        if poses is None:
            are_pauses = has_only_pauses(recording, sample)
            times = check_time(base, layout.t.source, are_pauses=are_pauses)
            findings += [*times, *source.checks(layout.t.source), *conditioning.checks()]
            limits = exempt_integrals(joints.known_limits, layout, file)
            checks = run_checks(recording, sample, layout, limits, tuple(findings), metadata, against)
        else:
            checks = (*findings, *report_poses(poses, base))
        progress(1.0, "stored")
        # In one step: nobody ever sees a file that is written half.
        os.replace(temporary, destination)
    # An interrupt leaves no unfinished file behind, either.
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    # The file has another name now, by which its rows are found from here on.
    return replace(recording, source=_open_stored(destination, joint_names, layout), path=destination), checks


def _open_stored(path: Path, joint_names: tuple[str, ...], layout: Layout) -> ParquetSource:
    has = (bool(columns) for columns in (layout.temperature, layout.wrench, layout.q_command))
    return ParquetSource(path, joint_names, *has)


@dataclass(frozen=True, eq=False)
class FurtherColumns:
    """Signals that were recorded besides positions and torques, each of all joints, or not at all.

    Parameters
    ----------
    temperature : (m, n), optional
        Temperatures of the joints in degC.
    wrench : (m, 6), optional
        Force in N and moment in N m of the base on the robot, in the base frame.
    command : (m, n), optional
        Positions that the robot was told to take, in rad or m.
    """

    temperature: FloatArray | None = None
    wrench: FloatArray | None = None
    command: FloatArray | None = None


NO_FURTHER_COLUMNS = FurtherColumns()


def recording_from_arrays(
    t: FloatArray,
    q: FloatArray,
    tau: FloatArray,
    *,
    joint_names: Sequence[str],
    further: FurtherColumns = NO_FURTHER_COLUMNS,
    segment: IntArray | None = None,
    windows: Windows = (),
    name: str = "recording",
) -> Recording:
    """Make a recording, held in memory, of arrays in SI units, without conditioning and without checks of its motion.

    Parameters
    ----------
    t : (m,)
        Times in s.
    q : (m, n)
        Positions in rad or m.
    tau : (m, n)
        Torques in N m, or forces in N.
    joint_names : sequence of str
        Names of the n joints, in the robot's order.
    further : FurtherColumns, optional
        What was recorded beside positions and torques.
    segment : (m,) of int, optional
        Number of the run that each row belongs to; nothing is filtered across their ends.
    windows : pairs (from, to), optional
        Seconds of t to use; empty: all of them.
    name : str
        What the recording is called.

    Returns
    -------
    Recording
        The recording, evenly sampled within each segment.

    Raises
    ------
    RecordingError
        For unsorted time, or what is no number inside the windows.
    """
    source = _ArrayFile(t, q, tau, segment, tuple(joint_names), further)
    layout = source.layout
    metadata = RecordingMetadata(name=name, windows=windows)
    base = scan_time(source, layout, windows)
    sink = ArraySink()
    poses = read_poses(source, layout, base)
    if poses is None:
        segments, _ = _convert_rows(source, layout, base, metadata, sink, ignore_progress)
    else:
        segments = write_poses(poses, sink)
    values = sink.join_values()
    q, tau = (values[:, layout.columns_of_kind(kind)] for kind in ("q", "tau"))
    optional = ((kind, getattr(layout, kind)) for kind in ("temperature", "wrench", "q_command"))
    further_values = (values[:, layout.columns_of_kind(kind)] if columns else None for kind, columns in optional)
    return Recording(
        name=name,
        joint_names=tuple(joint_names),
        sampling_rate=1.0 / base.period,
        segments=segments,
        source=ArraySource(q, tau, *further_values),
        windows=windows,
        role=None if poses is None else POSES,
        has_temperature=further.temperature is not None,
        has_wrench=further.wrench is not None,
        has_command=further.command is not None,
    )


def condition_arrays(
    t: FloatArray,
    q: FloatArray,
    tau: FloatArray,
    joints: RecordedJoints,
    segment: IntArray | None = None,
    sources: tuple[Sequence[str], Sequence[str]] | None = None,
) -> tuple[FloatArray, FloatArray, tuple[Check, ...]]:
    """Condition arrays as the rows of a file are conditioned before its checks.

    Parameters
    ----------
    t : (m,)
        Times in s.
    q : (m, n)
        Positions in rad or m.
    tau : (m, n)
        Torques in N m, or forces in N.
    joints : RecordedJoints
        The joints and what is known of them.
    segment : (m,) of int, optional
        Number of the run that each row belongs to.
    sources : pair of sequences of str, optional
        What the user calls the columns of q and of tau; by default they are called after the joints.

    Returns
    -------
    q, tau : (m, n)
        NaN where a sample is missing and cannot be bridged.
    checks : tuple of Check
        What was found.

    Raises
    ------
    RecordingError
        For unsorted time.
    """
    source = _ArrayFile(t, q, tau, segment, tuple(joints.names), NO_FURTHER_COLUMNS)
    layout = source.layout
    if sources is not None:
        named = (
            tuple(replace(column, source=name) for column, name in zip(columns, names, strict=True))
            for columns, names in zip((layout.q, layout.tau), sources, strict=True)
        )
        layout = replace(layout, q=next(named), tau=next(named))
    conditioning = Conditioning(layout, joints.known_limits, scan_time(source, layout, ()))
    values = np.concatenate([rows.values for rows in conditioning.condition(source.rows(layout))])
    return values[:, layout.columns_of_kind("q")], values[:, layout.columns_of_kind("tau")], conditioning.checks()


def scan_time(source: RawSource, layout: Layout, windows: Windows, progress: Progress = ignore_progress) -> TimeBase:
    """First pass: read the time column alone, and check the windows against it."""
    scan = TimeScan(layout.t.source)
    for rows in source.times(layout):
        scan.feed(rows)
        progress(0.5, "reading the time column")
    base = scan.result()
    for index, (start, end) in enumerate(windows):
        if end < base.first or start > base.last:
            raise RecordingError(
                f"Window {index + 1} runs from {start:g} to {end:g} s, but {layout.t.source} runs from "
                f"{format_time(base.first)} to {format_time(base.last)} s.",
                pointer=f"/windows/{index}",
                title="Empty window",
                time=start,
            )
    return base


def _convert_rows(
    source: RawSource,
    layout: Layout,
    base: TimeBase,
    metadata: RecordingMetadata,
    sink: ParquetSink | ArraySink,
    progress: Progress,
    conditioning: Conditioning | None = None,
) -> tuple[tuple[Segment, ...], RawSample]:
    """Second pass: condition the rows and write them; keep a bounded sample of them for the checks."""
    # A servo follows a command until the next one comes: on average, the one of half a row ago.
    held = 0.0 if layout.servo_gains is None else 0.5 * base.period
    segmenter = Segmenter(layout, base, metadata.torque_delay - held)
    collector = SampleCollector(base.n_rows, len(layout.q), layout.kinds)
    blocks = source.rows(layout)
    for rows in blocks if conditioning is None else conditioning.condition(blocks):
        if conditioning is not None:
            # Only what is conditioned is checked afterwards, for which the sample is taken.
            collector.feed(rows, is_inside_windows(rows.t, metadata.windows))
        for values in segmenter.push(rows):
            sink.write(values)
        progress((rows.first_row + len(rows.t)) / base.n_rows, "reading the samples")
    for values in segmenter.finish():
        sink.write(values)
    segments = segmenter.segments()
    if not segments:
        checks = () if conditioning is None else conditioning.checks()
        missing = "".join(f" {check.detail}" for check in checks if check.status == "error")
        raise RecordingError(
            f"No part of the recording has enough consecutive samples for the filters ({base.n_rows} rows).{missing}",
            pointer=layout.t.source,
            title="Too short",
        )
    return segments, collector.result()


@dataclass(frozen=True, eq=False)
class _ArrayFile:
    """Arrays that the two passes read like a file."""

    t: FloatArray
    q: FloatArray
    tau: FloatArray
    segment: IntArray | None
    joint_names: tuple[str, ...]
    further: FurtherColumns

    def __post_init__(self) -> None:
        further = self.further
        if further.wrench is not None and further.wrench.shape != (len(self.t), 6):
            raise RecordingError(
                f"wrench has shape {further.wrench.shape}; expected {(len(self.t), 6)}.", pointer="wrench"
            )
        shape = (len(self.t), len(self.joint_names))
        arrays = {"q": self.q, "tau": self.tau, "temperature": further.temperature, "command": further.command}
        for name, values in arrays.items():
            if values is not None and values.shape != shape:
                raise RecordingError(f"{name} has shape {values.shape}; expected {shape}.", pointer=name)

    @property
    def layout(self) -> Layout:
        def columns_of(kind: str) -> tuple[Column, ...]:
            return tuple(Column(f"{kind}_{joint}") for joint in self.joint_names)

        temperature = columns_of("temperature") if self.further.temperature is not None else ()
        wrench = tuple(Column(name) for name in WRENCH_NAMES) if self.further.wrench is not None else ()
        command = columns_of("q_command") if self.further.command is not None else ()
        return Layout(
            Column("t"),
            None,
            columns_of("q"),
            columns_of("tau"),
            q_command=command,
            temperature=temperature,
            wrench=wrench,
        )

    def times(self, layout: Layout) -> Iterator[RawRows]:
        yield RawRows(0, np.asarray(self.t, dtype=np.float64), self._labels(), np.empty((len(self.t), 0)))

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        optional = (self.further.command, self.further.wrench, self.further.temperature)
        parts = [self.q, self.tau, *(part for part in optional if part is not None)]
        yield RawRows(0, np.asarray(self.t, dtype=np.float64), self._labels(), np.concatenate(parts, axis=1))

    def _labels(self) -> IntArray:
        return np.zeros(len(self.t), dtype=np.int64) if self.segment is None else self.segment
