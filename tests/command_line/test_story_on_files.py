"""The user's story on files: each verb reads what the one before has written."""

from __future__ import annotations

import json
import shlex
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv as pacsv
import pytest
from support.running_commands import ROBOT, dynident, write_run

from dynident.advice import AdvisedDiagnosis, NextExperiment
from dynident.diagnosis import Examination
from dynident.effects import CATALOGUE
from dynident.excitation import DesignRequest
from dynident.identification import from_bytes
from dynident.number_format import format_number
from dynident.robot import urdf_from_robot
from dynident_cli.argument_loading import load_robot_argument
from dynident_cli.option_parsers import parse_windows

ERRORS = {"rms", "relative", "relative_total"}


@pytest.fixture(scope="module")
def diagnosed(desk: Path) -> dict:
    answer = dynident("diagnose", desk / "model.npz", desk / "run1.csv", "--out", desk / "diagnosis.json", "--json")
    assert answer.code == 0, answer.err
    return answer.document


def test_identify_prints_the_result_of_the_contract(desk: Path) -> None:
    answer = dynident("identify", desk / "arm.json", desk / "run1.csv", "-v", desk / "run2.csv", "--json")
    found = answer.document
    assert found.keys() >= {
        "parameters",
        "residual",
        "validation",
        "condition_number",
        "n_equations",
        "equations_per_parameter",
        "inertia_matrix_positive_definite",
        "warnings",
        "parent_id",
    }
    assert found["residual"].keys() >= {*ERRORS, "sigma"}
    assert found["validation"].keys() >= ERRORS
    fields = {"name", "value", "unit", "standard_deviation", "relative_standard_deviation", "well_identified", "effect",
              "link", "grouping"}  # fmt: skip
    assert all(parameter.keys() >= fields for parameter in found["parameters"])
    stored = from_bytes((desk / "model.npz").read_bytes())
    assert [parameter["value"] for parameter in found["parameters"]] == stored.values.tolist()
    assert [item["name"] for item in found["measurements"]] == ["run1", "run2"]
    assert all(item["checks"] for item in found["measurements"])


def test_identify_shows_errors_parameters_and_warnings_to_people(desk: Path) -> None:
    answer = dynident("identify", desk / "arm.json", desk / "run1.csv")
    stored = from_bytes((desk / "model.npz").read_bytes())
    for joint in ROBOT.joint_names:
        assert joint in answer.out
    for parameter in stored.parameters:
        assert parameter.name in answer.out
    assert "There is no validation data" in answer.out


def test_choices_of_effects_estimator_filters_and_windows_are_followed(desk: Path) -> None:
    first = ROBOT.joint_names[0]
    answer = dynident(
        "identify", desk / "arm.json", desk / "run1.csv", "--json", "--estimator", "ols",
        "--effects", f"default,offset,stribeck@{first}:vs=0.2", "--windows", "2:9,11:18",
        "--preprocessing", "position_cutoff=9,torque_cutoff=7,decimation=2",
    )  # fmt: skip
    found = answer.document
    assert [effect["effect"] for effect in found["effects"]][-2:] == ["offset", "stribeck"]
    shape = {"vs": 0.2, "delta": pytest.approx(2.0)}
    assert found["effects"][-1] == {"effect": "stribeck", "joints": [first], "shape_parameters": shape, "runs": []}
    used = found["preprocessing"]
    assert (used["position_cutoff"], used["torque_cutoff"], used["decimation"]) == (9.0, 7.0, 2)
    # Two windows of 7 s at 50 Hz, less what the filters need to settle.
    assert 0.6 * 700 < found["n_equations"] / ROBOT.n < 700


def test_every_measurement_gets_the_windows_that_stand_behind_its_name() -> None:
    found = parse_windows(["run1=2:9,11:18,run2=3:15"], ["run1", "run2"])
    assert found == {"run1": ((2.0, 9.0), (11.0, 18.0)), "run2": ((3.0, 15.0),)}
    assert parse_windows(["2:9", "run2=11:18"], ["run1", "run2"]) == {
        "run1": ((2.0, 9.0),),
        "run2": ((2.0, 9.0), (11.0, 18.0)),
    }


def test_windows_of_a_file_beside_belong_to_another_call_and_those_of_none_are_refused(desk: Path) -> None:
    alone = dynident("identify", desk / "arm.json", desk / "run1.csv", "--windows", "2:9", "--json").document
    asked = ("identify", desk / "arm.json", desk / "run1.csv", "--json", "--windows")
    shared = dynident(*asked, "run1=2:9,run2=3:15").document
    assert shared["n_equations"] == alone["n_equations"]
    refused = dynident(*asked, "run1=2:9,rnu2=3:15")
    assert refused.code == 2
    assert "there is no measurement 'rnu2'" in refused.err


def test_the_condition_number_and_the_equations_per_parameter_are_told(desk: Path) -> None:
    document = dynident("identify", desk / "arm.json", desk / "run1.csv", "--json").document
    shown = dynident("identify", desk / "arm.json", desk / "run1.csv").out
    assert f"Scaled condition number of W: {format_number(document['equilibrated_condition_number'])} (" in shown
    assert f"{document['equations_per_parameter']:.0f} equations per parameter" in shown


def test_currents_columns_and_units_of_other_names_give_the_same_model(desk: Path, tmp_path: Path) -> None:
    table = pacsv.read_csv(desk / "run1.csv")
    gains, columns = [2.0, 4.0, 8.0, 16.0], {"zeit": table["t"].to_numpy() * 1000}
    for j, joint in enumerate(ROBOT.joints):
        unit = np.rad2deg(1.0) if joint.kind == "revolute" else 1000.0
        columns[f"pos {j}"] = table[f"q{j + 1}"].to_numpy() * unit
        columns[f"amp {j}"] = table[f"tau{j + 1}"].to_numpy() / gains[j]
    header = ",".join(columns)
    np.savetxt(
        tmp_path / "other.csv", np.column_stack(list(columns.values())), "%.17g", ",", header=header, comments=""
    )
    mapping = (
        {"t": "zeit"} | {f"q{j + 1}": f"pos {j}" for j in range(4)} | {f"current{j + 1}": f"amp {j}" for j in range(4)}
    )
    units = ",".join(f"q{j + 1}={'deg' if joint.kind == 'revolute' else 'mm'}" for j, joint in enumerate(ROBOT.joints))
    common = ("--json", "--preprocessing", "position_cutoff=9,torque_cutoff=7,decimation=2")
    other = dynident(
        "identify", desk / "arm.json", tmp_path / "other.csv", "--columns", json.dumps(mapping),
        "--units", f"t=ms,{units}", "--drive-gains", ",".join(map(str, gains)), *common,
    )  # fmt: skip
    assert other.code == 0, other.err
    plain = dynident("identify", desk / "arm.json", desk / "run1.csv", *common)
    values = [[parameter["value"] for parameter in answer.document["parameters"]] for answer in (plain, other)]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-6, atol=1e-9)


def test_compare_prints_the_errors_and_writes_the_signals(desk: Path) -> None:
    answer = dynident("compare", desk / "model.npz", desk / "run2.csv", "--out", desk / "signals.csv", "--json")
    found = answer.document
    assert found.keys() >= {*ERRORS, "worst"}
    assert found["worst"][0].keys() >= {"joint", "from", "to", "rms", "pose"}
    signals = pacsv.read_csv(desk / "signals.csv")
    name = ROBOT.joint_names[0]
    residual = signals[f"residual_{name}"].to_numpy()
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(found["rms"][0], rel=1e-6)
    difference = signals[f"measured_{name}"].to_numpy() - signals[f"predicted_{name}"].to_numpy()
    np.testing.assert_allclose(residual, difference, atol=1e-9)
    held_out = from_bytes((desk / "model.npz").read_bytes()).held_out
    assert found["relative_total"] == pytest.approx(held_out.relative_total, rel=1e-6)


def test_compare_says_when_the_motion_only_repeats_what_was_learnt(desk: Path) -> None:
    same = dynident("compare", desk / "model.npz", desk / "run1.csv", "--fit", desk / "run1.csv", "--json").document
    assert same["repeated_motion"]["share"] == 1.0
    other = dynident("compare", desk / "model.npz", desk / "run2.csv", "--fit", desk / "run1.csv").out
    assert "generalisation" not in other
    assert "noise floor" in other
    assert "repeated periods" in other


@pytest.mark.parametrize(
    "words",
    [
        ("extend", "MODEL", "RUN", "--effects", "offset"),
        ("report", "MODEL", "RUN", "-o", "report.html"),
        ("compare", "MODEL", "OTHER", "--fit", "RUN"),
    ],
    ids=lambda words: words[0],
)
def test_recordings_that_are_said_to_be_those_of_the_model_are_held_against_it(
    desk: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    copy = tmp_path / "renamed.csv"
    copy.write_bytes((desk / "run1.csv").read_bytes())
    given = {"MODEL": desk / "model.npz", "OTHER": desk / "run2.csv", "report.html": tmp_path / "report.html"}
    refused = dynident(*({**given, "RUN": desk / "run2.csv"}.get(word, word) for word in words))
    assert refused.code == 2
    assert "not the recordings that the model was identified from (run1)" in " ".join(refused.err.split())
    # The content counts, not the name of the file.
    taken = dynident(*({**given, "RUN": copy}.get(word, word) for word in words))
    assert taken.code == 0, taken.err


def test_diagnose_names_the_effect_and_writes_what_it_prints(diagnosed: dict, desk: Path) -> None:
    assert diagnosed.keys() >= {
        "verdict",
        "noise_floor",
        "candidates",
        "recommended",
        "unknown",
        "not_visible",
        "failure_map",
        "next_experiment",
    }
    assert diagnosed["candidates"][0].keys() >= {
        "rank",
        "effect",
        "joints",
        "error_before",
        "error_after",
        "error_drop",
        "p_value",
        "significant",
        "evidence",
        "equivalent",
        "separability",
        "shape_parameters",
    }
    assert diagnosed["verdict"] == "missing_effect"
    assert diagnosed["candidates"][0]["effect"] == "stribeck"
    assert ROBOT.joint_names[0] in diagnosed["candidates"][0]["joints"]
    assert json.loads((desk / "diagnosis.json").read_text()) == diagnosed


def test_diagnose_tells_people_how_to_add_what_is_missing(desk: Path, diagnosed: dict) -> None:
    answer = dynident("diagnose", desk / "model.npz", desk / "run1.csv", "--candidates", "stribeck,offset")
    assert diagnosed["summary"].split(".")[0] in " ".join(answer.out.split())
    assert run_printed(answer.out)["effects"][-1]["effect"] == "stribeck"


def test_held_out_recordings_confirm_or_refuse_what_a_diagnosis_finds(desk: Path, tmp_path: Path) -> None:
    asked = ("diagnose", desk / "model.npz", desk / "run1.csv", "--candidates", "stribeck,offset", "--validation")
    confirmed = dynident(*asked, desk / "run2.csv")
    assert run_printed(confirmed.out)["validation"]["relative_total"] < 0.1
    refused = dynident(*asked, write_run(tmp_path / "without.csv", 4, stribeck=0.0), "--json")
    assert refused.document["recommended"] == []


def run_printed(out: str) -> Any:
    """What the command that a diagnosis prints gives, run as it is printed."""
    (line,) = (line for line in out.splitlines() if "To add what is missing: " in line)
    program, *words = shlex.split(line.split("missing: ")[1])
    assert program == "dynident"
    extended = dynident(*words, "--json")
    assert extended.code == 0, extended.err
    return extended.document


def test_the_printed_command_reads_recordings_as_the_diagnosis_did(desk: Path, tmp_path: Path) -> None:
    folder = tmp_path / "my cell [1]"
    folder.mkdir()
    lines = (desk / "run1.csv").read_text().replace('"', "").splitlines()
    run, model = folder / "run 1.csv", folder / "my model.npz"
    run.write_text("\n".join([lines[0].replace("tau1", "torque of joint 1"), *lines[1:]]) + "\n")
    read = ("--columns", "tau1=torque of joint 1", "--windows", "run 1=0.5:12,run 1=13:19.5", "--skip", "idle_drives")
    made = dynident("identify", "scara", run, *read, "--out", model)
    assert made.code == 0, made.err
    asked = ("diagnose", model, run, *read, "--no-cure", "--candidates", "stribeck,offset")
    answer = dynident(*asked)
    assert answer.code == 0, answer.err
    assert run_printed(answer.out)["effects"][-1]["effect"] == "stribeck"
    # Where the diagnosis is in a file, that says more than a list of effects can.
    stored = dynident(*asked, "--out", folder / "a diagnosis.json")
    assert "--diagnosis" in stored.out
    assert run_printed(stored.out)["effects"][-1]["effect"] == "stribeck"


def test_extend_adds_what_the_diagnosis_recommends_and_the_error_falls(desk: Path, diagnosed: dict) -> None:
    answer = dynident(
        "extend", desk / "model.npz", desk / "run1.csv", "-v", desk / "run2.csv",
        "--diagnosis", desk / "diagnosis.json", "--out", desk / "better.npz", "--json",
    )  # fmt: skip
    found = answer.document
    better = from_bytes((desk / "better.npz").read_bytes())
    before = better.step.parent.held_out.relative_total
    assert found["parent_id"] == "model"
    assert found["validation"]["relative_total"] == pytest.approx(better.held_out.relative_total)
    assert better.held_out.relative_total < 0.8 * before
    assert len(list(better.ladder())) == 2


def test_a_diagnosis_that_recommends_nothing_leaves_the_model_as_it_is(
    desk: Path, diagnosed: dict, tmp_path: Path
) -> None:
    told, out = tmp_path / "nothing.json", tmp_path / "same.npz"
    told.write_text(json.dumps(diagnosed | {"recommended": []}), encoding="utf-8")
    answer = dynident("extend", desk / "model.npz", desk / "run1.csv", "--diagnosis", told, "--out", out)
    assert answer.code == 0, answer.err
    assert "Nothing was added, because the diagnosis recommends nothing." in " ".join(answer.out.split())
    assert from_bytes(out.read_bytes()).choices == from_bytes((desk / "model.npz").read_bytes()).choices


def test_what_was_added_is_removed_and_the_ladders_are_compared(desk: Path, diagnosed: dict) -> None:
    test_extend_adds_what_the_diagnosis_recommends_and_the_error_falls(desk, diagnosed)
    joint = ROBOT.joint_names[0]
    taken = dynident(
        "remove", desk / "better.npz", "--effects", f"stribeck@{joint}", "--out", desk / "back.npz", "--json"
    )
    assert taken.code == 0, taken.err
    back, first = (from_bytes((desk / f"{name}.npz").read_bytes()) for name in ("back", "model"))
    assert len(list(back.ladder())) == 3
    assert back.held_out.relative_total == pytest.approx(first.held_out.relative_total, rel=1e-6)
    compared = dynident("ladder", desk / "back.npz", "--against", desk / "better.npz", "--json").document
    assert [rung["id"] for rung in compared["items"]] == ["back/1", "back/2", "back"]
    assert compared["common_ancestor"] == "back/2"
    assert compared["differences"][1]["validation_total"] == 0.0
    assert compared["differences"][2]["against_id"] is None
    assert compared["same_data"] is True
    shown = dynident("ladder", desk / "model.npz", "--against", desk / "better.npz").out
    assert "Stribeck" in shown
    assert "first model" in shown
    alone = dynident("ladder", desk / "back.npz").out
    assert "without Stribeck" in " ".join(alone.split())


def test_report_is_one_file_about_the_extended_model(desk: Path, diagnosed: dict) -> None:
    test_extend_adds_what_the_diagnosis_recommends_and_the_error_falls(desk, diagnosed)
    answer = dynident(
        "report", desk / "better.npz", desk / "run1.csv", "-v", desk / "run2.csv",
        "--diagnosis", desk / "diagnosis.json", "--out", desk / "report.html", "--json", "--title", "An <arm>",
    )  # fmt: skip
    content = (desk / "report.html").read_text(encoding="utf-8")
    assert answer.document["size"] == len(content.encode())
    assert "An &lt;arm&gt;" in content
    assert "run2 (held out)" in content
    assert "This model contains the recommended effects" in content
    paper = desk / "report.pdf"
    printed = dynident("report", desk / "better.npz", desk / "run1.csv", "--out", paper, "--json")
    assert (printed.document["media_type"], printed.document["size"]) == ("application/pdf", paper.stat().st_size)
    assert paper.read_bytes().startswith(b"%PDF")


def test_a_design_is_a_trajectory_that_the_virtual_robot_follows(tmp_path: Path) -> None:
    trajectory, measured = tmp_path / "trajectory.csv", tmp_path / "measured.parquet"
    designed = dynident(
        "design", "scara", "--kind", "random", "--duration", 4, "--rate", 200, "--out", trajectory, "--json"
    )
    assert designed.document.keys() >= {"criterion_values", "baseline_values", "margins", "n_samples"}
    assert designed.document["criterion_values"]["condition_number"] > 1
    assert max(margin["share"] for margin in designed.document["margins"]) <= 1.0 + 1e-9
    assert pacsv.read_csv(trajectory).num_rows == designed.document["n_samples"]
    hidden = f"stribeck@{ROBOT.joint_names[1]}:Fst=5,vs=0.1"
    simulated = dynident(
        "simulate", "scara", "--trajectory", trajectory, "--effects", hidden, "--rate", 200, "--out", measured, "--json"
    )
    assert simulated.code == 0, simulated.err
    assert simulated.document["n_samples"] == pytest.approx(designed.document["n_samples"], abs=2)
    identified = dynident(
        "identify", "scara", measured, "--json", "--effects", f"default,stribeck@{ROBOT.joint_names[1]}:vs=0.1"
    )
    found = {parameter["name"]: parameter for parameter in identified.document["parameters"]}
    assert found["Fst2"]["value"] == pytest.approx(5.0, rel=0.25)


def test_a_virtual_robot_goes_from_point_to_point_and_sticks_where_it_dwells(tmp_path: Path) -> None:
    trajectory, measured = tmp_path / "trajectory.csv", tmp_path / "measured.csv"
    designed = dynident(
        *(
            "design",
            "scara",
            "--no-floor",
            "--kind",
            "random",
            "--family",
            "point_to_point",
            "--points",
            4,
            "--rate",
            200,
        ),
        *("--dwell", 0.5, 0.6, "--out", trajectory, "--json"),
    )
    assert designed.code == 0, designed.err
    simulated = dynident(
        *("simulate", "scara", "--trajectory", trajectory, "--rate", 200, "--encoder-counts", 0, "--torque-noise", 0),
        *("--out", measured),
    )
    assert simulated.code == 0, simulated.err
    wanted, found = pacsv.read_csv(trajectory), pacsv.read_csv(measured)
    still = np.all([wanted[f"dq_{name}"].to_numpy() == 0 for name in ROBOT.joint_names], axis=0)[: found.num_rows]
    # 0.2 s into a rest the controller has come to its end, and friction holds what is left of its error.
    rests = np.convolve(still, np.ones(81), "same") > 80.5
    assert np.count_nonzero(rests) > 4 * 10
    for j in range(ROBOT.n):
        moved = np.diff(found[f"q{j + 1}"].to_numpy())[rests[1:]]
        assert np.abs(moved).max() < 1e-5
        assert np.mean(moved == 0) > 0.5


def test_the_next_experiment_of_a_diagnosis_is_designed_as_it_is_proposed(desk: Path, tmp_path: Path) -> None:
    model, told, out = tmp_path / "m.npz", tmp_path / "d.json", tmp_path / "next.csv"
    assert dynident("identify", desk / "arm.json", desk / "run1.csv", "--out", model).code == 0
    assert dynident("diagnose", model, desk / "run1.csv", "--out", told).code == 0
    document = json.loads(told.read_text())
    joint = ROBOT.joint_names[1]
    document["next_experiment"] = {
        "reason": "It would tell.",
        "design": {
            "robot_id": "rob_1",
            "kind": "constant_velocity",
            "trajectory": {"speeds": [0.1, 0.2], "joints": [joint], "sampling_rate": 50.0},
        },
    }
    told.write_text(json.dumps(document))
    answer = dynident("design", desk / "arm.json", "--diagnosis", told, "--out", out)
    assert answer.code == 0, answer.err
    moved = pacsv.read_csv(out)
    assert {name for name in ROBOT.joint_names if np.ptp(moved[f"q_{name}"].to_numpy()) > 0.01} == {joint}
    told.write_text(json.dumps(document | {"next_experiment": None}))
    refused = dynident("design", desk / "arm.json", "--diagnosis", told, "--out", tmp_path / "none.csv")
    assert refused.code == 2
    assert "proposes no experiment" in refused.err


def test_the_next_experiment_is_looked_for_in_files_and_where_it_is_asked_for(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, out = tmp_path / "m.npz", tmp_path / "d.json"
    assert dynident("identify", desk / "arm.json", desk / "run1.csv", "--out", model).code == 0
    proposal = NextExperiment("It would tell.", DesignRequest(kind="random"), instructions=("Be slow.",))
    questions: list[int] = []

    def propose(examination: Examination) -> AdvisedDiagnosis:
        questions.append(len(examination.doubts))
        found = {item.name: getattr(examination.diagnosis, item.name) for item in fields(examination.diagnosis)}
        return AdvisedDiagnosis(**found, next_experiment=proposal)

    monkeypatch.setattr("dynident.api.model_diagnosis.advise", propose)
    asked = ("diagnose", model, desk / "run1.csv", "--candidates", "stribeck,viscous_nonlinear")
    without = dynident(*asked)
    assert not questions
    assert dynident(*asked, "--out", out, "--no-next-experiment").code == 0
    assert not questions
    assert json.loads(out.read_text())["next_experiment"] is None
    assert dynident(*asked, "--out", out).code == 0
    assert json.loads(out.read_text())["next_experiment"]["design"]["kind"] == "random"
    told = dynident(*asked, "--next-experiment", "--out", out)
    assert "Next experiment: It would tell." in told.out
    assert "Be slow." in told.out
    assert json.loads(out.read_text())["next_experiment"]["design"]["kind"] == "random"
    assert len(questions) == 2
    assert ("--next-experiment looks for a motion" in without.out) == bool(questions[0])


def test_the_same_seed_gives_the_same_measurement(tmp_path: Path) -> None:
    dynident(
        "design", "scara", "--no-floor", "--kind", "random", "--duration", 2, "--rate", 200, "--out", tmp_path / "t.csv"
    )
    contents = []
    for seed in (1, 1, 2):
        dynident(
            "simulate",
            "scara",
            "--trajectory",
            tmp_path / "t.csv",
            "--seed",
            seed,
            "--rate",
            200,
            "-o",
            tmp_path / "m.csv",
        )
        contents.append((tmp_path / "m.csv").read_bytes())
    assert contents[0] == contents[1] != contents[2]


def test_runs_of_one_simulation_are_told_apart_by_segment_and_a_payload_is_in_one_of_them(tmp_path: Path) -> None:
    dynident(
        "design", "scara", "--no-floor", "--kind", "random", "--duration", 2, "--rate", 200, "--out", tmp_path / "t.csv"
    )
    answer = dynident(
        "simulate", "scara", "--trajectory", tmp_path / "t.csv", "--effects", "payload:run=2,Mp=4", "--runs", 2,
        "--pause", 90, "--rate", 200, "--torque-noise", 0, "-o", tmp_path / "m.csv",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    table = pacsv.read_csv(tmp_path / "m.csv")
    t, segment, lift = (table[name].to_numpy() for name in ("t", "segment", "tau3"))
    assert t[segment == 2][0] - t[segment == 1][0] > 90.0
    # The vertical axis of a SCARA carries the weight of what hangs on it.
    assert abs(np.mean(lift[segment == 2] - lift[segment == 1])) == pytest.approx(4 * 9.81, rel=0.05)
    refused = dynident("simulate", "scara", "--effects", "payload:run=3", "--runs", 2, "-o", tmp_path / "n.csv")
    assert refused.code != 0
    assert "there are the runs 1, 2" in refused.err


def test_a_load_of_the_second_run_is_identified(tmp_path: Path) -> None:
    motion, runs, model = tmp_path / "t.csv", [tmp_path / "empty.csv", tmp_path / "carrying.csv"], tmp_path / "m.npz"
    dynident("design", "scara", "--no-floor", "--kind", "random", "--duration", 8, "--rate", 200, "--out", motion)
    for run, effects in zip(runs, ((), ("--effects", "payload:run=1,Mp=4,MXp=0.2")), strict=True):
        answer = dynident("simulate", "scara", "--trajectory", motion, *effects, "-o", run)
        assert answer.code == 0, answer.err
    answer = dynident("identify", "scara", *runs, "--effects", "default,payload:run=2", "--out", model, "--json")
    assert answer.code == 0, answer.err
    (mass,) = (one for one in answer.document["parameters"] if one["name"].startswith("Mp"))
    assert mass["value"] == pytest.approx(4.0, rel=0.05)
    # A SCARA does not turn its load about all axes.
    assert "does not determine MZp4 of the load" in dynident("export", model, "--out", tmp_path / "load.script").err
    refused = dynident("identify", "scara", *runs, "--effects", "default,payload:run=3", "--out", model)
    assert refused.code == 2
    assert "run 1 to 2" in refused.err


def test_effects_lists_the_catalogue() -> None:
    found = dynident("effects", "--json").document
    assert [item["id"] for item in found["items"]] == list(CATALOGUE)
    assert found["items"][0].keys() >= {"id", "title", "formula", "parameters", "signature", "sources"}
    shown = dynident("effects").out
    assert all(name[:12] in shown for name in CATALOGUE)


def test_the_robot_may_be_a_request_of_the_service(desk: Path, tmp_path: Path) -> None:
    body = {
        "name": "arm with gains",
        "description": {"format": "modified_dh", "content": json.loads((desk / "arm.json").read_text())},
        "drives": {ROBOT.joint_names[0]: {"drive_gain": 3.0}},
    }
    (tmp_path / "robot.json").write_text(json.dumps(body))
    answer = dynident("identify", tmp_path / "robot.json", desk / "run1.csv", "--out", tmp_path / "m.npz", "--json")
    assert answer.code == 0, answer.err
    robot = from_bytes((tmp_path / "m.npz").read_bytes()).model.robot
    assert robot.name == "arm with gains"
    assert robot.drives[0].gain == 3.0


def test_a_urdf_gives_the_robot_its_name(tmp_path: Path) -> None:
    (tmp_path / "description.urdf").write_text(urdf_from_robot(replace(ROBOT, name="Arm 7")), encoding="utf-8")
    robot = load_robot_argument(str(tmp_path / "description.urdf"))
    assert robot.name == "Arm 7"
    assert robot.joint_names == ROBOT.joint_names


def test_two_files_of_one_name_are_told_apart(desk: Path, tmp_path: Path) -> None:
    (tmp_path / "run1.csv").write_bytes((desk / "run2.csv").read_bytes())
    answer = dynident(
        "identify",
        desk / "arm.json",
        desk / "run1.csv",
        "-v",
        tmp_path / "run1.csv",
        "--windows",
        "run1_2=5:15",
        "--json",
    )
    assert [item["name"] for item in answer.document["measurements"]] == ["run1", "run1_2"]


def test_a_clean_recording_lacks_nothing(tmp_path: Path, desk: Path) -> None:
    for seed in (1, 2):
        write_run(tmp_path / f"run{seed}.csv", seed, stribeck=0.0)
    dynident("identify", desk / "arm.json", tmp_path / "run1.csv", "-o", tmp_path / "model.npz")
    answer = dynident("diagnose", tmp_path / "model.npz", tmp_path / "run1.csv", "--json")
    assert answer.document["verdict"] == "adequate"
    assert answer.document["recommended"] == []


def test_a_virtual_robot_has_the_parameters_and_the_controller_that_are_asked_for(tmp_path: Path) -> None:
    dynident(
        "design", "scara", "--no-floor", "--kind", "random", "--duration", 2, "--rate", 200, "--out", tmp_path / "t.csv"
    )
    torques = []
    for more in ((), ("--parameters", "Fc1=40"), ("--feed-forward", "none")):
        answer = dynident(
            "simulate", "scara", "--trajectory", tmp_path / "t.csv", "--torque-noise-absolute", "0,0,0,0",
            "--encoder-counts", 0, *more, "-o", tmp_path / "m.csv",
        )  # fmt: skip
        assert answer.code == 0, answer.err
        torques.append(pacsv.read_csv(tmp_path / "m.csv")["tau1"].to_numpy())
    usual, rough, alone = (np.abs(tau).mean() for tau in torques)
    assert rough > usual + 5.0
    assert alone != usual
    refused = dynident("simulate", "scara", "--torque-noise=-1", "-o", tmp_path / "m.csv")
    assert (refused.code, "torque_noise is -1" in refused.err) == (2, True), refused.err
