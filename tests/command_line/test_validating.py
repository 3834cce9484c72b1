"""`dynident validate`: every kind on files, its verdict, its exit code, what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from support.running_commands import ROBOT, dynident

from dynident.identification.methods.base_classes import MODELS


def test_unseen_data_and_own_data(desk: Path):
    for kind, run in (("cross", "run2.csv"), ("direct", "run1.csv")):
        answer = dynident("validate", desk / "model.npz", kind, desk / run, "--json")
        assert answer.code == 0, answer.err
        assert answer.document["verdict"] == "pass"
        assert answer.document["measurements"][0]["name"] == run.removesuffix(".csv")
        assert 0 < answer.document["total"]["relative_total"] < 0.15


def test_what_fails_ends_with_exit_code_1_and_its_reason(desk: Path):
    answer = dynident("validate", desk / "model.npz", "cross", desk / "run2.csv", "--limit", "0.001")
    assert answer.code == 1
    assert "fail" in answer.out
    assert "limit of 0.10\u202f%" in answer.out


def test_the_worst_posture(desk: Path):
    answer = dynident("validate", desk / "model.npz", "inertia_matrix", "--json")
    assert set(answer.document["worst_posture"]) == set(ROBOT.joint_names)
    assert answer.code == (0 if answer.document["verdict"] == "pass" else 1)


def test_a_shape_constant_is_told_with_its_interval_or_in_words(desk: Path):
    extend = ["extend", desk / "model.npz", desk / "run1.csv", "--effects", f"stribeck@{ROBOT.joint_names[0]}"]
    velocity, kind = dynident(*extend, "--json").document["shape_constants"]
    low, high = velocity["interval"]
    assert (velocity["name"], velocity["unit"], velocity["joints"]) == ("vs", "rad/s", [ROBOT.joint_names[0]])
    assert low < 0.2 < high
    assert velocity["judgement"] in ("determined", "uncertain")
    assert (kind["name"], kind["interval"], kind["judgement"]) == ("delta", None, "chosen")
    shown = dynident(*extend)
    assert "Shape constants" in shown.out
    assert "chosen" in shown.out


def test_deviations_beside_those_of_draws(desk: Path):
    answer = dynident("validate", desk / "model.npz", "bootstrap", "--draws", "200", "--seed", "1", "--json")
    drawn = answer.document["bootstrap"]
    assert drawn["draws"] == 200
    assert answer.code == (0 if answer.document["verdict"] == "pass" else 1)
    shown = dynident("validate", desk / "model.npz", "bootstrap", "--draws", "200", "--seed", "1")
    assert "Standard deviations: reported, and over draws" in shown.out
    assert all(one["name"] in shown.out for one in drawn["parameters"])


def test_methods_in_a_table(desk: Path):
    asked = ["validate", desk / "model.npz", "methods", desk / "run1.csv", "-v", desk / "run2.csv"]
    answer = dynident(*asked, "--methods", "wls,ols,sequential/wrist_then_shoulder", "--json")
    rows = answer.document["methods"]
    assert [row["method"] for row in rows] == [
        "dynamic, global, wls",
        "dynamic, global, ols",
        "dynamic, wrist then shoulder, wls",
    ]
    shown = dynident(*asked, "--methods", "wls,ols", "--out", desk / "methods.json")
    assert "dynamic, global, ols" in shown.out
    assert [row["estimator"] for row in json.loads((desk / "methods.json").read_text())["methods"]] == ["wls", "ols"]


def test_a_report_holds_how_validations_ended(desk: Path):
    for kind, run in (("cross", [desk / "run2.csv"]), ("inertia_matrix", [])):
        dynident("validate", desk / "model.npz", kind, *run, "--out", desk / f"{kind}.json")
    stored = ["--validated", desk / "cross.json", "--validated", desk / "inertia_matrix.json"]
    answer = dynident("report", desk / "model.npz", desk / "run1.csv", *stored, "-o", desk / "validated.html")
    assert answer.code == 0, answer.err
    page = (desk / "validated.html").read_text(encoding="utf-8")
    assert json.loads((desk / "cross.json").read_text())["reason"] in page
    assert "Worst of " in page
    refused = dynident("report", desk / "model.npz", desk / "run1.csv", "--validated", desk / "arm.json")
    assert refused.code == 2
    assert "arm.json" in refused.err


def test_essential_parameters(desk: Path):
    answer = dynident("essential", desk / "model.npz", "--out", desk / "essential.npz", "--json")
    assert answer.code == 0, answer.err
    assert len(answer.document["parameters"]) == len(answer.document["essential"])
    assert "Backward elimination" in dynident("essential", desk / "model.npz").out
    smaller = dynident("validate", desk / "essential.npz", "cross", desk / "run2.csv", "--json")
    assert smaller.document["total"]["relative_total"] == answer.document["validation"]["relative_total"]


def test_drift_of_positions_and_velocities(desk: Path):
    answer = dynident("validate", desk / "model.npz", "drift", desk / "run2.csv", "--horizons", "0.2,0.1")
    assert "Drift of the position under the measured torque" in " ".join(answer.out.split())
    assert "Drift of the velocity" in answer.out
    # No other times than those that were asked for.
    assert "after 0.2 s" in answer.out
    assert "2 s" not in answer.out.replace("0.2 s", "")


def test_contact_detection_has_thresholds_by_joint(desk: Path):
    answer = dynident("validate", desk / "model.npz", "collision", desk / "run2.csv", "--false-alarms-per-hour", "600")
    assert answer.code in (0, 1), answer.err
    assert "N at the tool in 67 ms while the arm moves" in " ".join(answer.out.split())
    assert "Contact thresholds on the residual of the momentum observer" in " ".join(answer.out.split())
    refused = dynident("validate", desk / "model.npz", "drift", desk / "run2.csv", "--false-alarms-per-hour", "600")
    assert refused.code == 2
    assert "--false-alarms-per-hour" in refused.err


@pytest.mark.slow
def test_the_simulator_and_the_filters(desk: Path):
    answer = dynident("validate", desk / "model.npz", "simulation", desk / "run2.csv", "--longest", "4", "--json")
    assert answer.document["simulations"][0]["duration"] <= 4.0
    answer = dynident(
        "validate", desk / "model.npz", "filters", desk / "run1.csv", "--longest", "5", "--cutoffs", "3,9"
    )
    assert "smallest error" in answer.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["sorcery", "{run}"], ["sorcery", "inertia_matrix"]),
        (["cross"], ["cross needs a recording"]),
        (["inertia_matrix", "{run}"], ["takes no recording"]),
        (["bootstrap", "{run}"], ["takes no recording"]),
        (["bootstrap", "--draws", "3"], ["--draws", "99 to 9999"]),
        (["direct", "{run}", "--draws", "300"], ["--draws"]),
        (["cross", "{run}", "--cutoffs", "3"], ["--cutoffs"]),
        (["cross", "{run}", "-v", "{run}"], ["--validation"]),
        (["cross", "{run}", "--limit", "-1"], ["limit", "1e-06 to 10"]),
        (["methods", "{run}", "--methods", "best"], ["--methods", "best", "irls"]),
        (["methods", "{run}", "--methods", "ols/wls"], ["--methods", "one of each"]),
        (["filters", "{run}", "--cutoffs", "70", "--longest", "2"], ["--cutoffs", "below 50"]),
        (["drift", "{run}", "--horizons", "20"], ["--horizons", "0.01 to 10"]),
        (["filters", "{run}", "{run}"], ["exactly one recording"]),
        (["payload", "{run}", "--mass", "2"], ["--unloaded"]),
        (["payload", "{run}", "--unloaded", "{run}", "--mass", "-2"], ["--mass", "1e-06 to 1e+06"]),
        (["payload", "{run}", "--unloaded", "{other}"], ["run2", "payload"]),
    ],
)
def test_what_does_not_fit_is_said_in_words(desk: Path, arguments: list[str], said: list[str]):
    answer = dynident(
        "validate",
        desk / "model.npz",
        *[text.format(run=desk / "run2.csv", other=desk / "run1.csv") for text in arguments],
    )
    assert answer.code == 2
    for words in said:
        assert words in answer.err


@pytest.mark.sweep
@pytest.mark.parametrize("model", [name for name in MODELS.names if name != "base_wrench"])
def test_every_model_can_be_chosen_for_an_identification(desk: Path, model: str):
    answer = dynident(
        "identify", desk / "arm.json", desk / "run1.csv", "-v", desk / "run2.csv", "--model", model, "--json"
    )
    assert answer.code == 0, answer.err
    assert answer.document["validation"]["relative_total"] < 0.3


def test_a_strategy_can_be_chosen_for_an_identification(desk: Path):
    options = ["--strategy", "sequential", "--steps", "wrist_then_shoulder"]
    answer = dynident("identify", desk / "arm.json", desk / "run1.csv", *options, "--json")
    assert answer.code == 0, answer.err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--model", "static"], ["--model", "static", "filtered"]),
        (["--strategy", "random"], ["--strategy", "sequential"]),
        (["--steps", "backwards"], ["--steps", "link_by_link"]),
        (["--prior", "hope"], ["--prior", "description"]),
        (["--pole", "-3"], ["pole", "0.001 to 1e+06"]),
    ],
)
def test_choices_that_there_are_not_are_said_in_words(desk: Path, options: list[str], said: list[str]):
    answer = dynident("identify", desk / "arm.json", desk / "run1.csv", *options)
    assert answer.code == 2
    for words in said:
        assert words in answer.err


def test_joints_with_long_names_leave_room_for_the_names_of_methods(desk: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("dynident_cli.command_output._WIDE", 100)
    asked = ["validate", desk / "model.npz", "methods", desk / "run1.csv", "-v", desk / "run2.csv"]
    shown = dynident(*asked, "--methods", "wls,ols").out
    assert "dynamic" in shown
    assert f"Joints: 1 {ROBOT.joint_names[0]}, 2 {ROBOT.joint_names[1]}" in shown


def test_a_table_of_methods_that_is_too_wide_loses_columns_and_no_method_is_broken(
    desk: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("dynident_cli.command_output._WIDE", 74)
    asked = ["validate", desk / "model.npz", "methods", desk / "run1.csv", "-v", desk / "run2.csv"]
    shown = dynident(*asked, "--methods", "wls,ols,sequential/wrist_then_shoulder").out
    for method in ("dynamic, global, wls", "dynamic, global, ols", "dynamic, wrist then shoulder, wls"):
        assert re.search(rf"^{method} .*%", shown, re.MULTILINE), shown
    assert "farthest, time, the errors of each joint. --json and reports have them" in " ".join(shown.split())


def test_the_table_of_a_validation_has_the_errors_of_its_sentence(desk: Path):
    """Both are of the rows where each joint moves."""
    asked = ["validate", desk / "model.npz", "cross", desk / "run2.csv", desk / "run1.csv"]
    document = dynident(*asked, "--json").document
    errors = document["total"]
    moving = [*errors["moving"]["relative"], errors["moving"]["relative_total"]]
    shown = dynident(*asked).out
    assert "Relative torque error while each joint moves" in shown
    (row,) = (line for line in shown.splitlines() if line.startswith("all "))
    assert [float(number) for number in re.findall(r"[\d.]+(?=\s%)", row)] == pytest.approx(
        [100 * error for error in moving], rel=6e-3
    )
    assert f"is {100 * moving[-1]:.1f}\u202f%" in document["reason"]
    # Otherwise this would hold of the errors on all rows, too.
    assert moving != pytest.approx([*errors["relative"], errors["relative_total"]], rel=6e-3)
