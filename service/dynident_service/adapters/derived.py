"""From the bodies of the contract to the requests of the science."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

from pydantic import BaseModel

from dynident_service.adapters.effects import choice_of
from dynident_service.models.common import EffectChoice
from dynident_service.models.derived import SCIENCE

T = TypeVar("T")


def taken(asked: BaseModel, science: type[T], **more: Any) -> T:
    """What a body asks for; `more` are fields that are no part of it.

    Raises
    ------
    DynidentError
        Where the request refuses what it is given.
    """
    names = [one.name for one in fields(science) if hasattr(asked, one.name) and one.name not in more]  # type: ignore[arg-type]
    return science(**{name: _taken(getattr(asked, name)) for name in names}, **more)


def _taken(value: Any) -> Any:
    if isinstance(value, EffectChoice):
        return choice_of(value)
    if isinstance(value, BaseModel):
        return taken(value, SCIENCE[type(value)])
    if isinstance(value, dict):
        return {name: _taken(one) for name, one in value.items()}
    return tuple(_taken(one) for one in value) if isinstance(value, list) else value
