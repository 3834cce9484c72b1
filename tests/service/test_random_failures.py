"""A little bad luck, one thing after the other, on those who answer and those who do the jobs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CHAOS = Path(__file__).resolve().parents[2] / "benchmarks" / "chaos.py"
HAPPENS = ("api", "worker", "child", "nursery", "database", "stop")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "happens"),
    [
        pytest.param([], HAPPENS, id="two_services", marks=pytest.mark.thorough),
        pytest.param(["--cluster"], (*HAPPENS, "scheduler", "stop of the scheduler"), id="a_cluster"),
    ],
)
def test_every_job_that_was_accepted_ends_once_and_well_whatever_is_killed(
    asked: list[str], happens: tuple[str, ...]
) -> None:
    command = [sys.executable, str(CHAOS), "--jobs", "12", "--brief", *asked]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    for what in happens:
        assert f"what happened: {what} " in run.stdout
