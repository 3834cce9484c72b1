"""The house is as drawn: modules of a size one can read, imports downward only."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from support.sources import tree_of

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted(path for folder in ("src", "service") for path in (ROOT / folder).rglob("*.py"))
LONGEST = 500
MOST_PARAMETERS = 8

# Classes of these rooms are read side by side. Names that stand in two of their modules; none may join them.
NEIGHBOURS = ("estimation", "identification", "diagnosis", "advice", "validation")
NAMES_OF_TWO = {"Bootstrap", "Question"}


def test_there_are_modules_to_look_at() -> None:
    assert len(MODULES) > 50


def test_every_file_that_the_architecture_names_is_there() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w/]+/[\w/]*(?:\.\w+)?)`", page)) | set(re.findall(r"`(\w+\.py)`", page))
    assert len(named) > 100
    service = ROOT / "service/dynident_service"
    homes = (ROOT, ROOT / "src/dynident", ROOT / "src/dynident_cli", service, service / "workbench/static/js")
    assert {name for name in named if not any((home / name).exists() for home in homes)} == set()


def test_no_module_is_longer_than_one_can_read() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert {name: length for name, length in lengths.items() if length > LONGEST} == {}


def test_the_page_of_the_architecture_lists_every_module() -> None:
    modules = runpy.run_path(str(ROOT / "docs" / "list_modules.py"))["list_modules"]()
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert f"\n{modules}\n" in page, "run `python docs/list_modules.py`"


def test_imports_run_downward_only() -> None:
    command = Path(sys.executable).with_name("lint-imports")
    if not command.exists():
        pytest.skip("import-linter is not installed: pip install 'dynident[dev]'")
    # Its cache still knows modules that were moved since.
    run = subprocess.run([command, "--no-cache"], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stdout + run.stderr


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports within functions and those for types alone count as well; a package's own file names what is in it."""
    grimp = pytest.importorskip("grimp", reason="import-linter is not installed: pip install 'dynident[dev]'")
    graph = grimp.build_graph("dynident", "dynident_client", "dynident_service", "dynident_cli", cache_dir=None)
    modules = {module for module in graph.modules if not graph.find_children(module)}
    assert len(modules) > 400
    # A circle is an error, which names its modules.
    TopologicalSorter(
        {module: graph.find_modules_directly_imported_by(module) & modules for module in modules}
    ).prepare()


def test_whoever_uses_casadi_loads_the_lock_around_it() -> None:
    grimp = pytest.importorskip("grimp", reason="import-linter is not installed: pip install 'dynident[dev]'")
    packages = ("dynident", "dynident_service", "dynident_cli")
    options = {"include_external_packages": True, "exclude_type_checking_imports": True, "cache_dir": None}
    graph = grimp.build_graph(*packages, **options)
    users = graph.find_modules_that_directly_import("casadi")
    lock = "dynident.expressions"
    inside = {lock, *graph.find_descendants(lock)}
    assert len(users) > 20
    assert {user for user in users - inside if not any(graph.chain_exists(user, place) for place in inside)} == set()


def test_no_function_takes_more_parameters_than_one_can_keep_in_mind() -> None:
    """Signatures that are made of a request, of commands and of the client's `**options`, stand in no module."""
    found = {}
    for path in MODULES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                taken = node.args
                names = [one.arg for one in (*taken.posonlyargs, *taken.args, *taken.kwonlyargs)]
                count = len([name for name in names if name not in ("self", "cls")])
                if count > MOST_PARAMETERS:
                    found[f"{path.relative_to(ROOT)}:{node.name}"] = count
    assert found == {}


def test_a_class_name_means_one_thing_in_rooms_that_are_read_side_by_side() -> None:
    names = Counter(name for room in NEIGHBOURS for name in public_classes(ROOT / "src/dynident" / room))
    assert {name for name, count in names.items() if count > 1} == NAMES_OF_TWO


def test_no_class_of_the_service_is_called_as_one_of_the_validations() -> None:
    """What is shown on the wire is called as what it shows, which for validations are documents of their own."""
    service = set(public_classes(ROOT / "service"))
    assert service & set(public_classes(ROOT / "src/dynident/validation")) == set()


def public_classes(room: Path) -> list[str]:
    bodies = (node for path in room.rglob("*.py") for node in tree_of(path).body)
    return [node.name for node in bodies if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
