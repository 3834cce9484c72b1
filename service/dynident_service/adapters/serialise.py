"""Conversion of results of the library to views of the contract and back, field by field of the same name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.estimation import Errors
from dynident_service.adapters.requests import from_wire_choice, show_choice
from dynident_service.field_hints import resolve_hint
from dynident_service.models import common
from dynident_service.models.identifications import ErrorFigures, ErrorsView

T = TypeVar("T")
ViewT = TypeVar("ViewT", bound=BaseModel)

_ABSENT = object()
_SAME_NAME = common.SourcePath()


def to_view(view: type[ViewT], result: object, **more: object) -> ViewT:
    """Build a view of a result.

    Parameters
    ----------
    view : type
        A model of the contract. Each field is read from the result's attribute of the same name, or from the path that
        `SourcePath` states in its annotation. A field that may be null is null where the number is not finite. Errors
        get the errors on moving rows as well.
    result : object
        A result of the library; None where all fields are in `more`.
    more
        Values of fields that the result does not have, or has in another form.

    Returns
    -------
    BaseModel
        The view.
    """
    values: dict[str, object] = {}
    for name, field in view.model_fields.items():
        owner, attribute = _resolve_path(result, _source_of_field(field).path or name)
        # A path that ends at None, as "held_out.rms_total" without held-out data, gives null. An attribute that does
        # not exist leaves the field to its default.
        nothing = None if owner is None and result is not None else _ABSENT
        value = more[name] if name in more else getattr(owner, attribute, nothing)
        if value is _ABSENT:
            continue
        if isinstance(value, Errors) and ErrorsView in _union_members(field.annotation):
            value = show_errors(value, getattr(owner, f"{attribute}_moving", None))
        # Models validate by alias where a field has one: "from" is no Python name.
        values[field.alias or name] = _to_wire_value(field.annotation, value)
    return view.model_validate(values)


def from_view(science: type[T], view: BaseModel, **more: object) -> T:
    """Restore a result of the library from its view.

    Parameters
    ----------
    science : type
        The dataclass of the result.
    view : BaseModel
        The view, as it was stored.
    more
        Values of fields that the view holds in another form.

    Returns
    -------
    object
        The result, as far as the view holds it; other fields have their defaults.
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
            science_field.name: _from_wire_fields(resolve_hint(science, science_field), values[science_field.name])
            for science_field in science_fields
        },
        **more,
    )


def show_errors(errors: Errors, moving: Errors | None = None, sigma: FloatArray | None = None) -> ErrorsView:
    """Show the errors of a model on data.

    Parameters
    ----------
    errors, moving : Errors
        On all rows, and on those where each joint moves.
    sigma : array (n,), optional
        Standard deviation of the residual per joint.

    Returns
    -------
    ErrorsView
        The errors, null where a joint has no rows.
    """
    return ErrorsView(
        **show_figures(errors).model_dump(),
        moving=None if moving is None else show_figures(moving),
        sigma=None if sigma is None else to_json_numbers(sigma),
    )


def show_figures(errors: Errors) -> ErrorFigures:
    """Show errors on a set of rows; null for a joint without rows there."""
    has_rows = errors.counts > 0
    return ErrorFigures(
        rms=to_json_numbers(np.where(has_rows, errors.rms, np.nan)),
        relative=to_json_numbers(np.where(has_rows, errors.relative, np.nan)),
        relative_total=finite_or_none(errors.relative_total) if has_rows.any() else None,
    )


def finite_or_none(value: float) -> float | None:
    """Return a number, or None for infinity and NaN, which JSON does not have."""
    return float(value) if math.isfinite(value) else None


def to_json_numbers(values: FloatArray) -> list[float | None]:
    """Return an array (n,) as JSON numbers, None where one is not finite."""
    # Signals are long and almost always finite: one vectorised check spares a Python call a sample.
    listed: list[float | None] = values.tolist()
    return listed if np.isfinite(values).all() else [finite_or_none(value) for value in values.tolist()]


def _source_of_field(field: FieldInfo) -> common.SourcePath:
    return next((about for about in field.metadata if isinstance(about, common.SourcePath)), _SAME_NAME)


def _resolve_path(result: object, path: str) -> tuple[object, str]:
    owner, _, attribute = path.rpartition(".")
    for step in owner.split(".") if owner else ():
        result = getattr(result, step, None)
    return result, attribute


def _union_members(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _to_wire_value(hint: Any, value: object) -> object:
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
        return tuple(_to_wire_value(part, element) for part, element in zip(inner, value, strict=True))
    if isinstance(value, (tuple, list)) and get_origin(hint) is not dict:
        return [_to_wire_value(inner[0], element) for element in value]
    if isinstance(value, (Mapping, tuple)):
        return {name: _to_wire_value(inner[1], element) for name, element in dict(value).items()}
    return to_view(hint, value)


def _from_wire_fields(hint: Any, shown_fields: Mapping[str, tuple[FieldInfo, object]]) -> object:
    """Restore one attribute, from the field that shows it or from several fields that show its attributes."""
    if "" in shown_fields:
        field, value = shown_fields[""]
        return _from_wire_value(hint, value, _source_of_field(field).null)
    # Without an entry for the attribute itself, the fields show attributes of it, so it is built from them.
    flat = {
        name: _from_wire_value(resolve_hint(hint, science_field), shown_fields[science_field.name][1])
        for science_field in fields(hint)
        if (name := science_field.name) in shown_fields
    }
    return hint(**flat)


def _from_wire_value(hint: Any, value: object, null: float | tuple[float, float] = math.nan) -> object:
    parts = _union_members(hint)
    if value is None:
        return None if NoneType in parts else null
    hint = next(part for part in parts if part is not NoneType)
    if isinstance(value, common.EffectChoice):
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
    return tuple(_from_wire_value(get_args(hint)[0], element) for element in value)
