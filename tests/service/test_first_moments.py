"""Requests that come while a service still loads the science beside them."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import dynident_service
from dynident_service import science

PACKAGE = Path(dynident_service.__file__).parent
LOADS = science.load_science.__name__

IN_THE_MIDDLE = """
import sys, tempfile, threading
from pathlib import Path

from fastapi.testclient import TestClient

from dynident_service.app import create_app
from dynident_service.settings import Settings

loading, asking = threading.Event(), threading.Event()


class Meets:
    "Holds who loads `scipy.spatial`, which has parts that need the whole, until another one has begun with a part."

    def find_spec(self, name, path=None, target=None):
        if name == "scipy.spatial._kdtree" and not loading.is_set():
            loading.set()
            asking.wait(3.0)
        if name == "scipy.spatial.transform._rotation" and loading.is_set():
            asking.set()


assert "scipy.spatial" not in sys.modules
sys.meta_path.insert(0, Meets())
with tempfile.TemporaryDirectory() as folder:
    app = create_app(Settings(data_dir=Path(folder), workers=1))
    with TestClient(app, "http://127.0.0.1", raise_server_exceptions=False) as client:
        assert loading.wait(60.0)
        body = {"robot_id": "none", "measurement_ids": ["none"]}
        print(client.post("/v1/identifications", json=body).json()["detail"])
"""


@pytest.mark.slow
def test_a_request_that_needs_the_science_while_it_is_loaded_is_answered() -> None:
    assert _said(IN_THE_MIDDLE).strip() == "there is no robot 'none'"


@pytest.mark.slow
def test_whatever_a_request_needs_is_loaded_at_once() -> None:
    modules = sorted({module for _, module, _ in _imports_of_requests()})
    assert modules
    missing = f"print(*({{name for name in {modules!r}}} - sys.modules.keys()))"
    assert not _said(f"import sys\nfrom dynident_service.science import {LOADS}\n{LOADS}()\n{missing}").split()


def test_no_request_imports_science_before_it_is_loaded() -> None:
    found = list(_imports_of_requests())
    assert found
    assert not [f"{where} imports {module}" for where, module, is_behind in found if not is_behind]


def _imports_of_requests() -> Iterator[tuple[str, str, bool]]:
    """Where what is imported while a request is answered, and whether that is behind `load_science`."""
    for path in sorted((PACKAGE / "routes").rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text())):
            if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                loads = [one.lineno for one in ast.walk(function) if isinstance(one, ast.Name) and one.id == LOADS]
                for one in ast.walk(function):
                    if isinstance(one, ast.ImportFrom):
                        where = f"{path.name}:{one.lineno}"
                        yield where, str(one.module), bool(loads) and min(loads) < one.lineno


def _said(program: str) -> str:
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout
