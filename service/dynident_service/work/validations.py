"""Jobs that try an identified model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from dynident.estimation.bootstrap import DRAWS
from dynident.identification import Identification
from dynident.progress import part
from dynident.validation import (
    LARGEST_ERROR,
    filters_by_simulation,
    validate_bootstrap,
    validate_cross,
    validate_direct,
    validate_inertia_matrix,
    validate_methods,
    validate_payload,
    validate_simulation,
)
from dynident.validation.filters import LONGEST as LONGEST_FOR_FILTERS
from dynident.validation.simulation import LONGEST
from dynident_service.adapters import validations as adapter
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.validations import ValidationKind, ValidationRequest, ValidationResult
from dynident_service.work.means import model_by_id, recording_by_id, recordings_by_id


def validate_model(task: Task) -> Outcome:
    """Try a model by the test that was asked for."""
    request = ValidationRequest.model_validate(task.subject.request)
    model = model_by_id(task, request.identification_id)
    return Outcome(plain(TESTS[request.kind](task, request, model)))


def _direct(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    ids = task.subject.all("measurement")
    found = validate_direct(model, recordings_by_id(task, ids), request.limit or LARGEST_ERROR, task.progress)
    return adapter.describe_torque("direct", found, ids)


def _cross(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    ids = task.subject.all("measurement")
    found = validate_cross(model, recordings_by_id(task, ids), request.limit or LARGEST_ERROR, task.progress)
    return adapter.describe_torque("cross", found, ids)


def _inertia_matrix(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    return adapter.describe_inertia_matrix(validate_inertia_matrix(model, seed=request.seed, progress=task.progress))


def _bootstrap(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    found = validate_bootstrap(model, draws=request.draws or DRAWS, seed=request.seed, progress=task.progress)
    return adapter.describe_bootstrap(found)


def _methods(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    training = recordings_by_id(task, task.subject.all("training"))
    held_out = recordings_by_id(task, task.subject.all("measurement"))
    methods = adapter.methods_of(request.methods)
    return adapter.describe_methods(validate_methods(model, training, held_out, methods, task.progress))


def _simulation(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    ids = task.subject.all("measurement")
    found = []
    for index, identifier in enumerate(ids):
        progress = part(task.progress, index / len(ids), (index + 1) / len(ids))
        recording = recording_by_id(task, identifier)
        limit, longest = request.limit or LARGEST_ERROR, request.longest or LONGEST
        found.append(validate_simulation(model, recording, limit, longest, progress))
    return adapter.describe_simulations(found, ids)


def _filters(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    found = filters_by_simulation(
        model,
        recording_by_id(task, task.subject.one("measurement")),
        cutoffs=request.cutoffs,
        longest=request.longest or LONGEST_FOR_FILTERS,
        seed=request.seed,
        progress=task.progress,
    )
    return adapter.describe_filters(found)


def _payload(task: Task, request: ValidationRequest, model: Identification) -> ValidationResult:
    ids = task.subject.all("measurement")
    unloaded = recordings_by_id(task, task.subject.all("training"))
    found = []
    for index, identifier in enumerate(ids):
        task.progress(index / len(ids), "weighing the load")
        found.append(validate_payload(model, unloaded, recording_by_id(task, identifier), request.mass))
    return adapter.describe_payloads(found, ids)


Test = Callable[[Task, ValidationRequest, Identification], ValidationResult]
TESTS: Mapping[ValidationKind, Test] = MappingProxyType(
    {
        "direct": _direct,
        "cross": _cross,
        "inertia_matrix": _inertia_matrix,
        "methods": _methods,
        "simulation": _simulation,
        "filters": _filters,
        "payload": _payload,
        "bootstrap": _bootstrap,
    }
)
