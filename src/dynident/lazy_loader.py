"""Lazy exports of packages: a name's module is imported at the first use of the name.

Modules that only declare requests can thus be imported without the code that answers them.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from importlib.abc import InspectLoader
from typing import Any


def make_lazy_exports(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for a package, which import each exported name at its first use and list them.

    The imports stand below `if TYPE_CHECKING` in the package's `__init__`, once for type checkers and for these
    functions. No module of the package may have the name of an export: importing the module would hide the export.

    Parameters
    ----------
    package : str
        The package's dotted name.

    Returns
    -------
    tuple of two functions
    """

    def get(name: str) -> object:
        home = find_export_modules(package).get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(import_module(home), name)
        # With the name in the package's namespace Python does not call `get` again for it.
        setattr(sys.modules[package], name, value)
        return value

    def list_names() -> list[str]:
        names: list[str] = sys.modules[package].__all__
        return sorted(names)

    return get, list_names


class LazyModule:
    """A module that is imported when something of it is first used: a slow one that few recordings need.

    Parameters
    ----------
    name : str
        The module's dotted name.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        # Copies, and pickles that are read, are asked for special names before they have any of their own.
        if name.startswith("_") and "_name" not in vars(self):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return getattr(import_module(self._name), name)


@cache
def find_export_modules(package: str) -> Mapping[str, str]:
    """Return the module of every name that a package imports for type checkers alone.

    Parameters
    ----------
    package : str
        The dotted name of a package that is imported.

    Returns
    -------
    mapping of name to dotted module
    """
    spec = sys.modules[package].__spec__
    assert spec is not None
    assert isinstance(spec.loader, InspectLoader)
    # By the loader, not from a file: the package may lie in a ZIP archive.
    source = spec.loader.get_source(package) or ""
    # The imports for type checkers are the only list of exports, so that it cannot differ from what type checkers see.
    branches = [node.body for node in ast.parse(source).body if isinstance(node, ast.If)]
    imports = [node for body in branches for node in body if isinstance(node, ast.ImportFrom)]
    return {name.name: node.module for node in imports if node.module for name in node.names}
