"""Rooms that declare what can be asked do not load what answers it."""

from __future__ import annotations

import ast
import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

import dynident
from dynident.lazy_loader import LazyModule, find_export_modules

SOURCES = Path(dynident.__file__).parent
ROOMS = sorted(
    path.parent.name
    for path in SOURCES.glob("*/__init__.py")
    if "make_lazy_exports(" in path.read_text(encoding="utf-8")
)


def test_there_are_rooms() -> None:
    assert "effects" in ROOMS


@pytest.mark.parametrize("room", ROOMS)
def test_every_name_of_a_room_comes_from_where_its_imports_say(room: str) -> None:
    package = import_module(f"dynident.{room}")
    source = ast.parse((SOURCES / room / "__init__.py").read_text(encoding="utf-8"))
    at_once = {alias.name for node in source.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert set(package.__all__) - at_once == set(find_export_modules(package.__name__))
    for name in package.__all__:
        assert getattr(package, name) is not None


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_hides_a_name_of_its_room(room: str) -> None:
    modules = {path.stem for path in (SOURCES / room).iterdir()}
    assert modules.isdisjoint(import_module(f"dynident.{room}").__all__)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_alone_loads_no_science(room: str) -> None:
    heavy = ("numpy", "scipy", "casadi", "pinocchio", "pyarrow")
    program = f"import sys, dynident.{room}; print([one for one in {heavy} if one in sys.modules])"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "[]"


@pytest.mark.parametrize("repeat", [copy.copy, copy.deepcopy, lambda module: pickle.loads(pickle.dumps(module))])
def test_a_module_that_is_imported_when_used_can_be_copied(repeat: Callable[[LazyModule], LazyModule]) -> None:
    module = repeat(LazyModule("json"))
    assert module.loads("[1]") == [1]
    assert module.__name__ == "json"
    with pytest.raises(AttributeError, match="_nothing"):
        _ = module._nothing
