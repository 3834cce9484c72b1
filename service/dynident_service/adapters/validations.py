"""Validations between the contract and the science."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

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
from dynident_service.adapters.answers import show_errors, shown
from dynident_service.adapters.derived import taken
from dynident_service.models import validations as wire

if TYPE_CHECKING:
    from dynident.validation.request import TrialResult


def trial_from_request(asked: wire.ValidationRequest) -> Trial:
    """Take the validation that is asked for off the wire; `DynidentError` for what its kind does not take."""
    stated: Any = taken(asked, Stated)
    return trial_of(asked.kind, {one.name: getattr(stated, one.name) for one in fields(stated)})


def describe(trial: Trial, found: TrialResult, measurement_ids: Sequence[str]) -> wire.ValidationResult:
    """Describe what a validation gave, for the measurements that it was tried on."""
    match found:
        case TorqueValidation():
            tried = zip(measurement_ids, found.recordings, strict=True)
            measurements = [
                wire.MeasurementErrors(measurement_id=one, name=on.name, errors=show_errors(on.errors, on.moving))
                for one, on in tried
            ]
            return _result(trial, found, measurements=measurements)
        case InertiaMatrixValidation():
            return _inertia_matrix(trial, found)
        case BootstrapValidation():
            drawn = [shown(wire.DrawnParameterView, one, expected=(one.low, one.high)) for one in found.parameters]
            return _result(trial, found, parameters=[], bootstrap=shown(wire.BootstrapView, found, parameters=drawn))
        case MethodsValidation():
            return _result(trial, found, methods=[_method(one, found.parameters) for one in found.results])
        case FiltersBySimulation():
            return _result(trial, found, filters=_filters(found))
    named = zip(measurement_ids, found, strict=True)
    if isinstance(trial, Payload):
        weighed = [_payload(one, identifier) for identifier, one in named if isinstance(one, PayloadValidation)]
        return _of_several(trial, found, payloads=weighed)
    simulated = [shown(wire.SimulationOnMeasurement, one, measurement_id=identifier) for identifier, one in named]
    limits = [one.limit for one in found if isinstance(one, SimulationValidation)]
    return _of_several(trial, found, simulations=simulated, limit=limits[0] if limits else None)


def _result(trial: Trial, found: object, **more: object) -> wire.ValidationResult:
    return shown(wire.ValidationResult, found, kind=trial.name, **more)


def _of_several(
    trial: Trial, found: Sequence[PayloadValidation | SimulationValidation], **more: object
) -> wire.ValidationResult:
    judged = together([(one.name, one.judged) for one in found])
    return _result(trial, None, verdict=judged.verdict, reason=judged.reason, **more)


def _inertia_matrix(trial: Trial, found: InertiaMatrixValidation) -> wire.ValidationResult:
    value, posture = found.smallest_eigenvalue, found.posture
    return _result(
        trial,
        found,
        inertia_matrix_positive_definite=None if value is None else value > 0,
        eigenvalue_standard_deviation=found.standard_deviation,
        worst_posture=None if posture is None else dict(zip(found.joint_names, posture.tolist(), strict=True)),
        postures_tried=found.evaluations,
    )


def _method(one: MethodResult, names: Sequence[str]) -> wire.MethodView:
    return shown(
        wire.MethodView,
        one,
        estimator=document_of(one.method.estimator),
        problem=one.problem or None,
        farthest=None if one.farthest is None else names[one.farthest],
    )


def _filters(found: FiltersBySimulation) -> wire.FiltersView:
    return shown(
        wire.FiltersView,
        found,
        used=_trial(found.used),
        chosen=_trial(found.chosen),
        trials=[_trial(one) for one in found.trials],
    )


def _trial(one: FilterTrial) -> wire.FilterTrialView:
    return shown(wire.FilterTrialView, one, worst=one.worst or None, problem=one.problem or None)


def _payload(one: PayloadValidation, measurement_id: str) -> wire.PayloadView:
    gains = [] if one.gains is None else [shown(wire.DriveGainView, gain) for gain in one.gains.each]
    return shown(wire.PayloadView, one, measurement_id=measurement_id, gains=gains)
