"""Types of the fields of requests, one at a time."""

from __future__ import annotations

import sys
from dataclasses import Field
from typing import get_type_hints


def hint_of(science: type, one: Field[object]) -> object:
    """The type of one field; those of other fields may need what is not loaded."""
    # An inherited field is in the words of the module that states it.
    stated_by = next(base for base in science.__mro__ if one.name in vars(base).get("__annotations__", {}))
    alone = type("Alone", (), {"__annotations__": {one.name: one.type}, "__module__": stated_by.__module__})
    return get_type_hints(alone, vars(sys.modules[stated_by.__module__]))[one.name]
