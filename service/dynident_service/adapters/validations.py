"""Validations between the contract and the science."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from dynident.arrays import FloatArray
from dynident.identification.loads.drive_gains import DriveGains
from dynident.kinds import document_of
from dynident.validation import (
    BootstrapValidation,
    FiltersBySimulation,
    FilterTrial,
    InertiaMatrixValidation,
    MethodResult,
    MethodsValidation,
    PayloadValidation,
    SimulationValidation,
    TorqueValidation,
    together,
)
from dynident.validation.request import Payload, Stated, Trial, trial_of
from dynident_service.adapters.derived import taken
from dynident_service.adapters.identifications import finite, numbers, show_errors, show_preprocessing
from dynident_service.models import validations as wire


def trial_from_request(asked: wire.ValidationRequest) -> Trial:
    """Take the validation that is asked for off the wire; `DynidentError` for what its kind does not take."""
    stated: Any = taken(asked, Stated)
    return trial_of(asked.kind, {one.name: getattr(stated, one.name) for one in fields(stated)})


def describe(trial: Trial, found: Any, measurement_ids: Sequence[str]) -> wire.ValidationResult:
    """Describe what a validation gave, for the measurements that it was tried on."""
    match found:
        case TorqueValidation():
            return describe_torque(trial.name, found, measurement_ids)
        case InertiaMatrixValidation():
            return describe_inertia_matrix(found)
        case BootstrapValidation():
            return describe_bootstrap(found)
        case MethodsValidation():
            return describe_methods(found)
        case FiltersBySimulation():
            return describe_filters(found)
    return (describe_payloads if isinstance(trial, Payload) else describe_simulations)(found, measurement_ids)


def describe_torque(
    kind: wire.ValidationKind, found: TorqueValidation, measurement_ids: Sequence[str]
) -> wire.ValidationResult:
    """Describe a direct or cross validation."""
    return wire.ValidationResult(
        kind=kind,
        verdict=found.judged.verdict,
        reason=found.judged.reason,
        limit=found.limit,
        measurements=[
            wire.MeasurementErrors(measurement_id=identifier, name=one.name, errors=show_errors(one.errors, one.moving))
            for identifier, one in zip(measurement_ids, found.recordings, strict=True)
        ],
        total=show_errors(found.total, found.total_moving),
    )


def describe_inertia_matrix(found: InertiaMatrixValidation) -> wire.ValidationResult:
    """Describe the search for the worst posture."""
    value = found.smallest_eigenvalue
    posture = found.posture
    return wire.ValidationResult(
        kind="inertia_matrix",
        verdict=found.judged.verdict,
        reason=found.judged.reason,
        inertia_matrix_positive_definite=None if value is None else value > 0,
        smallest_eigenvalue=None if value is None else finite(value),
        eigenvalue_standard_deviation=None if found.standard_deviation is None else finite(found.standard_deviation),
        worst_posture=None if posture is None else dict(zip(found.joint_names, posture.tolist(), strict=True)),
        postures_tried=found.evaluations,
    )


def describe_bootstrap(found: BootstrapValidation) -> wire.ValidationResult:
    """Describe deviations over draws of stretches of time."""
    return wire.ValidationResult(
        kind="bootstrap",
        verdict=found.judged.verdict,
        reason=found.judged.reason,
        bootstrap=wire.BootstrapView(
            kind=found.kind,
            stretches=found.stretches,
            draws=found.draws,
            lost=found.lost,
            parameters=[
                wire.DrawnParameterView(
                    name=one.name,
                    unit=one.unit,
                    told=finite(one.told),
                    drawn=finite(one.drawn),
                    ratio=finite(one.ratio),
                    expected=(one.low, one.high),
                    outside=one.outside,
                )
                for one in found.parameters
            ],
        ),
    )


def describe_methods(found: MethodsValidation) -> wire.ValidationResult:
    """Describe all methods on the same data."""
    return wire.ValidationResult(
        kind="methods",
        verdict=found.judged.verdict,
        reason=found.judged.reason,
        parameters=list(found.parameters),
        methods=[_method(one, found.parameters) for one in found.results],
    )


def describe_simulations(
    found: Sequence[SimulationValidation], measurement_ids: Sequence[str]
) -> wire.ValidationResult:
    """Describe simulated robots that followed recorded motions."""
    judged = together([(one.name, one.judged) for one in found])
    return wire.ValidationResult(
        kind="simulation",
        verdict=judged.verdict,
        reason=judged.reason,
        limit=found[0].limit if found else None,
        simulations=[
            wire.SimulationOnMeasurement(
                measurement_id=identifier,
                name=one.name,
                duration=one.duration,
                torque=None if one.torque is None else show_errors(one.torque),
                position=_maybe(one.position),
                position_share=_maybe(one.position_share),
                verdict=one.judged.verdict,
                reason=one.judged.reason,
            )
            for identifier, one in zip(measurement_ids, found, strict=True)
        ],
    )


def describe_payloads(found: Sequence[PayloadValidation], measurement_ids: Sequence[str]) -> wire.ValidationResult:
    """Describe loads that were weighed."""
    judged = together([(one.name, one.judged) for one in found])
    return wire.ValidationResult(
        kind="payload",
        verdict=judged.verdict,
        reason=judged.reason,
        payloads=[_payload(one, identifier) for one, identifier in zip(found, measurement_ids, strict=True)],
    )


def describe_filters(found: FiltersBySimulation) -> wire.ValidationResult:
    """Describe the choice of filters by simulating the identification."""
    return wire.ValidationResult(
        kind="filters",
        verdict=found.judged.verdict,
        reason=found.judged.reason,
        filters=wire.FiltersView(
            used=_trial(found.used),
            chosen=_trial(found.chosen),
            trials=[_trial(one) for one in found.trials],
            position_noise=numbers(found.noise.position),
            torque_noise=numbers(found.noise.torque),
        ),
    )


def _method(one: MethodResult, names: Sequence[str]) -> wire.MethodView:
    method = one.method
    return wire.MethodView(
        method=method.words,
        model=method.model,
        strategy=method.strategy,
        estimator=document_of(method.estimator),
        steps=method.steps,
        prior=method.prior,
        problem=one.problem or None,
        values=_maybe(one.values),
        standard_deviations=_maybe(one.standard_deviations),
        fit=None if one.fit is None else show_errors(one.fit, one.fit_moving),
        held_out=None if one.held_out is None else show_errors(one.held_out, one.held_out_moving),
        distance=_maybe(one.distance),
        distance_rms=None if one.distance_rms is None else finite(one.distance_rms),
        farthest=None if one.farthest is None else names[one.farthest],
        torque_distance=None if one.torque_distance is None else finite(one.torque_distance),
        torque_deviation=None if one.torque_deviation is None else finite(one.torque_deviation),
        seconds=one.seconds,
        warnings=list(one.warnings),
    )


def _payload(one: PayloadValidation, measurement_id: str) -> wire.PayloadView:
    weighed = one.weighed
    return wire.PayloadView(
        measurement_id=measurement_id,
        name=one.name,
        stated_mass=one.stated,
        identifiable=weighed.identifiable,
        mass=weighed.mass,
        interval=weighed.interval,
        friction_shared=weighed.alike.mass,
        friction_apart=None if weighed.apart is None else weighed.apart.mass,
        gains=[] if one.gains is None else _gains(one.gains),
        verdict=one.judged.verdict,
        reason=one.judged.reason,
    )


def _gains(found: DriveGains) -> list[wire.DriveGainView]:
    return [
        wire.DriveGainView(
            joint=joint,
            drive_gain=float(value),
            interval=(finite(interval[0]), finite(interval[1])),
            factor=float(factor),
            identifiable=good,
        )
        for joint, value, interval, factor, good in zip(
            found.joint_names, found.values, found.intervals, found.factors, found.identifiable, strict=True
        )
    ]


def _trial(one: FilterTrial) -> wire.FilterTrialView:
    return wire.FilterTrialView(
        preprocessing=show_preprocessing(one.preprocessing),
        error=None if one.error is None else finite(one.error),
        bias=None if one.bias is None else finite(one.bias),
        worst=one.worst or None,
        worst_bias=None if one.worst_bias is None else finite(one.worst_bias),
        problem=one.problem or None,
    )


def _maybe(values: FloatArray | None) -> list[float | None] | None:
    return None if values is None else numbers(values)
