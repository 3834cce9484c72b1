"""Derive HTTP bodies and queries from request dataclasses: types, words, ranges, defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from inspect import cleandoc
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import pydantic
from pydantic import BaseModel, create_model
from pydantic.config import JsonDict, JsonValue

from dynident.schema.fields import FieldDescription, NamedValues, get_default, get_description, resolve_hint
from dynident.schema.registry import Registry, RegistryEntry
from dynident_service.shared.wire_types import NumberRange, QueryModel, RequestModel

ModelT = TypeVar("ModelT", bound=BaseModel)

BODIES: dict[type, type[BaseModel]] = {}
"""What each request of the science is on the wire."""

REQUESTS: dict[type[BaseModel], type] = {}
"""What each of these bodies asks for."""


def derive_body(
    science: type,
    *but: str,
    only: tuple[str, ...] | None = None,
    or_null: tuple[str, ...] = (),
    words: Mapping[str, str] = MappingProxyType({}),
) -> Callable[[type[ModelT]], type[ModelT]]:
    """Decorate a body: add the fields of a request of the library to those that the class states itself.

    `science` is a frozen dataclass of `declare_field`s. Fields of `but` are no part of the contract, of `only` those of
    `only` are, those of `or_null` may be null for their default. `words` has what fields mean here, if something else.
    """

    def build_body(body: type[ModelT]) -> type[ModelT]:
        own = body.model_fields
        for request_field in fields(science):
            if request_field.name in own and own[request_field.name].description is None:
                # Of another type there; what it means is said once.
                own[request_field.name].description = get_description(request_field).sentence or None
        derived = {
            request_field.name: _derive_field(
                science, request_field, request_field.name in or_null, words.get(request_field.name)
            )
            for request_field in fields(science)
            if request_field.name not in (*but, *own)
            and (only is None or request_field.name in only)
            and not get_description(request_field).local
        }
        # Built at run time from the library's dataclass, so that library and contract cannot differ.
        model: type[ModelT] = create_model(  # type: ignore[call-overload]
            body.__name__, __base__=body, __module__=body.__module__, __doc__=body.__doc__, **derived
        )
        if only is None:
            # Else the contract would depend on which module was imported first.
            assert science not in BODIES, f"{body.__name__} has to be derived before its first use"
            BODIES[science] = model
        REQUESTS[model] = science
        return model

    return build_body


def derive_query(science: type) -> object:
    """Build the model of a query that asks for a request of the library; other parameters are ignored."""
    derived: dict[str, Any] = {
        request_field.name: _derive_field(science, request_field) for request_field in fields(science)
    }
    return create_model(science.__name__, __base__=QueryModel, **derived)


def find_body(science: type) -> type[BaseModel]:
    """Return the body of a request of the library, or of a part of one."""
    if science not in BODIES:
        plain: type[BaseModel] = create_model(science.__name__, __base__=RequestModel, __doc__=_get_prose(science))
        derive_body(science)(plain)
    return BODIES[science]


def _get_prose(science: type) -> str:
    """Return the docstring of a request without the section on its fields, which the contract describes one by one."""
    return cleandoc(science.__doc__ or "").partition("\n\nParameters\n")[0]


def _derive_field(
    science: type, request_field: Field[Any], or_null: bool = False, words: str | None = None
) -> tuple[Any, Any]:
    about = get_description(request_field)
    about = about if words is None else replace(about, words=words)
    if about.kinds is None:
        hint = _to_wire_type(resolve_hint(science, request_field), request_field.name, about)
        hint = hint | None if or_null else hint
    else:
        hint = _build_choice_type(about, optional=or_null or get_default(request_field) is None)
    # Null stands for the default: the library is not asked what it would be.
    default = None if or_null else get_default(request_field)
    several = any(get_origin(part) is list for part in (hint, *get_args(hint)))
    if several and isinstance(default, tuple):
        default = list(default)
    return hint, _build_field(about, default, sized=several or hint is str)


def describe_choices(kinds: NamedValues) -> JsonDict:
    """Return the schema extension that lists the choices of a field."""
    choices: list[JsonValue] = [
        {"name": choice.name, "label": choice.label or choice.name, "words": choice.words} for choice in kinds.choices
    ]
    return {"x-choices": choices}


def _build_field(about: FieldDescription, default: Any, sized: bool) -> Any:
    extra: dict[str, Any] = {}
    if about.unit:
        extra["x-unit"] = about.unit
    if about.label:
        extra["x-label"] = about.label
    if about.kinds is not None:
        extra |= describe_choices(about.kinds)
    schema: dict[str, Any] = {"description": about.sentence or None, "json_schema_extra": extra or None}
    if sized:
        schema |= {"min_length": about.fewest, "max_length": about.most}
    return pydantic.Field(default=... if default is MISSING else _wire_default(default), **schema)


def _wire_default(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return find_body(type(value))()
    return dict(value) if isinstance(value, Mapping) else value


def _build_choice_type(about: FieldDescription, optional: bool) -> Any:
    kinds = about.kinds
    assert kinds is not None
    hint: Any = Literal[kinds.names]
    # A kind with options may be given by its name alone, or as an object with the name and options.
    if isinstance(kinds, Registry):
        for kind in kinds:
            if fields(kind):
                hint = hint | _build_kind_model(kind)
    return hint | None if optional else hint


def _build_kind_model(kind: type[RegistryEntry]) -> type[BaseModel]:
    name_field: dict[str, Any] = {"name": (Literal[kind.name], ...)}
    derived = {option_field.name: _derive_field(kind, option_field) for option_field in fields(kind)}
    model: type[BaseModel] = create_model(  # type: ignore[call-overload]
        kind.__name__, __base__=RequestModel, __doc__=_get_prose(kind), **name_field, **derived
    )
    BODIES[kind], REQUESTS[model] = model, kind
    return model


def _to_wire_type(hint: Any, name: str, about: FieldDescription) -> Any:
    origin, parts = get_origin(hint), get_args(hint)
    if is_dataclass(hint) and isinstance(hint, type):
        return find_body(hint)
    if origin is tuple and parts[-1] is Ellipsis:
        return list[_to_wire_type(parts[0], name, about)]  # type: ignore[misc]
    if origin is tuple:
        return tuple[tuple(_to_wire_type(part, name, about) for part in parts)]  # type: ignore[misc]
    if origin in (Union, UnionType):
        return Union[tuple(part if part is NoneType else _to_wire_type(part, name, about) for part in parts)]  # noqa: UP007
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return dict[parts[0], _to_wire_type(parts[1], name, about)]  # type: ignore[misc,valid-type]
    # The range is part of the contract, so that clients can check it before they send.
    return Annotated[hint, NumberRange(name, about)] if hint in (int, float) else hint
