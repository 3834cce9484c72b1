"""Report sections on accuracy: errors by joint, residuals with spectra, validations (§12.7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.diagnosis import Diagnosis
from dynident.identification import Identification
from dynident.presentation.model_tables import (
    ErrorFigures,
    ErrorKind,
    ErrorNumbers,
    build_error_table,
    describe_interval,
    list_error_kinds,
)
from dynident.presentation.tables import Cell, ReportedTable, make_percent_cells
from dynident.presentation.validation_and_verdict_tables import build_validation_table
from dynident.recordings.joint_phases import Phase
from dynident.reports.figures.residuals import draw_residuals, draw_spectra
from dynident.reports.figures.signals_over_time import JOINTS_PER_FIGURE, draw_torque
from dynident.reports.reported_data import ReportedRecording, ReportedValidation, Section


@dataclass(frozen=True)
class ValidationContent:
    """The content of the section: the verdicts of all validations, and the figures behind them."""

    verdicts: ReportedTable
    tables: tuple[ReportedTable, ...]


def build_validation_section(validations: Sequence[ReportedValidation]) -> Section:
    """Return the section on validations.

    Parameters
    ----------
    validations : sequence of ReportedValidation
        The results of the model's validations.

    Returns
    -------
    Section
        A row for each validation.
    """
    content = ValidationContent(
        build_validation_table((validation.title, validation.judged) for validation in validations),
        tuple(table for validation in validations for table in validation.tables),
    )
    return Section("validation", "Validation", "validation", content)


@dataclass(frozen=True)
class ResidualsContent:
    """The content of the section: the figures and the names of the recordings they show."""

    figures: tuple[Markup, ...]
    spectra: tuple[Markup, ...]
    spectra_of: str
    names: tuple[str, ...]
    held_out: bool


def build_residuals_section(runs: Sequence[ReportedRecording]) -> Section:
    """Return the section on the residual over the signals that missing physics would depend on.

    Parameters
    ----------
    runs : sequence of ReportedRecording
        Recordings to show: the held-out ones among them, or all where there are none.

    Returns
    -------
    Section
        Densities over velocity, position and load, and spectra.
    """
    # Held-out data alone show what the model lacks: to those of the fit its parameters have adapted.
    shown_runs = [run for run in runs if run.held_out] or list(runs)
    comparisons = [run.comparison for run in shown_runs]
    # Recordings cannot be joined for a spectrum; the longest has the finest resolution.
    longest = max(shown_runs, key=lambda run: len(run.comparison.t))
    n = len(comparisons[0].joint_names)
    parts = [range(first, min(first + JOINTS_PER_FIGURE, n)) for first in range(0, n, JOINTS_PER_FIGURE)]
    content = ResidualsContent(
        tuple(draw_residuals(comparisons, joints) for joints in parts),
        tuple(draw_spectra(longest.comparison, joints) for joints in parts),
        longest.name,
        tuple(run.name for run in shown_runs),
        any(run.held_out for run in shown_runs),
    )
    return Section("residuals", "Residuals", "residuals", content)


@dataclass(frozen=True)
class RunFigures:
    """The figures and errors of one recording; `folded` where another recording's figures say more."""

    name: str
    role: str
    folded: bool
    figures: tuple[Markup, ...]
    worst: tuple[str, ...]


@dataclass(frozen=True)
class ErrorsContent:
    """The content of the section: tables of errors and the figures of every recording.

    `by_recording` is None where it would repeat the first table.
    """

    errors: ReportedTable
    by_recording: ReportedTable | None
    rests: bool
    runs: tuple[RunFigures, ...]


def build_errors_section(
    identification: Identification, runs: Sequence[ReportedRecording], diagnosis: Diagnosis | None
) -> Section:
    """Return the section on how well the model predicts torque.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    runs : sequence of ReportedRecording
        Recordings to show, each with the model's prediction.
    diagnosis : Diagnosis or None
        Diagnosis that tells the noise floor.

    Returns
    -------
    Section
        Errors by joint, and the figures of every recording.
    """
    kinds = list_error_kinds(identification)
    joints = identification.model.robot.joints
    names = [joint.name for joint in joints]
    floor = None if diagnosis is None else diagnosis.noise_floor.tolist()
    content = ErrorsContent(
        build_error_table(kinds, names, [joint.effort_unit for joint in joints], floor),
        _build_recording_table(names, kinds, runs),
        any(bool((run.comparison.phase == Phase.STANDING).any()) for run in runs),
        tuple(_build_run_figures(run, any(other.held_out for other in runs)) for run in runs),
    )
    return Section("torque", "Measured and predicted torque", "errors", content)


def _build_recording_table(
    joints: Sequence[str], kinds: Sequence[ErrorKind], runs: Sequence[ReportedRecording]
) -> ReportedTable | None:
    """Return the relative errors in each recording, moving and on all rows.

    None where these are the errors of the fit and of held-out data to the last digit.
    """
    columns = [
        _make_column(ErrorFigures.from_errors(errors))
        for run in runs
        for errors in (run.comparison.moving_errors, run.comparison.errors)
    ]
    known = [_make_column(errors) for kind in kinds for errors in (kind.moving, kind.all_rows)]
    # Columns are compared as text, as the reader sees them: equal text is a repetition whatever the digits behind.
    texts = {tuple(cell.text for cell in column) for column in known}
    if texts.issuperset(tuple(cell.text for cell in column) for column in columns):
        return None
    heads = (words for run in runs for words in (f"{run.name}, moving ({run.role})", "all rows"))
    rows = tuple(
        (Cell(name), *cells) for name, cells in zip((*joints, "all joints"), zip(*columns, strict=True), strict=True)
    )
    return ReportedTable("Relative error per recording", ("joint", *heads), rows)


def _make_column(errors: ErrorNumbers) -> list[Cell]:
    return make_percent_cells([*errors.relative, errors.relative_total])


def _build_run_figures(run: ReportedRecording, some_held_out: bool) -> RunFigures:
    comparison = run.comparison
    n = len(comparison.joint_names)
    parts = [range(first, min(first + JOINTS_PER_FIGURE, n)) for first in range(0, n, JOINTS_PER_FIGURE)]
    return RunFigures(
        run.name,
        run.role,
        # Recordings of the fit are folded where held-out ones, which say more, are shown.
        some_held_out and not run.held_out,
        tuple(draw_torque(comparison, joints, run.name) for joints in parts),
        tuple(map(describe_interval, comparison.worst[:4])),
    )
