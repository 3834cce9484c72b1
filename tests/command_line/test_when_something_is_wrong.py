"""Whatever a user can mend ends in exit code 2, in words that say where, with nothing half-written."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.running_commands import ROBOT, dynident

from dynident_cli import command_output

JOINTS = ROBOT.joint_names


def run1(desk: Path, **changes) -> dict:
    table = pacsv.read_csv(desk / "run1.csv")
    return {name: table[name].to_numpy().copy() for name in table.column_names} | changes


CASES = {
    "an unknown arm": (["identify", "no_such_arm", "{desk}/run1.csv"], ["no_such_arm", "scara", "ur10"]),
    "a file that is not there": (["identify", "{desk}/arm.json", "{desk}/run9.csv"], ["run9.csv"]),
    "a robot that is neither XML nor JSON": (["identify", "{desk}/run1.csv", "{desk}/run1.csv"], ["run1.csv", "JSON"]),
    "too few drive gains": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--drive-gains", "1,2"],
        ["--drive-gains", "2 drive gains for 4 joints"],
    ),
    "a drive gain of an unknown joint": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--drive-gains", "knee=2"],
        ["--drive-gains", "knee", JOINTS[0]],
    ),
    "a gain that is no number": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--drive-gains", "1,2,x,4"],
        ["--drive-gains", "'x'"],
    ),
    "an unknown effect": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--effects", "default,stribek"],
        ["stribek", "stribeck"],
    ),
    "an effect on an unknown joint": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--effects", "default,stribeck@knee"],
        ["knee", JOINTS[0]],
    ),
    "an unknown shape constant": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--effects", "default,stribeck:speed=1"],
        ["speed", "vs"],
    ),
    "an effect that cannot be read": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--effects", "stribeck@"],
        ["--effects", "effect@joint"],
    ),
    "an unknown estimator": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--estimator", "best"],
        ["--estimator", "best", "wls"],
    ),
    "a window that cannot be read": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--windows", "3-9"],
        ["--windows", "3-9", "from:to"],
    ),
    "a window of an unknown measurement": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--windows", "run7=3:9"],
        ["--windows", "run7", "run1"],
    ),
    "windows that overlap": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--windows", "3:9", "--windows", "5:12"],
        ["--windows", "3:9", "5:12", "run1", "overlap"],
    ),
    "a window beyond the recording": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--windows", "300:900"],
        ["300", "run1.csv"],
    ),
    "columns that cannot be read": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--columns", "q1"],
        ["--columns", "name=value"],
    ),
    "a column that the file does not hold": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--columns", "q1=shoulder"],
        ["--columns q1", "shoulder"],
    ),
    "an unknown unit": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--units", "q1=furlong"],
        ["--units q1", "furlong", "deg"],
    ),
    "a cut-off beyond the Nyquist frequency": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--preprocessing", "position_cutoff=80"],
        ["position_cutoff", "Nyquist"],
    ),
    "an unknown filter": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--preprocessing", "cutoff=8"],
        ["cutoff", "position_cutoff"],
    ),
    "a model that is none": (["compare", "{desk}/run1.csv", "{desk}/run1.csv"], ["run1.csv", "not a model file"]),
    "a diagnosis that is none": (
        ["report", "{desk}/model.npz", "{desk}/run1.csv", "--diagnosis", "{desk}/arm.json", "-o", "{desk}/x.html"],
        ["arm.json", "not a diagnosis"],
    ),
    "nothing to remove": (["remove", "{desk}/model.npz"], ["--effects"]),
    "what is not in the model": (["remove", "{desk}/model.npz", "--effects", "stribeck"], ["has no stribeck"]),
    "nothing to add": (["extend", "{desk}/model.npz", "{desk}/run1.csv"], ["--effects"]),
    "what is in the model already": (
        ["extend", "{desk}/model.npz", "{desk}/run1.csv", "--effects", "coulomb"],
        ["already in the model"],
    ),
    "an unknown candidate": (
        ["diagnose", "{desk}/model.npz", "{desk}/run1.csv", "--candidates", "magic"],
        ["magic", "stribeck"],
    ),
    "the robot behind the recording": (["identify", "{desk}/run1.csv", "scara"], ["which comes before the recordings"]),
    "a misspelt field of the filters": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "--preprocessing", "torque_cutof=3"],
        ["--preprocessing torque_cutof: ", "torque_cutoff"],
    ),
    "two files that cannot be used": (
        ["identify", "scara", "{desk}/model.npz", "{desk}/arm.json", "--no-as-proposed"],
        ["2 of 2 files cannot be used", "model.npz: ", "arm.json: "],
    ),
    "a folder that is not there": (
        ["identify", "{desk}/arm.json", "{desk}/run1.csv", "-o", "{desk}/nowhere/model.npz"],
        ["--out", "nowhere"],
    ),
    "a trajectory of an unknown format": (["design", "scara", "--out", "{desk}/t.xls"], ["--out", ".csv"]),
    "an unknown kind of design": (
        ["design", "scara", "--kind", "wild", "--out", "{desk}/t.csv"],
        ["--kind", "wild", "optimized"],
    ),
    "limits of an unknown joint": (
        ["design", "scara", "--limits", "{desk}/limits.json", "--out", "{desk}/t.csv"],
        ["knee", JOINTS[0]],
    ),
    "a trajectory without a joint": (
        ["simulate", "scara", "--trajectory", "{desk}/run1.csv", "-o", "{desk}/m.csv"],
        [f"q_{JOINTS[0]}", "run1.csv"],
    ),
    "an effect of a virtual robot on an unknown joint": (
        ["simulate", "scara", "--effects", "stribeck@knee", "-o", "{desk}/m.csv"],
        ["knee", JOINTS[0]],
    ),
    "nothing that could be hidden": (["demo", "--effect", "coulomb", "-o", "{desk}/demo"], ["--effect", "coulomb"]),
    "a joint that an effect cannot sit on": (
        ["demo", "--joint", "knee", "-o", "{desk}/demo"],
        ["--joint", "knee", "elbow_joint"],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_is_named_with_its_place_and_ends_in_exit_code_2(case: str, desk: Path) -> None:
    (desk / "limits.json").write_text(json.dumps({"knee": {"velocity": 1.0}}))
    before = set(desk.iterdir())
    arguments, words = CASES[case]
    answer = dynident(*(argument.format(desk=desk) for argument in arguments))
    assert answer.code == 2, answer.out
    told = " ".join(answer.err.split())
    for word in words:
        assert word in told, told
    assert answer.out == ""
    assert set(desk.iterdir()) == before


BAD_FILES = {
    "a missing column": (lambda desk: {k: v for k, v in run1(desk).items() if k != "tau3"}, ["tau3", JOINTS[2]]),
    "time that runs back": (lambda desk: run1(desk, t=run1(desk)["t"][::-1].copy()), ["t", "row"]),
    "a joint in degrees": (lambda desk: run1(desk, q1=run1(desk)["q1"] * 57.3), ["q1", "deg"]),
    "a torque of the wrong sign": (
        lambda desk: run1(desk, tau1=-run1(desk)["tau1"]),
        ["tau1", "sign", "state --accept torque_sign"],
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_refused_by_its_column(case: str, desk: Path, tmp_path: Path) -> None:
    make, words = BAD_FILES[case]
    pacsv.write_csv(pa.table(make(desk)), tmp_path / "bad.csv")
    answer = dynident("identify", desk / "arm.json", tmp_path / "bad.csv", "-o", tmp_path / "model.npz")
    assert answer.code == 2
    assert "bad.csv" in answer.err
    for word in words:
        assert word in answer.err, answer.err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ('{"joints": [{"sigma": 4}]}', "bad.json: /joints/0/sigma: Expected 0 (revolute) or 1 (prismatic)."),
        ('{"description": {"format": "sdf"}}', "bad.json: /description/format: Expected urdf, mjcf, modified_dh, dh."),
        ("t,q1", "bad.json: this looks like a recording: the robot's description comes first"),
        (
            "an arm",
            "bad.json: this is neither XML (URDF, MJCF) nor JSON; read as a Denavit-Hartenberg table:",
        ),
    ],
)
def test_a_bad_robot_is_refused_by_its_place_said_once(content: str, told: str, desk: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text(content, encoding="utf-8")
    answer = dynident("identify", tmp_path / "bad.json", desk / "run1.csv")
    assert answer.code == 2
    assert f"\n  {told}" in answer.err


def test_a_robot_as_the_service_takes_it_is_read_with_its_gains(desk: Path, tmp_path: Path) -> None:
    table = json.loads((desk / "arm.json").read_text(encoding="utf-8"))
    drives = {name: {"drive_gain": 2.0} for name in JOINTS}
    document = {"name": "cell", "description": {"format": "modified_dh", "content": table}, "drives": drives}
    (tmp_path / "cell.json").write_text(json.dumps(document), encoding="utf-8")
    currents = {name.replace("tau", "current"): values for name, values in run1(desk).items()}
    pacsv.write_csv(pa.table(currents), tmp_path / "currents.csv")
    answer = dynident("identify", tmp_path / "cell.json", tmp_path / "currents.csv", "--json")
    assert answer.code == 0, answer.err
    values = {one["name"]: one["value"] for one in answer.document["parameters"]}
    assert values["Fc2"] == pytest.approx(6.0, rel=0.05)


def test_what_the_user_accepts_is_only_a_warning(desk: Path, tmp_path: Path) -> None:
    pacsv.write_csv(pa.table(run1(desk, tau1=-run1(desk)["tau1"])), tmp_path / "odd.csv")
    answer = dynident("identify", desk / "arm.json", tmp_path / "odd.csv", "--accept", "torque_sign", "--json")
    assert answer.code == 0, answer.err
    checks = {check["name"]: check["status"] for check in answer.document["measurements"][0]["checks"]}
    assert checks["torque_sign"] == "warning"


def test_a_hole_in_the_numbers_is_named_by_column_and_row(desk: Path, tmp_path: Path) -> None:
    columns = run1(desk)
    columns["q2"][123] = float("nan")
    pacsv.write_csv(pa.table(columns), tmp_path / "bad.csv")
    answer = dynident("identify", desk / "arm.json", tmp_path / "bad.csv")
    assert answer.code == 0
    assert "q2 (1 in row 124)" in " ".join((answer.out + answer.err).split())


def test_with_json_a_problem_is_printed_for_scripts(desk: Path) -> None:
    answer = dynident("extend", desk / "model.npz", desk / "run1.csv", "--effects", "magic", "--json")
    assert answer.code == 2
    assert answer.document["status"] == 422
    assert "magic" in answer.document["detail"]


def test_unknown_options_and_commands_are_misuse_too() -> None:
    assert dynident("identify", "--nonsense").code == 2
    assert dynident("fly").code == 2


def test_ctrl_c_ends_a_command_quietly_and_leaves_nothing(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("dynident.api.model_identification.identify", interrupted)
    answer = dynident("identify", desk / "arm.json", desk / "run1.csv", "-o", desk / "never.npz")
    assert answer.code == 130
    assert answer.err.strip() == "dynident: cancelled"
    assert not (desk / "never.npz").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals as on POSIX")
def test_a_running_optimisation_is_interrupted_at_once(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dynident_cli", "design", "ur10", "--time-budget", "120",
               "--out", str(tmp_path / "t.csv")]  # fmt: skip
    # As from a terminal: whoever started the tests in the background has the signal ignored, which children inherit.
    heeding = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    terminal, its_end = os.openpty()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=its_end, preexec_fn=heeding) as running:
        os.close(its_end)
        told = b""
        while b"iteration" not in told:
            told += os.read(terminal, 4096)
        running.send_signal(signal.SIGINT)
        # Far less than is left of its two minutes, however busy the machine is.
        running.wait(timeout=30)
        told += os.read(terminal, 4096)
    os.close(terminal)
    assert running.returncode == 130
    assert b"cancelled" in told
    assert b"Traceback" not in told
    assert not list(tmp_path.iterdir())


def test_lines_are_broken_between_words_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    path = "package://arm_description/meshes/visual/link-base-and-flange.stl"
    command_output.message_console().print(f"A sentence that is longer than one line names {path} and ends.\n  Next.")
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if len(line) > 40] == [path]
    assert lines[-1] == "  Next."
    assert len(lines) == 5


def test_names_with_square_brackets_stand_in_tables_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    command_output.result_console().print(command_output.build_table("of [green]", ("joint",), [["[red]elbow"]]))
    assert {"of [green]", "[red]elbow"} <= {line.strip() for line in capsys.readouterr().out.splitlines()}
