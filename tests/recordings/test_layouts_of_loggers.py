"""Files in the layouts of many loggers: columns, order, units and times are told without a question, and read right."""

from __future__ import annotations

import re
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.controller_logs import CONTROLLER_LOGS, INTERPOLATED
from support.logger_layouts import BETWEEN_SAMPLES, LAYOUTS, WITHOUT_TIME, Recorded
from support.oracles import arm, crooked_urdf, fourier_motion, pinocchio_torque

from dynident.api.recording_files import read_recordings
from dynident.identification.column_inference.file_inspection import read_sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.unit_inference import get_factor
from dynident.recordings import RecordingError, RecordingMetadata
from dynident.recordings.formats import open_source
from dynident.recordings.time_columns import pad_fractions
from dynident.recordings.units import FACTORS
from dynident.robot import Robot, robot_from_urdf

pytestmark = pytest.mark.sweep

CASES = [("ur10", 200.0, 1), ("franka_panda", 125.0, 2), ("crooked", 250.0, 3)]
_TIMES = FACTORS["t", None]


@cache
def machine(name: str) -> Robot:
    return arm(name)


def recorded(name: str, rate: float, seed: int, duration: float = 10.0) -> Recorded:
    """Measured on a robot that moves by its description, with friction and some noise."""
    robot, rng = machine(name), np.random.default_rng(seed)
    motion = fourier_motion(robot, duration, rate, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = tau + 0.01 * np.abs(tau).max(axis=0) * (np.sign(motion.dq) + rng.normal(0.0, 0.3, tau.shape))
    slides = tuple(joint.kind == "prismatic" for joint in robot.joints)
    return Recorded(tuple(robot.joint_names), motion.t, motion.q, motion.dq, tau, slides, rng)


def read_as_proposed(path: Path, robot: Robot, rate: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t (m,), q and tau (m, n) of a file in SI, in the robot's order, as its columns and units are proposed."""
    sample = read_sample(path, rate)
    proposal = propose(sample, robot)
    assert proposal.questions == ()
    values = dict(zip(sample.names, sample.values.T, strict=True))
    signals = []
    for kind in ("q", "tau"):
        for j, joint in enumerate(robot.joints):
            unit = proposal.units.get(f"{kind}{j + 1}", proposal.units.get(kind))
            factor = 1.0 if unit is None else get_factor(kind, joint.kind, unit)
            signals.append(factor * values[proposal.columns[f"{kind}{j + 1}"]])
    t = _TIMES[proposal.units.get("t", "s")] * values[proposal.columns["t"]]
    both = np.column_stack(signals)
    return t - t[0], both[:, : robot.n], both[:, robot.n :]


@pytest.mark.sweep
@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_read_as_it_was_measured(tmp_path, layout, case):
    name, rate, _ = case
    robot, run = machine(name), recorded(*case)
    path = LAYOUTS[layout](tmp_path, run)
    check_signals(read_as_proposed(path, robot, rate if layout in WITHOUT_TIME else None), run, layout)


@pytest.mark.sweep
@pytest.mark.parametrize("layout", CONTROLLER_LOGS)
def test_a_log_of_a_controller_is_read_as_it_was_measured(tmp_path, layout):
    # The robots take turns: every layout is written by one of them.
    case = CASES[sorted(CONTROLLER_LOGS).index(layout) % len(CASES)]
    run = recorded(*case)
    check_signals(read_as_proposed(CONTROLLER_LOGS[layout](tmp_path, run), machine(case[0]), None), run, layout)


def test_rows_that_are_none_are_left_out(tmp_path):
    """Rows written twice, rows never written behind the last, and -9999 where a sample is missing."""
    run = recorded("scara", 100.0, 4)
    names, values = ["t", *columns_of(run, "q", "tau")], np.column_stack([run.t, run.q, run.tau])
    marked = np.where(run.rng.random(values.shape) < 0.005, -9999.0, values)
    marked[:, 0] = run.t
    written_to = {
        "repeated_time": np.repeat(values, 2, axis=0),
        "rows_left_out": np.vstack([values, np.zeros((700, values.shape[1]))]),
        "missing_values": marked,
    }
    for check, rows in written_to.items():
        path = write_table(tmp_path / f"{check}.csv", names, rows)
        assert propose(read_sample(path), machine("scara")).questions == ()
        (item,) = read_recordings(path, robot=machine("scara"))
        assert check in {one.name for one in item.checks if one.status == "warning"}
        frame = item._columns()
        stored = np.column_stack([frame[f"tau_{joint}"] for joint in run.joints])
        assert len(run.t) - 3 <= len(stored) <= len(run.t)
        assert np.abs(stored[:50] - run.tau[:50]).max() < 0.05 * np.abs(run.tau).max()


def test_few_numbers_far_from_all_others_are_no_poses_and_no_counts(tmp_path):
    run = recorded("ur10", 100.0, 5)
    values = np.column_stack([run.t, run.q, run.tau])
    values[[150, 420, 777], 1:] = 1e4 * run.rng.normal(size=(3, values.shape[1] - 1))
    path = write_table(tmp_path / "few.csv", ["t", *columns_of(run, "q", "tau")], values)
    proposal = propose(read_sample(path), machine("ur10"))
    assert (proposal.questions, proposal.units.get("q", "rad")) == ((), "rad")


def test_thousandths_of_radians_are_no_counts_of_an_encoder(tmp_path):
    run = recorded("ur10", 100.0, 6)
    values = np.rint(1e3 * np.column_stack([run.t, run.q, run.tau]))
    path = write_table(tmp_path / "whole.csv", ["t", *columns_of(run, "q", "tau")], values)
    assert propose(read_sample(path), machine("ur10")).units["q"] == "counts:6283"


def test_shares_of_the_joints_ranges_are_asked_about(tmp_path):
    run, robot = recorded("franka_panda", 100.0, 7), machine("franka_panda")
    low, high = np.array([joint.limits.position for joint in robot.joints]).T
    values = np.column_stack([run.t, 100.0 * (2.0 * run.q - low - high) / (high - low), run.tau])
    path = write_table(tmp_path / "shares.csv", ["t", *columns_of(run, "pos", "torque")], values)
    (question,) = propose(read_sample(path), robot).questions
    (remedy,) = question.remedies
    (item,) = read_recordings(path, robot=robot, columns=dict(propose(read_sample(path), robot).columns),
                              units=remedy.value)  # fmt: skip
    assert item._columns()[f"q_{run.joints[3]}"].max() == pytest.approx(run.q[:, 3].max(), abs=1e-3)


def test_angles_of_motors_ask_for_the_gear_ratio(tmp_path):
    run = recorded("ur10", 100.0, 8)
    values = np.column_stack([run.t, run.q * np.linspace(50.0, 120.0, run.n), run.tau])
    path = write_table(tmp_path / "motor.csv", ["t", *columns_of(run, "motor_pos_", "torque_")], values)
    questions = propose(read_sample(path), machine("ur10")).questions
    assert any("gear ratio" in question.detail for question in questions)


def test_angles_that_begin_at_zero_are_counted_from_the_start(tmp_path):
    """Zeros of the joints that the dynamics tell are found; that of the last is one with its link's parameters."""
    robot = robot_from_urdf("few", crooked_urdf(3, 4, ()))
    motion = fourier_motion(robot, 10.0, 100.0, 9)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 0.3 * np.sign(motion.dq)
    tau += 0.03 * np.random.default_rng(2).normal(size=tau.shape)
    values = np.column_stack([motion.t, motion.q - motion.q[0], tau])
    names = ["t", *(f"{signal}{k}" for signal in ("q", "tau") for k in (1, 2, 3))]
    (question,) = propose(read_sample(write_table(tmp_path / "start.csv", names, values)), robot).questions
    assert (question.field, question.check) == ("zeros", "joint_zero")
    (remedy,) = question.remedies
    assert remedy.value["q2"] == pytest.approx(-motion.q[0, 1], abs=0.02)


def test_rows_in_a_wrong_order_say_so(tmp_path):
    run = recorded("ur10", 100.0, 10)
    values = np.column_stack([run.t, run.q, run.tau])
    for row in range(0, len(values) - 1, 50):
        values[[row, row + 1]] = values[[row + 1, row]]
    path = write_table(tmp_path / "order.csv", ["t", *columns_of(run, "q", "tau")], values)
    assert "Sort the rows" in propose(read_sample(path), machine("ur10")).questions[0].detail
    # Where only times were exchanged sorting would ruin the rows.
    values = np.column_stack([run.t, run.q, run.tau])
    values[50:-1:50, 0], values[51::50, 0] = values[51::50, 0], values[50:-1:50, 0].copy()
    path = write_table(tmp_path / "times.csv", ["t", *columns_of(run, "q", "tau")], values)
    assert "Do not sort them" in propose(read_sample(path), machine("ur10")).questions[0].detail


@pytest.mark.parametrize(("rate", "start", "digits"), [(200.0, 1517383224.918554, 9), (61.3, 0.0, 9), (97.0, 41.0, 6)])
def test_zeros_behind_the_point_of_a_time_are_put_back(tmp_path, rate, start, digits):
    run = recorded("ur10", rate, 10)
    ticks = [round((start + t) * 10**digits) for t in run.t.tolist()]
    stamps = [f"{tick // 10**digits}.{tick % 10**digits}" for tick in ticks]
    rows = [",".join([stamp, *map(str, row)]) for stamp, row in zip(stamps, np.c_[run.q, run.tau], strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([",".join(["t", *columns_of(run, "q", "tau")]), *rows, ""]))
    assert not propose(read_sample(path), machine("ur10")).questions
    (item,) = read_recordings(path, robot=machine("ur10"))
    assert len(item.recording.segments) == 1
    assert 1.0 / item.recording.period == pytest.approx(rate, rel=1e-4)
    assert "lost the zeros" in next(check.detail for check in item.checks if check.status == "warning")


def test_zeros_behind_the_point_are_put_back_around_missing_times():
    t = 0.95 + 0.01 * np.arange(300)
    ticks = [round(1e9 * own) for own in t.tolist()]
    lost = np.array([float(f"{tick // 10**9}.{tick % 10**9}") for tick in ticks])
    for rows in ([0], [0, 1], [1], [149, 150], [299]):
        for missing in (np.nan, np.inf):
            given, right = lost.copy(), t.copy()
            given[rows] = right[rows] = missing
            np.testing.assert_allclose(pad_fractions(given, 0.01), right)


def check_signals(signals: tuple[np.ndarray, ...], run: Recorded, layout: str) -> None:
    """Check that t, q and tau are what was measured; the last row may be missing."""
    t, q, tau = (signal[np.isfinite(signals[0])] for signal in signals)
    assert len(t) >= len(run.t) - 1
    # Whole nanoseconds since 1970 lose their last 256 as numbers, and so do ticks since 1601.
    np.testing.assert_allclose(t, run.t[: len(t)], atol=1e-5 if layout == "filetime" else 1e-6)
    for measured, truth in ((q, run.q), (tau, run.tau)):
        wrong = np.abs(measured - truth[: len(t)])
        # Between samples a signal is read in a straight line, which smooths its noise.
        assert np.nanquantile(wrong, 0.99) < 0.02 * np.abs(truth).max()
        if layout not in BETWEEN_SAMPLES | INTERPOLATED:
            assert wrong.max() < 1e-6 * np.abs(truth).max()


@pytest.mark.parametrize("layout", ["rostopic", "sparse_topics", "json_lines", "iso_dates", "file_a_signal", "no_time"])
def test_an_import_gives_what_the_look_at_the_file_proposed(tmp_path, layout):
    case = CASES[0]
    robot, run = machine(case[0]), recorded(*case)
    path, rate = LAYOUTS[layout](tmp_path, run), case[1] if layout in WITHOUT_TIME else None
    proposal = propose(read_sample(path, rate), robot)
    files = tuple(path.parent / one for one in path.name.split("+"))
    (item,) = read_recordings(
        files,
        robot=robot,
        columns=dict(proposal.columns),
        units=dict(proposal.units),
        metadata=RecordingMetadata(rate=rate),
    )
    assert item.recording.n_samples >= len(run.t) - 2
    assert abs(item.recording.sampling_rate - case[1]) < 0.01 * case[1]
    frame = item._columns()
    for j, joint in enumerate(robot.joint_names):
        stored = frame[f"tau_{joint}"][: len(run.t)]
        assert np.corrcoef(stored, run.tau[: len(stored), j])[0, 1] > 0.99


FEW_JOINTS = {
    "pendulum": (1, (), ["position", "effort"]),
    "pendulum in degrees": (1, (), ["pos_deg", "load_Nm"]),
    "slide": (1, (0,), ["x_mm", "Fx"]),
    "German slide": (1, (0,), ["Weg [mm]", "Kraft [N]"]),
    "gantry": (3, (0, 1, 2), ["x_mm", "y_mm", "z_mm", "Fx", "Fy", "Fz"]),
    "gantry by words": (3, (0, 1, 2), ["pos_x", "pos_y", "pos_z", "force_x", "force_y", "force_z"]),
}


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("case", FEW_JOINTS)
def test_columns_of_few_joints_need_no_numbers(tmp_path, case, seed):
    n, sliding, names = FEW_JOINTS[case]
    robot = robot_from_urdf("few", crooked_urdf(n, seed + 5, sliding))
    motion = fourier_motion(robot, 10.0, 200.0, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 0.3 * np.sign(motion.dq)
    factor = 1e3 if "mm" in names[0] else 180 / np.pi if "deg" in names[0] else 1.0
    path = tmp_path / "run.csv"
    header = ",".join(["time", *names])
    np.savetxt(path, np.column_stack([motion.t, factor * motion.q, tau]), "%.9g", ",", header=header, comments="")
    proposal = propose(read_sample(path), robot)
    assert {one.field for one in proposal.questions} <= {"effort_kind", "units/q1", "units/tau", "units/tau1"}
    assert [proposal.columns[f"{kind}{j + 1}"] for kind in ("q", "tau") for j in range(n)] == names


def test_a_counter_of_rows_is_no_clock_where_another_column_is_one(tmp_path):
    run = recorded(*CASES[0])
    rows = np.arange(len(run.t))
    for name in ("", "seq", "Unnamed: 0", "time_index"):
        path = tmp_path / "run.csv"
        header = ",".join([name, "stamp_ms", *(f"q{k}" for k in range(6)), *(f"tau{k}" for k in range(6))])
        values = np.column_stack([rows, 1e3 * run.t + 0.2 * run.rng.normal(size=len(rows)), run.q, run.tau])
        np.savetxt(path, values, "%.9g", ",", header=header, comments="")
        proposal = propose(read_sample(path), machine(CASES[0][0]))
        assert proposal.columns["t"] == "stamp_ms"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04", "zip|archive"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(500), "save the sheet as CSV"),
        (b"\x80\x04\x95" + bytes(50), "never opened"),
        (b"\x1f\x8b\x08\x00" + bytes(30), "unpacked"),
        (b'{"t": [', "JSON"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        (b"\n<!doctype html>\n<html></html>", "download that itself"),
        (b"#group,false,true\n#datatype,string,long\n", "pivot"),
        (b"TDSm\x0e\0\0\0", "nptdms"),
        (b"MDF     4.10", "asammdf"),
        (b"\n\r\r\n\x1c\0\0\0", "raw frames"),
        (b"(1436509052.249713) can0 181#2A366C2B\n", "raw frames"),
        (b" (1436509052.25) can0  141   [8]  1A 70 :: Motor(Position: 1.5 deg)\n", "a line of JSON for each"),
        (b"  vcan0  080   [0]\n  vcan0  181   [8]  00 11 22 33 44 55 66 77\n", "a line of JSON for each"),
        (b"DIAEXTENDED  {@:ENGLISH\r\n#BEGINCHANNELHEADER\r\n200,Zeit\r\n", "KUKA"),
        (b"% a run\nt = [0.0;\n0.1];\n", "script"),
        (b"<?xml version='1.0'?><log/>", "XML"),
        (b"t,q,tau\n0,00,0,51,1,20\n0,01,0,52,1,21\n", "decimal commas stand between commas"),
        (b"<html><body><table border=1><tr><td>t</td>", "open it in a spreadsheet"),
        (b"{{0.1, 2.5*^-3},\n {0.2, 1.0}}", "Mathematica"),
        (b'robot = "a"\n\n[[sample]]\nt = 0.1\n', "TOML"),
        (b"-- MySQL dump\nDROP TABLE IF EXISTS `log`;\nINSERT INTO `log` VALUES (1,0.1);\n", "a dump of SQL"),
        (b"# Created by Octave 8.4.0\n# name: t\n", "Octave's text"),
        (b"run.csv".ljust(257, b"\0") + b"ustar\0", "unpack"),
    ],
)
def test_a_file_that_is_known_and_not_read_says_what_to_do(tmp_path, content, words):
    path = tmp_path / "run"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        read_sample(path)


@pytest.mark.parametrize(
    "header", ["Axis 1 [1];Axis 2 [1];Torque [Nm]", "Joint 1 [0];Joint 2 [0];pos [1]", "Encoder 100 [1];b;c"]
)
def test_a_table_whose_names_look_like_frames_of_a_bus_is_read(tmp_path, header):
    path = tmp_path / "run.csv"
    path.write_text(f"{header}\n" + "".join(f"{k / 100};{k};{k + 0.5}\n" for k in range(50)))
    assert read_sample(path).values.shape == (50, 3)


@pytest.mark.parametrize(
    ("factor", "offset", "words"), [(1.0, 1.7e9, "their clocks differ"), (1e3, 0.0, "in different units")]
)
def test_files_whose_times_do_not_belong_together_are_not_joined(tmp_path, factor, offset, words):
    run = recorded(*CASES[0])
    positions = write_table(tmp_path / "q.csv", ["time", *columns_of(run, "q")], np.column_stack([run.t, run.q]))
    t = offset + factor * run.t
    torques = write_table(tmp_path / "tau.csv", ["time", *columns_of(run, "tau")], np.column_stack([t, run.tau]))
    with pytest.raises(RecordingError, match=words):
        read_sample(Path(f"{positions}+{torques}"))


def test_a_workbook_says_how_to_save_it(tmp_path):
    path = tmp_path / "run.xlsx"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/worksheets/sheet1.xml", "<worksheet/>")
    with pytest.raises(RecordingError, match="save the sheet as CSV"):
        read_sample(path)


def test_files_of_different_lengths_and_a_file_alone_say_what_is_missing(tmp_path):
    run = recorded(*CASES[0])
    LAYOUTS["clock_in_a_file"](tmp_path, run)
    np.savetxt(tmp_path / "short.csv", run.tau[:-5])
    with pytest.raises(RecordingError, match=r"short.csv ends after \d+ rows, but .* has more"):
        read_sample(tmp_path / "t.csv+q.csv+short.csv")
    alone = propose(read_sample(tmp_path / "q.csv"), machine("ur10"))
    assert "rate" in alone.questions[0].detail
    assert "q.csv+dq.csv+tau.csv" in alone.questions[0].detail
    LAYOUTS["file_a_signal"](tmp_path, run)
    alone = propose(read_sample(tmp_path / "arm_position.csv"), machine("ur10"))
    assert [one.field for one in alone.questions] == ["columns/tau"]
    assert "q.csv+dq.csv+tau.csv" in alone.questions[0].detail


def test_a_signal_that_stops_is_not_read_across_the_gap(tmp_path):
    run = recorded(*CASES[0])
    path = LAYOUTS["sparse_topics"](tmp_path, run)
    first, *rows = path.read_text().splitlines()
    is_silent = [4.0 < float(row.split(",")[0]) - 1.7e9 < 6.0 and row.split(",")[1] == "" for row in rows]
    quiet = [row for row, silent in zip(rows, is_silent, strict=True) if not silent]
    path.write_text("\n".join([first, *quiet]))
    sample = read_sample(path)
    t = sample.values[:, 0] - 1.7e9
    torque = sample.values[:, [k for k, name in enumerate(sample.names) if name.endswith("torque")]]
    inside = (t > 4.1) & (t < 5.9)
    assert inside.sum() > 300
    assert np.isnan(torque[inside]).all()
    assert np.isfinite(torque[(t > 0.1) & (t < 3.9)]).all()


def write_table(path: Path, names: list[str], values: np.ndarray) -> Path:
    np.savetxt(path, values, "%.9g", ",", header=",".join(names), comments="")
    return path


def columns_of(run: Recorded, *signals: str) -> list[str]:
    return [f"{signal}{k + 1}" for signal in signals for k in range(run.n)]


def test_a_clock_of_whole_seconds_asks_for_the_rate_that_its_rows_have(tmp_path):
    run = recorded(*CASES[0])
    path = write_table(
        tmp_path / "s.csv", ["Time", *columns_of(run, "q", "tau")], np.column_stack([np.floor(run.t), run.q, run.tau])
    )
    (question,) = propose(read_sample(path), machine("ur10")).questions
    assert (question.field, [remedy.field for remedy in question.remedies]) == ("columns/t", ["rate"])
    assert question.remedies[0].value == pytest.approx(CASES[0][1], rel=0.01)


def test_turns_of_motors_ask_for_the_gear_ratio(tmp_path):
    run = recorded(*CASES[0])
    turns = np.column_stack([run.t, 60.0 * run.q / (2.0 * np.pi), run.tau])
    names = ["time", *(f"axis{k}.pos_estimate" for k in range(run.n)), *(f"axis{k}.torque" for k in range(run.n))]
    questions = propose(read_sample(write_table(tmp_path / "turns.csv", names, turns)), machine("ur10")).questions
    (question,) = (question for question in questions if question.field == "units/q")
    assert "turns of the motors" in question.detail
    answered = write_table(tmp_path / "again.csv", ["t", *columns_of(run, "q", "tau")], turns)
    (item,) = read_recordings(answered, robot=machine("ur10"), units={"q": "counts:60"})
    assert item._columns()["q_elbow_joint"].max() == pytest.approx(run.q[:, 2].max(), abs=0.01)


@pytest.mark.parametrize("size", [0.0, 1e-309])
def test_efforts_that_nobody_wrote_are_called_that_and_not_a_joint_that_is_missing(tmp_path, size):
    run = recorded(*CASES[0])
    names = ["time", *(f"{joint}_{signal}" for signal in ("position", "effort") for joint in run.joints)]
    values = np.column_stack([run.t, run.q, np.full(run.q.shape, size)])
    (question,) = propose(read_sample(write_table(tmp_path / "zero.csv", names, values)), machine("ur10")).questions
    assert (question.field, question.check) == ("effort_kind", "constant_torque")


def test_one_arm_of_two_is_told_which_joints_to_lock(tmp_path):
    one = crooked_urdf(3, 4, ()).partition("<robot")[2].partition(">")[2].rpartition("</robot>")[0]
    arms = [re.sub(r'(name|link)="([^"]+)"', rf'\1="{side}\2"', one) for side in ("left_", "right_")]
    bases = [re.search(r'<link name="([^"]+)"', text)[1] for text in arms]
    mounts = "".join(
        f'<joint name="mount_{base}" type="fixed"><parent link="world"/><child link="{base}"/></joint>'
        for base in bases
    )
    robot = robot_from_urdf("duo", f'<robot name="duo"><link name="world"/>{mounts}{"".join(arms)}</robot>')
    joints = [name for name in robot.joint_names if name.startswith("right_")]
    rng = np.random.default_rng(3)
    values = np.column_stack([np.arange(900) / 100, rng.normal(size=(900, 6)).cumsum(axis=0)])
    names = ["t", *(f"{joint}_{signal}" for signal in ("position", "effort") for joint in joints)]
    (question,) = propose(read_sample(write_table(tmp_path / "duo.csv", names, values)), robot).questions
    assert question.field == "robot"
    assert list(question.remedies[0].value) == [name for name in robot.joint_names if name.startswith("left_")]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,q1,tau1\n", "no row"),
        ("a,b\nx,y\nz,u\n", "No cell of the file is a number"),
    ],
)
def test_a_table_without_numbers_says_so(tmp_path, text, words):
    path = tmp_path / "run.csv"
    path.write_text(text)
    assert words in propose(read_sample(path), machine("ur10")).questions[0].detail


def test_registers_in_hexadecimal_are_numbers(tmp_path):
    path = tmp_path / "can.csv"
    path.write_text("t_ms,pos1\n" + "".join(f"{k},0x{40000 + k:04X}\n" for k in range(50)))
    assert (read_sample(path).values[:, 1] == 40000 + np.arange(50)).all()


def test_a_clock_that_is_put_back_begins_a_segment_and_rows_in_a_wrong_order_do_not(tmp_path):
    run = recorded(*CASES[0])
    t = run.t + 1.7e9
    names = ["t", *columns_of(run, "q", "tau")]

    def read(stamps: np.ndarray, rows: np.ndarray):
        path = tmp_path / "run.csv"
        text = [",".join([f"{stamp:.6f}", *map(str, values)]) for stamp, values in zip(stamps, rows, strict=True)]
        path.write_text("\n".join([",".join(names), *text, ""]))
        return read_recordings(path, robot=machine("ur10"))

    values = np.column_stack([run.q, run.tau])
    back = np.where(run.t > 6.0, t - 0.35, t)
    (item,) = read(back, values)
    (check,) = (check for check in item.checks if check.name == "time_restarts")
    assert len(item.recording.segments) == 2
    assert "1700000006.000 to 1700000005.655" in check.detail
    order = np.r_[0:500, 700:900, 500:700, 900 : len(t)]
    with pytest.raises(RecordingError, match="sort the rows"):
        read(t[order], values[order])


def test_rows_of_another_width_are_left_out_and_counted(tmp_path):
    run = recorded(*CASES[0])
    (item,) = read_recordings(CONTROLLER_LOGS["cut_off"](tmp_path, run), robot=machine("ur10"))
    (check,) = (check for check in item.checks if check.name == "layout")
    assert f"1 row, {len(run.t)}, has" in check.detail
    text = (tmp_path / "cut.csv").read_text().splitlines()
    (tmp_path / "most.csv").write_text("\n".join([text[0], *(f"{row},1" for row in text[1:-1]), ""]))
    with pytest.raises(RecordingError, match="have 14 cells, but there are 13 columns"):
        read_sample(tmp_path / "most.csv")


def test_a_clock_that_often_goes_back_is_weaker_than_another(tmp_path):
    run = recorded(*CASES[0])
    late = run.t + np.abs(run.rng.normal(0.0, 0.004, len(run.t)))
    names = ["host_time", "robot_time", *columns_of(run, "q", "tau")]
    path = write_table(tmp_path / "two.csv", names, np.column_stack([late, run.t + 3.0, run.q, run.tau]))
    assert propose(read_sample(path), machine("ur10")).columns["t"] == "robot_time"


def test_angles_that_wrap_tell_their_unit_and_slow_rows_are_not_taken_for_milliseconds(tmp_path):
    run = recorded(*CASES[0])
    names = ["t", *columns_of(run, "angle", "torque")]
    wrapped = np.column_stack([run.t, np.rad2deg(run.q) % 360.0, run.tau])
    proposal = propose(read_sample(write_table(tmp_path / "turns.csv", names, wrapped)), machine("ur10"))
    assert (proposal.questions, proposal.units["q"]) == ((), "deg")
    slow = slice(None, None, 50)
    seconds = write_table(
        tmp_path / "slow.csv", names, np.column_stack([run.t[: len(run.t[slow])] * 50, run.q[slow], run.tau[slow]])
    )
    assert propose(read_sample(seconds), machine("ur10")).units.get("t", "s") == "s"


def test_every_joint_without_a_torque_is_named(tmp_path):
    run = recorded(*CASES[0])
    names = ["t", *(f"q_{joint}" for joint in run.joints), *(f"tau_{joint}" for joint in run.joints[:4])]
    path = write_table(tmp_path / "four.csv", names, np.column_stack([run.t, run.q, run.tau[:, :4]]))
    proposal = propose(read_sample(path), machine("ur10"))
    assert (proposal.questions, [proposal.columns[f"tau{k}"] for k in (5, 6)]) == ((), ["none", "none"])


def test_a_description_in_millimetres_and_a_sensor_in_millivolts_say_so(tmp_path):
    run = recorded(*CASES[0])
    names = ["t", *columns_of(run, "q"), *(f"torque{k + 1} [mV]" for k in range(run.n))]
    path = write_table(tmp_path / "mv.csv", names, np.column_stack([run.t, run.q, 7.0 * run.tau]))
    assert any("N m per mV" in question.detail for question in propose(read_sample(path), machine("ur10")).questions)
    text = re.sub(
        r'<origin xyz="([^"]+)"',
        lambda origin: f'<origin xyz="{" ".join(f"{1e3 * float(x):g}" for x in origin[1].split())}"',
        crooked_urdf(3, 4, ()),
    )
    (question,) = propose(read_sample(path), robot_from_urdf("large", text)).questions
    assert "It would reach in mm 1.7 m. Write the lengths in the description in m." in question.detail


@pytest.mark.parametrize(
    "text",
    [
        "q: [0.1, 0.2]\ntau: [1]\n" * 50 + "q: [0.1,\n" + "0.2,\n" * 100_000,
        "q: 1\nb: 2\n" * 60 + "q: " + "9" * 6000 + "\nb: 3\n",
        "- a: 1\n  b: 2\n" * 50 + "-\n-\n- - - 1\n",
        "q: [1, 2]\ntau: [3, 4]\n" * 60 + "q: [1, 2]\ntau: [3,",
    ],
    ids=["open", "digits", "dashes", "cut"],
)
def test_damaged_printouts_are_read_as_far_as_they_go(tmp_path, text):
    path = tmp_path / "printed"
    path.write_text(text)
    assert len(read_sample(path).values) >= 50


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a:\n" + "".join(f"{' ' * k}a:\n" for k in range(1, 300)) + "b: 1\na: 1\nb: 2\n", "nested deeper than"),
        ("{'t': 0, 'q': array([1,2])}\n" * 50 + "{'t': array(" * 3000 + "\n", "cannot be read as JSON"),
    ],
    ids=["deep", "calls"],
)
def test_printouts_that_are_no_records_are_refused(tmp_path, text, words):
    path = tmp_path / "printed"
    path.write_text(text)
    with pytest.raises(RecordingError, match=words):
        read_sample(path)


@pytest.mark.parametrize("sign", [" ", ",", "\t"])
def test_signals_on_lines_of_their_own_in_turn_are_rows(tmp_path: Path, sign: str) -> None:
    path = tmp_path / "run.dat"
    values = np.round(np.random.default_rng(1).normal(size=(50, 3, 6)), 6)
    signals = ("Position", "Velocity", "Torque")
    rows = (
        [sign.join([signal, *map(str, numbers)]) for signal, numbers in zip(signals, row, strict=True)]
        for row in values
    )
    path.write_text("\n".join(line for row in rows for line in row) + "\n")
    sample = read_sample(path)
    assert sample.names == tuple(f"{signal}{j + 1}" for signal in signals for j in range(6))
    np.testing.assert_array_equal(sample.values, values.reshape(50, 18))


@pytest.mark.parametrize("time", ["time {}", "time: {}", "time,{}"])
def test_signals_in_turn_may_have_one_number_and_places_without_any(tmp_path: Path, time: str) -> None:
    path = tmp_path / "run.dat"
    rows = [[0.01 * k, 0.1 * k, "nan" if k == 3 else -k, 2 * k, "-inf" if k == 4 else 0.5] for k in range(50)]
    path.write_text("".join(f"{time.format(t)}\nPosition {a} {b}\nTorque {c} {d}\n" for t, a, b, c, d in rows))
    sample = read_sample(path)
    assert sample.names == ("time", "Position1", "Position2", "Torque1", "Torque2")
    expected = np.array(rows, dtype=float)
    np.testing.assert_array_equal(sample.values, np.where(np.isinf(expected), sample.values, expected))


@pytest.mark.parametrize("broken", ["", "Position 0.1 -", "Position 0.1 1-2-3"])
def test_a_line_that_is_missing_does_not_put_signals_of_two_rows_together(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "run.dat"
    rows = [f"Position {k} {k + 0.5}\nTorque {-k} {-k - 0.5}\n" for k in range(6000)]
    rows[5000] = rows[5000].replace("Position 5000 5000.5", broken)
    path.write_text("".join(rows))
    values = np.concatenate([np.asarray(block) for block in open_source(path, None).blocks()])
    assert len(values) == 6000
    whole = np.isfinite(values).all(axis=1)
    assert np.count_nonzero(~whole) == 1
    np.testing.assert_array_equal(values[whole, 0], -values[whole, 2])


def test_words_before_rows_that_come_in_no_order_are_states(tmp_path: Path) -> None:
    path = tmp_path / "run.dat"
    states = ["idle" if k < 20 else "moving" for k in range(60)]
    path.write_text("".join(f"{state},{0.01 * k:.2f},{k * 0.1:.1f},{k}\n" for k, state in enumerate(states)))
    assert len(read_sample(path).values) == 60


def test_lists_below_names_that_a_separator_ends_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = "".join(f'{0.01 * k:.2f},"({k}, {2 * k}, 0.5)",{-k}\n' for k in range(40))
    path.write_text("# a remark\ntime [s],position,torque,\n" + rows)
    sample = read_sample(path)
    assert sample.names == ("time [s]", "position1", "position2", "position3", "torque")
    np.testing.assert_array_equal(sample.values[7, 1:], [7.0, 14.0, 0.5, -7.0])


def test_rows_of_several_kinds_below_one_line_of_names_say_so(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    pages = "".join(f"{k},1,2,3\n" for k in range(10)) + "".join(f"{k},1\n" for k in range(30))
    path.write_text("time,q1,q2,q3\n" + pages)
    with pytest.raises(RecordingError, match="have 2 cells, but there are 4 columns: the file has rows of several"):
        read_sample(path)
