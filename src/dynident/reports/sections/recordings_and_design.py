"""Sections of a report on the recordings and on the design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.excitation import Design
from dynident.identification import Identification
from dynident.number_format import format_count, format_number
from dynident.presentation.design_tables import build_design_tables, build_promises_table
from dynident.presentation.recording_tables import ShownRecording, build_check_table, build_recording_table
from dynident.presentation.tables import ReportedTable
from dynident.recordings import Preprocessing, Recording
from dynident.reports.figures.design import draw_design
from dynident.reports.reported_data import ReportedRecording, Section
from dynident.robot import Robot


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
        _list_filters(preprocessing, [run.recording for run in runs]),
        preprocessing.reasons,
        identification.choices.preprocessing is None,
    )
    return Section("data", "The data", "data", content)


def _list_filters(preprocessing: Preprocessing, recordings: Sequence[Recording]) -> tuple[tuple[str, str], ...]:
    def format_cutoff(value: float | None) -> str:
        return "none" if value is None else f"{format_number(value)} Hz"

    position = preprocessing.position_cutoff
    # What the sampling rate allows may differ between recordings.
    own = [preprocessing.find_acceleration_cutoff(recording.sampling_rate) or position for recording in recordings]
    return (
        ("position: zero-phase Butterworth filter, cut-off", format_cutoff(position)),
        ("acceleration: the same filter, cut-off", ", ".join(dict.fromkeys(map(format_cutoff, own)))),
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


def build_promises_section(design: Design, identification: Identification) -> Section | None:
    """Return the section on predicted and achieved standard deviations.

    Parameters
    ----------
    design : Design
        The experiment that the data come from.
    identification : Identification
        The identified model, with the data of its fit.

    Returns
    -------
    Section or None
        None where the design predicted none of the parameters.
    """
    table = build_promises_table(design, identification)
    return None if table is None else Section("promises", "Promised and achieved", "promises", table)


# A robot has dozens of limits. Those that are nearly reached are the interesting ones.
_MAX_MARGINS = 12


@dataclass(frozen=True)
class DesignContent:
    """The content of the section: what kind of motion it is, its tables, notes and figure."""

    kind: str
    length: str
    tables: tuple[ReportedTable, ...]
    has_runs: bool
    notes: tuple[str, ...]
    figure: Markup


def build_design_section(design: Design, robot: Robot) -> Section:
    """Return the section on the designed trajectory.

    Parameters
    ----------
    design : Design
        The experiment that the data come from.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    Section
        Criteria, limits, test motions and the figure.
    """
    content = DesignContent(
        design.request.kind.replace("_", " "),
        f"{format_number(design.duration)} s from rest to rest, {format_count(design.n_samples, 'sample')} at "
        f"{format_number(design.sampling_rate, 4)} Hz",
        tuple(build_design_tables(robot, design, most_limits=_MAX_MARGINS)),
        bool(design.runs),
        design.notes,
        draw_design(design, robot),
    )
    return Section("design", "The experiment", "design", content)
