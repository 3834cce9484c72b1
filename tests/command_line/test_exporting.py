"""`dynident export`: a model as a file for other programs."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
from support.running_commands import ROBOT, dynident

from dynident.export import model_from_json
from dynident.robot import robot_from_urdf


def test_the_ending_of_the_file_says_the_format(desk: Path) -> None:
    for name in ("arm.urdf", "arm.xml", "model.c", "model.h", "model.hpp", "model.casadi", "exported.json"):
        answer = dynident("export", desk / "model.npz", "-o", desk / name, "--nearest")
        assert answer.code == 0, answer.err
        assert f"written to {desk / name}" in answer.out.replace("\n", "")
    read = robot_from_urdf("read", (desk / "arm.urdf").read_text())
    assert read.joint_names == ROBOT.joint_names
    assert model_from_json((desk / "exported.json").read_text()).robot.n == ROBOT.n


def test_a_header_has_thresholds_from_held_out_measurements(desk: Path) -> None:
    command = ["export", desk / "model.npz", "-o", desk / "with.hpp", "--json"]
    without = dynident(*command)
    assert "find_contacts" not in (desk / "with.hpp").read_text()
    held_out = [part for run in (1, 2) for part in ("-v", desk / f"run{run}.csv")]
    answer = dynident(*command, *held_out)
    assert answer.code == 0, answer.err
    assert "find_contacts" in (desk / "with.hpp").read_text()
    [note] = set(answer.document["notes"]) - set(without.document["notes"])
    assert note.startswith("A momentum observer detects ")


def test_a_ros_2_package_is_a_folder_or_a_zip_file(desk: Path) -> None:
    (desk / "existing").mkdir()
    for name in ("ros2", "existing", "package.zip"):
        answer = dynident("export", desk / "model.npz", "-o", desk / name)
        assert answer.code == 0, answer.err
    packages = [next((desk / folder).iterdir()) for folder in ("ros2", "existing")]
    files = [{str(file.relative_to(p)): file.read_bytes() for file in p.rglob("*") if file.is_file()} for p in packages]
    assert files[0] == files[1]
    with zipfile.ZipFile(desk / "package.zip") as packed:
        assert {name.split("/", 1)[1]: packed.read(name) for name in packed.namelist()} == files[0]


def test_a_file_is_named_after_the_robot_where_nobody_names_it(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    answer = dynident("export", "model.npz", "--format", "c", "--json")
    assert answer.document["media_type"] == "text/x-c"
    assert Path(answer.document["path"]).read_text().startswith("/*")
    assert answer.document["size"] == Path(answer.document["path"]).stat().st_size


def test_no_format_and_unknown_formats_are_refused(desk: Path) -> None:
    for arguments in (["-o", desk / "model.txt"], [], ["-f", "fortran"]):
        answer = dynident("export", desk / "model.npz", *arguments)
        assert answer.code != 0
        assert "json" in answer.err


def test_notes_say_what_a_format_leaves_out(desk: Path) -> None:
    grown = dynident("extend", desk / "model.npz", desk / "run1.csv", "--effects", "stribeck@shoulder",
                     "-o", desk / "grown.npz")  # fmt: skip
    assert grown.code == 0, grown.err
    answer = dynident("export", desk / "grown.npz", "-f", "urdf", "-o", desk / "grown.urdf", "--nearest", "--json")
    assert any("Stribeck" in note for note in answer.document["notes"])
    assert json.dumps(answer.document["notes"][-1])[1:30] in (desk / "grown.urdf").read_text()
