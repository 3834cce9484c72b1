"""A little bad luck, one thing after the other, on a service that answers and one that only works."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CHAOS = Path(__file__).resolve().parents[2] / "benchmarks" / "chaos.py"


@pytest.mark.slow
def test_every_job_that_was_accepted_ends_once_and_well_whatever_is_killed() -> None:
    command = [sys.executable, str(CHAOS), "--jobs", "12", "--brief"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    for what in ("api", "worker", "child", "nursery", "database", "stop"):
        assert f"what happened: {what}" in run.stdout
