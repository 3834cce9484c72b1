"""Recordings of real robots come in, and the checks find what is known of them and nothing else."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from dynident.identification.recording_faults.fault_checks import build_dynamics_checks
from dynident.number_format import format_percent
from dynident.recordings import (
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    choose_preprocessing,
    import_recording,
    phase_shares,
)
from dynident.robot import Robot, robot_from_urdf

DATA = Path(__file__).parents[3] / "shared" / "data"
JOINTS = tuple(f"joint{number}" for number in range(1, 7))
WITH_ROBOT = ("dfki_double_pendulum", "kinova_gen3")
MOTION = ((6.76, 37.38),)  # seconds of id_30s_12harm in which the arm follows its trajectory
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)

pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of real robots (../shared/data) are absent"),
]


def imported(path: Path, destination: Path, **metadata):
    friction = path.parent.name == "joint_friction"
    if friction:
        metadata |= {"columns": {"tau1": "tau_fric1"}, "role": "friction"}
    if "sweep" in path.stem:
        metadata["role"] = "friction"
    n_joints = sum(re.fullmatch(r"q\d+", name) is not None for name in pq.read_schema(path).names)
    names = ("joint",) if friction else tuple(f"joint{number}" for number in range(1, n_joints + 1))
    gains = GAINS if len(names) == len(GAINS) else (None,) * len(names)
    # Without its robot an elastic arm looks like one whose torque has the opposite sign; nobody imports it so.
    described = DATA / path.parent.name / "robot.urdf"
    against = build_dynamics_checks(robot_of(described)) if path.parent.name in WITH_ROBOT else None
    joints = RecordedJoints(robot_of(described).joint_names if against else names, gains=gains)
    metadata = RecordingMetadata(path.stem, **metadata)
    return import_recording(path, destination, joints, metadata=metadata, against=against)


@cache
def robot_of(described: Path) -> Robot:
    (path,) = [described] if described.exists() else described.parent.glob("*.urdf")
    return robot_from_urdf(path.parent.name, path.read_text(encoding="utf-8"))


def all_files() -> list[Path]:
    return sorted(DATA.glob("*/*.parquet"))


def known(path: Path) -> set[str]:
    """What is peculiar in a file, by the name of the check that should say it."""
    peculiar = {
        "ur10e": {"sampling_jitter"},
        "tx40": {"torque_delay"},
        "airbot_play": {"torque_delay"},
        "joint_friction": {"sampling_jitter", "gaps", "velocity_unit"},
        "dfki_double_pendulum": {"sampling_jitter", "quantisation"},
        "kinova_gen3": {"sampling_jitter", "gaps"},
    }
    return peculiar.get(path.parent.name, set())


@pytest.mark.sweep
@pytest.mark.parametrize("path", all_files(), ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_every_recording_comes_in_and_raises_no_false_alarm(path, tmp_path):
    recording, checks = imported(path, tmp_path / "stored")
    warned = {check.name for check in checks if check.status != "ok"}
    assert warned <= known(path), [check for check in checks if check.status != "ok"]
    # Short gaps are filled.
    filled = 0.03 if "gaps" in warned else 0.02
    assert abs(recording.n_samples - pq.read_metadata(path).num_rows) < filled * recording.n_samples


@pytest.mark.parametrize(
    ("name", "must"),
    [
        ("ur10e/id_30s_12harm", {"sampling_jitter"}),
        ("ur10e/val_ptp10", {"sampling_jitter"}),
        ("tx40/all", {"torque_delay"}),
        ("airbot_play/id_chirp_unloaded", {"torque_delay"}),
    ],
)
def test_what_is_known_of_a_recording_is_found(name, must, tmp_path):
    _, checks = imported(DATA / f"{name}.parquet", tmp_path / "stored")
    assert must <= {check.name for check in checks if check.status == "warning"}


def test_the_delays_that_are_known_come_out(tmp_path):
    for name, low, high in (("airbot_play/id_chirp_unloaded", 0.005, 0.015), ("tx40/all", -0.006, -0.001)):
        _, checks = imported(DATA / f"{name}.parquet", tmp_path / "stored")
        detail = next(check.detail for check in checks if check.name == "torque_delay")
        assert low < float(detail.split('"torque_delay": ')[1].split(" ")[0]) < high


def test_standstill_is_told_joint_by_joint_and_is_no_warning(tmp_path):
    recording, checks = imported(DATA / "ur10e" / "val_ptp10.parquet", tmp_path / "stored")
    (check,) = (check for check in checks if check.name == "standstill")
    assert check.status == "ok"
    # A motion from point to point: every joint rests between the points.
    shares = phase_shares(recording).standing
    assert all(
        f"{name} {format_percent(float(share), 2)}" in check.detail for name, share in zip(JOINTS, shares, strict=True)
    )


def changed(tmp_path: Path, change) -> Path:
    table = pq.read_table(DATA / "ur10e" / "id_30s_12harm.parquet")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    change(columns)
    import pyarrow as pa

    pq.write_table(pa.table(columns), tmp_path / "changed.parquet")
    return tmp_path / "changed.parquet"


@pytest.mark.sweep
@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5, 6])
def test_a_current_of_the_wrong_sign_is_refused(joint, tmp_path):
    def turn(columns):
        columns[f"current{joint}"] = -columns[f"current{joint}"]

    with pytest.raises(RecordingError) as caught:
        imported(changed(tmp_path, turn), tmp_path / "stored", windows=MOTION)
    assert (caught.value.title, caught.value.pointer) == ("Torque sign", f"current{joint}")


@pytest.mark.parametrize("pair", [(1, 4), (2, 3), (3, 5), (4, 6), (5, 6)])
def test_currents_in_another_order_are_refused(pair, tmp_path):
    def swap(columns):
        first, second = (f"current{joint}" for joint in pair)
        columns[first], columns[second] = columns[second], columns[first]

    with pytest.raises(RecordingError) as caught:
        imported(changed(tmp_path, swap), tmp_path / "stored")
    assert caught.value.title == "Torque order"


@pytest.mark.parametrize("kind", ["q", "dq"])
def test_degrees_beside_radians_are_refused(kind, tmp_path):
    def turn(columns):
        for joint in range(1, 7):
            columns[f"{kind}{joint}"] = np.degrees(columns[f"{kind}{joint}"])

    with pytest.raises(RecordingError, match="deg"):
        imported(changed(tmp_path, turn), tmp_path / "stored")


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("ur10e/id_30s_12harm", 4.0, 8.0),
        ("ur10/exciting_traj", 3.0, 8.0),
        ("airbot_play/id_chirp_unloaded", 3.0, 8.0),
        ("tx40/all", 25.0, 60.0),
    ],
)
def test_the_filter_that_is_chosen_suits_the_robot(name, low, high, tmp_path):
    recording, _ = imported(DATA / f"{name}.parquet", tmp_path / "stored")
    chosen = choose_preprocessing([recording])
    assert low <= chosen.torque_cutoff <= high
    assert chosen.torque_cutoff <= chosen.position_cutoff <= 1.5 * chosen.torque_cutoff
