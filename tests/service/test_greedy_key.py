"""A key that takes all it can get, beside another one that works."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

GREEDY = Path(__file__).resolve().parents[2] / "benchmarks" / "greedy_key.py"


@pytest.mark.slow
def test_another_key_has_its_jobs_accepted_and_done_while_one_takes_all_it_can_get() -> None:
    # Beside other tests an answer may take seconds; behind all that the other key sent it would take minutes.
    command = [sys.executable, str(GREEDY), "--seconds", "4", "--slack", "30"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "readers answered 429" in run.stdout
    assert "uploads answered 429" in run.stdout
