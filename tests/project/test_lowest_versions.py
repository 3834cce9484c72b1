"""What `.ci/matrix lowest` tries are the lowest versions: the script that says so knows the bounds."""

from __future__ import annotations

import runpy
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / ".ci" / "lowest.py"))


def test_every_requirement_of_the_project_has_a_bound_that_is_tried(script: dict[str, Any]) -> None:
    bounds = script["lower_bounds"]((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert len(bounds) > 40
    assert {"httpx2", "casadi", "numpy", "fastapi", "psycopg", "h5py", "mujoco"} <= set(bounds)


def test_a_version_is_the_lowest_one_where_it_begins_as_its_bound(script: dict[str, Any]) -> None:
    there = version("numpy")
    major, minor, *_ = there.split(".")
    assert script["is_lowest"]("numpy", there)
    assert script["is_lowest"]("numpy", f"{major}.{minor}")
    assert not script["is_lowest"]("numpy", f"{major}.{int(minor) - 1}")


def test_the_matrix_asks_it(script: dict[str, Any]) -> None:
    assert ".ci/lowest.py" in (ROOT / ".ci" / "matrix").read_text(encoding="utf-8")
