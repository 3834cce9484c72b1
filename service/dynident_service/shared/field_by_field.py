"""Generic conversion by field names: body to request and back, result to view; tables and catalogue, numbers in JSON.

Tables of reports and the catalogue of effects, which need little more than that, are converted here as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from dynident.array_types import FloatArray
from dynident.effects import CATALOGUE, Effect, EffectChoice
from dynident.estimation import Errors
from dynident.presentation import model_tables
from dynident.presentation.tables import ReportedTable
from dynident.robot.json_fields import make_pointer
from dynident.schema.fields import point_within, resolve_hint
from dynident.schema.registry import RegistryEntry
from dynident_service.shared import wire_types as shared_types
from dynident_service.shared import wire_types as wire
from dynident_service.shared.request_bodies import BODIES, REQUESTS
from dynident_service.shared.wire_types import ErrorFigures, ErrorsView, Table, TableColumn

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def show_catalogue() -> wire.Catalogue:
    """Return the view of all effects."""
    return wire.Catalogue(items=[_show_effect(effect) for effect in CATALOGUE.values()])


def _show_effect(effect: Effect) -> wire.EffectView:
    parameters = [
        to_view(wire.EffectParameter, parameter, prismatic_unit=parameter.get_unit("prismatic"))
        for parameter in effect.parameters
    ]
    shapes = [
        to_view(
            wire.ShapeParameter, shape, words=[wire.ShapeWord(value=value, word=word) for value, word in shape.words]
        )
        for shape in effect.shapes
    ]
    return to_view(wire.EffectView, effect, parameters=parameters, shape_parameters=shapes)


def show_tables(tables: Iterable[ReportedTable]) -> list[Table]:
    """Build the views of tables."""
    return [to_view(Table, table, columns=_show_columns(table)) for table in tables]


def _show_columns(table: ReportedTable) -> list[TableColumn]:
    return [TableColumn(word=word, figures=table.is_figures(k)) for k, word in enumerate(table.columns)]


def from_wire_choice(wire_choice: shared_types.EffectChoice) -> EffectChoice:
    """Convert a chosen effect of a body."""
    # Sorted, so that the same constants in another order are the same choice.
    shape = tuple(sorted(wire_choice.shape_parameters.items()))
    return EffectChoice(wire_choice.effect, tuple(wire_choice.joints), shape, tuple(wire_choice.runs))


def from_wire_choices(wire_choices: Iterable[shared_types.EffectChoice]) -> tuple[EffectChoice, ...]:
    """Convert the chosen effects of a body."""
    return tuple(from_wire_choice(wire_choice) for wire_choice in wire_choices)


def show_choice(choice: EffectChoice) -> shared_types.EffectChoice:
    """Build the view of a chosen effect."""
    return shared_types.EffectChoice(
        effect=choice.effect,
        joints=list(choice.joints),
        shape_parameters=dict(choice.shape),
        runs=list(choice.runs),
    )


RequestT = TypeVar("RequestT")
BodyT = TypeVar("BodyT", bound=BaseModel)


def to_request(request_body: BaseModel, science: type[RequestT], **more: object) -> RequestT:
    """Build a request of the library from a body. `more` has the values of fields that the body does not have."""
    body_fields = type(request_body).model_fields
    names = [
        request_field.name
        for request_field in fields(science)  # type: ignore[arg-type]
        if request_field.name not in more and request_field.name in body_fields
    ]
    # Null by default stands for the default of the library, which may be another.
    values = {
        name: _from_body_value(value, f"/{name}")
        for name in names
        if (value := getattr(request_body, name)) is not None or body_fields[name].default is not None
    }
    return science(**values, **more)


def to_body(kind: type[BodyT], value: DataclassInstance, **own: object) -> BodyT:
    """Build the body that asks for a request of the library. `own` has the values of fields that only the body has."""
    return kind.model_validate({**own, **_body_fields(value)})


def to_body_value(value: object) -> object:
    """Convert a value of a request to the types of JSON, as the contract writes it."""
    if isinstance(value, EffectChoice):
        return show_choice(value).model_dump()
    if is_dataclass(value) and not isinstance(value, type):
        return _body_fields(value)
    if isinstance(value, Mapping):
        return {name: to_body_value(element) for name, element in value.items()}
    return [to_body_value(element) for element in value] if isinstance(value, (tuple, list)) else value


def _body_fields(value: DataclassInstance) -> dict[str, object]:
    # A choice among kinds (an estimator with options) is an object with its name.
    name_entry = {"name": value.name} if isinstance(value, RegistryEntry) else {}
    wire_fields = BODIES[type(value)].model_fields
    return name_entry | {
        science_field.name: to_body_value(getattr(value, science_field.name))
        for science_field in fields(value)
        if science_field.name in wire_fields
    }


def to_requests(bodies: Mapping[str, BaseModel], science: type[RequestT], pointer: str) -> dict[str, RequestT]:
    """Build requests of the library from parts of a body by name. `pointer` leads to the parts, for errors."""
    requests = {}
    for name, body in bodies.items():
        with point_within(make_pointer(name, within=pointer)):
            requests[name] = to_request(body, science)
    return requests


def _from_body_value(value: Any, pointer: str) -> Any:
    if isinstance(value, shared_types.EffectChoice):
        return from_wire_choice(value)
    if isinstance(value, BaseModel):
        with point_within(pointer):
            return to_request(value, REQUESTS[type(value)])
    if isinstance(value, dict):
        return {name: _from_body_value(element, make_pointer(name, within=pointer)) for name, element in value.items()}
    if not isinstance(value, list):
        return value
    # Requests are frozen and hashable: lists become tuples.
    return tuple(_from_body_value(element, f"{pointer}/{index}") for index, element in enumerate(value))


T = TypeVar("T")
ViewT = TypeVar("ViewT", bound=BaseModel)

_ABSENT = object()
_SAME_NAME = shared_types.SourcePath()


def to_view(view: type[ViewT], result: object, **more: object) -> ViewT:
    """Build a view of a result.

    Each field is read from the result's attribute of the same name, or from the path that `SourcePath` states in its
    annotation; `more` has those that the result does not have, or has in another form. A field that may be null is null
    where the number is not finite or the text is empty. Errors get the errors on moving rows as well.
    """
    values: dict[str, object] = {}
    for name, field in view.model_fields.items():
        owner, attribute = _resolve_path(result, _source_of_field(field).path or name)
        # A path that ends at None, as "held_out.rms_total" without held-out data, gives null. An attribute that does
        # not exist leaves the field to its default.
        nothing = None if owner is None and result is not None else _ABSENT
        value = more[name] if name in more else getattr(owner, attribute, nothing)
        # A default stands for what is missing on the way, where the field may not be null.
        if value is _ABSENT or (value is None and not field.is_required() and not _may_be_null(field)):
            continue
        if isinstance(value, str) and not value and _may_be_null(field):
            value = None
        if isinstance(value, Errors) and ErrorsView in _union_members(field.annotation):
            value = show_errors(value, getattr(owner, f"{attribute}_moving", None))
        # Models validate by alias where a field has one: "from" is no Python name.
        values[field.alias or name] = _to_view_value(field.annotation, value)
    return view.model_validate(values)


def from_view(science: type[T], view: BaseModel, **more: object) -> T:
    """Restore a result of the library from its view.

    `more` has the fields that the view holds in another form; fields that it lacks have their defaults.
    """
    values: dict[str, dict[str, tuple[FieldInfo, object]]] = {}
    # Several fields of a view may come from one attribute ("choice.effect", "choice.joints"): they are collected by it.
    for name, info in type(view).model_fields.items():
        field, _, inner = (_source_of_field(info).path or name).partition(".")
        values.setdefault(field, {})[inner] = (info, getattr(view, name))
    science_fields = [
        science_field
        for science_field in fields(science)  # type: ignore[arg-type]
        if science_field.name in values and science_field.name not in more
    ]
    return science(
        **{
            science_field.name: _from_view_fields(resolve_hint(science, science_field), values[science_field.name])
            for science_field in science_fields
        },
        **more,
    )


def show_errors(errors: Errors, moving: Errors | None = None, sigma: FloatArray | None = None) -> ErrorsView:
    """Show the errors of a model on data.

    Those of `moving` are on the rows where each joint moves. They are null where a joint has no rows.
    """
    return ErrorsView(
        **show_figures(errors).model_dump(),
        moving=None if moving is None else show_figures(moving),
        sigma=None if sigma is None else to_json_numbers(sigma),
    )


def show_figures(errors: Errors) -> ErrorFigures:
    """Show errors on a set of rows; null for a joint without rows there."""
    return to_view(ErrorFigures, model_tables.ErrorFigures.from_errors(errors))


def replace_non_finite(value: float) -> float | None:
    """Return a number, or None for infinity and NaN, which JSON does not have."""
    return float(value) if math.isfinite(value) else None


def to_json_numbers(values: FloatArray) -> list[float | None]:
    """Return an array (n,) as JSON numbers, None where one is not finite."""
    # Signals are long and almost always finite: one vectorised check spares a Python call a sample.
    listed: list[float | None] = values.tolist()
    return listed if np.isfinite(values).all() else [replace_non_finite(value) for value in values.tolist()]


def _may_be_null(field: FieldInfo) -> bool:
    return NoneType in _union_members(field.annotation)


def _source_of_field(field: FieldInfo) -> shared_types.SourcePath:
    return next((about for about in field.metadata if isinstance(about, shared_types.SourcePath)), _SAME_NAME)


def _resolve_path(result: object, path: str) -> tuple[object, str]:
    owner, _, attribute = path.rpartition(".")
    for step in owner.split(".") if owner else ():
        result = getattr(result, step, None)
    return result, attribute


def _union_members(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _to_view_value(hint: Any, value: object) -> object:
    parts = _union_members(hint)
    if isinstance(value, (np.ndarray, np.generic)):
        # The same shortcut for long signals that are finite throughout.
        if value.ndim and np.isfinite(value).all():
            return value.tolist()
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) or NoneType not in parts else None
    # Before the containers: strings are sequences, and models are converted already.
    if value is None or hint is Any or isinstance(value, (str, int, BaseModel)):
        return value
    if isinstance(value, EffectChoice):
        return show_choice(value)
    if isinstance(value, Errors):
        return show_figures(value)
    hint = next(part for part in parts if part is not NoneType)
    inner = get_args(hint)
    if isinstance(value, (tuple, list)) and get_origin(hint) is tuple:
        return tuple(_to_view_value(part, element) for part, element in zip(inner, value, strict=True))
    if isinstance(value, (tuple, list)) and get_origin(hint) is not dict:
        return [_to_view_value(inner[0], element) for element in value]
    if isinstance(value, (Mapping, tuple)):
        return {name: _to_view_value(inner[1], element) for name, element in dict(value).items()}
    return to_view(hint, value)


def _from_view_fields(hint: Any, shown_fields: Mapping[str, tuple[FieldInfo, object]]) -> object:
    """Restore one attribute, from the field that shows it or from several fields that show its attributes."""
    if "" in shown_fields:
        field, value = shown_fields[""]
        return _from_view_value(hint, value, _source_of_field(field).null)
    # Without an entry for the attribute itself, the fields show attributes of it, so it is built from them.
    flat = {
        name: _from_view_value(resolve_hint(hint, science_field), shown_fields[science_field.name][1])
        for science_field in fields(hint)
        if (name := science_field.name) in shown_fields
    }
    return hint(**flat)


def _from_view_value(hint: Any, value: object, null: float | tuple[float, float] = math.nan) -> object:
    parts = _union_members(hint)
    if value is None:
        return None if NoneType in parts else null
    hint = next(part for part in parts if part is not NoneType)
    if isinstance(value, shared_types.EffectChoice):
        return from_wire_choice(value)
    if isinstance(value, BaseModel):
        return from_view(hint, value) if isinstance(hint, type) and is_dataclass(hint) else value
    if isinstance(value, dict) and get_origin(hint) is tuple:
        return tuple(sorted(value.items()))
    if not isinstance(value, (list, tuple)):
        return value
    # A list is an array in the library, unless the field says that it is a tuple.
    if get_origin(hint) is not tuple:
        return np.array(value, dtype=np.float64)
    # Of an interval each end has its own value for null, as −∞ and ∞.
    if isinstance(null, tuple):
        return tuple(end if element is None else element for element, end in zip(value, null, strict=True))
    return tuple(_from_view_value(get_args(hint)[0], element) for element in value)
