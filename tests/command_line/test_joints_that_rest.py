"""An arm that rests between its moves, on files: no windows, its errors, a rung for each effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.csv as pacsv
import pytest
from support.joints_at_rest import COULOMB, write_resting_run
from support.running_commands import ROBOT, dynident

from dynident.identification import from_bytes
from dynident.number_format import format_percent
from dynident.robot.bundled_arms import library_table

FIGURES = {"rms", "relative", "relative_total"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The arm, two recordings, a first model, and one with two effects more."""
    made = tmp_path_factory.mktemp("resting")
    (made / "arm.json").write_text(library_table("scara"), encoding="utf-8")
    for seed in (1, 2):
        write_resting_run(ROBOT, made / f"run{seed}.csv", seed)
    first = dynident(
        "identify", made / "arm.json", made / "run1.csv", "-v", made / "run2.csv", "-o", made / "model.npz"
    )
    assert first.code == 0, first.err
    (made / "identify.txt").write_text(first.out, encoding="utf-8")
    effects = f"offset,stribeck@{ROBOT.joint_names[1]}"
    extended = dynident(
        "extend", made / "model.npz", made / "run1.csv", "-v", made / "run2.csv", "--effects", effects,
        "-o", made / "better.npz",
    )  # fmt: skip
    assert extended.code == 0, extended.err
    (made / "extend.txt").write_text(extended.out, encoding="utf-8")
    return made


@pytest.mark.parametrize(("verb", "model"), [("identify", "model"), ("extend", "better")])
def test_errors_are_shown_where_each_joint_moves_and_on_all_rows(folder: Path, verb: str, model: str) -> None:
    out = (folder / f"{verb}.txt").read_text(encoding="utf-8")
    found = from_bytes((folder / f"{model}.npz").read_bytes())
    for j, joint in enumerate(ROBOT.joint_names):
        line = next(line for line in out.splitlines() if line.startswith(joint) and line.count("%") == 4)
        errors = (found.fit_moving, found.fit, found.held_out_moving, found.held_out)
        assert all(format_percent(float(one.relative[j])) in line for one in errors)
    assert format_percent(found.held_out_moving.relative_total) in out


def test_the_summary_of_a_recording_says_how_much_each_joint_stands(folder: Path) -> None:
    out = (folder / "identify.txt").read_text(encoding="utf-8")
    assert "standstill" in out
    line = next(line for line in out.splitlines() if line.startswith("run1"))
    shares = [float(text) for text in line.split("Hz")[1].replace("%", "").split(",")]
    assert len(shares) == ROBOT.n
    # It rests three tenths of the time, and is slow for a while before and after.
    assert all(30 <= share < 60 for share in shares)
    friction = [
        one.value for one in from_bytes((folder / "model.npz").read_bytes()).parameters if one.effect == "coulomb"
    ]
    np.testing.assert_allclose(friction, COULOMB, rtol=0.02)


def test_compare_tells_errors_with_and_without_the_band_and_writes_it(folder: Path) -> None:
    arguments = ("compare", folder / "model.npz", folder / "run2.csv", "--out", folder / "signals.csv")
    found = dynident(*arguments, "--json").document
    assert found["moving"].keys() == found["raw"].keys() == FIGURES
    assert found["raw"]["relative_total"] > 5 * found["relative_total"]
    assert found["moving"]["relative_total"] < 0.02
    shown = " ".join(dynident(*arguments).out.split())
    raw = " ".join(format_percent(found["raw"]["relative_total"]).split())
    assert f"on all rows is {raw}." in shown
    signals, joint = pacsv.read_csv(folder / "signals.csv"), ROBOT.joint_names[0]
    measured, lower, upper, residual = (
        signals[f"{name}_{joint}"].to_numpy() for name in ("measured", "friction_lower", "friction_upper", "residual")
    )
    phase = np.array(signals[f"phase_{joint}"].to_pylist())
    assert set(phase) == {"moving", "reversing", "standing"}
    assert (phase == "standing").mean() == pytest.approx(found["phases"]["standing"][0])
    rests = phase == "standing"
    np.testing.assert_allclose((measured - np.clip(measured, lower, upper))[rests], residual[rests], atol=1e-9)


def test_every_effect_has_its_rung_and_the_best_one_is_marked(folder: Path) -> None:
    document = dynident("ladder", folder / "better.npz", "--json").document
    assert [[one["effect"] for one in rung["added"]] for rung in document["items"]] == [[], ["offset"], ["stribeck"]]
    totals = [rung["validation"]["relative_total"] for rung in document["items"]]
    best = int(np.argmin(totals))
    assert [rung["best"] for rung in document["items"]] == [k == best for k in range(3)]
    assert [rung["rises"] for rung in document["items"]] == [k > best and totals[k] > totals[best] for k in range(3)]
    shown = dynident("ladder", folder / "better.npz").out
    assert shown.count("✓ best") == 1
    assert f"Model {best + 1} predicts held-out data best" in shown
    assert shown.count("↑ rises") == sum(rung["rises"] for rung in document["items"])
    extended = dynident(
        "extend", folder / "model.npz", folder / "run1.csv", "--effects", "offset,joint_spring", "--json"
    ).document
    assert [[one["effect"] for one in rung["added"]] for rung in extended["rungs"]] == [["offset"]]
    assert extended["rungs"][0]["residual"]["moving"].keys() == FIGURES
    alone = dynident("ladder", folder / "model.npz").out
    assert "best" not in alone
