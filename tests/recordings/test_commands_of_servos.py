"""A torque that position servos make of their commands: gain x (command of half a row ago - position)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.recording_data import JOINTS, motion, write_csv

from dynident.recordings import (
    JointLimits,
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    import_recording,
    open_recording,
)
from dynident.recordings.raw_signals import RecordedSignals, RobotFile

GAINS = (900.0, 700.0, 300.0)
RATE = 200.0


def commanded(path: Path, change=lambda columns: None) -> Path:
    """The motion of other tests, with the commands that servos of these gains need for its torque."""
    columns = motion()
    for joint in range(3):
        columns[f"q_command{joint + 1}"] = columns[f"q{joint + 1}"] + columns.pop(f"tau{joint + 1}") / GAINS[joint]
    change(columns)
    return write_csv(path, columns)


def imported(source: Path, gains=GAINS, limits=None, **stated):
    metadata = RecordingMetadata(effort_kind="position_command", **stated)
    joints = RecordedJoints(JOINTS, gains=gains, limits=limits)
    return import_recording(source, source.with_suffix(".stored"), joints, metadata=metadata)


def torque(recording) -> np.ndarray:
    table = pq.read_table(recording.path)
    return np.column_stack([table[f"tau_{joint}"].to_numpy() for joint in JOINTS])


def needed() -> np.ndarray:
    columns = motion()
    return np.column_stack([columns[f"tau{joint}"] for joint in (1, 2, 3)])


@pytest.mark.parametrize("further", [0.0, 0.02])
def test_the_torque_is_the_gain_times_the_error_from_the_command_of_half_a_row_ago(tmp_path, further):
    recording, checks = imported(commanded(tmp_path / "run.csv"), torque_delay=-further)
    table = pq.read_table(recording.path)
    tau, t, columns = torque(recording), table["t"].to_numpy(), motion()
    wanted = np.empty_like(tau)
    for joint, gain in enumerate(GAINS):
        command = columns[f"q{joint + 1}"] + columns[f"tau{joint + 1}"] / gain
        # The command of a row acts until the next row, and later still where a delay is stated.
        acting = np.interp(t - 0.5 / RATE - further, columns["t"], command)
        wanted[:, joint] = gain * (acting - np.interp(t, columns["t"], columns[f"q{joint + 1}"]))
    assert len(tau) > 2990
    assert np.median(np.abs(tau - wanted) / needed().std(axis=0)) < 0.02
    (source,) = [check for check in checks if check.name == "torque_source"]
    assert source.status == "warning"
    assert "q_command1" in source.detail
    assert recording.torque_from_commands
    assert open_recording(recording.path).torque_from_commands


def test_units_and_signs_of_commands_are_those_that_are_stated(tmp_path):
    def change(columns):
        for joint in (1, 2, 3):
            columns[f"q_command{joint}"] = np.degrees(columns[f"q_command{joint}"])

    plain, _ = imported(commanded(tmp_path / "rad.csv"))
    degrees, _ = imported(commanded(tmp_path / "deg.csv", change), units={"q": "rad", "q_command": "deg"})
    assert torque(degrees) == pytest.approx(torque(plain), abs=1e-6)
    doubled, _ = imported(commanded(tmp_path / "doubled.csv"), scale={"tau2": 2.0})
    assert torque(doubled)[:, 1] == pytest.approx(2.0 * torque(plain)[:, 1], rel=1e-9)


def in_degrees(columns):
    for joint in (1, 2, 3):
        columns[f"q{joint}"], columns[f"q_command{joint}"] = (
            np.degrees(columns[f"{kind}{joint}"]) for kind in ("q", "q_command")
        )


@pytest.mark.parametrize("units", [{"q": "deg"}, {"q1": "deg", "q_elbow": "deg", "q3": "deg"}])
def test_commands_of_which_nothing_is_said_are_in_the_unit_of_the_positions(tmp_path, units):
    plain, _ = imported(commanded(tmp_path / "rad.csv"))
    degrees, _ = imported(commanded(tmp_path / "deg.csv", in_degrees), units=units)
    assert torque(degrees) == pytest.approx(torque(plain), abs=1e-6)


@pytest.mark.parametrize("factor", [1.0, 20.0])
def test_positions_in_degrees_are_found_before_they_seem_far_behind_their_commands(tmp_path, factor):
    limits = [JointLimits(position=(-2.0, 2.0))] * 3
    path = commanded(tmp_path / "deg.csv", in_degrees)
    gains = tuple(factor * gain for gain in GAINS)
    with pytest.raises(RecordingError, match=r'units.*"q": "deg"') as refused:
        imported(path, gains, limits)
    assert refused.value.title == "Position unit"
    assert any(check.name == "position_unit" for check in refused.value.checks)


def test_a_command_of_another_turn_is_the_same_command(tmp_path):
    def change(columns):
        columns["q_command2"] = columns["q_command2"] + 2.0 * np.pi * (np.arange(3000) > 1500)

    # Of the command itself, beside the torque, the step remains.
    plain, turned = imported(commanded(tmp_path / "a.csv"))[0], imported(commanded(tmp_path / "b.csv", change))[0]
    assert torque(turned) == pytest.approx(torque(plain), abs=1e-6)


def test_a_missing_gain_a_missing_command_and_a_joint_without_torque(tmp_path):
    path = commanded(tmp_path / "run.csv")
    with pytest.raises(RecordingError, match=r"q_command2 is a command.*no drive gain.*N m/rad") as missing:
        imported(path, gains=(900.0, None, 300.0))
    assert missing.value.pointer == "/drives/elbow/drive_gain"
    with pytest.raises(RecordingError, match="q_command3"):
        imported(commanded(tmp_path / "two.csv", lambda columns: columns.pop("q_command3")))
    silent, _ = imported(path, columns={"tau2": "none"})
    assert silent.joints_without_torque == ("elbow",)
    assert not torque(silent)[:, 1].any()


def test_a_file_without_torque_says_what_its_commands_may_be(tmp_path):
    path = commanded(tmp_path / "run.csv")
    with pytest.raises(RecordingError, match='"effort_kind": "position_command"'):
        import_recording(path, tmp_path / "stored", RecordedJoints(JOINTS))


def test_intervals_at_full_duty_are_left_out(tmp_path):
    def change(columns):
        # A quarter of a second of the motion, in which the servo cannot follow.
        columns["q_command1"][1000:1050] += 0.5

    path = commanded(tmp_path / "run.csv", change)
    recording, checks = imported(path)
    (check,) = [check for check in checks if check.name == "full_duty"]
    assert (check.status, check.row) == ("warning", 1001)
    assert "1.7 %" in check.detail.replace("\u202f", " ")
    first, second = recording.segments
    assert first.start_time + first.length / RATE == pytest.approx(5.0, abs=0.02)
    assert second.start_time == pytest.approx(5.25, abs=0.02)
    assert np.abs(torque(recording)[:, 0]).max() < 0.35 * GAINS[0]
    kept, _ = imported(path, skip=("full_duty",))
    assert len(kept.segments) == 1
    assert np.abs(torque(kept)[:, 0]).max() > 0.4 * GAINS[0]


def test_a_known_torque_limit_tells_what_a_servo_can_give(tmp_path):
    path = commanded(tmp_path / "run.csv")
    greatest = np.abs(needed()).max(axis=0)
    limits = [JointLimits(effort=0.9 * greatest[0]), JointLimits(effort=0.0), JointLimits()]
    recording, checks = imported(path, limits=limits)
    (check,) = [check for check in checks if check.name == "full_duty"]
    assert (check.status, check.column) == ("warning", "q_command1")
    assert np.abs(torque(recording)[:, 0]).max() < 0.92 * greatest[0]


def test_no_angle_is_a_limit_of_what_slides(tmp_path):
    def change(columns):
        columns["q_command3"][1000:1050] += 0.5

    path = commanded(tmp_path / "run.csv", change)
    limits = [JointLimits(), JointLimits(), JointLimits("prismatic")]
    recording, checks = imported(path, limits=limits)
    assert not any(check.name == "full_duty" for check in checks)
    assert len(recording.segments) == 1


def spiked(columns):
    columns["q2"][500:2500:200] += 0.4


def held(columns):
    for joint in (1, 2, 3):
        columns[f"q{joint}"] = np.repeat(columns[f"q{joint}"][::4], 4)


@pytest.mark.parametrize(("change", "step"), [(spiked, "corrupted_samples"), (held, "held_samples")])
def test_a_corrected_position_corrects_the_torque(tmp_path, change, step):
    plain, _ = imported(commanded(tmp_path / "plain.csv"))
    mended, checks = imported(commanded(tmp_path / "mended.csv", change))
    assert [check.status for check in checks if check.name == step] == ["warning"]
    off = np.abs(torque(mended) - torque(plain)) / needed().std(axis=0)
    assert off[8:-8].max() < 0.01


def test_a_recording_mostly_at_full_duty_is_refused(tmp_path):
    def change(columns):
        columns["q_command1"][:1500] += 0.5

    with pytest.raises(RecordingError, match="full voltage"):
        imported(commanded(tmp_path / "run.csv", change))


def test_the_plotted_torque_is_that_of_the_law(tmp_path):
    path = commanded(tmp_path / "run.csv")
    metadata = RecordingMetadata(effort_kind="position_command")
    signals = RecordedSignals(RobotFile(path, metadata, RecordedJoints(JOINTS, gains=GAINS)), ["tau_elbow", "q1"])
    (rows,) = signals.rows(["tau_elbow", "q1"])
    assert rows.values[:, 0] == pytest.approx(needed()[:, 1], abs=1e-6)
    assert rows.values[:, 1] == pytest.approx(motion()["q1"])
