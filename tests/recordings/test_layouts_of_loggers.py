"""Files in the layouts of many loggers: columns, order, units and times are told without a question, and read right."""

from __future__ import annotations

import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.logger_layouts import BETWEEN_SAMPLES, LAYOUTS, WITHOUT_TIME, Recorded
from support.oracles import arm, crooked_urdf, fourier_motion, pinocchio_torque

from dynident.api.recording_files import read_recordings
from dynident.identification.column_inference.file_inspection import read_sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.unit_inference import get_factor
from dynident.recordings import RecordingError, RecordingMetadata
from dynident.robot import Robot, robot_from_urdf

pytestmark = pytest.mark.sweep

CASES = [("ur10", 200.0, 1), ("franka_panda", 125.0, 2), ("crooked", 250.0, 3)]
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@cache
def machine(name: str) -> Robot:
    return arm(name)


def recorded(name: str, rate: float, seed: int) -> Recorded:
    """Measured on a robot that moves by its description, with friction and some noise."""
    robot, rng = machine(name), np.random.default_rng(seed)
    motion = fourier_motion(robot, 10.0, rate, seed)
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
    t, q, tau = read_as_proposed(path, robot, rate if layout in WITHOUT_TIME else None)
    # Whole nanoseconds since 1970 lose their last 256 as numbers.
    np.testing.assert_allclose(t, run.t[: len(t)], atol=1e-6)
    for measured, truth in ((q, run.q), (tau, run.tau)):
        wrong = np.abs(measured - truth[: len(t)])
        # Between samples a signal is read in a straight line, which smooths its noise.
        assert np.quantile(wrong, 0.99) < 0.02 * np.abs(truth).max()
        if layout not in BETWEEN_SAMPLES:
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
        (b"header:\n  stamp:\n    sec: 1\n---\n", "--csv TOPIC"),
        (b"\x1f\x8b\x08\x00" + bytes(30), "unpacked"),
        (b'{"t": [', "JSON"),
    ],
)
def test_a_file_that_is_known_and_not_read_says_what_to_do(tmp_path, content, words):
    path = tmp_path / "run"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        read_sample(path)


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
