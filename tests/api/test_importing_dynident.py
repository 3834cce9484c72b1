"""`import dynident` costs nothing, and has everything by name."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import dynident

SOURCE = Path(inspect.getfile(dynident)).read_text(encoding="utf-8")


def run(code: str) -> str:
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_importing_it_loads_neither_numpy_nor_anything_else_that_is_large() -> None:
    heavy = "numpy", "scipy", "casadi", "pinocchio", "pyarrow", "matplotlib", "dynident.api", "dynident.robot"
    told = run(f"import sys, dynident; print([name for name in {heavy} if name in sys.modules])")
    assert told.strip() == "[]"


def test_reading_a_robot_and_a_recording_draws_nothing_and_loads_no_plotting() -> None:
    told = run("import sys, dynident as dy; dy.load_robot, dy.read_recordings; print('matplotlib' in sys.modules)")
    assert told.strip() == "False"


def test_identifying_loads_no_format_of_exports() -> None:
    told = run(
        "import sys, dynident as dy; dy.identify, dy.Model; print('dynident.export.model_export' in sys.modules)"
    )
    assert told.strip() == "False"


@pytest.mark.parametrize("name", dynident.__all__)
def test_every_name_is_there(name: str) -> None:
    assert getattr(dynident, name) is not None
    assert name in dir(dynident)


def test_the_types_that_editors_see_are_the_names_that_there_are() -> None:
    branch = next(one for one in ast.parse(SOURCE).body if isinstance(one, ast.If))
    seen = {alias.name: node.module for node in branch.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert set(seen) | {"__version__"} == set(dynident.__all__)
    assert seen == dynident._HOME_OF


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("indentify", "did you mean 'identify'"), ("load", "did you mean 'load_model' or 'load_robot'")],
)
def test_an_error_about_a_name_that_is_not_there_names_the_nearest(name: str, nearest: str) -> None:
    with pytest.raises(AttributeError, match=f"'dynident' has no attribute '{name}'; {nearest}"):
        getattr(dynident, name)


@pytest.mark.parametrize("package", ["effects", "motion", "excitation", "identification"])
def test_a_package_lists_what_it_exports(package: str) -> None:
    module = import_module(f"dynident.{package}")
    assert dir(module) == sorted(module.__all__)


def test_the_light_installation_says_what_is_missing() -> None:
    told = run(
        "import sys; sys.modules['numpy'] = None\n"
        "import dynident\n"
        "try: dynident.identify\n"
        "except ModuleNotFoundError as error: print(error)"
    )
    assert "dynident.identify needs the package numpy" in told
    assert "pip install 'dynident[science]'" in told


def test_the_library_below_knows_nothing_of_the_desk() -> None:
    told = run(
        "import sys\n"
        "import dynident.reports.html_page, dynident.export, dynident.validation, dynident.excitation\n"
        "print([name for name in sys.modules if name.startswith('dynident.api')])"
    )
    assert told.strip() == "[]"
