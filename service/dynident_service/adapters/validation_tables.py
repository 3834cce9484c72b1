"""The figures behind a validation's verdict, as tables for people."""

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
    """A validation with its tables."""
    judged = Judged(result.verdict, result.reason)
    return ReportedValidation(TITLES[result.kind], judged, tuple(tables_of(result, joints)), result.kind)


def tables_of(result: ValidationResult, joints: Sequence[str]) -> Iterator[ReportedTable]:
    """The tables that a result has figures for."""
    each = (*joints, "all joints")
    if result.measurements and result.total is not None:
        rows = [(one.name, one.errors) for one in result.measurements]
        rows += [("all", result.total)] if len(rows) > 1 else []
        cells = tuple((Cell(name), *_relative(errors, len(joints))) for name, errors in rows)
        yield ReportedTable("Relative torque error", ("measurement", *each), cells)
    if result.worst_posture is not None:
        posture = tuple((Cell(joint), figure(value)) for joint, value in result.worst_posture.items())
        yield ReportedTable(
            f"The worst posture that was found, of {result.postures_tried}", ("joint", "rad or m"), posture
        )
    yield from _methods(result.methods, each)
    if any(one.torque is not None for one in result.simulations):
        followed = tuple(
            (Cell(one.name), figure(one.duration, unit="s"), *_relative(one.torque, len(joints)))
            for one in result.simulations
        )
        yield ReportedTable("Simulated against measured torque", ("measurement", "simulated", *each), followed)
        strayed = tuple(
            (Cell(one.name), *shares(one.position_share))
            for one in result.simulations
            if one.position_share is not None
        )
        if strayed:
            title = "How far the simulated positions are from the measured ones, of each joint's range"
            yield ReportedTable(title, ("measurement", *joints), strayed)
    if result.filters is not None:
        yield _filters(result.filters)
    if result.bootstrap is not None and result.bootstrap.parameters:
        yield _bootstrap(result.bootstrap)
    if result.payloads:
        yield _payloads(result.payloads)
        yield from (_gains(one) for one in result.payloads if one.gains)


def _methods(methods: Sequence[MethodView], each: Sequence[str]) -> Iterator[ReportedTable]:
    solved = [(one, one.held_out) for one in methods if one.held_out is not None]
    if solved:
        best = min(errors.relative_total or 0.0 for _, errors in solved)
        columns = ("method", *each, "σ apart", "most in", "torque", "± of it", "time")
        rows = tuple(_method(one, errors, best) for one, errors in solved)
        title = "Relative held-out error by method; distance of parameters and torque from the first"
        yield ReportedTable(title, columns, rows)
    without = tuple((Cell(one.method), Cell(one.problem)) for one in methods if one.problem)
    if without:
        title = f"Methods that this data does not allow: {len(without)}"
        yield ReportedTable(title, ("method", "why"), without, numbers_from=2)


def _method(one: MethodView, errors: ErrorsView, best: float) -> tuple[Cell, ...]:
    *joints, total = _relative(errors, 0)
    return (
        Cell(one.method),
        *joints,
        Cell(total.text, total.value, "ok" if total.value == best else None),
        figure(one.distance_rms, 2),
        Cell(one.farthest or ""),
        share(one.torque_distance),
        share(one.torque_deviation),
        figure(one.seconds, 2, "s"),
    )


def _filters(filters: FiltersView) -> ReportedTable:
    rows = []
    for one in filters.trials:
        used = one.preprocessing
        cutoffs = (
            "none" if value is None else f"{number(value)} Hz" for value in (used.position_cutoff, used.torque_cutoff)
        )
        notes = [note for note, other in (("used", filters.used), ("smallest error", filters.chosen)) if one == other]
        cells = words(*cutoffs, str(used.decimation))
        rows.append((*cells, *shares([one.error, one.bias]), Cell(", ".join(notes) or one.problem or "")))
    columns = ("position cut-off", "torque cut-off", "decimation", "parameter error", "bias", "which")
    title = "What each choice of filters leaves in the parameters, as a share of the torque"
    return ReportedTable(title, columns, tuple(rows), numbers_from=2)


def _bootstrap(drawn: BootstrapView) -> ReportedTable:
    rows = tuple(
        (
            *words(one.name, one.unit),
            figure(one.told, 2),
            figure(one.drawn, 2),
            figure(one.ratio),
            interval(one.expected),
            Cell("! outside", mark="warning") if one.outside else Cell("✓", mark="ok"),
        )
        for one in drawn.parameters
    )
    columns = ("parameter", "unit", "told", "drawn", "ratio", "expected", "as expected")
    return ReportedTable("Standard deviations as told, and over draws", columns, rows, numbers_from=2)


def _payloads(payloads: Sequence[PayloadView]) -> ReportedTable:
    rows = tuple(
        (
            Cell(one.name),
            figure(one.stated_mass),
            figure(one.mass),
            interval(one.interval, "not identifiable"),
            figure(one.friction_shared),
            figure(one.friction_apart),
        )
        for one in payloads
    )
    columns = ("measurement", "stated", "weighed", "95 % interval", "with common friction", "with friction of each run")
    return ReportedTable("Mass of the load, kg", columns, rows)


def _gains(payload: PayloadView) -> ReportedTable:
    rows = tuple(
        (
            Cell(one.joint),
            figure(one.drive_gain),
            interval(one.interval),
            figure(one.factor),
            Cell("✓" if one.identifiable else "no"),
        )
        for one in payload.gains
    )
    columns = ("joint", "drive gain", "95 % interval", "times what was stated", "identifiable")
    return ReportedTable(f"Drive gains, if the load in {payload.name} is what it is said to be", columns, rows)


def _relative(errors: ErrorsView | None, n: int) -> list[Cell]:
    return shares([None] * (n + 1) if errors is None else [*errors.relative, errors.relative_total])
