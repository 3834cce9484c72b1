"""Motors that act on several joints: a wrist whose last motor turns with the joint before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import arm, fourier_motion

from dynident.errors import DynidentError
from dynident.recordings import RecordedJoints, RecordingMetadata, import_recording
from dynident.robot import Drive, coupling_matrix, library_table, robot_from_modified_dh
from dynident.robot.description_and_json import robot_from_document, robot_to_document
from dynident.robot.robot_model import compute_currents

NAMES = arm("ur10").joint_names
GAINS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
DRIVES = {name: Drive(gain) for name, gain in zip(NAMES, GAINS, strict=True)}


def coupled(**coupling: dict[str, float]):
    drives = {name: replace(drive, coupling=coupling.get(name, {})) for name, drive in DRIVES.items()}
    return robot_from_modified_dh("coupled", library_table("ur10"), drives=drives)


WRIST = coupled(wrist_3_joint={"wrist_2_joint": 1.0})


def test_a_motor_of_the_wrist_acts_on_two_joints():
    matrix = coupling_matrix(WRIST)
    expected = np.eye(6)
    expected[5, 4] = 1.0
    np.testing.assert_array_equal(matrix, expected)
    assert coupling_matrix(coupled()) is None


@given(seed=st.integers(0, 1000))
@settings(max_examples=50, deadline=None)
def test_motors_and_joints_give_the_same_power(seed):
    rng = np.random.default_rng(seed)
    robot = coupled(
        wrist_3_joint={"wrist_2_joint": float(rng.normal()), "wrist_1_joint": float(rng.normal())},
        wrist_2_joint={"wrist_1_joint": float(rng.normal())},
    )
    tau, dq = rng.normal(size=(2, 7, 6))
    motor_speeds = dq @ coupling_matrix(robot).T
    by_motors = np.sum(compute_currents(robot, tau) * np.array(GAINS) * motor_speeds, axis=1)
    np.testing.assert_allclose(by_motors, np.sum(tau * dq, axis=1), rtol=1e-9, atol=1e-12)


def test_currents_of_a_coupled_wrist_are_read_as_joint_torques(tmp_path):
    motion = fourier_motion(WRIST, 5.0, 200.0, 1)
    rng = np.random.default_rng(2)
    tau = motion.dq * rng.uniform(1, 5, 6) + motion.ddq + rng.normal(size=6)
    u = compute_currents(WRIST, tau)
    table = {"t": motion.t}
    table |= {f"q{j + 1}": motion.q[:, j] for j in range(6)}
    table |= {f"current{j + 1}": u[:, j] for j in range(6)}
    pq.write_table(pa.table(table), tmp_path / "in.parquet")
    recording, checks = import_recording(
        tmp_path / "in.parquet",
        tmp_path / "out.parquet",
        RecordedJoints(NAMES, gains=GAINS, coupling=coupling_matrix(WRIST)),
        metadata=RecordingMetadata(accept=("torque_sign", "torque_order")),
    )
    (rows,) = recording.source.rows(0, len(motion.t), 10**6)
    np.testing.assert_allclose(rows.tau, tau, rtol=1e-9, atol=1e-9)
    assert any("coupled to several joints" in check.detail for check in checks)


def test_torque_columns_are_joint_torques_already(tmp_path):
    motion = fourier_motion(WRIST, 5.0, 200.0, 1)
    tau = 2.0 * motion.dq + motion.ddq
    table = {"t": motion.t}
    table |= {f"q{j + 1}": motion.q[:, j] for j in range(6)}
    table |= {f"tau{j + 1}": tau[:, j] for j in range(6)}
    pq.write_table(pa.table(table), tmp_path / "in.parquet")
    recording, _ = import_recording(
        tmp_path / "in.parquet",
        tmp_path / "out.parquet",
        RecordedJoints(NAMES, coupling=coupling_matrix(WRIST)),
        metadata=RecordingMetadata(accept=("torque_sign", "torque_order")),
    )
    (rows,) = recording.source.rows(0, len(motion.t), 10**6)
    np.testing.assert_array_equal(rows.tau, tau)


def test_a_stored_robot_keeps_its_coupling():
    again = robot_from_document(robot_to_document(WRIST))
    np.testing.assert_array_equal(coupling_matrix(again), coupling_matrix(WRIST))


@pytest.mark.parametrize(
    ("other", "share", "word"),
    [
        ("wrist_3_joint", 1.0, "cannot be coupled to 'wrist_3_joint'"),
        ("elbow", 1.0, "cannot be coupled to 'elbow'"),
    ],
)
def test_couplings_that_make_no_sense_are_refused(other, share, word):
    with pytest.raises(DynidentError, match=word) as caught:
        coupled(wrist_3_joint={other: share})
    assert caught.value.pointer == f"/drives/wrist_3_joint/coupling/{other}"
