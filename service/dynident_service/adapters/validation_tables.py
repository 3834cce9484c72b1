"""The figures behind a validation's verdict, as tables for people: the command line and reports show the same."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.reports.numbers import number, percent
from dynident.reports.validated import ReportedTable, ReportedValidation
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
    return ReportedValidation(TITLES[result.kind], judged, tuple(tables_of(result, joints)))


def tables_of(result: ValidationResult, joints: Sequence[str]) -> list[ReportedTable]:
    """The tables that a result has figures for."""
    found = []
    if result.measurements and result.total is not None:
        found.append(_measurements(result, result.total, joints))
    if result.worst_posture is not None:
        postures = tuple((joint, f"{value:.3f}") for joint, value in result.worst_posture.items())
        found.append(ReportedTable("The worst posture that was found", ("joint", "rad or m"), postures))
    if result.methods:
        columns = ("method", *joints, "all joints", "parameters, σ", "most in", "torque", "± of it")
        rows = tuple(_method(one) for one in result.methods if one.held_out is not None)
        title = "Relative held-out error by method; distance of parameters and torque from the first"
        found.append(ReportedTable(title, columns, rows))
        without = tuple((one.method, one.problem) for one in result.methods if one.problem)
        if without:
            title = "Methods that this data does not allow"
            found.append(ReportedTable(title, ("method", "why"), without, numbers_from=2))
    if result.simulations:
        followed = tuple(
            (one.name, f"{one.duration:.1f} s", *_relative(one.torque, len(joints))) for one in result.simulations
        )
        columns = ("measurement", "simulated", *joints, "all joints")
        found.append(ReportedTable("Simulated against measured torque", columns, followed))
    if result.filters is not None:
        found.append(_filters(result.filters))
    if result.bootstrap is not None and result.bootstrap.parameters:
        found.append(_bootstrap(result.bootstrap))
    if result.payloads:
        found.append(_payloads(result.payloads))
        found += [_gains(one) for one in result.payloads if one.gains]
    return found


def _measurements(result: ValidationResult, total: ErrorsView, joints: Sequence[str]) -> ReportedTable:
    rows = [(one.name, *_relative(one.errors, len(joints))) for one in result.measurements]
    if len(rows) > 1:
        rows.append(("all", *_relative(total, len(joints))))
    return ReportedTable("Relative torque error", ("measurement", *joints, "all joints"), tuple(rows))


def _method(one: MethodView) -> tuple[str, ...]:
    errors = one.held_out
    return (
        one.method,
        *_relative(errors, 0),
        _maybe(one.distance_rms),
        one.farthest or "",
        *("–" if value is None else percent(value) for value in (one.torque_distance, one.torque_deviation)),
    )


def _filters(filters: FiltersView) -> ReportedTable:
    rows = []
    for one in filters.trials:
        used = one.preprocessing
        cutoffs = [
            "none" if value is None else f"{value:.3g} Hz" for value in (used.position_cutoff, used.torque_cutoff)
        ]
        errors = ["–" if value is None else f"{value:.3%}" for value in (one.error, one.bias)]
        words = [word for word, other in (("used", filters.used), ("smallest error", filters.chosen)) if one == other]
        rows.append((*cutoffs, str(used.decimation), *errors, ", ".join(words) or one.problem or ""))
    columns = ("position cut-off", "torque cut-off", "decimation", "parameter error", "bias", "")
    return ReportedTable("What each choice of filters leaves in the parameters", columns, tuple(rows), numbers_from=2)


def _bootstrap(drawn: BootstrapView) -> ReportedTable:
    rows = tuple(
        (
            one.name,
            one.unit,
            *("–" if value is None else number(value, 2) for value in (one.told, one.drawn)),
            _maybe(one.ratio),
            " to ".join(number(end) for end in one.expected),
            "! outside" if one.outside else "✓",
        )
        for one in drawn.parameters
    )
    columns = ("parameter", "unit", "told", "drawn", "ratio", "expected", "")
    return ReportedTable("Standard deviations as told, and over draws", columns, rows, numbers_from=2)


def _payloads(payloads: Sequence[PayloadView]) -> ReportedTable:
    rows = tuple(
        (
            one.name,
            number(one.stated_mass),
            _maybe(one.mass),
            "not identifiable" if one.interval is None else " to ".join(number(end) for end in one.interval),
            _maybe(one.friction_shared),
            _maybe(one.friction_apart),
        )
        for one in payloads
    )
    columns = ("measurement", "stated", "weighed", "95 % interval", "with common friction", "with friction of each run")
    return ReportedTable("Mass of the load, kg", columns, rows)


def _gains(payload: PayloadView) -> ReportedTable:
    rows = tuple(
        (
            one.joint,
            number(one.drive_gain),
            " to ".join(_maybe(end) for end in one.interval),
            number(one.factor),
            "✓" if one.identifiable else "no",
        )
        for one in payload.gains
    )
    columns = ("joint", "drive gain", "95 % interval", "times what was stated", "identifiable")
    return ReportedTable(f"Drive gains, if the load in {payload.name} is what it is said to be", columns, rows)


def _relative(errors: ErrorsView | None, n: int) -> list[str]:
    if errors is None:
        return ["–"] * (n + 1)
    return ["–" if value is None else percent(value) for value in [*errors.relative, errors.relative_total]]


def _maybe(value: float | None) -> str:
    return "–" if value is None else number(value)
