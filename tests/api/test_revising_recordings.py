"""A recording is read again with something else said of its file; cures are applied where that is asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.small_arm_files import ARM

import dynident as dy


def turned(desk: Path, tmp_path: Path) -> Path:
    header, *_ = (desk / "run1.csv").read_text().splitlines()
    names = header.replace('"', "").split(",")
    rows = np.loadtxt(desk / "run1.csv", delimiter=",", skiprows=1)
    rows[:, names.index("tau1")] *= -1.0
    path = tmp_path / "turned.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")
    return path


def test_what_is_revised_is_another_recording_of_the_same_file(runs: dy.Recordings) -> None:
    first = runs[0]
    second = dy.revise(first, windows=((2.0, 6.0),))
    third = dy.revise(second, exclude=((3.0, 4.0),), name="short")
    assert (second.name, third.name) == (f"{first.name} r1", "short")
    assert third.recording.windows == ((2.0, 3.0), (4.0, 6.0))
    assert first.recording.windows == ()
    assert third.source is not None
    assert [one.changes for one in third.source.edits] == [("windows",), ("exclude", "name")]


def test_a_file_with_a_torque_turned_round_is_read_right_if_cures_are_wanted(
    desk: Path, tmp_path: Path, robot: dy.Robot, runs: dy.Recordings
) -> None:
    path = turned(desk, tmp_path)
    with pytest.raises(dy.RecordingError) as refused:
        dy.read_recordings(path, robot=robot)
    (cure,) = [one.apply for one in refused.value.checks if one.status == "error"]
    assert cure == dy.Revision(signs={"tau1": -1.0})
    (mended,) = dy.read_recordings(path, robot=robot, cure=True)
    assert any("signs tau1: -1" in one.detail for one in mended.findings)
    accepted = dy.read_recordings(path, robot=robot, metadata=dy.RecordingMetadata(accept=("torque_sign",)))[0]
    for one in (mended, dy.revise(accepted, cure)):
        model = dy.identify(robot, one)
        assert model.fit.relative_total == pytest.approx(dy.identify(robot, runs[:1]).fit.relative_total, rel=1e-6)


def test_a_revision_has_the_fields_that_it_has(runs: dy.Recordings) -> None:
    with pytest.raises(dy.DynidentError, match=r"takes no argument 'wheels'.*windows, exclude"):
        dy.revise(runs[0], wheels=3)  # type: ignore[call-arg]
    with pytest.raises(dy.DynidentError, match="was not read from a file"):
        dy.revise(dy.CheckedRecording(runs[0].recording), name="x")
    assert ARM.n == runs[0].recording.n
