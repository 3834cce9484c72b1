"""Types of the fields of requests, one at a time."""

from __future__ import annotations

import sys
from dataclasses import Field
from typing import Any, get_type_hints


def hint_of(science: type, one: Field[Any]) -> Any:
    """The type of one field; those of other fields may need what is not loaded."""
    alone = type("Alone", (), {"__annotations__": {one.name: one.type}, "__module__": science.__module__})
    return get_type_hints(alone, vars(sys.modules[science.__module__]))[one.name]
