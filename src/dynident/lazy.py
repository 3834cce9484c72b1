"""Names of a package that are loaded when they are used: what declares a request must not load what answers it."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from importlib.abc import InspectLoader


def lazily(package: str) -> Callable[[str], object]:
    """The `__getattr__` of a package: each name comes from where the imports in its `__init__` say, if ever.

    They stand below `if TYPE_CHECKING`, once for type checkers and for this. No module of the package may be called
    as a name of it: to import the one would hide the other.
    """

    def get(name: str) -> object:
        home = homes_of(package).get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(import_module(home), name)
        setattr(sys.modules[package], name, value)
        return value

    return get


@cache
def homes_of(package: str) -> Mapping[str, str]:
    """The module that each name comes from which a package imports for type checkers."""
    spec = sys.modules[package].__spec__
    assert spec is not None
    assert isinstance(spec.loader, InspectLoader)
    source = spec.loader.get_source(package) or ""
    branches = [one.body for one in ast.parse(source).body if isinstance(one, ast.If)]
    imports = [one for body in branches for one in body if isinstance(one, ast.ImportFrom)]
    return {name.name: one.module for one in imports if one.module for name in one.names}
