"""Columns of a base that moves: its pose by the names of loggers, angles of its quaternion, wrenches on links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.floating_robots import WALKER, build_model, compute_motor_torque, draw_motion, stand_on_shin, write_log

import dynident as dy
from dynident.errors import DynidentError
from dynident.identification.robot_recording_import import build_recorded_joints
from dynident.recordings import RecordingMetadata
from dynident.recordings.base_motion import find_base_columns
from dynident.recordings.conditioning.angle_wrapping import compute_base_angles
from dynident.robot import Robot
from dynident.robot.forward_kinematics import project_wrench

PLAIN = ("base_x", "base_y", "base_z", "base_qx", "base_qy", "base_qz", "base_qw")


def walker(tmp_path: Path, base: str = "floating") -> Robot:
    (tmp_path / "walker.urdf").write_text(WALKER)
    return dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), base)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "pattern",
    [
        ("base_x", "base_qx"),
        ("base_pos_x", "base_quat_x"),
        ("root_pos.x", "root_quat.x"),
        ("/odom.pose.pose.position.x", "/odom.pose.pose.orientation.x"),
        ("pelvis position x", "pelvis orientation x"),
        ("root_pos_0", "root_rot_x"),
    ],
)
def test_the_pose_is_found_by_the_names_that_loggers_give_it(pattern: tuple[str, str]) -> None:
    position, orientation = pattern
    names = [position[:-1] + letter for letter in ("012" if position.endswith("0") else "xyz")]
    names += [orientation[:-1] + letter for letter in "wxyz"]
    others = ["base_fx", "base_mz", "base_vel_x", "odom.twist.twist.linear.x", "q1", "tcp_x", "target_base_x"]
    found = find_base_columns([*others, *names], RecordingMetadata())
    assert found == {
        **dict(zip(("base_x", "base_y", "base_z"), names[:3], strict=True)),
        **{f"base_q{letter}": orientation[:-1] + letter for letter in "xyzw"},
    }


def test_numbered_quaternions_are_not_guessed_and_what_is_stated_goes_first() -> None:
    names = [f"root_quat_{k}" for k in range(4)] + ["base_x", "base_y", "base_z", "mocap_x"]
    found = find_base_columns(names, RecordingMetadata(columns={"base_x": "mocap_x"}))
    assert found == {"base_x": "mocap_x", "base_y": "base_y", "base_z": "base_z"}


@pytest.mark.parametrize(
    "name",
    [
        *("left_foot_accelerometer_", "tool_accelerometer_", "wrist_imu_acc_", "imu_wrist_accel_", "shin_base_acc_"),
        *("gripper_imu_linear_acceleration_", "foot_imu_pos_", "mocap_ball_", "imu_gyroscope_", "arm_body_position_"),
    ],
)
def test_sensors_of_other_parts_are_not_those_of_the_base(tmp_path: Path, name: str) -> None:
    joints = build_recorded_joints(walker(tmp_path))
    strange = [name + axis for axis in "xyz"]
    assert not find_base_columns(strange, RecordingMetadata(), joints)
    imu = {f"base_acc_{axis}": f"imu_raw.acc[{axis}]" for axis in "xyz"}
    assert find_base_columns([*strange, *imu.values()], RecordingMetadata(), joints) == imu


def test_of_accelerometers_that_are_as_likely_none_is_taken() -> None:
    first, second, trunk = ([name + axis for axis in "xyz"] for name in ("imu1_imu_acc_", "imu_raw_acc_", "trunk_acc_"))
    first = [name.replace("imu1_", "imu_1_") for name in first]
    assert not find_base_columns([*first, *second], RecordingMetadata())
    assert list(find_base_columns([*first, *second, *trunk], RecordingMetadata()).values()) == trunk


def test_angles_are_those_of_the_rotation_and_near_the_pole_there_are_none() -> None:
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1, 1, (50, 3)) * np.array([np.pi, 1.2, np.pi])
    turns = [pin.Quaternion(pin.rpy.rpyToMatrix(roll, pitch, yaw)) for yaw, pitch, roll in angles]
    coefficients = np.array([turn.coeffs() for turn in turns]) * rng.choice([-1.0, 1.0, 2.0], (50, 1))
    np.testing.assert_allclose(compute_base_angles(coefficients), angles, atol=1e-12)
    steep = pin.Quaternion(pin.rpy.rpyToMatrix(0.1, 1.4, 0.2)).coeffs()
    assert np.isnan(compute_base_angles(np.array([steep, np.zeros(4)]))).all()


def test_wrenches_become_torques_by_pinocchios_jacobians(tmp_path: Path) -> None:
    robot, model = walker(tmp_path), build_model()
    data, motion = model.createData(), draw_motion(2, 1.0, 50.0)
    wrench = np.random.default_rng(3).normal(size=(len(motion.t), 6))
    turns = compute_base_angles(motion.q[:, 3:7])
    q = np.hstack([motion.q[:, :3], turns, motion.q[:, 7:]])
    joints = build_recorded_joints(robot)
    assert joints.links == ("trunk", "thigh", "shin", "arm")
    assert joints.project_wrench is not None
    for link, index in (("trunk", 5), ("shin", 7), ("arm", 8)):
        ours = project_wrench(robot, q, index, wrench)
        np.testing.assert_array_equal(joints.project_wrench(link, q, wrench, False), ours)
        for k in range(len(q)):
            pin.framesForwardKinematics(model, data, motion.q[k])
            placement = data.oMf[model.getFrameId(link)]
            local = pin.computeFrameJacobian(model, data, motion.q[k], model.getFrameId(link), pin.ReferenceFrame.LOCAL)
            torque = local.T @ wrench[k]
            np.testing.assert_allclose(ours[k, 6:], torque[6:], atol=1e-10)
            # Along the axes of the world the force on the base is that of Pinocchio's twist, turned.
            np.testing.assert_allclose(ours[k, :3], placement.rotation @ wrench[k, :3], atol=1e-10)
            in_world = project_wrench(
                robot, q[k : k + 1], index, placement.act(pin.Force(wrench[k])).vector[None], in_world=True
            )
            np.testing.assert_allclose(in_world[0], ours[k], atol=1e-10)


@pytest.mark.parametrize(
    "pose", [PLAIN, ("root_pos_x", "root_pos_y", "root_pos_z", "root_qx", "root_qy", "root_qz", "root_qw")]
)
def test_a_log_is_read_with_the_joints_counted_from_one(tmp_path: Path, pose: tuple[str, ...]) -> None:
    robot, motion = walker(tmp_path), draw_motion(4, 4.0)
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "log.csv", motion, torque, {"base": wrench}, pose=pose)
    (recording,) = dy.read_recordings(log, robot=robot)
    rows = next(recording.recording.source.rows(0, 800, 800))
    np.testing.assert_allclose(rows.q[:, 6:], motion.q[:, 7:], atol=1e-8)
    np.testing.assert_allclose(rows.tau[:, 6:], torque, atol=1e-7)
    # The weight is what the harness carries: the mean of the force upward, whatever the motion.
    assert rows.tau[:, 2].mean() == pytest.approx(12.7 * 9.81, rel=0.05)
    assert any("act on trunk (link frame), as measured" in check.detail for check in recording.checks)


def test_a_wrench_on_a_root_link_that_is_called_base_counts_once(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(WALKER.replace('"trunk"', '"base"'))
    robot, motion = dy.set_base(dy.load_robot(tmp_path / "robot.urdf"), "floating"), draw_motion(4, 4.0)
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "log.csv", motion, torque, {"base": wrench})
    (recording,) = dy.read_recordings(log, robot=robot)
    rows = next(recording.recording.source.rows(0, 800, 800))
    assert rows.tau[:, 2].mean() == pytest.approx(12.7 * 9.81, rel=0.05)


def test_two_wrenches_on_one_link_are_doubtful(tmp_path: Path) -> None:
    motion = draw_motion(4, 4.0)
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "log.csv", motion, torque, {"base": wrench, "trunk": wrench})
    (recording,) = dy.read_recordings(log, robot=walker(tmp_path))
    [check] = [check for check in recording.checks if check.name == "base_forces"]
    assert check.status == "warning"
    assert "several wrenches on trunk, and their sum is taken" in check.detail


def test_a_joint_that_stands_on_a_contact_needs_its_torque(tmp_path: Path) -> None:
    motion = draw_motion(4, 4.0)
    torque, _ = stand_on_shin(motion)
    log = write_log(tmp_path / "log.csv", motion, torque)
    robot = dy.set_base(walker(tmp_path), "floating", ["shin"])
    with pytest.raises(DynidentError, match="no torque of knee, but it holds the robot on its contacts"):
        dy.read_recordings(log, robot=robot, columns={"tau2": "none"})
    (recording,) = dy.read_recordings(log, robot=robot, columns={"tau3": "none"})
    assert recording.recording.joints_without_torque == ("shoulder",)


def test_a_turn_of_the_base_has_no_jump_and_millimetres_are_told_of_the_base_alone(tmp_path: Path) -> None:
    robot, motion = walker(tmp_path), draw_motion(4, 6.0)
    for k, t in enumerate(motion.t):
        turn = pin.Quaternion(motion.q[k, 3:7])
        motion.q[k, 3:7] = (pin.Quaternion(pin.rpy.rpyToMatrix(0, 0, 2.0 * t)) * turn).coeffs()
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "turning.csv", motion, torque, {"base": wrench})
    (recording,) = dy.read_recordings(log, robot=robot)
    yaw = next(recording.recording.source.rows(0, 1200, 1200)).q[:, 3]
    assert np.ptp(yaw) > 10.0
    assert np.abs(np.diff(yaw)).max() < 0.2
    motion.q[:, :3] *= 1e3
    log = write_log(tmp_path / "mm.csv", motion, torque, {"base": wrench})
    with pytest.raises(DynidentError, match=r'units={"base_x": "mm", "base_y": "mm", "base_z": "mm"}'):
        dy.read_recordings(log, robot=robot)
    (again,) = dy.read_recordings(log, robot=robot, units={"base_x": "mm", "base_y": "mm", "base_z": "mm"})
    np.testing.assert_allclose(next(again.recording.source.rows(0, 9, 9)).q[:, 0], motion.q[:9, 0] / 1e3, atol=1e-8)


def test_a_base_may_walk_and_turn_far(tmp_path: Path) -> None:
    robot, motion = walker(tmp_path), draw_motion(4, 12.0)
    for k, t in enumerate(motion.t):
        turn = pin.Quaternion(motion.q[k, 3:7])
        motion.q[k, 3:7] = (pin.Quaternion(pin.rpy.rpyToMatrix(0, 0, 3.0 * t)) * turn).coeffs()
    motion.q[:, 0] += 2.5 * motion.t
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "far.csv", motion, torque, {"base": wrench})
    (recording,) = dy.read_recordings(log, robot=robot)
    assert not [check for check in recording.checks if check.name == "position_unit" and check.status != "ok"]


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    robot, motion = walker(tmp_path), draw_motion(4, 4.0)
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "log.csv", motion, torque)
    with pytest.raises(DynidentError, match=r"Nothing holds the robot .* does not fall: in 4 s it would, by 19.6 m"):
        dy.read_recordings(log, robot=robot)
    nameless = tuple(f"c{k}" for k in range(7))
    log = write_log(tmp_path / "nameless.csv", motion, torque, pose=nameless)
    with pytest.raises(DynidentError, match="its orientation is not in the file"):
        dy.read_recordings(log, robot=robot)
    half = write_log(tmp_path / "half.csv", motion, torque, {"shin": wrench})
    half.write_text(half.read_text().replace("shin_mz", "other", 1))
    with pytest.raises(DynidentError, match="The wrench on shin is incomplete; missing columns: shin_mz"):
        dy.read_recordings(half, robot=robot)
