"""Files as public repositories hold them: without time, torque or names; made of the columns of a drawn arm."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import FloatArray, guess, log, log_of
from support.logger_layouts import cells, table
from support.oracles import arm, fourier_motion, pinocchio_torque

from dynident.effects import EffectChoice, Signals, build_columns
from dynident.identification.column_inference.file_inspection import inspect_file
from dynident.identification.column_inference.metadata_proposal import Proposal
from dynident.identification.recording_faults.column_faults import Motion as Rows
from dynident.identification.recording_faults.fault_search import _leaves_limits
from dynident.identification.recording_faults.gravity_in_torque import find_static_torque
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit
from dynident.identification.robot_recording_import import import_cured
from dynident.recordings import RecordingError, RecordingMetadata
from dynident.recordings.formats import open_source
from dynident.regressors.base_parameters import find_base_parameters
from dynident.robot import robot_from_urdf

ROBOT = arm("ur10")


def propose_of(path: Path, header: list[str], columns: FloatArray) -> Proposal:
    path.write_text(table(header, cells(columns)), encoding="utf-8")
    proposal = inspect_file(path, ROBOT).proposal
    assert proposal is not None
    return proposal


def named(pattern: str) -> list[str]:
    return [pattern.format(joint) for joint in range(1, 7)]


def test_a_file_without_time_says_what_its_columns_are(tmp_path: Path) -> None:
    given = log(duration=8.0)
    header = [*named("pos_arm_{}"), *named("torque_arm_{}")]
    proposal = propose_of(tmp_path / "run.csv", header, np.column_stack([given.q, given.tau]))
    assert [question.field for question in proposal.questions] == ["columns/t"]
    found = {guess.field: guess.value for guess in proposal.guesses}
    assert found == {"columns/q": "pos_arm_1 … pos_arm_6", "columns/tau": "torque_arm_1 … torque_arm_6"}


def test_a_file_without_time_and_torque_says_both_at_once(tmp_path: Path) -> None:
    given = log(duration=8.0)
    proposal = propose_of(tmp_path / "run.csv", named("pos_arm_{}"), given.q)
    assert [question.field for question in proposal.questions] == ["columns/t", "columns/tau"]
    assert "was the torque recorded?" in proposal.questions[1].detail


def test_positions_with_both_derivatives_are_no_torques(tmp_path: Path) -> None:
    motion = fourier_motion(ROBOT, 10.0, 100.0, 4)
    signals = {"dd": motion.ddq, "d": motion.dq, "": motion.q}
    header = ["time", *(f"{kind}thetalist{joint}" for kind in signals for joint in range(1, 7))]
    proposal = propose_of(tmp_path / "run.csv", header, np.column_stack([motion.t, *signals.values()]))
    found = {guess.field: guess.value for guess in proposal.guesses}
    assert found["columns/q"] == "thetalist1 … thetalist6"
    assert "columns/tau" not in found
    assert [question.field for question in proposal.questions] == ["columns/tau"]


def test_words_that_are_fewer_than_the_columns_below_name_none(tmp_path: Path) -> None:
    path = tmp_path / "hand.txt"
    rows = np.random.default_rng(1).normal(size=(40, 10))
    lines = [" ".join(f"{x:.6f}" for x in row[:3]) + "\t" + " ".join(f"{x:.6f}" for x in row[3:]) for row in rows]
    path.write_text("position\t\t gyroscope, right frame \t\t force sensor\n" + "\n".join(lines) + "\n")
    source = open_source(path, None)
    assert source.names == [f"column{k}" for k in range(1, 11)]
    np.testing.assert_allclose(np.concatenate(list(source.blocks())), rows, atol=1e-6)


def test_names_that_are_fewer_than_the_columns_are_not_thrown_away(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).normal(size=(40, 8))
    for delimiter in (",", " "):
        path = tmp_path / "names.txt"
        lines = [delimiter.join(f"{x:.6f}" for x in row) for row in rows]
        path.write_text("\n".join([delimiter.join(["t", "q1", "q2", "tau1", "tau2"]), *lines, ""]))
        with pytest.raises(RecordingError, match="have 8 cells, but there are 5 columns"):
            list(open_source(path, None).blocks())


def test_commas_with_tabs_beside_them_separate_decimal_points(tmp_path: Path) -> None:
    path = tmp_path / "ur.csv"
    rows = np.random.default_rng(2).normal(size=(30, 4))
    path.write_text("\n".join("\t,".join(f"{x:.6f}" for x in row) for row in rows) + "\n")
    np.testing.assert_allclose(np.concatenate(list(open_source(path, None).blocks())), rows, atol=1e-6)


def test_files_in_a_folder_with_a_plus_are_joined(tmp_path: Path) -> None:
    given, folder = log(duration=8.0), tmp_path / "lab+data"
    folder.mkdir()
    for name, values in (("q", given.q), ("tau", given.tau)):
        text = table(["t", *named(name + "{}")], cells(np.column_stack([given.t, values])))
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    # A folder called as the first part of the path is none of the files.
    (tmp_path / "lab").mkdir()
    for path in (f"{folder}/q.csv+{folder}/tau.csv", f"{folder}/q.csv+tau.csv"):
        source = open_source(Path(path), None)
        assert {"q6", "tau6"} <= set(source.names)


@pytest.mark.slow
def test_a_file_that_is_refused_while_it_is_read_ahead_ends_the_program_in_order(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    header = "a  b  c  d\n" + "1.0  2.0  3.0  4.0\n" * 30
    path.write_text(header + "0.182310  -0.068541\n" * 150_000)
    code = (
        "from pathlib import Path\nfrom dynident.recordings.formats import open_source\n"
        f"list(open_source(Path({str(path)!r}), None).blocks())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert "there are 4 columns" in run.stderr
    assert run.returncode == 1


def test_positions_within_their_limits_are_not_said_to_be_in_degrees() -> None:
    robot = arm("franka_panda")
    places = np.array([0.0, -0.4, 0.0, -2.6, 0.0, 2.0, 0.5])
    q = places + 0.3 * np.sin(np.linspace(0.0, 9.0, 200))[:, None]
    # In degrees joint 4, which cannot be stretched, would be.
    assert _leaves_limits(robot, q, np.deg2rad(q))
    assert not _leaves_limits(robot, np.rad2deg(q), q)
    assert not _leaves_limits(robot, q, q[:, [1, 0, *range(2, 7)]])


def test_an_axis_that_the_description_has_turned_is_found_whatever_the_limits_say(tmp_path: Path) -> None:
    robot = arm("franka_panda")
    given = log_of(robot, 51, duration=12.0)
    turned = np.where(np.arange(7) == 3, -1.0, 1.0)
    q = given.q * turned
    assert _leaves_limits(robot, given.q, q)
    columns = np.column_stack([given.t, q, given.tau * turned])
    path = tmp_path / "run.csv"
    header = ["t", *(f"q{k}" for k in range(1, 8)), *(f"tau{k}" for k in range(1, 8))]
    path.write_text(table(header, cells(columns)), encoding="utf-8")
    limits = [replace(joint.limits, position=(-3.2, 3.2)) for joint in robot.joints]
    wide = replace(robot, joints=tuple(replace(j, limits=own) for j, own in zip(robot.joints, limits, strict=True)))
    for one in (robot, wide):
        with pytest.raises(RecordingError, match="position and torque of"):
            import_cured(one, path, tmp_path / "read.parquet", RecordingMetadata(), most=0)


def test_friction_of_a_joint_that_carries_little_says_that_a_torque_was_measured() -> None:
    motion = fourier_motion(ROBOT, 20.0, 100.0, 5)
    still = np.zeros_like(motion.q)
    load = pinocchio_torque(ROBOT, motion.q, still, still)
    noise = 0.002 * np.abs(load).max() * np.random.default_rng(1).normal(size=load.shape)
    of_wrist = np.where(np.arange(6) > 3, 0.05, 0.0) * np.abs(load).max(axis=0).max() * np.sign(motion.dq)
    block = np.repeat(np.arange(10), len(motion.t) // 10)
    judge = HeldOutFit(ROBOT)

    def look(tau: FloatArray):
        rows = Rows(motion.q, motion.dq, motion.ddq, tau, block, motion.t)
        return find_static_torque(ROBOT, rows, judge)

    assert look(load + noise) is not None
    assert look(load + noise + of_wrist) is None


def test_two_zeros_that_explain_surely_more_are_not_another_direction_of_gravity(tmp_path: Path) -> None:
    """As of a table of Denavit and Hartenberg in which the arm stands upright at zero."""
    given = log(seed=6, duration=20.0)
    off = 0.5 * np.pi * np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0])
    path = tmp_path / "run.csv"
    columns = np.column_stack([given.t, given.q + off, given.tau])
    path.write_text(table(["t", *named("q{}"), *named("tau{}")], cells(columns)), encoding="utf-8")
    found = import_cured(ROBOT, path, tmp_path / "read.parquet", RecordingMetadata(), most=0)
    names = {check.name for check in found.checks if check.status != "ok"}
    assert "joint_zero" in names
    assert "gravity_direction" not in names


def test_a_first_moment_on_an_axis_that_rounding_tilts_is_no_base_parameter() -> None:
    text = (
        '<robot name="tilted"><link name="base"/><link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>'
        '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link><link name="fore">'
        '<inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" '
        'izz="0.1"/></inertial></link><joint name="j1" type="continuous"><parent link="base"/><child link="arm"/>'
        '<origin xyz="0 0 0" rpy="{} 3.141593 1.919862"/><axis xyz="0 0 1"/></joint><joint name="j2" '
        'type="continuous"><parent link="arm"/><child link="fore"/><origin xyz="0 0 0.2" rpy="1.570796 0 0"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    for roll, has_moment in (("-3.141593", False), ("-3.1", True)):
        robot = robot_from_urdf("tilted", text.format(roll))
        signals = Signals(robot)
        base = find_base_parameters(robot, build_columns([EffectChoice("rigid_body")], signals), signals)
        assert ("MX1" in {base.names[k] for k in base.kept}) == has_moment


@pytest.mark.parametrize("seed", [1, 2])
def test_a_wrist_that_turns_beyond_its_limits_is_in_the_unit_of_the_others(seed: int) -> None:
    motion = fourier_motion(ROBOT, 20.0, 100.0, seed)
    # More than the two turns of the description, as wrists do that turn without end.
    size = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 16.0 / np.ptp(motion.q[:, 5])])
    q, dq, ddq = motion.q * size, motion.dq * size, motion.ddq * size
    tau = pinocchio_torque(ROBOT, q, dq, ddq) + 5.0 * np.sign(dq) + dq
    columns = {"t": motion.t} | {f"q{j + 1}": q[:, j] for j in range(6)} | {f"tau{j + 1}": tau[:, j] for j in range(6)}
    found = {each.field: each.value for each in guess(ROBOT, columns).guesses}
    assert found["units/q"] == "rad"


@pytest.mark.parametrize("seed", [1, 2])
def test_columns_that_only_their_smoothness_tells_apart_are_asked_about(seed: int) -> None:
    given = log("ur10", seed, duration=8.0)
    noise = np.random.default_rng(seed).normal(size=given.tau.shape)
    asked = {}
    for kind, rough in (("noise", noise), ("torque", given.tau)):
        values = np.column_stack([given.t, given.q, rough])
        nameless = {f"column{k + 1}": values[:, k] for k in range(values.shape[1])}
        asked[kind] = [question.field for question in guess(ROBOT, nameless).questions]
    assert "columns/q" in asked["noise"]
    assert "columns/q" not in asked["torque"]


@pytest.mark.parametrize(("period", "is_asked"), [(1.3, True), (2.0 * np.pi, False)])
def test_positions_that_begin_again_where_no_turn_ends_are_to_be_unwrapped(period: float, is_asked: bool) -> None:
    given = log("ur10", 2)
    q = given.q.copy()
    q[:, 0] = np.mod(q[:, 0] - q[:, 0].mean(), period) - 0.5 * period
    asked = [question.detail for question in guess(ROBOT, given.columns(q=q)).questions]
    assert any("unwrap(q, period=1.3" in detail for detail in asked) is is_asked


def test_rows_without_a_motion_are_said_to_have_none_where_their_unit_is_asked() -> None:
    given = log("ur10", 2, duration=8.0)
    noise = np.random.default_rng(0).normal(size=given.q.shape)
    # Readings of a joint that stands go to and fro by a count, which is no counter that begins again.
    at_rest = given.q[0] + 1e-3 * np.rint(0.5 * noise)
    asked = guess(ROBOT, given.columns(q=at_rest, tau=given.tau[0] + 0.1 * noise)).questions
    assert [each.field for each in asked if each.field.startswith("columns")] == []
    assert any("no joint moves by more than 0.00" in each.detail for each in asked if each.field == "units/q")


def test_a_torque_that_stands_twice_in_a_file_is_not_asked_about() -> None:
    given = log("ur10", 2)
    dq = np.gradient(given.q, given.t, axis=0)
    values = np.column_stack([given.t, given.q, dq, given.tau, given.tau])
    twice = guess(ROBOT, {f"column{k + 1}": values[:, k] for k in range(values.shape[1])})
    assert "columns/tau" not in [question.field for question in twice.questions]
    assert twice.columns["tau1"] == "column14"
