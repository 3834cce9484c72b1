"""Robots and recordings from files: what is wrong is told once, all of it, in the words of Python."""

from __future__ import annotations

import gc
import json
from pathlib import Path

import numpy as np
import pyarrow.csv as pacsv
import pytest

import dynident as dy
from dynident.api.recording_collection import CheckedRecording
from dynident.recordings import open_recording, recording_from_arrays
from dynident.robot.bundled_arms import library_table

Table = dict[str, np.ndarray]


def table_of(path: Path) -> Table:
    read = pacsv.read_csv(path)
    return {name: read[name].to_numpy() for name in read.column_names}


def write(path: Path, table: Table) -> Path:
    lines = [
        ",".join(table),
        *(",".join(f"{value!r}" for value in map(float, row)) for row in zip(*table.values(), strict=True)),
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


# Robots.


def test_a_urdf_is_called_what_it_calls_itself(desk: Path) -> None:
    text = (desk / "arm.urdf").read_text(encoding="utf-8")
    assert f'name="{dy.load_robot(desk / "arm.urdf").name}"' in text
    assert dy.load_robot(str(desk / "arm.urdf"), name="mine").name == "mine"


def test_a_table_a_document_and_a_well_known_arm_are_the_same_robot(tmp_path: Path) -> None:
    (tmp_path / "table.json").write_text(library_table("scara"), encoding="utf-8")
    document = {
        "name": "cell 3",
        "description": {"format": "modified_dh", "content": json.loads(library_table("scara"))},
        "limits": {"elbow": {"velocity": 1.5}},
        "drives": {"elbow": {"gear_ratio": 50, "torque_constant": 0.2}},
    }
    (tmp_path / "document.json").write_text(json.dumps(document), encoding="utf-8")
    table, known = dy.load_robot(tmp_path / "table.json"), dy.load_robot("scara")
    stored = dy.load_robot(tmp_path / "document.json")
    assert table.name == "table"
    assert stored.name == "cell 3"
    assert table.joint_names == known.joint_names == stored.joint_names
    np.testing.assert_array_equal(table.inertias, known.inertias)
    assert stored.joints[1].limits.velocity == 1.5
    assert stored.joints[1].limits.position == known.joints[1].limits.position
    assert stored.drives[1].gain == 10.0


def test_what_is_said_beside_the_file_wins(tmp_path: Path) -> None:
    document = {
        "description": {"format": "modified_dh", "content": library_table("scara")},
        "limits": {"elbow": {"velocity": 1.5, "effort": 20}},
        "gravity": [0, 0, 9.81],
    }
    (tmp_path / "arm.json").write_text(json.dumps(document), encoding="utf-8")
    robot = dy.load_robot(
        tmp_path / "arm.json",
        limits={"elbow": dy.Limits(velocity=1.0)},
        drive_gains={"quill": 30.0},
        gravity=(0, 0, -1.62),
    )
    assert (robot.joints[1].limits.velocity, robot.joints[1].limits.effort) == (1.0, 20.0)
    assert [drive.gain for drive in robot.drives] == [None, None, 30.0, None]
    assert robot.gravity.tolist() == [0, 0, -1.62]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "there is no file"),
        ("{", "arm.json: this is neither XML (URDF, MJCF) nor JSON: line 1"),
        ("<robot name='a'>", "arm.json: line 1: The XML is malformed at column 17"),
        ('{"joints": [{"sigma": 4}]}', "arm.json: /joints/0/sigma: Expected 0 (revolute) or 1"),
        ('{"description": {"format": "modified_dh", "content": [{"d": "x"}]}}', "arm.json: /description/content/0/d: "),
        ('{"description": {"format": "sdf", "content": "…"}}', "arm.json: /description/format: Expected urdf"),
        ('{"description": {}, "joints": 3}', "arm.json: /joints: Unknown field 'joints'"),
        ('{"description": {}, "base_parameters_tolerance": 1e-6}', "leave it out here"),
        (
            '{"description": {"format": "urdf", "content": "x"}, "drives": {"a": {"gain": 2}}}',
            "/drives/a/gain: Unknown",
        ),
        ('{"description": {"format": "urdf", "content": "x"}, "drives": [1]}', "/drives: Expected an object"),
    ],
)
def test_what_is_no_robot_is_told_with_the_place(content: str | None, told: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.json"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(dy.DynidentError) as raised:
        dy.load_robot(path)
    assert told in str(raised.value)


def test_gains_are_one_a_joint_or_by_the_joints_names() -> None:
    assert [drive.gain for drive in dy.load_robot("scara", drive_gains=[1, 2, 3, 4]).drives] == [1, 2, 3, 4]
    with pytest.raises(dy.DynidentError, match="3 drive gains for 4 joints"):
        dy.load_robot("scara", drive_gains=[1, 2, 3])
    with pytest.raises(dy.DynidentError, match=r"no joint 'wrist'\. The joints are: shoulder"):
        dy.load_robot("scara", drive_gains={"wrist": 1.0})


# Recordings.


def test_recordings_come_by_number_by_slice_and_by_name(runs: dy.Recordings) -> None:
    assert runs.names == ("run1", "run2")
    assert runs["run2"] is runs[1]
    assert runs[:1].names == ("run1",)
    assert "run2" in runs
    assert "run2" not in runs[:1]
    assert (runs[1:] + runs[:1]).names == ("run2", "run1")
    with pytest.raises(KeyError, match="run1, run2"):
        runs["run3"]


def test_columns_units_and_windows_are_said_in_words(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    table = table_of(desk / "run1.csv")
    renamed = {f"{name}_deg" if name == "q1" else name: values for name, values in table.items()}
    renamed["q1_deg"] = np.rad2deg(table["q1"])
    path = write(tmp_path / "odd.csv", renamed)
    [odd] = dy.read_recordings(
        path,
        robot=robot,
        columns={"q1": "q1_deg"},
        units={"q1": "deg"},
        windows=[(2, 15)],
        metadata=dy.RecordingMetadata(role="validation"),
    )
    rows = next(odd.recording.source.rows(0, 100, 100))
    np.testing.assert_allclose(rows.q[:, 0], table["q1"][:100], atol=1e-12)
    assert odd.recording.windows == ((2.0, 15.0),)
    assert odd.recording.role == "validation"


def test_currents_become_torques_by_the_gains_of_the_robot_or_of_the_call(
    desk: Path, robot: dy.Robot, tmp_path: Path
) -> None:
    table = table_of(desk / "run1.csv")
    currents = {name.replace("tau", "current"): values for name, values in table.items()}
    path = write(tmp_path / "currents.csv", currents)
    [made] = dy.read_recordings(path, robot=robot, drive_gains=[2, 2, 2, 0.5])
    rows = next(made.recording.source.rows(0, 10, 10))
    np.testing.assert_allclose(
        rows.tau,
        np.column_stack([table[f"tau{j}"][:10] * g for j, g in zip((1, 2, 3, 4), (2, 2, 2, 0.5), strict=True)]),
    )
    with pytest.raises(dy.RecordingError, match="give drive_gains in N m/A"):
        dy.read_recordings(path, robot=robot)


def test_a_file_that_is_not_there_is_named_before_any_is_read(desk: Path, robot: dy.Robot) -> None:
    with pytest.raises(dy.DynidentError, match=r"there is no file .*run9\.csv"):
        dy.read_recordings(desk / "run1.csv", desk / "run9.csv", robot=robot)
    with pytest.raises(dy.DynidentError, match="at least one file"):
        dy.read_recordings(robot=robot)
    with pytest.raises(dy.DynidentError, match="give several recordings one by one"):
        dy.read_recordings([desk / "run1.csv"], robot=robot)  # type: ignore[arg-type]


def test_a_wrong_column_is_told_with_those_that_there_are(desk: Path, robot: dy.Robot) -> None:
    with pytest.raises(
        dy.RecordingError, match=r"run1\.csv: columns maps q1 to 'angle', which is not in the file.*q1, tau1"
    ):
        dy.read_recordings(desk / "run1.csv", robot=robot, columns={"q1": "angle"})


def test_fewer_joints_in_the_file_than_in_the_robot_are_told_by_the_joint(desk: Path) -> None:
    with pytest.raises(dy.RecordingError, match=r'joint wrist_2_joint.*columns=\{"tau\d": "…"\}') as raised:
        dy.read_recordings(desk / "run1.csv", robot=dy.load_robot("ur10"))
    assert '"columns"' not in str(raised.value)


def test_more_joints_in_the_file_than_in_the_robot_are_a_finding(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    table = table_of(desk / "run1.csv")
    path = write(tmp_path / "five.csv", {**table, "q5": table["q1"], "tau5": table["tau1"]})
    made = dy.read_recordings(path, robot=robot)
    [finding] = made.findings["five"]
    assert finding.name == "joint_columns"
    assert "q5 and tau5" in finding.detail
    assert "q5 and tau5" in repr(made)
    assert "q5 and tau5" in made._repr_html_()


def test_all_that_is_wrong_with_all_files_is_one_error(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    table = table_of(desk / "run1.csv")
    degrees = write(
        tmp_path / "degrees.csv", {name: np.rad2deg(v) if name.startswith("q") else v for name, v in table.items()}
    )
    lacking = write(tmp_path / "lacking.csv", {name: v for name, v in table.items() if name != "tau3"})
    with pytest.raises(dy.RecordingError) as raised:
        dy.read_recordings(degrees, desk / "run1.csv", lacking, robot=robot)
    told = str(raised.value)
    assert told.startswith("2 of 3 files cannot be used:")
    assert "degrees.csv: " in told
    assert 'units={"q": "deg"} for degrees alone' in told
    assert "lacking.csv: There is no column tau_quill or tau3" in told
    assert '"units"' not in told
    blocking = [check for check in raised.value.checks if check.status == "error"]
    assert blocking
    assert all(check.detail.split(" State ")[0] in told for check in blocking)


def test_what_several_files_lack_is_said_once(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    table = table_of(desk / "run1.csv")
    paths = [write(tmp_path / f"{name}.csv", {one: v for one, v in table.items() if one != "tau3"}) for name in "ab"]
    with pytest.raises(dy.RecordingError) as raised:
        dy.read_recordings(*paths, robot=robot)
    assert "a.csv, b.csv: There is no column" in str(raised.value)
    assert str(raised.value).count("There is no column") == 1


def test_what_is_accepted_becomes_a_finding(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    table = table_of(desk / "run1.csv")
    path = write(tmp_path / "far.csv", {name: np.rad2deg(v) if name[0] == "q" else v for name, v in table.items()})
    with pytest.raises(dy.RecordingError, match=r'state metadata=dy.RecordingMetadata\(accept=\("position_unit",\)\)'):
        dy.read_recordings(path, robot=robot)
    made = dy.read_recordings(path, robot=robot, metadata=dy.RecordingMetadata(accept=("position_unit",)))
    assert "position_unit" in [check.name for check in made.findings["far"]]


def test_a_checked_file_is_there_as_long_as_something_reads_it(desk: Path, robot: dy.Robot) -> None:
    made = dy.read_recordings(desk / "run1.csv", robot=robot)
    path = made[0].recording.path
    assert path is not None
    shortened = made[0].recording.with_windows(((1.0, 2.0),))
    del made
    gc.collect()
    assert path.is_file()
    del shortened
    gc.collect()
    assert not path.exists()


def test_a_failed_file_leaves_nothing_behind(desk: Path, robot: dy.Robot) -> None:
    kept = dy.read_recordings(desk / "run1.csv", robot=robot)
    path = kept[0].recording.path
    assert path is not None
    before = sorted(path.parent.iterdir())
    with pytest.raises(dy.RecordingError):
        dy.read_recordings(desk / "run1.csv", robot=dy.load_robot("ur10"))
    assert sorted(path.parent.iterdir()) == before


def test_what_is_said_beside_the_metadata_wins_and_the_file_gives_the_name(desk: Path, robot: dy.Robot) -> None:
    said = dy.RecordingMetadata(name="other", windows=((1.0, 4.0),), torque_delay=0.001, accept=("torque_sign",))
    [made] = dy.read_recordings(desk / "run1.csv", robot=robot, metadata=said)
    assert made.name == "run1"
    assert made.recording.windows == ((1.0, 4.0),)
    assert made.source is not None
    assert made.source.metadata.torque_delay == 0.001
    [shorter] = dy.read_recordings(desk / "run1.csv", robot=robot, windows=[(2, 3)], metadata=said)
    assert shorter.recording.windows == ((2.0, 3.0),)


def test_what_cannot_be_kept_says_why(desk: Path, robot: dy.Robot, runs: dy.Recordings, tmp_path: Path) -> None:
    with pytest.raises(dy.DynidentError, match="two recordings are called 'run1'"):
        dy.Recordings((runs[0], runs[0])).save(tmp_path)
    t = np.arange(1000) / 100.0
    q = np.sin(t)[:, None] * np.ones(robot.n)
    held = CheckedRecording(recording_from_arrays(t, q, q, joint_names=robot.joint_names, name="held"))
    with pytest.raises(dy.DynidentError, match="held exists only in memory"):
        held.save(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_keeps_checked_recordings_for_another_day(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    made = dy.read_recordings(desk / "run1.csv", robot=robot)
    made.save(tmp_path / "checked")
    made[0].save(tmp_path / "checked")
    del made
    gc.collect()
    again = open_recording(tmp_path / "checked" / "run1.checked.parquet")
    assert dy.identify(robot, again).recordings.names == ("run1",)


def test_two_files_of_one_name_are_told_apart(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    other = tmp_path / "run1.csv"
    other.write_bytes((desk / "run2.csv").read_bytes())
    assert dy.read_recordings(desk / "run1.csv", other, robot=robot).names == ("run1", "run1_2")


def test_files_are_read_before_they_are_identified_from(robot: dy.Robot, model: dy.Model) -> None:
    with pytest.raises(
        dy.DynidentError, match=r"'run1.csv' is not a recording; read files and data with read_recordings"
    ):
        dy.identify(robot, "run1.csv")  # type: ignore[arg-type]
    with pytest.raises(dy.DynidentError, match="at least one recording for the comparison"):
        dy.compare(model, ())


def test_recordings_of_another_robot_are_refused(runs: dy.Recordings) -> None:
    with pytest.raises(dy.DynidentError, match=r"run1 has the joints shoulder.*, but the robot has shoulder_pan_joint"):
        dy.identify(dy.load_robot("ur10"), runs)


def test_no_model_file_and_no_effect_are_told(tmp_path: Path, model: dy.Model, found: dy.DiagnosedModel) -> None:
    with pytest.raises(dy.DynidentError, match=r"there is no file .*none\.npz"):
        dy.load_model(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    with pytest.raises(dy.DynidentError, match=r"bad\.npz: this is not a model file that this version can read"):
        dy.load_model(tmp_path / "bad.npz")
    with pytest.raises(dy.DynidentError, match=r"name must end in \.npz"):
        model.save(tmp_path / "arm.pkl")
    with pytest.raises(dy.DynidentError, match="there is no folder"):
        model.save(tmp_path / "none" / "arm.npz")
    with pytest.raises(dy.DynidentError, match="stribek"):
        model.extend("stribek@elbow")
    with pytest.raises(dy.DynidentError, match="wrist"):
        model.extend("stribeck@wrist:vs=0.1")
    with pytest.raises(dy.DynidentError, match="no effect to add is given"):
        model.extend()
    with pytest.raises(dy.DynidentError, match="neither a diagnosis nor an effect"):
        model.extend(3)  # type: ignore[arg-type]


def test_a_diagnosis_with_nothing_to_add_says_so(better: dy.Model) -> None:
    nothing = dy.diagnose(better)
    assert nothing.verdict == "adequate"
    with pytest.raises(dy.DynidentError, match="recommends nothing to add: Nothing above the detection limits"):
        better.extend(nothing)
