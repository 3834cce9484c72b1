"""A file that would be refused is read as its checks propose, if asked, and that is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.running_commands import ROBOT, dynident, write_run

import dynident as dy
from dynident.api import recording_files
from dynident.recordings import RecordingError
from dynident.robot import urdf_from_robot


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot and a run whose first torque has the opposite sign."""
    folder = tmp_path_factory.mktemp("turned")
    (folder / "arm.urdf").write_text(urdf_from_robot(ROBOT), encoding="utf-8")
    table = pacsv.read_csv(write_run(folder / "right.csv", 1))
    columns = {name: table[name].to_numpy() for name in table.column_names}
    pacsv.write_csv(pa.table(columns | {"tau1": -columns["tau1"]}), folder / "wrong.csv")
    return folder


def test_a_refusal_names_the_option_that_cures_it(turned: Path) -> None:
    answer = dynident("identify", turned / "arm.urdf", turned / "wrong.csv", "--json")
    assert answer.code == 2
    assert "--cure" in answer.err
    (found,) = [one for one in answer.document["checks"] if one["status"] == "error"]
    assert found["apply"] == {"signs": {"tau1": -1.0}}


def test_a_cured_file_gives_the_model_of_the_right_one(turned: Path) -> None:
    cured = dynident("identify", turned / "arm.urdf", turned / "wrong.csv", "--cure", "--json").document
    right = dynident("identify", turned / "arm.urdf", turned / "right.csv", "--json").document
    assert cured["residual"]["relative_total"] == pytest.approx(right["residual"]["relative_total"], rel=1e-6)
    told = [one["detail"] for one in cured["measurements"][0]["checks"] if one["name"] == "cure"]
    assert told == ["Read with this correction: signs tau1: -1."]


def test_a_recording_that_does_not_show_a_fault_is_cured_with_one_that_does(turned: Path) -> None:
    """Where the joint of the wrong sign hardly moves, nothing is wrong; but the sign is that of the robot."""
    table = pacsv.read_csv(write_run(turned / "seed2.csv", 2))
    columns = {name: table[name].to_numpy() for name in table.column_names}
    still = columns | {"q1": 0.0 * columns["q1"], "tau1": 0.0 * columns["tau1"] + 1e-3 * np.sin(columns["t"])}
    pacsv.write_csv(pa.table(still), turned / "still.csv")
    both = ("identify", turned / "arm.urdf", turned / "still.csv", turned / "wrong.csv", "--cure", "--json")
    answer = dynident(*both)
    assert answer.code == 0, answer.err
    told = [
        [one["detail"] for one in run["checks"] if one["name"] == "cure"] for run in answer.document["measurements"]
    ]
    assert told == 2 * [["Read with this correction: signs tau1: -1."]]


def test_a_recording_that_is_right_contradicts_one_that_is_cured(turned: Path) -> None:
    both = ("identify", turned / "arm.urdf", turned / "right.csv", turned / "wrong.csv", "--cure")
    answer = dynident(*both)
    assert answer.code == 2
    assert "contradict" in answer.err
    assert "right does not" in answer.err


def test_a_sign_that_is_stated_for_a_file_is_no_correction_of_it(turned: Path) -> None:
    """It is read once, as stated, though another file is cured of the same."""
    (turned / "stated.csv").write_bytes((turned / "wrong.csv").read_bytes())
    (turned / "signs.json").write_text('{"signs": {"tau1": -1}}')
    files = (turned / "stated.csv", turned / "wrong.csv")
    answer = dynident(
        "identify", turned / "arm.urdf", *files, "--metadata", f"stated={turned / 'signs.json'}", "--cure", "--json"
    )
    assert answer.code == 0, answer.err
    cured = [any(one["name"] == "cure" for one in run["checks"]) for run in answer.document["measurements"]]
    assert cured == [False, True]


def test_a_second_reading_has_its_progress_and_its_own_errors(turned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What fails with the cures of others for another reason, such as a full disk, is no contradiction."""
    robot = dy.load_robot(turned / "arm.urdf")
    table = pacsv.read_csv(turned / "right.csv")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    still = columns | {"q1": 0.0 * columns["q1"], "tau1": 0.0 * columns["tau1"] + 1e-3 * np.sin(columns["t"])}
    pacsv.write_csv(pa.table(still), turned / "rests.csv")
    files = (turned / "rests.csv", turned / "wrong.csv")
    fractions: list[float] = []
    dy.read_recordings(*files, robot=robot, cure=True, progress=lambda fraction, _: fractions.append(fraction))
    assert any(0.5 < fraction < 0.75 for fraction in fractions)
    read = recording_files._read_recording

    def fail(*arguments: Any, **options: Any) -> Any:
        if options.get("edits"):
            raise RecordingError("The disk is full.", title="Storage")
        return read(*arguments, **options)

    monkeypatch.setattr(recording_files, "_read_recording", fail)
    with pytest.raises(RecordingError) as caught:
        dy.read_recordings(*files, robot=robot, cure=True)
    assert (caught.value.title, caught.value.detail) == ("Storage", "rests: The disk is full.")


def test_a_report_says_how_a_cured_file_was_read(turned: Path) -> None:
    model, page = turned / "model.npz", turned / "report.html"
    assert dynident("identify", turned / "arm.urdf", turned / "wrong.csv", "--cure", "-o", model).code == 0
    assert dynident("report", model, turned / "wrong.csv", "--cure", "-o", page).code == 0
    assert "--metadata wrong=wrong.columns.json" in page.read_text()
    assert "{&#34;signs&#34;: {&#34;tau1&#34;: -1.0}}" in page.read_text()
