"""From the bodies of the contract to the requests of the science, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel

from dynident.effects import EffectChoice
from dynident.kinds import Kind
from dynident_service.adapters.effects import choice_of, show_choice
from dynident_service.models import common
from dynident_service.models.derived import BODIES, SCIENCE

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")
BodyT = TypeVar("BodyT", bound=BaseModel)


def taken(request_body: BaseModel, science: type[T], **more: object) -> T:
    """What a body asks for; `more` are fields that are no part of it.

    Raises
    ------
    DynidentError
        Where the request refuses what it is given.
    """
    request_fields = [
        request_field
        for request_field in fields(science)  # type: ignore[arg-type]
        if request_field.name not in more and hasattr(request_body, request_field.name)
    ]
    # What may be null on the wire and not in the science stands for the default.
    names = [
        request_field.name
        for request_field in request_fields
        if getattr(request_body, request_field.name) is not None or "None" in str(request_field.type)
    ]
    return science(**{name: _taken(getattr(request_body, name)) for name in names}, **more)


def body(kind: type[BodyT], value: DataclassInstance, **own: object) -> BodyT:
    """The body that asks for a request of the science; `own` are fields that are no part of it."""
    return kind.model_validate({**own, **_fields(value)})


def written(value: object) -> object:
    """A value of the science as the contract writes it, in JSON's own types."""
    if isinstance(value, EffectChoice):
        return show_choice(value).model_dump()
    if is_dataclass(value) and not isinstance(value, type):
        return _fields(value)
    if isinstance(value, Mapping):
        return {name: written(element) for name, element in value.items()}
    return [written(element) for element in value] if isinstance(value, (tuple, list)) else value


def _fields(value: DataclassInstance) -> dict[str, object]:
    name_entry = {"name": value.name} if isinstance(value, Kind) else {}
    wire_fields = BODIES[type(value)].model_fields
    return name_entry | {
        science_field.name: written(getattr(value, science_field.name))
        for science_field in fields(value)
        if science_field.name in wire_fields
    }


def _taken(value: Any) -> Any:
    if isinstance(value, common.EffectChoice):
        return choice_of(value)
    if isinstance(value, BaseModel):
        return taken(value, SCIENCE[type(value)])
    if isinstance(value, dict):
        return {name: _taken(element) for name, element in value.items()}
    return tuple(_taken(element) for element in value) if isinstance(value, list) else value
