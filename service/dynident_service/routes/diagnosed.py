"""Completion of effects that are added by name alone, from earlier diagnoses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dynident_service.models.common import EffectChoice
from dynident_service.models.diagnoses import DiagnosisResult
from dynident_service.services import Services
from dynident_service.storage.records import Resource

_LATEST = 5


def complete_from_diagnoses(services: Services, model: Resource, effects: Sequence[EffectChoice]) -> list[EffectChoice]:
    """The choices, with the shape constants and runs that a diagnosis of the model recommended where none are given.

    The latest diagnoses count first, those of the model before those of the models that it came from. What was
    recommended more than once (two lines of ripple on a joint) is given out in that order.
    """
    recommended = [choice for diagnosis in _list_diagnoses(services, model) for choice in diagnosis.recommended]
    completed = []
    for requested in effects:
        match = None if requested.shape_parameters or requested.runs else _find_recommended(requested, recommended)
        if match is not None:
            recommended.remove(match)
        completed.append(match or requested)
    return completed


def _find_recommended(requested: EffectChoice, recommended: Sequence[EffectChoice]) -> EffectChoice | None:
    for choice in recommended:
        if choice.effect == requested.effect and set(choice.joints) == set(requested.joints):
            return choice
    return None


def _list_diagnoses(services: Services, model: Resource) -> Iterator[DiagnosisResult]:
    """Results of the latest diagnoses of a model and of its ancestors."""
    ancestor: Resource | None = model
    while ancestor is not None:
        for diagnosis in services.resources.list_page("diagnosis", _LATEST, on_id=ancestor.id).items:
            if diagnosis.result is not None:
                yield DiagnosisResult.model_validate(diagnosis.result)
        parents = ancestor.get_dependencies("parent")
        ancestor = services.resources.get("identification", parents[0]) if parents else None
