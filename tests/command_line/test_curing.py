"""A file that would be refused is read as its checks propose, if asked, and that is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from support.running_commands import ROBOT, dynident, write_run

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


def test_a_report_says_how_a_cured_file_was_read(turned: Path) -> None:
    model, page = turned / "model.npz", turned / "report.html"
    assert dynident("identify", turned / "arm.urdf", turned / "wrong.csv", "--cure", "-o", model).code == 0
    assert dynident("report", model, turned / "wrong.csv", "--cure", "-o", page).code == 0
    assert "--metadata wrong=wrong.columns.json" in page.read_text()
    assert "{&#34;signs&#34;: {&#34;tau1&#34;: -1.0}}" in page.read_text()
