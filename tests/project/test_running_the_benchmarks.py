"""The page of the benchmarks has the table that `run.py` writes, and every script runs to its end on few data."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynident.advice.campaign_request import DESIGN_STARTS

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TESTS = BENCHMARKS.parent / "tests"
SMALL = {
    "acceptance": "--requests 30 --clients 2",
    "campaigns": "--seeds 1 --goal 0.05 --starts 1",
    "changes": "--pairs 1 --processes 1",
    "clean_residuals": "--cases 1 --processes 1",
    "closed_loops": "",
    "contact_detection": "--quick",
    "controller_code": "",
    "corrupted_samples": "--arms 1",
    "decision_level": "--draws 5",
    "decisive_rules": "--small 1 --switches shadow",
    "design_speed": "--patience 0.5",
    "detection_limits": "--draws 1 --effects joint_spring",
    "diagnosis_ranking": "--samples 3000",
    "equal_terms": "--cases 1 --processes 1",
    "extending": "",
    "feasible_estimator": "",
    "gross_mistakes": "--cases 1 --each 1 --recordings 1",
    "held_at_rest": "--cases 1 --processes 1",
    "hidden_effects": "--cases 1",
    "identification_speed": "",
    "interval_coverage": "2",
    "interval_coverage shapes": "shapes 1",
    "joints_of_a_group": "--cases 1 --processes 1",
    "large_recording": "--samples 60000 --plain-samples 10000",
    "lines_over_angles": "--cases 1 --processes 1",
    "many_clients": "--clients 3 --seconds 3",
    "messy_arms": "--cases 1 --duration 5",
    "next_experiment": "--cases 1",
    "night_of_robots": "--robots 1 --seconds 10",
    "outlying_spans": "--cases 1 --processes 1",
    "placebo": "--shifts 1 --arms 1 --only simulated",
    "recordings_side_by_side": "--recordings 2 --samples 50000",
    "regressor_throughput": "",
    "reidentification": "",
    "rows_or_products": "--candidates 10",
    "smallest_gain": "--cases 1 --processes 1",
    "standing_rows": "--arms ur10 --rates 60",
    "walking_robots": "--robots quadruped --draws 0 --duration 5",
}
"""Arguments with which a script takes seconds."""
WITH_RECORDINGS = {
    "drift_coverage": "--arms kr300",
    "effort_kinds": "--cases 2",
    "foreign_files": "--files 1",
    "imports": "--draws 2",
    "planted_mistakes": "--pairs 1 --only tx40 --arms 1 --draws 5",
    "readme_figures": "--arms 1",
}
"""The same of scripts that need recordings of real robots."""
LONG = {"acceptance", "drift_coverage", "readme_figures", "walking_robots"}
"""Scripts that take most of a minute on the least of data; tests of their own hold what they measure."""
ELSEWHERE = {
    "drift_beside_mujoco_sysid": "needs the wheels of mujoco[sysid], in an environment of its own",
    "chaos": "tests/service/test_chaos.py",
    "greedy_key": "tests/service/test_greedy_key.py",
    "hostile_cases": "needs schemathesis, in an environment of its own",
    "methods_on_an_arm": "writes the table of docs/methods.md",
    "run": "this file",
    "workbench_speed": "needs Chromium; the browser tests do the same",
}


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


@pytest.fixture
def campaigns(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """The names of the script of campaigns; what it imports from its own folder goes again."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield runpy.run_path(str(BENCHMARKS / "campaigns.py"))
    for name in [name for name in sys.modules if name.split(".")[0] in ("common", "engine")]:
        sys.modules.pop(name)


def test_campaigns_search_as_the_library_does(campaigns: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    searches: list[int] = []
    campaigns["main"].__globals__["measure_loads"] = lambda asked, design: searches.append(design.starts)
    monkeypatch.setattr(sys, "argv", ["campaigns.py", "--load", "0.02"])
    campaigns["main"]()
    assert searches == [DESIGN_STARTS]


def test_a_campaign_that_gave_up_is_never_at_its_goal(
    campaigns: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    campaigns["Tally"].add_rivals.__globals__["run_rivals"] = lambda arm, state: {"random, 2 s": [(0.1, 0.01)]}
    tally = campaigns["Tally"](0.02)
    for code in ("reached", "not_reachable", "out_of_time"):
        state = SimpleNamespace(decision=SimpleNamespace(code=code))
        tally.add_rivals(None, state, [(0.2, None, np.array([0.01]), None)])
    campaigns["print_curves"](tally.curves, tally.ends, tally.goal)
    times = capsys.readouterr().out.split("Robot time until the goal")[1]
    assert [line.split()[-3:] for line in times.splitlines() if " of 3" in line] == [["2", "of", "3"], ["0", "of", "3"]]


def mark_long(names: Iterable[str]) -> list[Any]:
    """Return the names of scripts as parameters of a test; those that take long run with --thorough."""
    return [pytest.param(name, marks=pytest.mark.thorough if name in LONG else ()) for name in names]


def run_small(name: str, words: str, folder: Path) -> None:
    """Run a script in a process of its own, as the page says."""
    paths = [*sys.path, str(TESTS), str(TESTS / "recordings")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "TMPDIR": str(folder)}
    command = [sys.executable, str(BENCHMARKS / f"{name.split()[0]}.py"), *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, timeout=600)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert done.stdout.strip()


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("name", mark_long(SMALL))
def test_a_benchmark_runs_to_its_end(name: str, tmp_path: Path) -> None:
    run_small(name, SMALL[name], tmp_path)


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.sweep
@pytest.mark.parametrize("name", mark_long(WITH_RECORDINGS))
def test_a_benchmark_on_recordings_of_real_robots_runs_to_its_end(name: str, tmp_path: Path) -> None:
    if not (BENCHMARKS.parents[1] / "shared" / "data").is_dir():
        pytest.skip("the recordings of real robots are not here (../shared/data is missing)")
    run_small(name, WITH_RECORDINGS[name], tmp_path)


def test_every_benchmark_is_run_by_a_test() -> None:
    scripts = {path.stem for path in BENCHMARKS.glob("*.py") if "def main(" in path.read_text(encoding="utf-8")}
    assert scripts == {name.split()[0] for name in (*SMALL, *WITH_RECORDINGS, *ELSEWHERE)}
