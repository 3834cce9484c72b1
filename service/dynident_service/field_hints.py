"""Type hints of single fields of request dataclasses."""

from __future__ import annotations

import sys
from dataclasses import Field
from typing import get_type_hints


def resolve_hint(science: type, field: Field[object]) -> object:
    """Return the type of one field. Hints of other fields may need modules that are not loaded, and are left alone."""
    # The names in the hint of an inherited field are those of the module that defines the base class.
    stated_by = next(base for base in science.__mro__ if field.name in vars(base).get("__annotations__", {}))
    alone = type("Alone", (), {"__annotations__": {field.name: field.type}, "__module__": stated_by.__module__})
    return get_type_hints(alone, vars(sys.modules[stated_by.__module__]))[field.name]
