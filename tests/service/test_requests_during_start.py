"""Requests that come while a service still loads the science beside them.

What happens where they do not wait for each other (SciPy's modules, in a deadlock) takes a chance of milliseconds.
"""

from __future__ import annotations

import ast
import gc
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import dynident.diagnosis
import dynident.excitation
import dynident_service
from dynident_service import science_preload

PACKAGE = Path(dynident_service.__file__).parent
ALONE = science_preload.hold_import_lock.__name__


@pytest.mark.parametrize("time_after_time", range(12))
def test_requests_import_one_at_a_time_and_before_what_is_loaded_ahead(time_after_time: int) -> None:
    turns, order = science_preload.ImportLock(), list[str]()

    def has_its_turn(name: str) -> None:
        with turns.hold(patiently=name == "ahead"):
            order.append(name)

    threads = [threading.Thread(target=has_its_turn, args=(name,)) for name in ("ahead", "ahead", "ahead", "request")]
    with turns.hold():
        for thread in threads:
            thread.start()
            time.sleep(0.01)
        assert not order
    for thread in threads:
        thread.join()
    assert order == ["request", "ahead", "ahead", "ahead"]


def test_whatever_a_request_imports_it_imports_alone() -> None:
    found = list(_imports_of_requests())
    assert found
    assert not [where for where, is_alone in found if not is_alone]


def test_collections_of_garbage_leave_what_is_loaded_alone() -> None:
    science_preload.load_science()
    assert gc.get_freeze_count() > 0
    loaded = {id(one) for one in gc.get_objects()}
    assert not {id(vars(module)) for module in (dynident.diagnosis, dynident.excitation)} & loaded


def _imports_of_requests() -> Iterator[tuple[str, bool]]:
    """What is imported while a request is answered, and whether nobody else imports meanwhile."""
    for path in sorted({*PACKAGE.rglob("*routes.py"), *(PACKAGE / "shared").glob("*.py")}):
        for function in ast.walk(ast.parse(path.read_text())):
            if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                alone = {
                    id(one)
                    for block in ast.walk(function)
                    if isinstance(block, ast.With) and ALONE in ast.unparse(block.items[0])
                    for one in ast.walk(block)
                }
                for one in ast.walk(function):
                    if isinstance(one, ast.Import | ast.ImportFrom):
                        yield f"{path.name}:{one.lineno} {ast.unparse(one)}", id(one) in alone
