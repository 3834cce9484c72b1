"""CasADi's expressions in several threads: without the lock around them the process ends within half a second."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import casadi as ca
import pytest

import dynident.expressions

PROGRAM = Path(__file__).resolve().parents[1] / "support" / "three_threads.py"


def run_in_threads(task: str) -> str:
    # Nothing is cached: threads compile at once, too.
    environment = os.environ | {"DYNIDENT_CACHE_DIR": ""}
    command = [sys.executable, PROGRAM, task]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_threads_may_make_and_drop_the_same_constants() -> None:
    run_in_threads("expressions")


@pytest.mark.slow
def test_threads_may_identify_and_report_at_once() -> None:
    first, second = run_in_threads("models").split()
    assert first == second


def test_functions_are_evaluated_at_numbers_side_by_side_and_at_expressions_one_by_one() -> None:
    x = ca.SX.sym("x")
    function = ca.Function("twice", [x], [2 * x])
    values: list[object] = []
    numbers = threading.Thread(target=lambda: values.append(float(function(3.0))))
    expressions = threading.Thread(target=lambda: values.append(function(x)))
    with dynident.expressions.compiled_expressions._CASADI:
        numbers.start()
        numbers.join(10)
        expressions.start()
        expressions.join(0.1)
        assert values == [6.0]
    expressions.join(10)
    assert len(values) == 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_can_use_expressions_while_a_thread_of_its_parent_does() -> None:
    is_over = threading.Event()

    def work() -> None:
        while not is_over.is_set():
            ca.sin(ca.SX.sym("x")) + 1

    thread = threading.Thread(target=work)
    thread.start()
    try:
        child = os.fork()
        if child == 0:
            ca.sin(ca.SX.sym("x")) + 1
            os._exit(7)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    finally:
        is_over.set()
        thread.join()
