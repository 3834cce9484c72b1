"""Errors per joint, fit beside held-out, and measured against predicted torque over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.diagnosis import Diagnosis, WorstStretch
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.reports.figures.torque import JOINTS_A_FIGURE, torque_figure
from dynident.reports.numbers import number, percent
from dynident.reports.run import ReportedRun
from dynident.reports.section import Section


@dataclass(frozen=True)
class ErrorCell:
    """Residual of one joint: rms with unit, and relative; the figures themselves beside the words."""

    rms: float
    relative: float
    rms_text: str
    relative_text: str


@dataclass(frozen=True)
class ErrorRow:
    """One joint: fit, held-out, what sensor noise alone would leave."""

    joint: str
    unit: str
    fit: ErrorCell
    held_out: ErrorCell | None
    ratio: str
    floor: str


@dataclass(frozen=True)
class RunFigures:
    """One recording: its figures, its errors, its worst stretches."""

    name: str
    role: str
    figures: tuple[Markup, ...]
    worst: tuple[WorstStretch, ...]


@dataclass(frozen=True)
class ErrorsContent:
    """The table of errors and the figures of every recording."""

    rows: tuple[ErrorRow, ...]
    by_recording: tuple[tuple[str, tuple[str, ...]], ...]
    fit_total: str
    held_out_total: str | None
    has_floor: bool
    runs: tuple[RunFigures, ...]


def errors_section(identification: Identification, runs: Sequence[ReportedRun], diagnosis: Diagnosis | None) -> Section:
    """How well the model predicts torque."""
    held_out = identification.held_out
    content = ErrorsContent(
        tuple(_rows(identification, diagnosis)),
        tuple(_by_recording(identification.model.robot.joint_names, runs)),
        percent(identification.fit.relative_total),
        percent(held_out.relative_total) if held_out is not None else None,
        diagnosis is not None,
        tuple(_run(run) for run in runs),
    )
    return Section("torque", "Measured and predicted torque", "errors", content)


def _rows(identification: Identification, diagnosis: Diagnosis | None) -> Iterator[ErrorRow]:
    held_out = identification.held_out
    for j, joint in enumerate(identification.model.robot.joints):
        fit = _cell(identification.fit, j, joint.effort_unit)
        tried = _cell(held_out, j, joint.effort_unit) if held_out is not None else None
        yield ErrorRow(
            joint.name,
            joint.effort_unit,
            fit,
            tried,
            number(tried.relative / fit.relative) if tried is not None and fit.relative > 0 else "–",
            f"{number(float(diagnosis.noise_floor[j]))} {joint.effort_unit}" if diagnosis is not None else "",
        )


def _cell(errors: Errors, joint: int, unit: str) -> ErrorCell:
    rms, relative = float(errors.rms[joint]), float(errors.relative[joint])
    return ErrorCell(rms, relative, f"{number(rms)} {unit}", percent(relative))


def _by_recording(joints: Sequence[str], runs: Sequence[ReportedRun]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """A row for every joint and one for all: relative errors in each recording."""
    errors = [run.comparison.errors for run in runs]
    for j, joint in enumerate(joints):
        yield joint, tuple(percent(float(item.relative[j])) for item in errors)
    yield "all joints", tuple(percent(item.relative_total) for item in errors)


def _run(run: ReportedRun) -> RunFigures:
    comparison = run.comparison
    n = len(comparison.joint_names)
    parts = [range(first, min(first + JOINTS_A_FIGURE, n)) for first in range(0, n, JOINTS_A_FIGURE)]
    return RunFigures(
        run.name,
        run.role,
        tuple(torque_figure(comparison, joints, run.name) for joints in parts),
        comparison.worst[:4],
    )
