"""Commands and positions of servos, and no torque: proposed, identified with a stated gain, judged honestly."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support import vendor_logs
from support.running_commands import dynident
from support.servo_arm import RATE, make_exact_log, write_log
from support.vendor_logs import Signals

import dynident as dy
from dynident.array_types import FloatArray
from dynident.export import export_model
from dynident.identification import identify_gains
from dynident.presentation.model_tables import get_gain_unit
from dynident.recordings import RecordingMetadata
from dynident.validation import ValidationOutcome
from dynident.verdict import Outcome

GAIN = 8.0
COMMANDS = RecordingMetadata(effort_kind="position_command")


@pytest.fixture(scope="module")
def arm() -> dy.Robot:
    return dy.load_robot("so101")


@pytest.fixture(scope="module")
def logs(arm: dy.Robot, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("servos")
    return [write_log(folder / f"run{seed}.csv", *make_exact_log(arm, seed, GAIN)) for seed in (1, 2)]


@pytest.fixture(scope="module")
def model(arm: dy.Robot, logs: list[Path]) -> dy.Model:
    first, second = (dy.read_recordings(log, robot=arm, drive_gains=[GAIN] * 6, metadata=COMMANDS) for log in logs)
    return dy.identify(arm, first, validation=second)


def write_data_set(folder: Path, q: FloatArray, commands: FloatArray, robot: dy.Robot) -> Path:
    """Write two episodes in degrees, as LeRobot does."""
    m = len(q) // 2
    nothing = np.zeros_like(q[:m])
    episodes = [
        Signals(
            t=np.arange(m) / RATE,
            q=np.degrees(q[k * m : (k + 1) * m]),
            q_command=np.degrees(commands[k * m : (k + 1) * m]),
            **dict.fromkeys(("dq", "tau", "current", "tau_command", "current_command", "external"), nothing),
        )
        for k in range(2)
    ]
    return vendor_logs.lerobot(episodes, folder, list(robot.joint_names), effort=False)


def test_a_data_set_of_lerobot_without_torque_is_proposed_and_only_its_gains_are_asked_for(tmp_path, arm):
    q, commands = make_exact_log(arm, 3, GAIN)
    path = write_data_set(tmp_path / "set", q, commands, arm)
    found = dy.inspect(path, arm)
    assert found.inspection.proposal.effort_kind == "position_command"
    assert found.said["columns"]["q_command2"] == "action.shoulder_lift.pos"
    assert {"q": "deg", "q_command": "deg"}.items() <= found.said["units"].items()
    (question,) = found.questions
    assert question.field == "drives"
    # The masses of the description are those of this arm.
    (described,) = re.findall(r"need gains of ([\d.]+) \(", question.detail)
    assert float(described) == pytest.approx(GAIN, rel=0.05)
    assert "no error shows it" in question.detail
    known = dy.inspect(path, arm, drive_gains=[GAIN] * 6)
    assert known.questions == ()
    (read,) = dy.read_recordings(path, robot=arm, drive_gains=[GAIN] * 6, **known.said)
    assert read.recording.torque_from_commands
    assert len(read.recording.segments) == 2


def test_commands_stand_in_for_a_load_that_no_servo_wrote(tmp_path, arm):
    """A logger of several makes of servos has a column for what only some of them measure."""
    q, commands = make_exact_log(arm, 3, GAIN)
    names = [f"{kind}{joint}" for kind in ("position", "goal_position", "load") for joint in range(1, 7)]
    rows = np.column_stack([np.arange(len(q)) / RATE, q, commands, np.zeros_like(q)])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *names]), comments="")
    found = dy.inspect(path, arm)
    assert found.inspection.proposal.effort_kind == "position_command"
    assert [question.field for question in found.questions] == ["drives"]


@pytest.mark.parametrize("ahead", [0.0, 1.0])
def test_commands_that_echo_the_positions_are_no_torque_and_those_that_lead_leave_a_way_for_a_swing(
    tmp_path, arm, ahead
):
    """A robot that is moved by hand, or swings, has a command that follows it."""
    q, commands = make_exact_log(arm, 3, GAIN)
    names = [f"{kind}{joint}" for kind in ("position", "goal_position", "load") for joint in range(1, 7)]
    rows = np.column_stack([np.arange(len(q)) / RATE, q, q + ahead * (commands - q), np.zeros_like(q)])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *names]), comments="")
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        proposal = dy.inspect(path, arm).inspection.proposal
    if not ahead:
        (question,) = proposal.questions
        assert (question.field, question.check) == ("effort_kind", "constant_torque")
        return
    (silent,) = (guess for guess in proposal.guesses if guess.field == "columns/tau")
    assert [remedy.field for remedy in silent.remedies] == ["columns", "effort_kind", "accept"]
    assert silent.remedies[0].value == {f"tau{joint}": f"load{joint}" for joint in range(1, 7)}


RANGES = np.array([2400, 2360, 2200, 2340, 4095, 1463])
"""Counts between range_min and range_max of a calibration file."""


def as_lerobot_writes(counts: FloatArray, *, use_degrees: bool) -> FloatArray:
    """Return positions (m, 6) in LeRobot's numbers; the gripper is a share of its range in either case."""
    scale = np.full(6, 360.0 / 4095.0) if use_degrees else 200.0 / RANGES
    scale[5] = 100.0 / RANGES[5]
    return np.radians(counts * scale)


@pytest.mark.parametrize("use_degrees", [True, False])
def test_shares_of_the_calibrated_range_are_told_from_degrees_by_their_steps(tmp_path, arm, use_degrees):
    q, commands = (np.rint(part * 4096.0 / (2.0 * np.pi)) for part in make_exact_log(arm, 3, GAIN))
    written, sent = (as_lerobot_writes(counts, use_degrees=use_degrees) for counts in (q, commands))
    path = write_data_set(tmp_path / "set", written, sent, arm)
    found = dy.inspect(path, arm, drive_gains=[GAIN] * 6)
    assert found.questions == ()
    (read,) = dy.read_recordings(path, robot=arm, drive_gains=[GAIN] * 6, **found.said)
    table = pq.read_table(read.recording.path)
    read_back = np.column_stack([table[f"q_{joint}"].to_numpy() for joint in arm.joint_names])
    # The rows of the first episode lie between those of the file, where the commands act.
    true = 0.5 * (q[: len(q) // 2 - 1] + q[1 : len(q) // 2]) * 2.0 * np.pi / 4096.0
    assert read_back[: len(true)] == pytest.approx(true, abs=2e-3)
    assert (found.said["units"]["q1"] == "deg") == use_degrees
    assert found.said["units"]["q6"] == found.said["units"]["q_command6"] == f"counts:{4096 * 100 / RANGES[5]:.4f}"


def test_the_unit_of_a_joint_that_stands_is_asked_for_beside_shares(tmp_path, arm):
    q, commands = (np.rint(part * 4096.0 / (2.0 * np.pi)) for part in make_exact_log(arm, 3, GAIN))
    q[:, 4] = commands[:, 4] = 40.0
    written, sent = (as_lerobot_writes(counts, use_degrees=False) for counts in (q, commands))
    path = write_data_set(tmp_path / "set", written, sent, arm)
    (question,) = dy.inspect(path, arm, drive_gains=[GAIN] * 6).questions
    assert question.field == "units/q5"
    assert "range_max - range_min" in question.detail


def test_steps_of_rounded_degrees_are_no_shares(tmp_path, arm):
    q, commands = (np.radians(np.round(np.degrees(part), 1)) for part in make_exact_log(arm, 3, GAIN))
    found = dy.inspect(write_data_set(tmp_path / "set", q, commands, arm), arm, drive_gains=[GAIN] * 6)
    assert found.said["units"]["q"] == "deg"


def test_commands_that_no_joint_follows_are_not_taken(tmp_path, arm):
    q, commands = make_exact_log(arm, 1, GAIN, 20.0)
    path = write_log(tmp_path / "run.csv", q, np.roll(commands, len(q) // 3, axis=0))
    assert [question.field for question in dy.inspect(path, arm).questions] == ["columns/tau"]


def test_commands_without_numbers_are_not_taken(tmp_path, arm):
    q, commands = make_exact_log(arm, 1, GAIN, 20.0)
    path = write_log(tmp_path / "run.csv", q, np.full_like(commands, np.nan))
    found = dy.inspect(path, arm)
    assert found.inspection.proposal.effort_kind != "position_command"


def test_the_servos_law_gives_friction_and_load_of_the_arm(model):
    values = {parameter.name: parameter.value for parameter in model.identification.parameters}
    assert [values[f"Fc{k}"] for k in range(1, 7)] == pytest.approx([0.1] * 6, rel=0.1)
    assert [values[f"Fv{k}"] for k in range(1, 7)] == pytest.approx([0.7] * 6, rel=0.03)
    assert model.identification.held_out.relative_total < 0.02


def test_gains_that_are_half_as_large_halve_the_model_and_no_error_shows_it(arm, logs, model):
    first, second = (dy.read_recordings(log, robot=arm, drive_gains=[GAIN / 2] * 6, metadata=COMMANDS) for log in logs)
    halved = dy.identify(arm, first, validation=second)
    assert halved.identification.values == pytest.approx(0.5 * model.identification.values, rel=5e-3, abs=5e-5)
    errors = [one.identification.held_out.relative_total for one in (halved, model)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)


def test_the_recording_and_the_verdict_say_what_cannot_be_known(model):
    (source,) = [check for check in model.recordings[0].checks if check.name == "torque_source"]
    assert source.status == "warning"
    assert "back-EMF" in source.detail
    verdict = model.verdict()
    assert all(use.state != "yes" for use in verdict.uses)
    assert all("if the drive gains are wrong" in use.reason for use in verdict.uses if use.state == "limited")
    assert not any(use.next_action == "diagnose" for use in verdict.uses)
    assert not any("iagnose" in step for step in verdict.next_steps)


def test_a_model_that_was_stored_still_says_where_its_torque_came_from(tmp_path, model):
    path = tmp_path / "arm.npz"
    model.save(path)
    stored = dy.load_model(path)
    assert any("computed from the commands" in warning for warning in stored.warnings)
    verdict = stored.verdict()
    assert all("if the drive gains are wrong" in use.reason for use in verdict.uses if use.state == "limited")
    assert not any(use.next_action == "diagnose" for use in verdict.uses)
    assert not any("iagnose" in step for step in verdict.next_steps)


@pytest.mark.parametrize("kind", ["c", "json", "urdf"])
def test_exports_say_where_the_torque_came_from(model, kind):
    exported = export_model(model.identification, kind)
    assert any("computed from the commands" in note for note in exported.notes)
    assert kind == "urdf" or b"computed from the commands" in exported.content


def test_a_load_that_came_out_right_confirms_the_gains(model):
    weighed = [Outcome("payload", ValidationOutcome("pass", "The load weighs 0.15 kg."))]
    before, after = (model.verdict(outcomes).uses for outcomes in ([], weighed))
    assert any("if the drive gains are wrong" in use.reason for use in before)
    assert not any("if the drive gains are wrong" in use.reason for use in after)


def test_a_diagnosis_is_refused_with_its_reason(model):
    with pytest.raises(dy.DynidentError, match="no torque was recorded") as refused:
        dy.diagnose(model, model.recordings)
    assert "Present_Current" in refused.value.detail


def test_the_command_line_asks_identifies_and_refuses_a_diagnosis(tmp_path, logs):
    gains = ("--drive-gains", ",".join(["8"] * 6))
    asked = dynident("identify", "so101", logs[0], "--as-proposed", "--out", tmp_path / "arm.npz")
    assert asked.code != 0
    assert "--drive-gains" in asked.err
    assert "N m/rad" in asked.err
    made = dynident("identify", "so101", logs[0], "--as-proposed", *gains, "--out", tmp_path / "arm.npz")
    assert made.code == 0, made.err
    refused = dynident("diagnose", tmp_path / "arm.npz", logs[0], "--as-proposed")
    assert refused.code != 0
    assert "no torque was recorded" in refused.err


def test_gains_of_servos_are_per_radian(arm: dy.Robot, logs: list[Path]) -> None:
    plain, heavy = (
        dy.read_recordings(log, robot=arm, drive_gains=[GAIN] * 6, metadata=COMMANDS).recordings[0] for log in logs
    )
    of_servos = identify_gains(arm, [plain], [replace(heavy, payload={"mass": 0.1})])
    assert of_servos.from_commands
    machine = replace(arm, drives=tuple(dy.Drive(drive_gain=GAIN) for _ in range(arm.n)))
    assert get_gain_unit(machine, 0, of_servos.from_commands) == "N m/rad"
    assert get_gain_unit(machine, 0) == "N m/A"
