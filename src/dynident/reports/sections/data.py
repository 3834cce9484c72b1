"""Report section on recordings, their checks and filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.identification import Identification
from dynident.number_format import format_count, format_number
from dynident.presentation.recording_tables import ShownRecording, build_check_table, build_recording_table
from dynident.presentation.tables import ReportedTable
from dynident.recordings import Preprocessing
from dynident.reports.reported_data import ReportedRecording, Section


@dataclass(frozen=True)
class DataContent:
    """The content of the section: recordings, their checks (those that found nothing are folded away), filters."""

    recordings: ReportedTable
    doubtful: ReportedTable | None
    passed: ReportedTable | None
    filters: tuple[tuple[str, str], ...]
    reasons: tuple[str, ...]
    automatic: bool


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
    shown = [ShownRecording(run.recording, run.checks, run.role, len(run.comparison.t)) for run in runs]
    # All checks are listed: what was looked at is part of what is known of the data.
    checks = [(run.name, check) for run in runs for check in run.checks]
    doubtful = [pair for pair in checks if pair[1].status != "ok"]
    passed = [pair for pair in checks if pair[1].status == "ok"]
    passed_title = f"{format_count(len(passed), 'check')} passed"
    content = DataContent(
        build_recording_table(shown),
        build_check_table("Checks that found something", doubtful) if doubtful else None,
        build_check_table(passed_title, passed) if passed else None,
        _list_filters(preprocessing),
        preprocessing.reasons,
        identification.choices.preprocessing is None,
    )
    return Section("data", "The data", "data", content)


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
