"""Report section on recordings, their checks and filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.identification import Identification
from dynident.number_format import format_count, format_number
from dynident.recordings import Check, Preprocessing, phase_shares
from dynident.reports.labels import format_standstill_shares
from dynident.reports.reported_data import ReportedRecording, Section


@dataclass(frozen=True)
class RecordingRow:
    """One recording, in words."""

    name: str
    role: str
    samples: str
    rate: str
    duration: str
    windows: str
    rows: str
    standing: str
    payload: str


@dataclass(frozen=True)
class CheckRow:
    """One check of one recording."""

    recording: str
    check: Check
    place: str


@dataclass(frozen=True)
class DataContent:
    """The content of the section: recordings, checks, filters."""

    recordings: tuple[RecordingRow, ...]
    checks: tuple[CheckRow, ...]
    filters: tuple[tuple[str, str], ...]
    reasons: tuple[str, ...]
    automatic: bool

    @property
    def doubtful(self) -> list[CheckRow]:
        """The checks that found something."""
        return [row for row in self.checks if row.check.status != "ok"]

    @property
    def passed(self) -> list[CheckRow]:
        """The checks that found nothing."""
        return [row for row in self.checks if row.check.status == "ok"]


def build_data_section(identification: Identification, runs: Sequence[ReportedRecording]) -> Section:
    """Return the section on the data that the model was identified from and tried on.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    runs : sequence of ReportedRecording
        Recordings to show, each with the model's prediction.

    Returns
    -------
    Section
        Recordings, checks and filters.
    """
    preprocessing = identification.preprocessing
    content = DataContent(
        tuple(_build_recording_row(run) for run in runs),
        # All checks are listed, the passed ones folded: what was looked at is part of what is known of the data.
        tuple(CheckRow(run.name, check, _format_place(check)) for run in runs for check in run.checks),
        _list_filters(preprocessing),
        preprocessing.reasons,
        identification.choices.preprocessing is None,
    )
    return Section("data", "The data", "data", content)


def _build_recording_row(run: ReportedRecording) -> RecordingRow:
    recording = run.recording
    seconds = recording.n_samples * recording.period
    windows = "; ".join(f"{format_number(first, 4)} to {format_number(last, 4)} s" for first, last in recording.windows)
    runs = f" in {len(recording.segments)} runs" if len(recording.segments) > 1 else ""
    payload = ", ".join(f"{key} {value}" for key, value in (recording.payload or {}).items())
    return RecordingRow(
        name=run.name,
        role=run.role,
        samples=format_count(recording.n_samples, "sample"),
        rate=f"{format_number(recording.sampling_rate, 4)} Hz",
        duration=f"{format_number(seconds)} s{runs}",
        windows=windows or "all",
        rows=format_count(len(run.comparison.t), "row"),
        standing=format_standstill_shares(phase_shares(recording).standing),
        payload=payload or "none stated",
    )


def _format_place(check: Check) -> str:
    parts = []
    if check.column:
        parts.append(f"column {check.column}")
    if check.row is not None:
        parts.append(f"row {check.row}")
    if check.time is not None:
        parts.append(f"t = {check.time:.6g} s")
    return ", ".join(parts)


def _list_filters(preprocessing: Preprocessing) -> tuple[tuple[str, str], ...]:
    def format_cutoff(value: float | None) -> str:
        return "none" if value is None else f"{format_number(value)} Hz"

    return (
        ("position: zero-phase Butterworth filter, cut-off", format_cutoff(preprocessing.position_cutoff)),
        ("order of one pass", str(preprocessing.filter_order)),
        ("parallel filter on W and Y, cut-off", format_cutoff(preprocessing.torque_cutoff)),
        (
            "decimation",
            f"every {_format_ordinal(preprocessing.decimation)} row" if preprocessing.decimation > 1 else "none",
        ),
    )


def _format_ordinal(count: int) -> str:
    # 11th, 12th and 13th do not follow their last digit.
    if count % 100 in (11, 12, 13):
        return f"{count}th"
    return f"{count}{ {1: 'st', 2: 'nd', 3: 'rd'}.get(count % 10, 'th') }"
