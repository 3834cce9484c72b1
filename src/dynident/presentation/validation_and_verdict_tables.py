"""Tables of validations, and of the verdict on the uses of a model with the drift of its simulation."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from dynident.array_types import FloatArray
from dynident.number_format import format_count, format_number, format_percent
from dynident.presentation.labels import MarkedText
from dynident.presentation.tables import (
    Cell,
    ReportedTable,
    make_interval_cell,
    make_number_cell,
    make_percent_cell,
    make_percent_cells,
    make_text_cells,
)
from dynident.validation import ValidationOutcome, Verdict
from dynident.verdict import ModelVerdict, State

VALIDATION_WORDS: Mapping[Verdict, MarkedText] = {
    "pass": MarkedText("✓ pass", "ok"),
    "fail": MarkedText("✕ fail", "error"),
    "not_evaluated": MarkedText("– not evaluated", "warning"),
}
"""Words and mark for the verdict of a validation."""

VALIDATION_TITLES = {
    "direct": "Direct validation: the identification's own data",
    "cross": "Cross validation: held-out data",
    "inertia_matrix": "Inertia matrix over the whole joint range",
    "payload": "A known load",
    "methods": "Different methods on the same data",
    "simulation": "A simulator with the identified parameters",
    "drift": "Drift of a simulation without a controller",
    "collision": "Contact detection by a momentum observer",
    "filters": "Filters, by simulating the identification",
    "bootstrap": "Standard deviations, from resampled blocks of time",
}
"""What each kind of validation tests."""

STATE_WORDS: Mapping[State, MarkedText] = {
    "yes": MarkedText("✓ fit", "ok"),
    "limited": MarkedText("! within limits", "warning"),
    "no": MarkedText("✕ not fit", "error"),
    "not_judged": MarkedText("? not judged", "warning"),
}
"""Words and mark for how fit a model is for a use."""


class DriftFigures(Protocol):
    """Drift of a simulation after each of h times, of n joints; None where it diverged or nothing is that long."""

    @property
    def joint_names(self) -> Sequence[str]:
        """Names of the joints."""

    @property
    def after(self) -> Sequence[float]:
        """The times, s."""

    @property
    def distance(self) -> Sequence[Sequence[float | None]]:
        """Drift of the position (h, n), rad or m."""

    @property
    def speed(self) -> Sequence[Sequence[float | None]]:
        """Drift of the velocity (h, n), rad/s or m/s; empty where it is unknown."""

    @property
    def share(self) -> Sequence[Sequence[float | None]]:
        """Drift of the position over the joint's travel in that time (h, n), a fraction."""

    @property
    def starts(self) -> int:
        """How many starts the figures are of."""


def build_validation_table(validations: Iterable[tuple[str, ValidationOutcome]]) -> ReportedTable:
    """Return validations, each with its title, as a table of their verdicts and reasons."""
    rows = tuple(
        (Cell(title), _make_cell(VALIDATION_WORDS[judged.verdict]), Cell(judged.reason))
        for title, judged in validations
    )
    return ReportedTable("Validations", ("validation", "verdict", "why"), rows, numbers_from=3)


def _make_cell(marked: MarkedText) -> Cell:
    return Cell(marked.words, mark=marked.mark)


def build_verdict_tables(verdict: ModelVerdict) -> Iterator[ReportedTable]:
    """Yield the uses that a model is fit for, and the drift of its simulation; nothing after a gross fault."""
    if verdict.stop is not None:
        return
    rows = tuple(
        (Cell(use.words), _make_cell(STATE_WORDS[use.state]), *make_text_cells(use.reason, use.next_step))
        for use in verdict.uses
    )
    title = "Uses that the model is fit for, by a test of each use"
    yield ReportedTable(title, ("use", "fit", "why", "what next"), rows, numbers_from=4, name="uses")
    if verdict.drift is not None:
        drift = verdict.drift
        distance, share = (_without_diverged(values) for values in (drift.distance, drift.share))
        names, after, starts = drift.joint_names, drift.after, drift.starts
        figures = SimpleNamespace(
            joint_names=names, after=after, distance=distance, speed=[], share=share, starts=starts
        )
        yield from build_drift_tables(figures, "held-out data")


def _without_diverged(values: FloatArray) -> list[list[float | None]]:
    return [[float(value) if np.isfinite(value) else None for value in row] for row in values]


def build_drift_tables(drift: DriftFigures, where: str = "") -> Iterator[ReportedTable]:
    """Yield the drift of the positions and, where it is known, of the velocities: joints by times.

    Times that no recording reaches have no column; a diverged simulation has one.

    Parameters
    ----------
    drift : DriftFigures
        The drift.
    where : str
        The recording, where each has tables of its own.
    """
    kinds = [("position", "rad or m, and relative to the joint's travel", drift.distance, drift.share)]
    if drift.speed:
        kinds.append(("velocity", "rad/s or m/s", drift.speed, [[None] * len(drift.joint_names)] * len(drift.after)))
    for quantity, unit, distances, shares in kinds:
        reached = [k for k, row in enumerate(distances) if k == 0 or any(value is not None for value in row)]
        rows = tuple(
            (Cell(joint), *(_make_drift_cell(distances[k][j], shares[k][j]) for k in reached))
            for j, joint in enumerate(drift.joint_names)
        )
        place = f" on {where}" if where else ""
        starts = format_count(drift.starts, "start")
        title = f"Drift of the {quantity} under the measured torque{place}, rms, in {unit} ({starts})"
        columns = ("joint", *(f"after {drift.after[k]:g} s" for k in reached))
        yield ReportedTable(title, columns, rows, name="drift" if quantity == "position" else "drift_of_velocity")


class ContactThresholds(Protocol):
    """Thresholds of a momentum observer; None where a joint was not recorded long enough."""

    @property
    def speeds(self) -> Sequence[Sequence[float | None]]:
        """Speeds between the classes (n, 2), rad/s or m/s."""

    @property
    def thresholds(self) -> Sequence[Sequence[float | None]]:
        """Thresholds (n, 4), N m or N."""


def build_threshold_table(contact: ContactThresholds, joints: Sequence[str]) -> ReportedTable:
    """Return the contact thresholds of each joint, slow or just slow before, then by class of speed."""
    rows = tuple(
        (
            Cell(joint),
            *(make_number_cell(value) for value in thresholds),
            Cell(" and ".join("–" if speed is None else format_number(speed, 2) for speed in speeds)),
        )
        for joint, speeds, thresholds in zip(joints, contact.speeds, contact.thresholds, strict=True)
    )
    columns = (
        "joint",
        "slow, or just before",
        "moving slowly",
        "at medium speed",
        "fast",
        "speeds between, rad/s or m/s",
    )
    title = "Contact thresholds on the residual of the momentum observer, N m or N"
    return ReportedTable(title, columns, rows, name="thresholds")


def _make_drift_cell(distance: float | None, share: float | None) -> Cell:
    if distance is None:
        return Cell("diverged", mark="warning")
    text = format_number(distance, 2)
    return Cell(text if share is None else f"{text} ({format_percent(share, 2)})", distance)


def build_figure_tables(document: Mapping[str, object], joints: Sequence[str]) -> Iterator[ReportedTable]:
    """Yield a table for each kind of figures of a validation, whose JSON has all fields of the HTTP contract."""
    result: Any = json.loads(json.dumps(document), object_hook=lambda part: SimpleNamespace(**part))
    joint_columns = (*joints, "all joints")
    if result.measurements and result.total is not None:
        rows = [(measurement.name, measurement.errors) for measurement in result.measurements]
        # Results of earlier versions have no total of the rows where joints move, which the others are of.
        has_total = getattr(result.total, "moving", None) or not _have_moving_errors(rows)
        rows += [("all", result.total)] if len(rows) > 1 and has_total else []
        cells = tuple((Cell(name), *_relative_error_cells(errors, len(joints))) for name, errors in rows)
        title = "Relative torque error while each joint moves"
        yield ReportedTable(title, ("measurement", *joint_columns), cells)
    if result.worst_posture is not None:
        # The posture is told so that the user can try it.
        posture = tuple((Cell(joint), make_number_cell(value)) for joint, value in vars(result.worst_posture).items())
        yield ReportedTable(f"Worst of {result.postures_tried} postures", ("joint", "rad or m"), posture)
    yield from _build_method_tables(result.methods, joint_columns)
    if any(simulation.torque is not None for simulation in result.simulations):
        torque_rows = tuple(
            (
                Cell(simulation.name),
                make_number_cell(simulation.duration, unit="s"),
                *_relative_error_cells(simulation.torque, len(joints)),
            )
            for simulation in result.simulations
        )
        yield ReportedTable(
            "Simulated against measured torque, while each joint moves",
            ("measurement", "simulated", *joint_columns),
            torque_rows,
        )
        position_rows = tuple(
            (Cell(simulation.name), *make_percent_cells(simulation.position_share))
            for simulation in result.simulations
            if simulation.position_share is not None
        )
        if position_rows:
            title = "Distance of the simulated from the measured positions, relative to each joint's range"
            yield ReportedTable(title, ("measurement", *joints), position_rows)
        for simulation in result.simulations:
            if simulation.drift is not None:
                yield from build_drift_tables(simulation.drift, simulation.name if len(result.simulations) > 1 else "")
    if result.drift is not None:
        yield from build_drift_tables(result.drift)
    if result.contact is not None:
        yield build_threshold_table(result.contact, joints)
    if result.filters is not None:
        yield _build_filter_table(result.filters)
    if result.bootstrap is not None and result.bootstrap.parameters:
        yield _build_bootstrap_table(result.bootstrap)
    if result.payloads:
        yield _build_payload_table(result.payloads)
        yield from (_build_gain_table(payload) for payload in result.payloads if payload.gains)


def _have_moving_errors(rows: Sequence[tuple[str, Any]]) -> bool:
    return any(getattr(errors, "moving", None) is not None for _, errors in rows)


def _build_method_tables(methods: Sequence[Any], joint_columns: Sequence[str]) -> Iterator[ReportedTable]:
    solved_methods = [(method, method.held_out) for method in methods if method.held_out is not None]
    if solved_methods:
        # The best method is marked by its own error, and not by its place in the list.
        totals = [_relative_error_cells(errors, len(joint_columns) - 1)[-1].value for _, errors in solved_methods]
        best = min(total or 0.0 for total in totals)
        columns = ("method", *joint_columns, "σ apart", "farthest", "torque", "own ±", "time")
        rows = tuple(_build_method_row(method, errors, best) for method, errors in solved_methods)
        title = (
            "Relative error by method, while each joint moves; distance of parameters and torque from the first method"
        )
        yield ReportedTable(title, columns, rows)
    failed_rows = tuple((Cell(method.method), Cell(method.problem)) for method in methods if method.problem)
    if failed_rows:
        title = f"Methods that cannot use these data: {len(failed_rows)}"
        yield ReportedTable(title, ("method", "why"), failed_rows, numbers_from=2)


def _build_method_row(method: Any, errors: Any, best: float) -> tuple[Cell, ...]:
    *joints, total = _relative_error_cells(errors, 0)
    return (
        Cell(method.method),
        *joints,
        Cell(total.text, total.value, "ok" if total.value == best else None),
        make_number_cell(method.distance_rms, 2),
        Cell(method.farthest or ""),
        make_percent_cell(method.torque_distance),
        make_percent_cell(method.torque_deviation),
        make_number_cell(method.seconds, 2, "s"),
    )


def _build_filter_table(filters: Any) -> ReportedTable:
    rows = []
    for trial in filters.trials:
        preprocessing = trial.preprocessing
        cutoffs = (
            "none" if value is None else f"{format_number(value)} Hz"
            for value in (preprocessing.position_cutoff, preprocessing.torque_cutoff)
        )
        notes = [note for note, other in (("used", filters.used), ("smallest error", filters.chosen)) if trial == other]
        cells = make_text_cells(*cutoffs, str(preprocessing.decimation))
        rows.append(
            (*cells, *make_percent_cells([trial.error, trial.bias]), Cell(", ".join(notes) or trial.problem or ""))
        )
    columns = ("position cut-off", "torque cut-off", "decimation", "parameter error", "bias", "which")
    title = "Parameter error that each choice of filters causes, as a share of the torque"
    return ReportedTable(title, columns, tuple(rows), numbers_from=2)


def _build_bootstrap_table(bootstrap: Any) -> ReportedTable:
    rows = tuple(
        (
            *make_text_cells(parameter.name, parameter.unit),
            make_number_cell(parameter.told, 2),
            make_number_cell(parameter.drawn, 2),
            make_number_cell(parameter.ratio),
            make_interval_cell(parameter.expected),
            Cell("! outside", mark="warning") if parameter.outside else Cell("✓", mark="ok"),
        )
        for parameter in bootstrap.parameters
    )
    columns = ("parameter", "unit", "reported", "drawn", "ratio", "expected", "as expected")
    return ReportedTable("Standard deviations: reported, and over draws", columns, rows, numbers_from=2)


def _build_payload_table(payloads: Sequence[Any]) -> ReportedTable:
    rows = tuple(
        (
            Cell(payload.name),
            make_number_cell(payload.stated_mass),
            make_number_cell(payload.mass),
            make_interval_cell(payload.interval, "not identifiable"),
            make_number_cell(payload.friction_shared),
            make_number_cell(payload.friction_apart),
        )
        for payload in payloads
    )
    columns = ("measurement", "stated", "weighed", "95 % interval", "with common friction", "with friction of each run")
    return ReportedTable("Mass of the load, kg", columns, rows)


def _build_gain_table(payload: Any) -> ReportedTable:
    rows = tuple(
        (
            Cell(gain.joint),
            make_number_cell(gain.drive_gain),
            make_interval_cell(gain.interval),
            make_number_cell(gain.factor),
            Cell("✓" if gain.identifiable else "no"),
        )
        for gain in payload.gains
    )
    columns = ("joint", "drive gain", "95 % interval", "factor on the stated", "identifiable")
    return ReportedTable(f"Drive gains, if the load in {payload.name} has the stated mass", columns, rows)


def _relative_error_cells(errors: Any, n: int) -> list[Cell]:
    """Return the errors that a model is judged by: of each joint where it moves, on all rows if it never does."""
    if errors is None:
        return make_percent_cells([None] * (n + 1))
    moving = getattr(errors, "moving", None)
    if moving is None or moving.relative_total is None:
        return make_percent_cells([*errors.relative, errors.relative_total])
    of_joints = (m if m is not None else a for m, a in zip(moving.relative, errors.relative, strict=True))
    return make_percent_cells([*of_joints, moving.relative_total])
