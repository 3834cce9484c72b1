"""Requests with one number that nobody means: every numeric field of a request, and of its parts, in turn."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial
from math import inf, nan
from typing import Any, get_args, get_origin

from dynident.schema.fields import resolve_hint

ABSURD: tuple[float, ...] = (1e300, 1e-300, inf, nan, -1, 0, 2**70)

Change = tuple[str, float, Callable[[], Any]]
"""Path of the field, the number, and what makes the value with it: that may be refused already."""


def absurd_requests(request: Any) -> Iterator[Change]:
    """The request with each of its numbers absurd in turn; what it has in mappings and lists is among them.

    Whole numbers are not given fractions: the types of the contract refuse that before anything is computed.
    """
    for one in fields(request):
        try:
            hint = resolve_hint(type(request), one)
        except NameError:  # A part that the module names for type checkers alone: it has cases of its own.
            continue
        for path, number, make in _absurd_values(getattr(request, one.name), hint):
            yield f"{one.name}{path}", number, partial(_with_field, request, one.name, make)


def _absurd_values(value: Any, hint: Any) -> Iterator[Change]:
    origin, parts = get_origin(hint), get_args(hint)
    if is_dataclass(value) and not isinstance(value, type):
        yield from ((f".{path}", number, make) for path, number, make in absurd_requests(value))
    elif hint in (int, float):
        numbers = [number for number in ABSURD if hint is float or isinstance(number, int)]
        yield from (("", number, partial(_same, number)) for number in numbers)
    elif origin is tuple and value:
        for k, item in enumerate(value):
            for path, number, make in _absurd_values(item, parts[0] if parts[-1] is Ellipsis else parts[k]):
                yield f"[{k}]{path}", number, partial(_with_item, value, k, make)
    elif isinstance(origin, type) and issubclass(origin, Mapping):
        for key, item in (value or {}).items():
            for path, number, make in _absurd_values(item, parts[1]):
                yield f"[{key}]{path}", number, partial(_with_key, value, key, make)
    elif origin is not None and origin is not tuple:
        for part in parts:
            yield from _absurd_values(value, part)


def _same(number: float) -> float:
    return number


def _with_field(request: Any, name: str, make: Callable[[], Any]) -> Any:
    return replace(request, **{name: make()})


def _with_item(items: tuple[Any, ...], k: int, make: Callable[[], Any]) -> tuple[Any, ...]:
    return (*items[:k], make(), *items[k + 1 :])


def _with_key(items: Mapping[str, Any], key: str, make: Callable[[], Any]) -> dict[str, Any]:
    return {**items, key: make()}
