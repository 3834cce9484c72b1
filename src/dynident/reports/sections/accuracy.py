"""Report sections on accuracy: errors by joint, residuals with spectra, validations (§12.7)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import nan

from markupsafe import Markup

from dynident.diagnosis import Diagnosis, WorstInterval
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.number_format import format_number, format_percent
from dynident.recordings.joint_phases import Phase
from dynident.reports.figures.residuals import draw_residuals, draw_spectra
from dynident.reports.figures.signals_over_time import JOINTS_PER_FIGURE, draw_torque
from dynident.reports.reported_data import ReportedRecording, ReportedValidation, Section

_VERDICT_TEXTS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_VERDICT_MARKS = {"pass": "ok", "fail": "error", "not_evaluated": "warning"}


@dataclass(frozen=True)
class ValidationRow:
    """One validation in words; `mark` is the CSS class of its verdict."""

    validation: ReportedValidation
    verdict: str
    mark: str


@dataclass(frozen=True)
class ValidationContent:
    """The content of the section: all validations."""

    rows: tuple[ValidationRow, ...]


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
    rows = tuple(
        ValidationRow(validation, _VERDICT_TEXTS[validation.judged.verdict], _VERDICT_MARKS[validation.judged.verdict])
        for validation in validations
    )
    return Section("validation", "Validation", "validation", ValidationContent(rows))


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
class ErrorCell:
    """The residual of one joint: its rms with unit and its relative error, as numbers and as text."""

    rms: float
    relative: float
    rms_text: str
    relative_text: str


@dataclass(frozen=True)
class ErrorRow:
    """The errors of one joint: in the fit and held out, each where it moves and on all rows.

    `cells` are in the order of the table's columns; `floor` is the rms that sensor noise alone leaves.
    """

    joint: str
    cells: tuple[ErrorCell, ...]
    ratio: str
    floor: str


@dataclass(frozen=True)
class RunFigures:
    """The figures and errors of one recording; `folded` where another recording's figures say more."""

    name: str
    role: str
    folded: bool
    figures: tuple[Markup, ...]
    worst: tuple[WorstInterval, ...]


@dataclass(frozen=True)
class ErrorsContent:
    """The content of the section: the table of errors and the figures of every recording.

    `by_recording` is empty where it would repeat the first table.
    """

    kinds: tuple[str, ...]
    rows: tuple[ErrorRow, ...]
    totals: tuple[str, ...]
    by_recording: tuple[tuple[str, tuple[str, ...]], ...]
    has_floor: bool
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
    kinds = _list_error_kinds(identification)
    content = ErrorsContent(
        tuple(name for name, _, _ in kinds),
        tuple(_build_error_rows(identification, kinds, diagnosis)),
        tuple(format_percent(errors.relative_total) for _, moving, all_rows in kinds for errors in (moving, all_rows)),
        tuple(_build_recording_rows(identification.model.robot.joint_names, kinds, runs)),
        diagnosis is not None,
        any(bool((run.comparison.phase == Phase.STANDING).any()) for run in runs),
        tuple(_build_run_figures(run, any(other.held_out for other in runs)) for run in runs),
    )
    return Section("torque", "Measured and predicted torque", "errors", content)


def _list_error_kinds(identification: Identification) -> list[tuple[str, Errors, Errors]]:
    """Return the kinds of errors: a name, the errors of moving rows, the errors of all rows."""
    kinds = [("fit", identification.fit_moving, identification.fit)]
    if identification.held_out is not None and identification.held_out_moving is not None:
        kinds.append(("held out", identification.held_out_moving, identification.held_out))
    return kinds


def _build_error_rows(
    identification: Identification, kinds: Sequence[tuple[str, Errors, Errors]], diagnosis: Diagnosis | None
) -> Iterator[ErrorRow]:
    for j, joint in enumerate(identification.model.robot.joints):
        cells = tuple(
            _build_error_cell(errors, j, joint.effort_unit)
            for _, moving, all_rows in kinds
            for errors in (moving, all_rows)
        )
        # The cells alternate between moving and all rows; these two are the moving ones of the first and the last kind.
        fit, held_out = cells[0].relative, cells[-2].relative
        yield ErrorRow(
            joint.name,
            cells,
            format_number(held_out / fit) if len(kinds) > 1 and fit > 0 else "–",
            f"{format_number(float(diagnosis.noise_floor[j]))} {joint.effort_unit}" if diagnosis is not None else "",
        )


def _build_error_cell(errors: Errors, joint: int, unit: str) -> ErrorCell:
    # A joint that never moved, or whose torque was not recorded, has no rows and so no error.
    if not errors.counts[joint]:
        return ErrorCell(nan, nan, "never", "–")
    rms, relative = float(errors.rms[joint]), float(errors.relative[joint])
    return ErrorCell(rms, relative, f"{format_number(rms)} {unit}", format_percent(relative))


def _build_recording_rows(
    joints: Sequence[str], kinds: Sequence[tuple[str, Errors, Errors]], runs: Sequence[ReportedRecording]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the relative errors in each recording: one row a joint, moving and on all rows, and one for all joints.

    Nothing is yielded where these are the errors of the fit and of held-out data to the last digit.
    """
    # Columns are compared as text, as the reader sees them: equal text is a repetition whatever the digits behind.
    known = {_format_column(errors) for _, *both in kinds for errors in both}
    columns = [
        _format_column(errors) for run in runs for errors in (run.comparison.moving_errors, run.comparison.errors)
    ]
    if not known.issuperset(columns):
        yield from zip((*joints, "all joints"), zip(*columns, strict=True), strict=True)


def _format_column(errors: Errors) -> tuple[str, ...]:
    each = (
        format_percent(float(share)) if count else "–"
        for share, count in zip(errors.relative, errors.counts, strict=True)
    )
    return (*each, format_percent(errors.relative_total))


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
        comparison.worst[:4],
    )
