"""Validations from bodies, their views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from dynident.presentation.tables import ReportedTable
from dynident.presentation.validation_and_verdict_tables import (
    VALIDATION_TITLES,
    build_figure_tables,
    build_validation_table,
)
from dynident.reports.reported_data import ReportedValidation
from dynident.schema.registry import kind_to_document
from dynident.validation import (
    BootstrapValidation,
    CollisionValidation,
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
from dynident_service.shared.wire_types import ContactDetectionView, DriftView, to_plain_json
from dynident_service.validations import wire_types as wire

if TYPE_CHECKING:
    from dynident.validation.validation_request import TrialResult


def build_reported_validation(result: wire.ValidationResult, joints: Sequence[str]) -> ReportedValidation:
    """Build the part of a report on a validation: title, verdict and tables."""
    tables = tuple(build_figure_tables(to_plain_json(result), joints))
    return ReportedValidation(
        VALIDATION_TITLES[result.kind], ValidationOutcome(result.verdict, result.reason), tables, result.kind
    )


def list_stored_tables(result: wire.ValidationResult, joints: Sequence[str]) -> list[ReportedTable]:
    """Return the verdict of a stored validation and its reason as a table, then the figures behind it."""
    reported = build_reported_validation(result, joints)
    return [build_validation_table([(reported.title, reported.judged)]), *reported.tables]


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
            total = show_errors(outcome.total, outcome.total_moving)
            return _build_result(trial, outcome, measurements=measurements, total=total)
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
        case CollisionValidation():
            contact = None if outcome.contact is None else to_view(ContactDetectionView, outcome.contact)
            return _build_result(trial, outcome, contact=contact)
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
