"""Validations from bodies, their views and tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from dynident.number_format import format_number
from dynident.presentation.tables import (
    Cell,
    ReportedTable,
    make_interval_cell,
    make_number_cell,
    make_percent_cell,
    make_percent_cells,
    make_text_cells,
)
from dynident.presentation.validation_and_verdict_tables import (
    build_drift_tables,
    build_validation_table,
)
from dynident.reports.reported_data import ReportedValidation
from dynident.schema.registry import kind_to_document
from dynident.validation import (
    BootstrapValidation,
    DriftValidation,
    FiltersBySimulation,
    InertiaMatrixValidation,
    MethodResult,
    MethodsValidation,
    PayloadValidation,
    SimulationValidation,
    TorqueValidation,
    ValidationOutcome,
    combine_verdicts,
)
from dynident.validation.validation_request import Payload, Stated, Trial, build_trial
from dynident_service.shared.field_by_field import show_errors, to_request, to_view
from dynident_service.shared.wire_types import DriftView, ErrorsView
from dynident_service.validations import wire_types as wire
from dynident_service.validations.wire_types import (
    BootstrapView,
    FiltersView,
    MethodView,
    PayloadView,
    ValidationResult,
)

if TYPE_CHECKING:
    from dynident.validation.validation_request import TrialResult


TITLES = {
    "direct": "Direct validation: the identification's own data",
    "cross": "Cross validation: held-out data",
    "inertia_matrix": "Inertia matrix over the whole joint range",
    "payload": "A known load",
    "methods": "Different methods on the same data",
    "simulation": "A simulator with the identified parameters",
    "drift": "Drift of a simulation without a controller",
    "filters": "Filters, by simulating the identification",
    "bootstrap": "Standard deviations, from resampled blocks of time",
}


def build_reported_validation(result: ValidationResult, joints: Sequence[str]) -> ReportedValidation:
    """Build the part of a report on a validation: title, verdict and tables."""
    verdict = ValidationOutcome(result.verdict, result.reason)
    return ReportedValidation(TITLES[result.kind], verdict, tuple(build_validation_tables(result, joints)), result.kind)


def list_stored_tables(result: ValidationResult, joints: Sequence[str]) -> list[ReportedTable]:
    """Return the verdict of a stored validation and its reason as a table, then the figures behind it."""
    verdict = build_validation_table([(TITLES[result.kind], ValidationOutcome(result.verdict, result.reason))])
    return [verdict, *build_validation_tables(result, joints)]


def build_validation_tables(result: ValidationResult, joints: Sequence[str]) -> Iterator[ReportedTable]:
    """Yield a table for each kind of figures that the result of a validation has."""
    joint_columns = (*joints, "all joints")
    if result.measurements and result.total is not None:
        rows = [(measurement.name, measurement.errors) for measurement in result.measurements]
        rows += [("all", result.total)] if len(rows) > 1 else []
        cells = tuple((Cell(name), *_relative_error_cells(errors, len(joints))) for name, errors in rows)
        yield ReportedTable("Relative torque error", ("measurement", *joint_columns), cells)
    if result.worst_posture is not None:
        # The posture is told so that the user can try it.
        posture = tuple((Cell(joint), make_number_cell(value)) for joint, value in result.worst_posture.items())
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
            "Simulated against measured torque", ("measurement", "simulated", *joint_columns), torque_rows
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
    if result.filters is not None:
        yield _build_filter_table(result.filters)
    if result.bootstrap is not None and result.bootstrap.parameters:
        yield _build_bootstrap_table(result.bootstrap)
    if result.payloads:
        yield _build_payload_table(result.payloads)
        yield from (_build_gain_table(payload) for payload in result.payloads if payload.gains)


def _build_method_tables(methods: Sequence[MethodView], joint_columns: Sequence[str]) -> Iterator[ReportedTable]:
    solved_methods = [(method, method.held_out) for method in methods if method.held_out is not None]
    if solved_methods:
        # The best method is marked by its own error, and not by its place in the list.
        best = min(errors.relative_total or 0.0 for _, errors in solved_methods)
        columns = ("method", *joint_columns, "σ apart", "farthest", "torque", "own ±", "time")
        rows = tuple(_build_method_row(method, errors, best) for method, errors in solved_methods)
        title = "Relative held-out error by method; distance of parameters and torque from the first method"
        yield ReportedTable(title, columns, rows)
    failed_rows = tuple((Cell(method.method), Cell(method.problem)) for method in methods if method.problem)
    if failed_rows:
        title = f"Methods that cannot use these data: {len(failed_rows)}"
        yield ReportedTable(title, ("method", "why"), failed_rows, numbers_from=2)


def _build_method_row(method: MethodView, errors: ErrorsView, best: float) -> tuple[Cell, ...]:
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


def _build_filter_table(filters: FiltersView) -> ReportedTable:
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


def _build_bootstrap_table(bootstrap: BootstrapView) -> ReportedTable:
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


def _build_payload_table(payloads: Sequence[PayloadView]) -> ReportedTable:
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


def _build_gain_table(payload: PayloadView) -> ReportedTable:
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


def _relative_error_cells(errors: ErrorsView | None, n: int) -> list[Cell]:
    return make_percent_cells([None] * (n + 1) if errors is None else [*errors.relative, errors.relative_total])


def trial_from_request(wire_request: wire.ValidationRequest) -> Trial:
    """Build the validation that a body asks for; `DynidentError` for options that its kind does not take."""
    options: Any = to_request(wire_request, Stated)
    return build_trial(
        wire_request.kind, {option_field.name: getattr(options, option_field.name) for option_field in fields(options)}
    )


def describe_validation(trial: Trial, outcome: TrialResult, measurement_ids: Sequence[str]) -> wire.ValidationResult:
    """Build the view of what a validation of this kind gave; the ids are those of its recordings, in their order."""
    match outcome:
        case TorqueValidation():
            errors_by_id = zip(measurement_ids, outcome.recordings, strict=True)
            measurements = [
                wire.MeasurementErrors(
                    measurement_id=measurement_id,
                    name=recording_errors.name,
                    errors=show_errors(recording_errors.errors, recording_errors.moving),
                )
                for measurement_id, recording_errors in errors_by_id
            ]
            return _build_result(trial, outcome, measurements=measurements)
        case InertiaMatrixValidation():
            return _describe_inertia_matrix(trial, outcome)
        case BootstrapValidation():
            drawn_parameters = [
                to_view(wire.DrawnParameterView, parameter, expected=(parameter.low, parameter.high))
                for parameter in outcome.parameters
            ]
            return _build_result(
                trial,
                outcome,
                parameters=[],
                bootstrap=to_view(wire.BootstrapView, outcome, parameters=drawn_parameters),
            )
        case MethodsValidation():
            return _build_result(
                trial, outcome, methods=[_show_method(method, outcome.parameters) for method in outcome.results]
            )
        case DriftValidation():
            drift = None if outcome.drift is None else to_view(DriftView, outcome.drift)
            return _build_result(trial, outcome, drift=drift)
        case FiltersBySimulation():
            return _build_result(trial, outcome, filters=to_view(wire.FiltersView, outcome))
    # The remaining kinds give one outcome a recording.
    outcomes_by_id = zip(measurement_ids, outcome, strict=True)
    if isinstance(trial, Payload):
        weighed = [
            to_view(wire.PayloadView, payload, measurement_id=identifier)
            for identifier, payload in outcomes_by_id
            if isinstance(payload, PayloadValidation)
        ]
        return _combine_results(trial, outcome, payloads=weighed)
    simulated = [
        to_view(wire.SimulationOnMeasurement, simulation, measurement_id=identifier)
        for identifier, simulation in outcomes_by_id
    ]
    limits = [simulation.limit for simulation in outcome if isinstance(simulation, SimulationValidation)]
    return _combine_results(trial, outcome, simulations=simulated, limit=limits[0] if limits else None)


def _build_result(trial: Trial, outcome: object, **more: object) -> wire.ValidationResult:
    return to_view(wire.ValidationResult, outcome, kind=trial.name, **more)


def _combine_results(
    trial: Trial, outcomes: Sequence[PayloadValidation | SimulationValidation], **more: object
) -> wire.ValidationResult:
    verdict = combine_verdicts([(outcome.name, outcome.judged) for outcome in outcomes])
    return _build_result(trial, None, verdict=verdict.verdict, reason=verdict.reason, **more)


def _describe_inertia_matrix(trial: Trial, outcome: InertiaMatrixValidation) -> wire.ValidationResult:
    value, posture = outcome.smallest_eigenvalue, outcome.posture
    return _build_result(
        trial,
        outcome,
        inertia_matrix_positive_definite=None if value is None else value > 0,
        eigenvalue_standard_deviation=outcome.standard_deviation,
        worst_posture=None if posture is None else dict(zip(outcome.joint_names, posture.tolist(), strict=True)),
        postures_tried=outcome.evaluations,
    )


def _show_method(method: MethodResult, names: Sequence[str]) -> wire.MethodView:
    return to_view(
        wire.MethodView,
        method,
        estimator=kind_to_document(method.method.estimator),
        farthest=None if method.farthest is None else names[method.farthest],
    )
