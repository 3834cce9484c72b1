"""Bodies of the contract, derived from request dataclasses of the library: fields, words, units, ranges, defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, create_model
from pydantic import Field as wire_field
from pydantic.config import JsonDict, JsonValue

from dynident.asking import Named, Said, default_of, said_of
from dynident.kinds import Kind, Kinds
from dynident_service.hints import hint_of
from dynident_service.models.common import Asked, Queried

ModelT = TypeVar("ModelT", bound=BaseModel)

BODIES: dict[type, type[BaseModel]] = {}
"""What each request of the science is on the wire."""

SCIENCE: dict[type[BaseModel], type] = {}
"""What each of these bodies asks for."""


def asks(
    science: type, *but: str, only: tuple[str, ...] | None = None, or_null: tuple[str, ...] = ()
) -> Callable[[type[ModelT]], type[ModelT]]:
    """Decorate a body: add the fields of a request of the library to those that the class states itself.

    Parameters
    ----------
    science : type
        A frozen dataclass whose fields say what they are (`dynident.asking.said`).
    but : str
        Fields that are no part of the contract.
    only : tuple of str, optional
        Those that are, where they are few.
    or_null : tuple of str
        Those that may be null for their default.
    """

    def made(body: type[ModelT]) -> type[ModelT]:
        own = body.model_fields
        for request_field in fields(science):
            if request_field.name in own and own[request_field.name].description is None:
                # Of another type there; what it means is said once.
                own[request_field.name].description = said_of(request_field).sentence or None
        derived = {
            request_field.name: _derived(science, request_field, request_field.name in or_null)
            for request_field in fields(science)
            if request_field.name not in (*but, *own)
            and (only is None or request_field.name in only)
            and not said_of(request_field).local
        }
        model: type[ModelT] = create_model(  # type: ignore[call-overload]
            body.__name__, __base__=body, __module__=body.__module__, __doc__=body.__doc__, **derived
        )
        if only is None:
            BODIES[science] = model
        SCIENCE[model] = science
        return model

    return made


def query_of(science: type) -> object:
    """Build the model of a query that asks for a request of the library; other parameters are ignored."""
    derived: dict[str, Any] = {
        request_field.name: _derived(science, request_field) for request_field in fields(science)
    }
    return create_model(science.__name__, __base__=Queried, **derived)


def body_of(science: type) -> type[BaseModel]:
    """Return the body of a request of the library, or of a part of one."""
    if science not in BODIES:
        plain: type[BaseModel] = create_model(science.__name__, __base__=Asked, __doc__=science.__doc__)
        asks(science)(plain)
    return BODIES[science]


def _derived(science: type, request_field: Field[Any], or_null: bool = False) -> tuple[Any, Any]:
    about = said_of(request_field)
    if about.kinds is None:
        hint = _on_the_wire(hint_of(science, request_field), about)
        hint = hint | None if or_null else hint
    else:
        hint = _one_of(about, optional=or_null or "None" in str(request_field.type))
    default = None if or_null else default_of(request_field)
    several = any(get_origin(part) is list for part in (hint, *get_args(hint)))
    if several and isinstance(default, tuple):
        default = list(default)
    return hint, _described(about, default, sized=several or hint is str)


def choices_shown(kinds: Named) -> JsonDict:
    """Return the schema extension that lists the choices of a field."""
    choices: list[JsonValue] = [
        {"name": choice.name, "label": choice.label or choice.name, "words": choice.words} for choice in kinds.choices
    ]
    return {"x-choices": choices}


def _described(about: Said, default: Any, sized: bool) -> Any:
    extra: dict[str, Any] = {}
    if about.unit:
        extra["x-unit"] = about.unit
    if about.kinds is not None:
        extra |= choices_shown(about.kinds)
    schema: dict[str, Any] = {"description": about.sentence or None, "json_schema_extra": extra or None}
    if sized:
        schema |= {"min_length": about.fewest, "max_length": about.most}
    return wire_field(default=... if default is MISSING else _default(default), **schema)


def _default(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return body_of(type(value))()
    return dict(value) if isinstance(value, Mapping) else value


def _range(about: Said) -> dict[str, float | None]:
    return {"gt": about.above, "ge": about.at_least, "le": about.at_most}


def _one_of(about: Said, optional: bool) -> Any:
    kinds = about.kinds
    assert kinds is not None
    hint: Any = Literal[kinds.names]
    if isinstance(kinds, Kinds):
        for kind in kinds:
            if fields(kind):
                hint = hint | _with_options(kind)
    return hint | None if optional else hint


def _with_options(kind: type[Kind]) -> type[BaseModel]:
    name_field: dict[str, Any] = {"name": (Literal[kind.name], ...)}
    derived = {option_field.name: _derived(kind, option_field) for option_field in fields(kind)}
    model: type[BaseModel] = create_model(  # type: ignore[call-overload]
        kind.__name__, __base__=Asked, __doc__=kind.__doc__, **name_field, **derived
    )
    BODIES[kind], SCIENCE[model] = model, kind
    return model


def _on_the_wire(hint: Any, about: Said) -> Any:
    origin, parts = get_origin(hint), get_args(hint)
    if is_dataclass(hint) and isinstance(hint, type):
        return body_of(hint)
    if origin is tuple and parts[-1] is Ellipsis:
        return list[_on_the_wire(parts[0], about)]  # type: ignore[misc]
    if origin is tuple:
        return tuple[tuple(_on_the_wire(part, about) for part in parts)]  # type: ignore[misc]
    if origin in (Union, UnionType):
        return Union[tuple(part if part is NoneType else _on_the_wire(part, about) for part in parts)]  # noqa: UP007
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return dict[parts[0], _on_the_wire(parts[1], about)]  # type: ignore[misc,valid-type]
    if hint in (int, float):
        ends = {name: end for name, end in _range(about).items() if end is not None}
        return Annotated[hint, wire_field(**ends)] if ends else hint  # type: ignore[call-overload]
    return hint
