"""The examples in the docstrings of `import dynident` do what they show."""

from __future__ import annotations

import doctest
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest
from support.page_commands import run_commands

import dynident as dy

NAMES = [name for name in dy.__all__ if isinstance(getattr(dy, name), FunctionType)] + ["Model", "Recordings"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that `read_recordings` describes, by the command that it states."""
    folder = tmp_path_factory.mktemp("examples")
    for number in (1, 2):
        options = f"--effects stribeck@elbow --rate 200 --seed {number} -o run{number}.csv"
        run_commands(folder, f"dynident simulate scara {options}")
    return folder


@pytest.fixture(scope="module")
def names_of_examples(folder: Path) -> dict[str, Any]:
    robot = dy.load_robot("scara")
    return {"dy": dy, "robot": robot, "runs": dy.read_recordings(folder / "run1.csv", folder / "run2.csv", robot=robot)}


@pytest.mark.usefixtures("restored_catalogue")
@pytest.mark.parametrize("name", NAMES)
def test_an_example_does_what_it_shows(
    name: str, folder: Path, names_of_examples: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(dy, name), name, globs=dict(names_of_examples))
    assert example.examples, f"dynident.{name} has no example"
    shown: list[str] = []
    doctest.DocTestRunner().run(example, out=shown.append)
    assert not shown, "".join(shown)
