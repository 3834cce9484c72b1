"""Conversion of bodies of the contract to request dataclasses of the library, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel

from dynident.effects import EffectChoice
from dynident.schema.registry import RegistryEntry
from dynident_service.models import common
from dynident_service.models.request_bodies import BODIES, REQUESTS

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
from collections.abc import Iterable


def from_wire_choice(wire_choice: common.EffectChoice) -> EffectChoice:
    """Convert a chosen effect of a body."""
    # Sorted, so that the same constants in another order are the same choice.
    shape = tuple(sorted(wire_choice.shape_parameters.items()))
    return EffectChoice(wire_choice.effect, tuple(wire_choice.joints), shape, tuple(wire_choice.runs))


def from_wire_choices(wire_choices: Iterable[common.EffectChoice]) -> tuple[EffectChoice, ...]:
    """Convert the chosen effects of a body."""
    return tuple(from_wire_choice(wire_choice) for wire_choice in wire_choices)


def show_choice(choice: EffectChoice) -> common.EffectChoice:
    """Build the view of a chosen effect."""
    return common.EffectChoice(
        effect=choice.effect,
        joints=list(choice.joints),
        shape_parameters=dict(choice.shape),
        runs=list(choice.runs),
    )


T = TypeVar("T")
BodyT = TypeVar("BodyT", bound=BaseModel)


def to_request(request_body: BaseModel, science: type[T], **more: object) -> T:
    """Build a request of the library from a body.

    Parameters
    ----------
    request_body : BaseModel
        The body, or a part of one.
    science : type
        The dataclass of the request.
    more
        Values of fields that the body does not have.

    Returns
    -------
    object
        The request.

    Raises
    ------
    DynidentError
        Where the request refuses a value.
    """
    request_fields = [
        request_field
        for request_field in fields(science)  # type: ignore[arg-type]
        if request_field.name not in more and hasattr(request_body, request_field.name)
    ]
    # A field that may be null in the contract only, and not in the library, stands for its default when it is null.
    names = [
        request_field.name
        for request_field in request_fields
        if getattr(request_body, request_field.name) is not None or "None" in str(request_field.type)
    ]
    return science(**{name: _from_wire_value(getattr(request_body, name)) for name in names}, **more)


def to_body(kind: type[BodyT], value: DataclassInstance, **own: object) -> BodyT:
    """Build the body that asks for a request of the library.

    Parameters
    ----------
    kind : type
        The model of the body.
    value : dataclass
        The request.
    own
        Values of fields that only the body has.

    Returns
    -------
    BaseModel
        The body.
    """
    return kind.model_validate({**own, **_wire_fields(value)})


def to_wire_value(value: object) -> object:
    """Convert a value of a request to the types of JSON, as the contract writes it."""
    if isinstance(value, EffectChoice):
        return show_choice(value).model_dump()
    if is_dataclass(value) and not isinstance(value, type):
        return _wire_fields(value)
    if isinstance(value, Mapping):
        return {name: to_wire_value(element) for name, element in value.items()}
    return [to_wire_value(element) for element in value] if isinstance(value, (tuple, list)) else value


def _wire_fields(value: DataclassInstance) -> dict[str, object]:
    # A choice among kinds (an estimator with options) is an object with its name.
    name_entry = {"name": value.name} if isinstance(value, RegistryEntry) else {}
    wire_fields = BODIES[type(value)].model_fields
    return name_entry | {
        science_field.name: to_wire_value(getattr(value, science_field.name))
        for science_field in fields(value)
        if science_field.name in wire_fields
    }


def _from_wire_value(value: Any) -> Any:
    if isinstance(value, common.EffectChoice):
        return from_wire_choice(value)
    if isinstance(value, BaseModel):
        return to_request(value, REQUESTS[type(value)])
    if isinstance(value, dict):
        return {name: _from_wire_value(element) for name, element in value.items()}
    # Requests are frozen and hashable: lists become tuples.
    return tuple(_from_wire_value(element) for element in value) if isinstance(value, list) else value
