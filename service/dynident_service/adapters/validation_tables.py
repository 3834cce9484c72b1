"""The figures behind the verdict of a validation, as tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dynident.reports.numbers import number
from dynident.reports.tables import Cell, ReportedTable, figure, interval, share, shares, words
from dynident.reports.validated import ReportedValidation
from dynident.validation import Judged
from dynident_service.models.identifications import ErrorsView
from dynident_service.models.validations import BootstrapView, FiltersView, MethodView, PayloadView, ValidationResult

TITLES = {
    "direct": "Direct validation: the identification's own data",
    "cross": "Cross validation: data that no parameter saw",
    "inertia_matrix": "Inertia matrix over the whole joint range",
    "payload": "A known load",
    "methods": "Different methods on the same data",
    "simulation": "A simulator with the identified parameters",
    "filters": "Filters, by simulating the identification",
    "bootstrap": "Standard deviations, with stretches of time drawn anew",
}


def reported(result: ValidationResult, joints: Sequence[str]) -> ReportedValidation:
    """Build the part of a report on a validation: title, verdict and tables."""
    verdict = Judged(result.verdict, result.reason)
    return ReportedValidation(TITLES[result.kind], verdict, tuple(tables_of(result, joints)), result.kind)


def tables_of(result: ValidationResult, joints: Sequence[str]) -> Iterator[ReportedTable]:
    """Yield the tables of a validation.

    Parameters
    ----------
    result : ValidationResult
        The result; a kind of validation fills only some of its fields.
    joints : sequence of str
        Names of the robot's joints.

    Yields
    ------
    ReportedTable
        One table for each kind of figures that the result has.
    """
    joint_columns = (*joints, "all joints")
    if result.measurements and result.total is not None:
        rows = [(measurement.name, measurement.errors) for measurement in result.measurements]
        rows += [("all", result.total)] if len(rows) > 1 else []
        cells = tuple((Cell(name), *_relative(errors, len(joints))) for name, errors in rows)
        yield ReportedTable("Relative torque error", ("measurement", *joint_columns), cells)
    if result.worst_posture is not None:
        posture = tuple((Cell(joint), figure(value)) for joint, value in result.worst_posture.items())
        yield ReportedTable(
            f"The worst posture that was found, of {result.postures_tried}", ("joint", "rad or m"), posture
        )
    yield from _methods(result.methods, joint_columns)
    if any(simulation.torque is not None for simulation in result.simulations):
        torque_rows = tuple(
            (Cell(simulation.name), figure(simulation.duration, unit="s"), *_relative(simulation.torque, len(joints)))
            for simulation in result.simulations
        )
        yield ReportedTable(
            "Simulated against measured torque", ("measurement", "simulated", *joint_columns), torque_rows
        )
        position_rows = tuple(
            (Cell(simulation.name), *shares(simulation.position_share))
            for simulation in result.simulations
            if simulation.position_share is not None
        )
        if position_rows:
            title = "How far the simulated positions are from the measured ones, of each joint's range"
            yield ReportedTable(title, ("measurement", *joints), position_rows)
    if result.filters is not None:
        yield _filters(result.filters)
    if result.bootstrap is not None and result.bootstrap.parameters:
        yield _bootstrap(result.bootstrap)
    if result.payloads:
        yield _payloads(result.payloads)
        yield from (_gains(payload) for payload in result.payloads if payload.gains)


def _methods(methods: Sequence[MethodView], joint_columns: Sequence[str]) -> Iterator[ReportedTable]:
    solved_methods = [(method, method.held_out) for method in methods if method.held_out is not None]
    if solved_methods:
        best = min(errors.relative_total or 0.0 for _, errors in solved_methods)
        columns = ("method", *joint_columns, "σ apart", "most in", "torque", "± of it", "time")
        rows = tuple(_method(method, errors, best) for method, errors in solved_methods)
        title = "Relative held-out error by method; distance of parameters and torque from the first"
        yield ReportedTable(title, columns, rows)
    failed_rows = tuple((Cell(method.method), Cell(method.problem)) for method in methods if method.problem)
    if failed_rows:
        title = f"Methods that this data does not allow: {len(failed_rows)}"
        yield ReportedTable(title, ("method", "why"), failed_rows, numbers_from=2)


def _method(method: MethodView, errors: ErrorsView, best: float) -> tuple[Cell, ...]:
    *joints, total = _relative(errors, 0)
    return (
        Cell(method.method),
        *joints,
        Cell(total.text, total.value, "ok" if total.value == best else None),
        figure(method.distance_rms, 2),
        Cell(method.farthest or ""),
        share(method.torque_distance),
        share(method.torque_deviation),
        figure(method.seconds, 2, "s"),
    )


def _filters(filters: FiltersView) -> ReportedTable:
    rows = []
    for trial in filters.trials:
        preprocessing = trial.preprocessing
        cutoffs = (
            "none" if value is None else f"{number(value)} Hz"
            for value in (preprocessing.position_cutoff, preprocessing.torque_cutoff)
        )
        notes = [note for note, other in (("used", filters.used), ("smallest error", filters.chosen)) if trial == other]
        cells = words(*cutoffs, str(preprocessing.decimation))
        rows.append((*cells, *shares([trial.error, trial.bias]), Cell(", ".join(notes) or trial.problem or "")))
    columns = ("position cut-off", "torque cut-off", "decimation", "parameter error", "bias", "which")
    title = "What each choice of filters leaves in the parameters, as a share of the torque"
    return ReportedTable(title, columns, tuple(rows), numbers_from=2)


def _bootstrap(bootstrap: BootstrapView) -> ReportedTable:
    rows = tuple(
        (
            *words(parameter.name, parameter.unit),
            figure(parameter.told, 2),
            figure(parameter.drawn, 2),
            figure(parameter.ratio),
            interval(parameter.expected),
            Cell("! outside", mark="warning") if parameter.outside else Cell("✓", mark="ok"),
        )
        for parameter in bootstrap.parameters
    )
    columns = ("parameter", "unit", "told", "drawn", "ratio", "expected", "as expected")
    return ReportedTable("Standard deviations as told, and over draws", columns, rows, numbers_from=2)


def _payloads(payloads: Sequence[PayloadView]) -> ReportedTable:
    rows = tuple(
        (
            Cell(payload.name),
            figure(payload.stated_mass),
            figure(payload.mass),
            interval(payload.interval, "not identifiable"),
            figure(payload.friction_shared),
            figure(payload.friction_apart),
        )
        for payload in payloads
    )
    columns = ("measurement", "stated", "weighed", "95 % interval", "with common friction", "with friction of each run")
    return ReportedTable("Mass of the load, kg", columns, rows)


def _gains(payload: PayloadView) -> ReportedTable:
    rows = tuple(
        (
            Cell(gain.joint),
            figure(gain.drive_gain),
            interval(gain.interval),
            figure(gain.factor),
            Cell("✓" if gain.identifiable else "no"),
        )
        for gain in payload.gains
    )
    columns = ("joint", "drive gain", "95 % interval", "times what was stated", "identifiable")
    return ReportedTable(f"Drive gains, if the load in {payload.name} is what it is said to be", columns, rows)


def _relative(errors: ErrorsView | None, n: int) -> list[Cell]:
    return shares([None] * (n + 1) if errors is None else [*errors.relative, errors.relative_total])
