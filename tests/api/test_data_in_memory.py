"""Recordings from arrays, dictionaries and data frames are those of the file with the same numbers."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv as pacsv
import pytest

import dynident as dy
from dynident.api.recordings_in_memory import _get_temporary_folder

pandas = pytest.importorskip("pandas")


def _by_time(frame: Any) -> Any:
    return frame.drop(columns="t").set_index(pandas.to_timedelta(frame.t, unit="s").rename(None))


def _arrays(frame: Any, **times: Any) -> dict[str, Any]:
    q, tau = ([f"{kind}{k}" for k in range(1, 5)] for kind in ("q", "tau"))
    return {"q": frame[q].to_numpy(), "tau": frame[tau].to_numpy(), **times}


FORMS: dict[str, Callable[[Any], Any]] = {
    "pandas frame": lambda frame: frame,
    "frame with names": lambda frame: frame.rename(columns={"q2": "q_elbow", "tau2": "tau_elbow"}),
    "frame by time": _by_time,
    "selected rows": lambda frame: frame[frame.t >= -1.0].sample(frac=1.0, random_state=0).sort_values("t"),
    "dictionary of lists": lambda frame: frame.to_dict("list"),
    "arrays with times": lambda frame: _arrays(frame, t=frame.t.to_numpy()),
    "arrays with a period": lambda frame: _arrays(frame, dt=0.01),
    "arrays that are frames": lambda frame: {
        "q": frame.filter(regex="^q"),
        "tau": frame.filter(regex="^tau"),
        "t": frame.t,
    },
}


@pytest.mark.parametrize("form", FORMS)
def test_data_in_memory_are_read_as_a_file(form: str, desk: Path, robot: dy.Robot, runs: dy.Recordings) -> None:
    [read] = dy.read_recordings(FORMS[form](pandas.read_csv(desk / "run1.csv")), robot=robot)
    of_file = runs["run1"].to_table()
    for name in ("t", "q_elbow", "tau_quill"):
        np.testing.assert_allclose(read.to_table()[name], of_file[name], atol=1e-9)
    assert read.name == "recording"
    assert [check.name for check in read.findings] == [check.name for check in runs["run1"].findings]


def test_tables_of_arrow_and_frames_of_polars_are_read(desk: Path, robot: dy.Robot, runs: dy.Recordings) -> None:
    table = pacsv.read_csv(desk / "run1.csv")

    class Frame:
        """What every data frame has: columns, and the data by Arrow's interface."""

        columns = table.column_names

        def __arrow_c_stream__(self, requested_schema: object = None) -> object:
            return table.__arrow_c_stream__(requested_schema)

    for frame in (table, Frame()):
        [read] = dy.read_recordings(frame, robot=robot)
        np.testing.assert_array_equal(read.to_table()["q_elbow"], runs["run1"].to_table()["q_elbow"])


def test_names_are_given_or_made_different(desk: Path, robot: dy.Robot) -> None:
    frame = pandas.read_csv(desk / "run1.csv")
    assert dy.read_recordings(frame, frame, robot=robot).names == ("recording", "recording_2")
    monday = dy.RecordingMetadata(name="monday")
    assert dy.read_recordings(frame, frame, robot=robot, metadata=monday).names == ("monday", "monday_2")
    assert dy.read_recordings(desk / "run1.csv", frame, robot=robot, metadata=monday).names == ("run1", "monday")


def test_a_recording_from_memory_can_be_revised_and_leaves_nothing_behind(desk: Path, robot: dy.Robot) -> None:
    gc.collect()
    before = set(os.listdir(_get_temporary_folder().name))
    read = dy.read_recordings(pandas.read_csv(desk / "run1.csv"), robot=robot)
    revised = dy.revise(read[0], windows=((1.0, 5.0),))
    del read
    gc.collect()
    again = dy.revise(revised, windows=((1.0, 4.0),))
    assert again.recording.windows == ((1.0, 4.0),)
    del revised, again
    gc.collect()
    assert set(os.listdir(_get_temporary_folder().name)) <= before


def test_a_model_of_arrays_is_that_of_the_file(desk: Path, robot: dy.Robot, runs: dy.Recordings) -> None:
    read = dy.read_recordings(_arrays(pandas.read_csv(desk / "run1.csv"), dt=0.01), robot=robot)
    np.testing.assert_allclose(
        np.asarray(dy.identify(robot, read).params), np.asarray(dy.identify(robot, runs[:1]).params), rtol=1e-6
    )


def test_a_frame_of_texts_with_decimal_commas_is_read_as_numbers(runs: dy.Recordings, robot: dy.Robot) -> None:
    pytest.importorskip("pandas")
    frame = runs[0].to_frame("pandas").drop(columns="segment")
    written = frame.assign(q_elbow=[f"{value:.9f}".replace(".", ",") for value in frame["q_elbow"]])
    plain, texts = (dy.read_recordings(data, robot=robot)[0].to_table()["q_elbow"] for data in (frame, written))
    np.testing.assert_allclose(texts, plain, atol=1e-8)


def test_commas_that_may_part_thousands_are_no_decimals(runs: dy.Recordings, robot: dy.Robot) -> None:
    pytest.importorskip("pandas")
    frame = runs[0].to_frame("pandas").drop(columns="segment")
    frame["q_elbow"] = [f"1,{index % 1000:03d}" for index in range(len(frame))]
    with pytest.raises(dy.RecordingError, match="q_elbow"):
        dy.read_recordings(frame, robot=robot)


def test_a_frame_with_names_on_two_levels_is_inspected_and_read_as_proposed(desk: Path, robot: dy.Robot) -> None:
    table = pandas.read_csv(desk / "run1.csv").set_index("t")
    frame = pandas.concat(
        {"position": table.filter(regex="^q").set_axis(list(robot.joint_names), axis=1),
         "effort": table.filter(regex="^tau").set_axis(list(robot.joint_names), axis=1)}, axis=1
    )  # fmt: skip
    found = dy.inspect(frame, robot)
    assert found.questions == ()
    assert found.said["columns"]["q2"] == "position_elbow"
    [read] = dy.read_recordings(frame, robot=robot, **found.said)
    np.testing.assert_allclose(read.to_table()["q_elbow"], table["q2"], atol=1e-9)
    with pytest.raises(dy.DynidentError, match="give it, inspect"):
        dy.inspect(frame)


def test_plain_names_of_a_frame_are_kept(desk: Path, robot: dy.Robot) -> None:
    frame = pandas.read_csv(desk / "run1.csv").rename(columns={"q2": "(q, 0)"})
    [read] = dy.read_recordings(frame, robot=robot, columns={"q2": "(q, 0)"})
    np.testing.assert_allclose(read.to_table()["q_elbow"], frame["(q, 0)"], atol=1e-9)


def test_names_on_two_levels_that_become_equal_are_refused(robot: dy.Robot) -> None:
    frame = pandas.DataFrame({("a_b", "c"): [1.0, 2.0], ("a", "b_c"): [3.0, 4.0]})
    with pytest.raises(dy.DynidentError, match=r"\('a_b', 'c'\) and \('a', 'b_c'\) both get the name a_b_c; give"):
        dy.read_recordings(frame, robot=robot)


def read_with_other_names(desk: Path) -> Any:
    """Return a recording with the columns of another logger."""
    names = {"t": "time [s]", "q": "actual position", "tau": "actual torque"}
    return pandas.read_csv(desk / "run1.csv").rename(
        columns=lambda name: f"{names[name.rstrip('1234')]} {name.lstrip('tauq')}".strip()
    )


def test_columns_of_another_logger_are_read_as_proposed_and_a_finding_says_so(
    desk: Path, robot: dy.Robot, tmp_path: Path
) -> None:
    path, frame = tmp_path / "run1.csv", read_with_other_names(desk)
    frame.to_csv(path, index=False)
    usual, run = (dy.read_recordings(source, robot=robot)[0] for source in (desk / "run1.csv", path))
    (note,) = (check for check in run.findings if check.name == "columns")
    assert note.detail.startswith("Read as t: time [s]")
    assert "q: actual position 1" in note.detail
    np.testing.assert_allclose(run.to_table()["tau_elbow"], usual.to_table()["tau_elbow"], atol=1e-9)
    # The usual columns are no guess.
    assert not [check for check in usual.findings if check.name == "columns"]


def test_an_open_question_names_the_arguments_that_answer_it(desk: Path, robot: dy.Robot) -> None:
    frame = read_with_other_names(desk).drop(columns="time [s]")
    with pytest.raises(dy.DynidentError, match=r"metadata=dy.RecordingMetadata\(rate=…\)"):
        dy.read_recordings(frame, robot=robot)
    (run,) = dy.read_recordings(frame, robot=robot, metadata=dy.RecordingMetadata(rate=100.0))
    assert run.sampling_rate == pytest.approx(100.0)
