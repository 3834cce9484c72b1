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


def taken(asked: BaseModel, science: type[T], **more: object) -> T:
    """What a body asks for; `more` are fields that are no part of it.

    Raises
    ------
    DynidentError
        Where the request refuses what it is given.
    """
    stated = [one for one in fields(science) if one.name not in more and hasattr(asked, one.name)]  # type: ignore[arg-type]
    # What may be null on the wire and not in the science stands for the default.
    names = [one.name for one in stated if getattr(asked, one.name) is not None or "None" in str(one.type)]
    return science(**{name: _taken(getattr(asked, name)) for name in names}, **more)


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
        return {name: written(one) for name, one in value.items()}
    return [written(one) for one in value] if isinstance(value, (tuple, list)) else value


def _fields(value: DataclassInstance) -> dict[str, object]:
    named = {"name": value.name} if isinstance(value, Kind) else {}
    known = BODIES[type(value)].model_fields
    return named | {one.name: written(getattr(value, one.name)) for one in fields(value) if one.name in known}


def _taken(value: Any) -> Any:
    if isinstance(value, common.EffectChoice):
        return choice_of(value)
    if isinstance(value, BaseModel):
        return taken(value, SCIENCE[type(value)])
    if isinstance(value, dict):
        return {name: _taken(one) for name, one in value.items()}
    return tuple(_taken(one) for one in value) if isinstance(value, list) else value
