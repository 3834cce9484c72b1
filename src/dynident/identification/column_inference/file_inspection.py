"""`inspect_file`: a file's format, proposed columns and first rows; holds how many rows are shown (20)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.array_types import FloatArray
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.metadata_proposal import SURE, Guess, Proposal, Question
from dynident.identification.robot_recording_import import build_recorded_joints, refute_clocks
from dynident.recordings import Check, Recording, RecordingError, RecordingMetadata, import_recording
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.file_names_and_digests import compute_digest
from dynident.recordings.formats import format_of, open_source
from dynident.robot import Robot

SHOWN_ROWS = 20
SKETCHED_ROWS = 60
"""Rows, at even distances, that a small drawing of a column needs."""

ROW_CHECKS = (
    "time_restarts",
    "gaps",
    "repeated_time",
    "sampling_jitter",
    "rows_left_out",
    "missing_values",
    "saturation",
    "dead_zone",
    "position_jump",
    "joint_columns",
    "clock_rate",
)
"""Checks of rows, time, steps and further joints whose warnings are told of a file that can be used."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """The result of an inspection of a file.

    Parameters
    ----------
    path : Path
        The file, or the files of one recording joined to one path.
    format : str
        Format of the file.
    columns : tuple of str
        Names of its columns.
    rows : (m, columns)
        Its first rows, as they are.
    sketch : (k, columns)
        Some of the rows that were read, at even distances.
    n_rows_seen : int
        Number of rows that were read.
    proposal : Proposal or None
        What the columns probably are; None without a robot.
    """

    path: Path
    format: str
    columns: tuple[str, ...]
    rows: FloatArray
    sketch: FloatArray
    n_rows_seen: int
    proposal: Proposal | None

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the whole file, which is read only when this is asked for."""
        return compute_digest(self.path)


def inspect_file(
    path: Path, robot: Robot | None, rate: float | None = None, columns: Mapping[str, str] | None = None
) -> Inspection:
    """Inspect a sample of a file: at most its first 65536 rows, or 16000 of a bag.

    Parameters
    ----------
    path : path
        Of one file, or of several that are one recording: q.csv+dq.csv+tau.csv.
    robot : Robot, optional
        Whose recording it is; without it nothing is proposed.
    rate : float, optional
        Hz of the rows, where they have no time.
    columns : mapping of our name to the file's, optional
        Those that the user has stated: the others are judged beside them.

    Returns
    -------
    Inspection
        Format, columns, first rows and, with a robot, the proposal.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    sample = read_sample(path, rate)
    if robot is not None and columns:
        sample = replace(sample, stated=_find_stated_signals(columns, sample, robot))
    return Inspection(
        path=path,
        format=format_of(path),
        columns=sample.names,
        rows=sample.values[:SHOWN_ROWS],
        sketch=sample.values[:: max(1, len(sample.values) // SKETCHED_ROWS)][:SKETCHED_ROWS],
        n_rows_seen=len(sample.values),
        proposal=None if robot is None else _import_sample(_propose(sample, robot), sample, robot, columns or {}),
    )


_FOUND_BY_NAMES = ("columns/q", "columns/dq", "columns/tau", "columns/current")


def _propose(sample: Sample, robot: Robot) -> Proposal:
    """Propose what the columns are; of a file without time also what is known, or missing, at any rate of its rows."""
    proposal = propose(sample, robot)
    if "t" in sample.names or all(question.field != "columns/t" for question in proposal.questions):
        return proposal
    rates = (remedy.value for question in proposal.questions for remedy in question.remedies if remedy.field == "rate")
    rate = next((value for value in rates if isinstance(value, float)), _ANY_RATE)
    times = np.arange(len(sample.values)) / rate
    timed = replace(sample, names=(*sample.names, "t"), values=np.column_stack([sample.values, times]))
    at_rate = propose(replace(timed, has_stated_rate=True), robot)
    guesses = (each for each in at_rate.guesses if each.field in _FOUND_BY_NAMES and each.confidence >= SURE)
    missing = [each for each in at_rate.questions if each.field in _FOUND_BY_NAMES]
    # The time that was added is no column of the file.
    missing = [replace(each, choices=tuple(name for name in each.choices if name != "t")) for each in missing]
    return replace(proposal, guesses=(*proposal.guesses, *guesses), questions=(*proposal.questions, *missing))


_ANY_RATE = 100.0
"""Hz of rows that have no time: only what the columns are called is told by it."""


def _find_stated_signals(columns: Mapping[str, str], sample: Sample, robot: Robot) -> dict[str, str]:
    """Return our name of the time, and of signals that are stated for all joints, by the file's name."""
    ours = {columns["t"]: "t"} if columns.get("t") in sample.names else dict[str, str]()
    for signal in ("q", "dq", "tau", "current"):
        keys = [(f"{signal}{joint + 1}", f"{signal}_{name}") for joint, name in enumerate(robot.joint_names)]
        stated = [columns.get(number, columns.get(name, "")) for number, name in keys]
        # Of some joints alone nothing is known of the others, and they are asked about together.
        if set(stated) <= set(sample.names):
            ours |= dict(zip(stated, (name for _, name in keys), strict=True))
    return ours


def _import_sample(proposal: Proposal, sample: Sample, robot: Robot, stated: Mapping[str, str]) -> Proposal:
    """Import the sample as proposed, but with the stated columns, and turn what is refused into questions."""
    # Open questions come first: without their answers the import would fail for reasons that are known already.
    if not proposal.is_sure:
        return proposal
    columns = {**proposal.columns, **stated}
    metadata = RecordingMetadata(columns=columns, units=proposal.units, effort_kind=proposal.effort_kind)
    with TemporaryDirectory(prefix="dynident-") as folder:
        rows = Path(folder) / "rows.parquet"
        # The rows go through the real import, so that nothing is proposed that it would refuse afterwards.
        pq.write_table(pa.table([from_numbers(column) for column in sample.values.T], names=list(sample.names)), rows)
        try:
            recording, checks = import_recording(
                rows,
                Path(folder) / "read.parquet",
                build_recorded_joints(robot),
                metadata=metadata,
                against=_report_checked,
            )
            checks = refute_clocks(robot, recording, checks)
        except RecordingError as error:
            refused = [check for check in error.checks if check.status == "error"]
            questions = [Question.from_check("columns", check) for check in refused]
            return replace(proposal, questions=tuple(questions) or (Question("columns", error.detail),))
    return replace(proposal, guesses=(*proposal.guesses, *_list_findings(checks, proposal)))


def _list_findings(checks: Sequence[Check], proposal: Proposal) -> list[Guess]:
    """Return the warnings of an import that the proposal does not report already."""
    reported = {guess.field for guess in proposal.guesses}
    return [
        Guess(f"rows/{check.name}", "noticed", 0.95, check.detail, check.remedies)
        for check in checks
        if check.status == "warning" and check.name in ROW_CHECKS and f"rows/{check.name}" not in reported
    ]


def _report_checked(_recording: Recording, _q: Sequence[str], _tau: Sequence[str]) -> tuple[Check, ...]:
    """Report that the columns were checked against the dynamics already, so that friction alone need not decide."""
    return (Check("torque_order", "ok", "The inspection has checked this with the robot's dynamics."),)


def read_sample(path: Path, rate: float | None = None) -> Sample:
    """Read the first rows of a file, whose `rate` in Hz may be stated.

    Parameters
    ----------
    path : Path
        The file.
    rate : float, optional
        Rate of the rows in Hz, where the file has no time.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    source = open_source(path, None, rate)
    parts: list[FloatArray] = []
    n_rows = 0
    for block in source.blocks():
        # Only as many rows as are needed: a file may be larger than memory.
        parts.append(block[: source.sample_rows - n_rows])
        n_rows += len(parts[-1])
        if n_rows >= source.sample_rows:
            break
    values = np.concatenate(parts) if parts else np.empty((0, len(source.names)))
    return Sample(tuple(source.names), values, source.units, source.remarks, has_stated_rate=rate is not None)
