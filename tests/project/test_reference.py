"""The reference has an entry for every public name, and the entry says what a caller has to know.

What needs the generator (warnings, dead links, entries in the built pages) `docs/build_site.py` checks as it builds.
"""

from __future__ import annotations

import ast
import inspect
import re
import runpy
from importlib import import_module
from pathlib import Path
from types import FunctionType

import pytest

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference"
ARRAY = r"\b(Float|Int|Bool)Array\b"
PACKAGES: list[str] = runpy.run_path(str(ROOT / "docs" / "build_site.py"))["public_packages"]()


def public(kind: type | tuple[type, ...]) -> list[tuple[str, object]]:
    """Public names of a kind, each by the name that a program writes."""
    found = {}
    for package in PACKAGES:
        module = import_module(package)
        for name in module.__all__:
            if isinstance(value := getattr(module, name), kind):
                found.setdefault(id(value), (f"{package}.{name}", value))
    return list(found.values())


FUNCTIONS = public(FunctionType)
NAMES = public((FunctionType, type))


def called(one: object) -> str:
    """The name of a case; its value needs none."""
    return one if isinstance(one, str) else ""


def test_every_public_package_has_a_page_and_stands_in_the_index() -> None:
    assert len(PACKAGES) >= 16
    pages = {page.stem: page.read_text(encoding="utf-8") for page in REFERENCE.glob("*.rst")}
    assert set(pages) == {*PACKAGES, "index"}
    for package in PACKAGES:
        assert f".. automodule:: {package}\n" in pages[package]
        assert f"   {package}\n" in pages["index"], f"{package} is not in docs/reference/index.rst"


def test_what_the_front_door_takes_from_the_rooms_is_linked() -> None:
    front, rooms = import_module("dynident"), [one for one in PACKAGES if one not in ("dynident", "dynident_client")]
    page = (REFERENCE / "dynident.rst").read_text(encoding="utf-8")
    for name in front.__all__:
        homes = [room for room in rooms if getattr(import_module(room), name, None) is getattr(front, name)]
        if homes:
            assert f"~{homes[0]}.{name}`" in page, f"{name} has its entry in {homes[0]}: link it"


@pytest.mark.parametrize(("name", "value"), NAMES, ids=called)
def test_a_public_name_says_what_it_is(name: str, value: object) -> None:
    assert (inspect.getdoc(value) or "").strip(), name


@pytest.mark.parametrize(("name", "function"), FUNCTIONS, ids=called)
def test_a_public_function_gives_the_shapes_of_its_arrays(name: str, function: FunctionType) -> None:
    said = inspect.getdoc(function) or ""
    arrays = [
        one for one, kind in function.__annotations__.items() if re.search(r"\b(Float|Int|Bool)Array\b", str(kind))
    ]
    shaped = re.search(r"\((?:\d+|(?:\d+ )?[a-zN](?: \+ \d+)?),[^()]*\)|any shape", said)
    assert not arrays or shaped, f"{name}: {', '.join(arrays)} without a shape such as (m, n)"


@pytest.mark.parametrize(("name", "function"), FUNCTIONS, ids=called)
def test_a_public_function_that_refuses_something_says_what(name: str, function: FunctionType) -> None:
    raised = re.findall(r"^\s+raise (\w+Error)\(", inspect.getsource(function), re.MULTILINE)
    said = inspect.getdoc(function) or ""
    assert not raised or "Raises" in said or any(one in said for one in raised), f"{name} raises {', '.join(raised)}"


def documented_parameters(value: object) -> set[str]:
    """Names in the Parameters section that have a description, as numpydoc wants them."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n---|\Z)", inspect.getdoc(value) or "", re.M | re.S)
    entries = re.findall(r"^(\S[^\n:]*)(?::[^\n]*)?\n(?=[ ]{4}\S)", section[1] if section else "", re.MULTILINE)
    return {name.strip().lstrip("*") for entry in entries for name in entry.split(",")}


@pytest.mark.parametrize(("name", "value"), NAMES, ids=called)
def test_every_parameter_of_a_public_name_is_described(name: str, value: object) -> None:
    if isinstance(value, type) and issubclass(value, tuple):
        parameters = set(getattr(value, "_fields", ()))
    elif isinstance(value, FunctionType) or ("__init__" in vars(value) and not issubclass(value, dict)):
        signature = inspect.signature(value if isinstance(value, FunctionType) else vars(value)["__init__"])
        parameters = {one for one in signature.parameters if one not in ("self", "cls") and not one.startswith("_")}
    else:
        return
    assert parameters - documented_parameters(value) == set(), name


def test_a_function_that_another_package_uses_describes_its_parameters() -> None:
    """Of the library; in `__all__` or not. One argument its first line may describe."""
    modules = {
        ".".join(path.relative_to(ROOT / "src").with_suffix("").parts): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted((ROOT / "src" / "dynident").rglob("*.py"))
    }
    used = {
        (node.module, name.name)
        for module, tree in modules.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[:2] != module.split(".")[:2]
        for name in node.names
    }
    assert len(used) > 500
    bare = [
        f"{module}.{node.name}"
        for module, tree in modules.items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        if (module, node.name) in used and len((*node.args.args, *node.args.kwonlyargs)) > 1
        if "Parameters\n---" not in (ast.get_docstring(node) or "")
    ]
    assert bare == []
