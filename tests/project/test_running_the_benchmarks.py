"""The table of the benchmarks' page is what `benchmarks/run.py` writes, and `--quick` tells a ratio that has fallen."""

from __future__ import annotations

import json
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """The names of the script; what it imports from its own folder goes again."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield runpy.run_path(str(BENCHMARKS / "run.py"))
    sys.modules.pop("compared", None)


def test_the_table_of_the_page_is_that_of_the_ratios_kept(run: dict[str, Any]) -> None:
    kept = json.loads((BENCHMARKS / "ratios.json").read_text(encoding="utf-8"))
    page = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
    assert kept
    assert f"{run['BEGIN']}\n{run['table'](kept)}\n{run['END']}" in page, "run python benchmarks/run.py"


def test_a_ratio_below_half_of_the_one_kept_fails_and_noise_does_not(run: dict[str, Any], tmp_path: Path) -> None:
    from compared import Comparison

    state = run["check"].__globals__
    state["KEPT"] = tmp_path / "ratios.json"
    state["KEPT"].write_text(json.dumps([{"what": "a", "rival": "b", "times better": 10.0}]), encoding="utf-8")
    runs = [Comparison("a", "b", 1.0, 3.0), Comparison("a", "b", 1.0, 6.0), Comparison("new", "b", 1.0, 1.0)]
    state["measured"] = lambda scripts, times: {("a", "b"): runs[:2], ("new", "b"): runs[2:]}
    run["check"](["extending"])
    state["measured"] = lambda scripts, times: {("a", "b"): runs[:1]}
    with pytest.raises(SystemExit, match="a, beside b: 3 times better, it was 10"):
        run["check"](["extending"])


def test_a_repetition_tells_how_far_each_ratio_is_from_the_table_and_fails_beyond_a_fifth(
    run: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from compared import Comparison

    state = run["repeat"].__globals__
    state["KEPT"] = tmp_path / "ratios.json"
    state["KEPT"].write_text(json.dumps([{"what": "a", "rival": "b", "times better": 10.0}]), encoding="utf-8")
    state["measured"] = lambda scripts, runs: {("a", "b"): [Comparison("a", "b", 1.0, by) for by in (2.0, 9.0, 11.0)]}
    run["repeat"](["extending"], 3)
    assert "a; beside b: 9 times better, in the table 10: -10%" in capsys.readouterr().out
    state["measured"] = lambda scripts, runs: {("a", "b"): [Comparison("a", "b", 1.0, 13.0)]}
    with pytest.raises(SystemExit, match="1 of the ratios are more than 20% from"):
        run["repeat"](["extending"], 1)


def test_fewer_seconds_and_more_samples_are_better(run: dict[str, Any]) -> None:
    from compared import Comparison

    assert Comparison("a", "b", 0.5, 2.0).times_better == 4.0
    assert Comparison("a", "b", 2e6, 5e5, "samples a second").times_better == 4.0
    assert [run["said"](*one) for one in ((0.0474, "seconds"), (59.2, "seconds"), (191.7, "MB"))] == [
        "47.4 ms",
        "59.2 s",
        "192 MB",
    ]
