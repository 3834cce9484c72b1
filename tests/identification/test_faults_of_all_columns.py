"""What is wrong with a whole robot is one cause with one cure, before single columns are looked at."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.oracles import Motion, arm, crooked_urdf, fourier_motion, pinocchio_torque, record

from dynident.diagnosis.conclusion import point_to_check
from dynident.errors import Remedy
from dynident.identification import identify
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.recording_faults import (
    ColumnFault,
    build_dynamics_checks,
    check_recording_faults,
    find_recording_faults,
)
from dynident.identification.recording_faults.description_fit import check_description
from dynident.identification.recording_faults.fault_checks import _describe_cure
from dynident.identification.recording_faults.gravity_in_torque import find_mounting
from dynident.identification.recording_faults.joint_angle_faults import find_parallel_axes, report_zeros_from_start
from dynident.identification.recording_faults.rows_for_fault_search import (
    HeldOutFits,
    filter_for_search,
    filter_motion,
    filter_whole_motion,
)
from dynident.identification.recording_faults.torque_scale import refine_factor_by_masses
from dynident.identification.recording_faults.unexplained_torque import is_proved_by_friction
from dynident.identification.robot_recording_import import refute_zeros
from dynident.recordings import Check, Recording, RecordingMetadata, Revision
from dynident.robot import Robot, robot_from_urdf
from dynident.robot.pseudo_inertia import find_description_units
from dynident.verdict import verdict

pytestmark = pytest.mark.sweep

ROBOT = arm("ur10")
EFFORT = np.array([joint.limits.effort for joint in ROBOT.joints])
Q, TAU = ([f"{name}{k + 1}" for k in range(6)] for name in ("q", "tau"))
PENDULUM = (
    '<robot name="pendulum"><link name="base"/>'
    + "".join(
        f'<link name="link{k}"><inertial><origin xyz="0 0 -0.15"/><mass value="{1.0 - 0.2 * k}"/><inertia ixx="0.01" '
        f'ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link><joint name="joint{k}" type="revolute">'
        f'<parent link="{"link1" if k == 2 else "base"}"/><child link="link{k}"/><origin xyz="0 0 {-0.3 * (k - 1)}"/>'
        '<axis xyz="0 1 0"/><limit lower="-6" upper="6" velocity="9" effort="9"/></joint>'
        for k in (1, 2)
    )
    + "</robot>"
)
SLOPE = np.array([-np.sqrt(0.5), 0.0, -np.sqrt(0.5)])


@cache
def measured(
    seed: int = 3, gravity: tuple[float, ...] = (0.0, 0.0, -9.81), seconds: float = 20.0
) -> tuple[Motion, np.ndarray]:
    motion = fourier_motion(ROBOT, seconds, 200.0, seed)
    friction = 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq
    machine = replace(ROBOT, gravity=np.array(gravity))
    tau = pinocchio_torque(machine, motion.q, motion.dq, motion.ddq) + friction
    return motion, tau + 0.005 * EFFORT * np.random.default_rng(seed).normal(size=tau.shape)


def findings(recording: Recording, robot: Robot = ROBOT) -> list[Check]:
    checks = build_dynamics_checks(robot)(recording, Q, TAU) or ()
    # Loads are numbers that are added to those of a link here, and no bodies.
    return [one for one in checks if one.status != "ok" and one.name != "description_inertias"]


def test_a_turned_joint_with_little_friction_is_no_drive_that_is_off() -> None:
    """Friction is a share of each joint's own torque, as where wrists are small beside shoulders."""
    robot, joint, seed = arm("franka_panda"), 4, 2
    motion = fourier_motion(robot, 16.0, 100.0, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    size = np.abs(tau).max(axis=0)
    noise = np.random.default_rng(seed).normal(size=tau.shape)
    tau = tau + size * (0.03 * np.sign(motion.dq) + 0.025 * motion.dq + 0.003 * noise)
    assert find_recording_faults(robot, record(robot, motion, tau))[0] == ()
    signs = np.where(np.arange(robot.n) == joint, -1.0, 1.0)
    (found,), _ = find_recording_faults(robot, record(robot, motion, signs * tau))
    assert (found.fault.kind, found.fault.joints) == ("torque turned", (joint,))


@pytest.mark.parametrize("seed", [0, 2, 7])
def test_a_joint_whose_angle_is_of_the_base_is_no_drive_that_is_off(seed: int) -> None:
    """By the wrong velocity its torque seems to overcome no friction."""
    robot = robot_from_urdf("pendulum", PENDULUM)
    motion = fourier_motion(robot, 20.0, 200.0, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    peak, noise = np.abs(tau).max(axis=0), np.random.default_rng(seed).normal(size=tau.shape)
    tau = tau + peak * (0.08 * np.sign(motion.dq) + 0.03 * motion.dq + 0.005 * noise)
    assert find_recording_faults(robot, record(robot, motion, tau))[0] == ()
    q, dq, ddq = (np.cumsum(signal, axis=1) for signal in (motion.q, motion.dq, motion.ddq))
    (found,), _ = find_recording_faults(robot, record(robot, replace(motion, q=q, dq=dq, ddq=ddq), tau))
    assert (found.fault.kind, found.fault.joints, found.fault.factor) == ("joint coupled", (1, 0), 1.0)


def test_friction_proves_a_sign_only_beside_other_joints_whose_drives_are_on() -> None:
    """One of two joints may be passive: with a wrong gain it looks turned as one whose sign is."""
    turned, spread = ColumnFault("torque turned", (1,)), 1.0 + 0.01 * np.cos(np.arange(10.0))[:, None]
    proofs = [
        is_proved_by_friction(fault, spread * before, spread * after)
        for fault, before, after in (
            (turned, [0.3, -0.2, 0.25], [0.3, 0.2, 0.25]),
            (ColumnFault("torque turned", (0, 1)), [-0.3, -0.2], [0.3, 0.2]),
            (turned, [0.3, -0.2], [0.3, 0.2]),
            (turned, [0.3, -0.02, 0.25], [0.3, 0.02, 0.25]),
            (turned, [0.3, -0.2, 0.25], [0.3, -0.1, 0.25]),
            (turned, [0.3, -0.2, 0.25, 0.3], [0.3, -0.2, 0.25, 0.3]),
            (ColumnFault("torque turned", (0, 1)), [-0.3, -0.02, 0.25, 0.3], [0.3, 0.02, 0.25, 0.3]),
            (ColumnFault("torques swapped", (0, 1)), [0.3, -0.2, 0.25], [0.3, 0.2, 0.25]),
        )
    ]
    assert proofs == [True, True, *[False] * 6]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_torques_of_outer_joints_in_another_unit_are_named_together(seed: int) -> None:
    """Beside each other, joints of a group have the friction of one unit, and are held against the others alone."""
    motion, tau = measured(seed)
    outer = np.where(np.arange(6) >= 3, 100.0, 1.0)
    (found,), _ = find_recording_faults(ROBOT, record(ROBOT, motion, outer * tau))
    assert (found.fault.kind, found.fault.joints, found.fault.factor) == ("torque scaled", (3, 4, 5), 0.01)


def test_torques_that_are_all_turned_round_are_one_cause_with_one_cure() -> None:
    motion, tau = measured()
    (found,) = findings(record(ROBOT, motion, -tau))
    assert (found.name, found.status) == ("torque_sign", "error")
    assert "all torques" in found.detail
    assert found.apply == Revision(signs=dict.fromkeys(TAU, -1.0))


@pytest.mark.parametrize("direction", [[-1, 0, 0], [0, -1, 0], [0, 0, 1], SLOPE, [0.3, 0, -np.sqrt(0.91)]], ids=str)
def test_gravity_that_pulls_elsewhere_is_told_with_its_direction(direction: list[float]) -> None:
    gravity = 9.81 * np.asarray(direction)
    recording = record(ROBOT, *measured(gravity=tuple(gravity)))
    (found,) = findings(recording)
    assert found.name == "gravity_direction"
    motion = filter_motion(recording)
    assert motion is not None
    mounting = find_mounting(ROBOT, motion)
    assert mounting.gravity == pytest.approx(gravity, abs=0.3)
    # The mean over the joints hides what is left of the first joint's torque.
    assert mounting.unexplained < 0.3 * mounting.unexplained_as_stated or direction == [0, 0, 1]
    assert findings(recording, replace(ROBOT, gravity=gravity)) == []


@pytest.mark.parametrize("joint", [1, 2])
def test_a_sweep_of_one_joint_tells_signs_and_gravity(joint: int) -> None:
    """The others rest, but for the noise of their encoders: their links are not fitted to it."""
    rng = np.random.default_rng(joint)
    motion = fourier_motion(ROBOT, 90.0, 125.0, joint, base_frequency=0.2)
    at_rest = np.arange(6) != joint
    pose = np.array([0.0, -1.5, 0.2, -1.4, 0.1, 0.0])
    q, dq, ddq = (np.where(at_rest, 0.0, signal) for signal in (motion.q, motion.dq, motion.ddq))
    motion = replace(motion, q=q + pose + 1e-5 * rng.normal(size=q.shape), dq=dq, ddq=ddq)
    friction = 0.04 * EFFORT * np.sign(dq) + 0.03 * EFFORT * dq
    noise = 0.003 * EFFORT * rng.normal(size=q.shape)
    tau = pinocchio_torque(ROBOT, q + pose, dq, ddq) + friction + noise
    assert findings(record(ROBOT, motion, tau)) == []
    turned = np.where(at_rest, 1.0, -1.0)
    assert [one.name for one in findings(record(ROBOT, motion, turned * tau))] == ["torque_sign"]
    (found,) = findings(record(ROBOT, replace(motion, q=-motion.q), tau))
    assert found.name == "joint_sign"
    (found,) = findings(record(ROBOT, motion, tau), replace(ROBOT, gravity=np.array([-9.81, 0.0, 0.0])))
    assert found.name == "gravity_direction"


@pytest.mark.parametrize("seed", [3, 4])
def test_a_load_at_the_flange_is_no_other_unit_of_a_wrist(seed: int) -> None:
    """It is many times what the description has there; friction, which another unit would change, is as it was."""
    motion = fourier_motion(ROBOT, 20.0, 200.0, seed)
    bare = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    inertias = ROBOT.inertias.copy()
    inertias[-1] += 3.0 * np.array([0.01, 0.0, 0.0, 0.01, 0.0, 0.002, 0.0, 0.0, 0.05, 1.0])
    loaded = pinocchio_torque(replace(ROBOT, inertias=inertias), motion.q, motion.dq, motion.ddq)
    size = np.maximum(np.abs(bare).max(axis=0), 0.02 * np.abs(bare).max())
    rest = 0.04 * np.sign(motion.dq) + 0.03 * motion.dq + 0.004 * np.random.default_rng(seed).normal(size=bare.shape)
    assert findings(record(ROBOT, motion, loaded + size * rest)) == []
    tenfold = np.where(np.arange(6) == 4, 10.0, 1.0)
    (found,) = findings(record(ROBOT, motion, tenfold * (bare + size * rest)))
    assert found.name == "torque_scale"


def test_a_torque_without_friction_and_inertia_is_a_command() -> None:
    motion, _ = measured()
    still = np.zeros_like(motion.q)
    load = pinocchio_torque(ROBOT, motion.q, still, still)
    noise = 0.002 * np.abs(load).max() * np.random.default_rng(1).normal(size=load.shape)
    (found,) = findings(record(ROBOT, motion, load + noise))
    assert (found.name, found.status) == ("commanded_torque", "error")
    friction = 0.03 * np.abs(load).max(axis=0) * np.sign(motion.dq)
    assert not [one for one in findings(record(ROBOT, motion, load + friction + noise)) if one.name == found.name]


def test_a_sensor_behind_the_gears_measures_gravity_alone_in_a_slow_motion() -> None:
    """Ten times slower, inertia is a hundred times smaller: its absence is no sign of a command."""
    motion, _ = measured()
    slow = Motion(motion.t * 10.0, motion.q, motion.dq / 10.0, motion.ddq / 100.0)
    tau = pinocchio_torque(ROBOT, slow.q, slow.dq, slow.ddq)
    noise = 0.002 * np.abs(tau).max() * np.random.default_rng(1).normal(size=tau.shape)
    assert findings(record(ROBOT, slow, tau + noise)) == []


def test_outer_drives_in_another_unit_are_told_together_and_by_a_ratio() -> None:
    motion, tau = measured()
    (found,) = findings(record(ROBOT, motion, tau * np.where(np.arange(6) > 2, 207.0, 1.0)))
    assert (found.name, found.status) == ("torque_scale", "error")
    assert "wrist_1_joint, wrist_2_joint and wrist_3_joint" in found.detail
    # A ratio is as good as the description's masses: it is said, and not applied unasked.
    assert found.apply is None
    rows = filter_motion(record(ROBOT, motion, tau * np.where(np.arange(6) > 2, 207.0, 1.0)))
    assert rows is not None
    assert refine_factor_by_masses(ROBOT, rows, (3, 4, 5), 0.001) == pytest.approx(1.0 / 207.0, rel=0.1)


def test_an_angle_that_is_counted_from_the_joint_before_is_named() -> None:
    motion, tau = measured()
    assert np.flatnonzero(find_parallel_axes(ROBOT)).tolist() == [2, 3]
    counted = motion.q + np.outer(motion.q[:, 1], np.arange(6) == 2)
    recording = record(ROBOT, replace(motion, q=counted), tau)
    found, left = find_recording_faults(ROBOT, recording) or ((), 1.0)
    assert [one.fault for one in found] == [ColumnFault("joint coupled", (2, 1), 1.0)]
    assert left < 0.1
    (check,) = findings(recording)
    assert check.name == "joint_coupling"
    assert "the description needs q3 - q2" in check.detail


@pytest.mark.parametrize(("seed", "joint", "quarters"), [(3, 2, 1), (4, 3, -1), (5, 4, 2), (6, 5, 1)])
def test_a_joint_whose_zero_is_a_quarter_turn_off_is_named_with_where_it_is(seed: int, joint: int, quarters: int):
    motion, tau = measured(seed)
    off = 0.5 * np.pi * quarters * (np.arange(6) == joint - 1)
    recording = record(ROBOT, replace(motion, q=motion.q + off), tau)
    (check,) = findings(recording)
    # It may be the description that has another zero: it is proposed and not ordered.
    assert (check.name, check.status) == ("joint_zero", "warning")
    assert check.apply is not None
    assert replace(check.apply, zeros={}) == Revision()
    assert check.apply.zeros == {f"q{joint}": pytest.approx(0.5 * np.pi * quarters)}
    assert f"the column is {90 * quarters} degrees (" in check.detail


@pytest.mark.parametrize(("seed", "joint", "off"), [(3, 2, 0.35), (4, 3, -0.5), (5, 3, 2.2)])
def test_a_joint_that_was_not_homed_is_named_with_the_angle_that_it_reads_too_much(seed: int, joint: int, off: float):
    motion, tau = measured(seed)
    recording = record(ROBOT, replace(motion, q=motion.q + off * (np.arange(6) == joint - 1)), tau)
    (check,) = findings(recording)
    assert (check.name, check.status) == ("joint_zero", "warning")
    assert check.apply is not None
    assert check.apply.zeros == {f"q{joint}": pytest.approx(off, abs=0.03)}


@pytest.mark.parametrize(("seed", "joint", "quarters"), [(1, 2, 1), (2, 2, -1), (3, 3, 1), (4, 3, 2)])
def test_a_link_in_another_pose_than_described_has_two_zeros_elsewhere(seed: int, joint: int, quarters: int) -> None:
    """Its own joint and the next one, about a parallel axis, are off by as much in opposite directions."""
    motion, tau = measured(seed)
    off = 0.5 * np.pi * quarters * (np.eye(6)[joint - 1] - np.eye(6)[joint])
    (check,) = findings(record(ROBOT, replace(motion, q=motion.q + off), tau))
    assert (check.name, check.status) == ("joint_zero", "warning")
    assert check.apply is not None
    angles = {key: np.exp(1j * zero) for key, zero in check.apply.zeros.items()}
    assert angles == {
        f"q{joint}": pytest.approx(np.exp(0.5j * np.pi * quarters)),
        f"q{joint + 1}": pytest.approx(np.exp(-0.5j * np.pi * quarters)),
    }
    assert "or turn the link between them" in check.detail


@pytest.mark.parametrize(("seed", "joint", "factor"), [(3, 3, 1.25), (4, 2, 0.8), (5, 3, 2.0), (6, 2, 0.5)])
def test_a_position_by_another_gear_ratio_is_named_with_its_factor(seed: int, joint: int, factor: float) -> None:
    motion, tau = measured(seed)
    scaled = (signal * np.where(np.arange(6) == joint - 1, factor, 1.0) for signal in (motion.q, motion.dq, motion.ddq))
    (check,) = findings(record(ROBOT, Motion(motion.t, *scaled), tau))
    # One number explains much, so that it is proposed and not ordered.
    assert (check.name, check.status) == ("position_scale", "warning")
    assert check.apply is not None
    assert check.apply.scale == {f"q{joint}": pytest.approx(1.0 / factor, rel=0.02)}
    assert "another gear ratio" in check.detail


def test_degrees_of_a_slow_motion_are_told_by_the_load() -> None:
    motion, tau = measured()
    slow = Motion(motion.t, *(np.rad2deg(signal) for signal in (motion.q, motion.dq, motion.ddq)))
    (check,) = findings(record(ROBOT, slow, tau))
    assert check.name == "position_scale"
    assert "all positions (q1 … q6) are in degrees" in check.detail


@pytest.mark.parametrize("joint", [1, 2])
def test_a_pendulum_tells_the_gear_ratio_of_each_joint(joint: int) -> None:
    pendulum = robot_from_urdf("pendulum", PENDULUM)
    motion = fourier_motion(pendulum, 20.0, 200.0, 4)
    tau = pinocchio_torque(pendulum, motion.q, motion.dq, motion.ddq)
    tau += 0.05 * np.abs(tau).max(axis=0) * (np.sign(motion.dq) + motion.dq)
    tau += 0.005 * np.abs(tau).max() * np.random.default_rng(4).normal(size=tau.shape)
    scaled = (signal * np.where(np.arange(2) == joint - 1, 1.25, 1.0) for signal in (motion.q, motion.dq, motion.ddq))
    checks = build_dynamics_checks(pendulum)(record(pendulum, Motion(motion.t, *scaled), tau), Q[:2], TAU[:2]) or ()
    (check,) = [check for check in checks if check.status != "ok"]
    assert check.name == "position_scale"
    assert check.apply is not None
    assert check.apply.scale == {f"q{joint}": pytest.approx(0.8, rel=0.02)}


@pytest.mark.parametrize(("seed", "off"), [(3, 0.5 * np.pi), (4, -1.2)])
def test_another_zero_of_the_last_joint_is_named_beside_a_load_on_its_link(seed: int, off: float) -> None:
    inertias = ROBOT.inertias.copy()
    inertias[-1] += np.array([0.06, 0, 0, 0.06, 0, 0.01, 0.12, 0.0, 0.2, 2.0])
    robot, motion = replace(ROBOT, inertias=inertias), fourier_motion(ROBOT, 15.0, 100.0, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 1.5 * np.sign(motion.dq) + 2.0 * motion.dq
    tau += 0.3 * np.random.default_rng(seed).normal(size=tau.shape)
    (check,) = findings(record(robot, replace(motion, q=motion.q + off * (np.arange(6) == 5)), tau), robot)
    assert (check.name, check.status) == ("joint_zero", "warning")
    assert check.apply is not None
    assert check.apply.zeros == {"q6": pytest.approx(off, abs=0.03)}
    assert "load on this link" in check.detail


def test_positions_from_the_start_are_told_where_no_fault_of_single_columns_explains_as_much() -> None:
    robot = robot_from_urdf("few", crooked_urdf(3, 4, ()))
    motion = fourier_motion(robot, 10.0, 100.0, 9)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 0.3 * np.sign(motion.dq)
    tau += 0.03 * np.random.default_rng(2).normal(size=tau.shape)
    recording = record(robot, replace(motion, q=motion.q - motion.q[0]), tau)
    rows, fit = filter_motion(recording), HeldOutFits(robot).plain_fit
    assert rows is not None
    as_is, right = (fit.measure_unexplained(replace(rows, q=rows.q + zeros)) for zeros in (0.0, motion.q[0]))
    check = report_zeros_from_start(robot, recording, rows, fit, (as_is, as_is), Q)
    assert check is not None
    assert check.status == "error"
    assert report_zeros_from_start(robot, recording, rows, fit, (as_is, right), Q) is None


def test_torques_that_are_exchanged_are_named_where_the_positions_rattle_close_above_the_motion() -> None:
    motion, tau = measured()
    rattle = 0.04 * np.sin(2.0 * np.pi * 4.5 * motion.t[:, None] + np.arange(6))
    recording = record(ROBOT, replace(motion, q=motion.q + rattle), tau[:, [1, 0, 2, 3, 4, 5]])
    wide, rows = filter_whole_motion(recording), filter_for_search(recording, HeldOutFits(ROBOT))
    assert wide is not None
    assert rows[0][1] > 3.0 * wide[1]
    assert [check.name for check in findings(recording)] == ["torque_order"]


def test_a_mistake_is_found_below_a_vibration_which_hides_it_in_all_that_is_recorded() -> None:
    motion, tau = measured(seconds=60.0)
    # Only the right columns explain more at low frequencies, so that nothing else tells where to look.
    shaken = tau + 1.5 * tau.std(axis=0) * np.sin(2.0 * np.pi * 3.5 * motion.t[:, None] + np.arange(6))
    order = [0, 2, 1, 3, 4, 5]
    assert findings(record(ROBOT, motion, shaken)) == []
    assert [check.name for check in findings(record(ROBOT, motion, shaken[:, order]))] == ["torque_order"]


def test_friction_tells_a_sign_where_much_is_unexplained_for_another_reason() -> None:
    motion, tau = measured()
    rocking = tau + 0.8 * tau.std(axis=0) * np.sin(2.0 * np.pi * 0.83 * motion.t[:, None] + np.arange(6))
    assert findings(record(ROBOT, motion, rocking)) == []
    (check,) = findings(record(ROBOT, motion, -rocking))
    assert (check.name, check.status) == ("torque_sign", "warning")
    assert "friction would drive the joint" in check.detail


def test_a_single_joint_that_moves_slowly_has_a_torque_of_another_unit_by_the_masses() -> None:
    axis = np.arange(6) == 1
    t = np.arange(0.0, 40.0, 0.01)
    pose, phase = np.array([0.0, -1.2, 1.2, 0.1, 0.2, 0.0]), 2.0 * np.pi * t[:, None] / 20.0
    signals = (0.8 * np.sin(phase), 0.25 * np.cos(phase), -0.08 * np.sin(phase))
    motion = Motion(t, pose + signals[0] * axis, signals[1] * axis, signals[2] * axis)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 0.04 * EFFORT * np.sign(motion.dq)
    tau += 0.005 * EFFORT * np.random.default_rng(1).normal(size=tau.shape)
    assert findings(record(ROBOT, motion, tau)) == []
    (check,) = findings(record(ROBOT, motion, 10.0 * tau))
    assert check.name == "torque_scale"
    assert check.apply is not None
    # Joints that stand have no say.
    assert check.apply.scale == {"tau2": pytest.approx(0.1)}


@pytest.mark.parametrize(("scale", "first"), [(0.5, 1.0), (1.0, -1.0)])
def test_a_wrist_that_is_logged_at_the_motors_of_its_differential_is_told_with_what_to_compute(
    scale: float, first: float
) -> None:
    motion, tau = measured(6)
    to_joints = scale * np.array([[first, 1.0], [1.0, -first]])
    to_motors = np.linalg.inv(to_joints)
    q, at_motors = motion.q.copy(), tau.copy()
    q[:, 4:], at_motors[:, 4:] = q[:, 4:] @ to_motors.T, tau[:, 4:] @ to_joints
    (check,) = findings(record(ROBOT, replace(motion, q=q), at_motors))
    # No statement about the file turns two columns into sums: it is told how to compute them.
    assert (check.name, check.status, check.apply) == ("joint_coupling", "error", None)
    size = "" if scale == 1.0 else "0.5 "
    assert f"replace q5 by {'-' if first < 0 else ''}{size}q5 + {size}q6" in check.detail


@pytest.mark.parametrize(("seed", "sign"), [(6, 1.0), (7, -1.0)])
def test_a_wrist_whose_last_motor_drives_through_the_gears_before_is_told_with_what_to_compute(
    seed: int, sign: float
) -> None:
    motion, tau = measured(seed)
    q, at_motors = motion.q.copy(), tau.copy()
    q[:, 5] += sign * q[:, 4]
    at_motors[:, 4] -= sign * tau[:, 5]
    (check,) = findings(record(ROBOT, replace(motion, q=q), at_motors))
    assert (check.name, check.status, check.apply) == ("joint_coupling", "error", None)
    minus, plus = ("-", "+") if sign > 0 else ("", "-")
    assert f"replace q6 by {minus}q5 + q6, tau5 by tau5 {plus} tau6, and velocities" in check.detail


def test_a_mirrored_joint_of_a_pendulum_is_told_by_its_masses() -> None:
    pendulum = robot_from_urdf("pendulum", PENDULUM)
    motion = fourier_motion(pendulum, 20.0, 200.0, 4)
    tau = pinocchio_torque(pendulum, motion.q, motion.dq, motion.ddq)
    tau += 0.05 * np.abs(tau).max(axis=0) * (np.sign(motion.dq) + motion.dq)
    tau += 0.005 * np.abs(tau).max() * np.random.default_rng(4).normal(size=tau.shape)

    def found(change: np.ndarray) -> list[str]:
        checks = build_dynamics_checks(pendulum)(record(pendulum, motion, tau * change), Q[:2], TAU[:2]) or ()
        return [one.name for one in checks if one.status != "ok"]

    assert found(np.array([1.0, 1.0])) == []
    assert found(np.array([1.0, -1.0])) == ["torque_sign"]


@pytest.mark.parametrize(
    ("masses", "inertias", "words"),
    [(1e3, 1e9, "g mm²"), (1.0, 1e6, "kg mm²"), (1e3, 1e3, "masses seem to be in g")],
)
def test_a_description_in_grams_or_millimetres_is_what_is_wrong(masses: float, inertias: float, words: str) -> None:
    assert ROBOT.inertias is not None
    factors = np.array([inertias] * 6 + [masses] * 4)
    described = replace(ROBOT, inertias=ROBOT.inertias * factors)
    units = find_description_units(described)
    assert units is not None
    assert words in str(units)
    assert units.to_si(described).inertias == pytest.approx(ROBOT.inertias)
    (found,) = findings(record(ROBOT, *measured()), described)
    assert (found.name, found.status) == ("description_units", "warning")
    assert all(find_description_units(arm(name)) is None for name in ("ur10", "franka_panda", "scara", "crooked"))


def test_a_description_in_centimetres_or_with_exchanged_inertias_is_told() -> None:
    assert ROBOT.inertias is not None
    assert all(not check_description(arm(name), None) for name in ("ur10", "franka_panda", "scara"))
    joints = [replace(joint, placement=joint.placement.copy()) for joint in ROBOT.tree.joints]
    for joint in joints:
        joint.placement[:3, 3] *= 100.0
    long = replace(ROBOT, joints=tuple(joints), inertias=ROBOT.inertias * np.array([1e4] * 6 + [1e2] * 3 + [1.0]))
    (check,) = check_description(long, find_description_units(long))
    assert check.name == "description_lengths"
    assert "in cm (1" in check.detail
    # Rows written where the upper triangle belongs: ixx, ixy, ixz, iyy, iyz, izz as ixx, iyy, izz, ….
    exchanged = ROBOT.inertias.copy()
    exchanged[2, :6] = exchanged[2, [0, 3, 5, 1, 2, 4]]
    (check,) = check_description(replace(ROBOT, inertias=exchanged), None)
    assert (check.name, check.status) == ("description_inertias", "warning")
    assert f"gives {ROBOT.joint_names[2]} an inertia" in check.detail
    assert point_to_check({"run": check_description(long, None)}).startswith("First correct")


def test_of_cures_that_leave_alike_none_is_ordered() -> None:
    """A planar arm moves in a mirror as it does: its positions and its torques turned round are one."""
    planar = robot_from_urdf("planar", PLANAR)
    motion = fourier_motion(planar, 20.0, 200.0, 1)
    tau = pinocchio_torque(planar, motion.q, motion.dq, motion.ddq) + 0.3 * np.sign(motion.dq) + 0.1 * motion.dq
    noise = 0.01 * np.random.default_rng(1).normal(size=tau.shape)
    found = check_recording_faults(planar, record(planar, motion, noise - tau), Q[:2], TAU[:2]).checks
    (wrong,) = [one for one in found if one.status != "ok"]
    assert "all torques" in wrong.detail
    assert "all positions" in wrong.detail
    assert wrong.apply is None


def test_an_elastic_arm_and_a_free_motor_are_no_mistake_in_the_columns() -> None:
    planar = robot_from_urdf("planar", PLANAR)
    motion = fourier_motion(planar, 20.0, 200.0, 2, base_frequency=0.15)
    rattle = 0.5 * motion.ddq.std(axis=0) / (2 * np.pi * 7.0) ** 2 * np.sin(2 * np.pi * 7.0 * motion.t)[:, None]
    tau = pinocchio_torque(planar, motion.q, motion.dq, motion.ddq) + 0.3 * np.sign(motion.dq)
    noise = 0.01 * np.random.default_rng(1).normal(size=tau.shape)
    # The first motor is off: what is left of its torque is noise.
    free = tau * (np.arange(2) != 0)
    for torque in (tau, free):
        given = record(planar, replace(motion, q=motion.q + rattle), torque + noise)
        assert [one for one in check_recording_faults(planar, given, Q[:2], TAU[:2]).checks if one.status != "ok"] == []


def swing(
    robot: Robot, driven: int, seed: int, seconds: float = 10.0, rate: float = 200.0
) -> tuple[Motion, np.ndarray]:
    """Two joints of which one motor swings both at one frequency; the other is off and reports what it generates."""
    rng = np.random.default_rng(seed)
    size, frequency = rng.uniform(0.5, 0.9), 2.0 * np.pi * rng.uniform(1.2, 1.7)
    friction = lambda dq: 0.08 * np.tanh(dq / 0.05) + 0.02 * dq  # noqa: E731
    off = 1 - driven

    def accelerate(t: float, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tau = np.zeros(2)
        tau[driven], tau[off] = size * np.sin(frequency * t), -0.02 * dq[off]
        states = (np.tile(q, (3, 1)), np.vstack([dq, dq * 0.0, dq * 0.0]), np.vstack([dq * 0.0, np.eye(2)]))
        bias, *rest = pinocchio_torque(robot, *states)
        still = pinocchio_torque(robot, q[None], dq[None] * 0.0, dq[None] * 0.0)[0]
        mass = np.array(rest) - still + 0.01 * np.eye(2)
        return np.linalg.solve(mass, tau - bias - friction(dq)), tau

    t, step = np.arange(round(seconds * rate)) / rate, 1.0 / rate
    q, dq = np.zeros(2), np.zeros(2)
    rows = []
    for now in t:
        ddq, tau = accelerate(now, q, dq)
        rows.append((q, dq, ddq, tau))
        # Heun's method: the motion need only be one that these torques make, nearly.
        middle, _ = accelerate(now + step, q + step * dq, dq + step * ddq)
        q, dq = q + step * dq + 0.5 * step**2 * ddq, dq + 0.5 * step * (ddq + middle)
    q, dq, ddq, tau = (np.array(part) for part in zip(*rows, strict=True))
    return Motion(t, q, dq, ddq), tau + 0.01 * rng.normal(size=tau.shape)


@pytest.mark.parametrize("driven", [0, 1])
@pytest.mark.parametrize("seed", range(4))
def test_of_a_motor_that_is_off_no_sign_is_told(seed: int, driven: int) -> None:
    planar = robot_from_urdf("planar", PLANAR)
    given = record(planar, *swing(planar, driven, seed))
    assert [one for one in check_recording_faults(planar, given, Q[:2], TAU[:2]).checks if one.status != "ok"] == []


def test_a_look_at_a_file_says_first_what_is_left_of_its_torque_and_why() -> None:
    motion, tau = measured(gravity=(0.0, -9.81, 0.0))
    found = propose(Sample(("t", *Q, *TAU), np.column_stack([motion.t, motion.q, tau]), {}), ROBOT)
    first = found.guesses[0]
    assert first.field == "check"
    assert "shoulder_pan_joint" in first.reason
    assert "Gravity seems to act along (0,-9.81,0)" in first.reason
    assert [one.field for one in found.questions] == ["gravity"]


def test_a_look_at_a_file_asks_for_a_torque_that_never_changes() -> None:
    motion, tau = measured()
    silent = tau * (np.arange(6) != 0)
    found = propose(Sample(("t", *Q, *TAU), np.column_stack([motion.t, motion.q, silent]), {}), ROBOT)
    assert any("tau1 never change" in one.detail for one in found.questions)


def test_a_check_of_size_vetoes_a_model_that_fits_well_until_it_is_accepted() -> None:
    fitted, other = (record(ROBOT, motion, 1e-3 * tau, name) for name, (motion, tau) in RUNS.items())
    model = identify(ROBOT, [fitted], [other])
    assert model.held_out is not None
    assert model.held_out.relative_total < 0.1
    checks = {"fitted": build_dynamics_checks(ROBOT)(fitted, Q, TAU) or ()}
    judged = verdict(model, [fitted], [other], checks)
    assert not any(one.fit for one in judged.uses)
    assert all("masses of the description" in one.reason for one in judged.uses)
    accepted = {"fitted": [replace(one, is_accepted=True) for one in checks["fitted"]]}
    assert any(one.fit for one in verdict(model, [fitted], [other], accepted).uses)


def test_a_fit_that_holds_where_nothing_held_out_is_explained_asks_for_more_data() -> None:
    motion = fourier_motion(ROBOT, 6.0, 200.0, 1, amplitude=0.05)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 0.04 * EFFORT * np.sign(motion.dq)
    fitted = record(ROBOT, motion, tau + 0.01 * EFFORT * np.random.default_rng(1).normal(size=tau.shape), "fitted")
    judged = verdict(identify(ROBOT, [fitted], [record(ROBOT, *RUNS["other"], "other")]))
    assert judged.stop is not None
    assert "Record a designed motion" in judged.stop.cause
    assert "units" not in " ".join(judged.next_steps)


def test_errors_that_are_in_the_rows_at_rest_alone_are_not_laid_to_the_columns() -> None:
    fitted, other = (record(ROBOT, motion, tau, name) for name, (motion, tau) in RUNS.items())
    model = identify(ROBOT, [fitted], [other])
    assert model.held_out is not None
    times = (0.9 / model.held_out.relative_total) ** 2
    judged = verdict(replace(model, held_out=replace(model.held_out, squares=model.held_out.squares * times)))
    assert judged.stop is not None
    assert "rows at standstill" in judged.stop.cause


RUNS = {"fitted": measured(3), "other": measured(4)}
PLANAR = (
    '<robot name="planar"><link name="base"/>'
    + "".join(
        f'<link name="l{k}"><inertial><origin xyz="0 0 -0.15"/><mass value="0.6"/><inertia ixx="0.005" ixy="0" ixz="0" '
        'iyy="0.005" iyz="0" izz="0.0005"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="{"l0" if k else "base"}"/><child link="l{k}"/>'
        f'<origin xyz="0 0 {-0.3 if k else 0.0}"/><axis xyz="0 1 0"/>'
        '<limit lower="-6" upper="6" velocity="8" effort="9"/></joint>'
        for k in range(2)
    )
    + "</robot>"
)


def test_friction_that_depends_on_the_angle_is_no_delay_of_a_sweep() -> None:
    """In a sweep of one frequency the angle tells the speed, so that such friction lags like a torque that is early."""
    rng = np.random.default_rng(1)
    t, axis, pose = np.arange(0.0, 90.0, 0.01), np.arange(6) == 2, np.array([0.0, -1.5, 0.2, -1.4, 0.1, 0.0])
    rate = 2.0 * np.pi / 6.0
    angle = 1.4 * np.sin(rate * t)
    signals = (angle, 1.4 * rate * np.cos(rate * t), -(rate**2) * angle)
    q, dq, ddq = (np.outer(signal, axis) for signal in signals)
    tau = pinocchio_torque(ROBOT, pose + q, dq, ddq) + 0.001 * EFFORT * rng.normal(size=q.shape)
    tau += EFFORT * (0.06 + 0.01 * np.cos(q - 1.5)) * np.sign(dq)
    motion = Motion(t, pose + q + 1e-5 * rng.normal(size=q.shape), dq, ddq)
    checks = {check.name: check for check in build_dynamics_checks(ROBOT)(record(ROBOT, motion, tau), Q, TAU) or ()}
    assert checks["torque_delay"].status == "ok"
    assert "usual" in checks["torque_delay"].detail


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("name", ["franka_panda", "mirrored"])
def test_an_arm_that_its_driver_mirrors_is_told_with_all_turned_joints(name: str, seed: int) -> None:
    robot = arm(name) if name != "mirrored" else robot_from_urdf("plain", plain_urdf(6, seed))
    motion = fourier_motion(robot, 30.0, 100.0, seed)
    effort = np.array([joint.limits.effort for joint in robot.joints])
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    effort = np.maximum(np.abs(tau).max(axis=0), 0.02 * np.abs(tau).max())
    tau = tau + 0.1 * effort * np.sign(motion.dq) + 0.05 * effort * motion.dq
    tau += 0.002 * effort * np.random.default_rng(seed).normal(size=tau.shape)
    turned = [0, 2, 4, 6] if name == "franka_panda" else [0, 3, 5]
    signs = np.where(np.isin(np.arange(robot.n), turned), -1.0, 1.0)
    for sign, expected in ((signs, [tuple(turned)]), (np.ones(robot.n), [])):
        mirrored = replace(motion, q=sign * motion.q, dq=sign * motion.dq, ddq=sign * motion.ddq)
        found = find_recording_faults(robot, record(robot, mirrored, sign * tau, "arm"))
        faults = [] if found is None else [one.fault for one in found[0]]
        assert [fault.joints for fault in faults] == expected
        assert {fault.kind for fault in faults} <= {"joint turned"}
        for fault in faults:
            names = [[f"{kind}{k + 1}" for k in range(robot.n)] for kind in ("q", "tau")]
            _, (remedy,) = _describe_cure(fault, *names)
            assert remedy == Remedy("signs", {f"{kind}{j + 1}": -1 for kind in ("q", "tau") for j in turned})


def plain_urdf(n: int, seed: int) -> str:
    """An arm whose axes at zero are along those of the base, with links that are beside them."""
    rng = np.random.default_rng(seed)
    parts = ['<robot name="plain"><link name="l-1"/>']
    for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")[:n]):
        mass = 8.0 / (k + 1)
        place = ("0 0.02 0.2", "0.05 0.12 0.2", "0 0 0.5", "0.05 -0.07 0.08", "0.4 0 0", "0.1 0 0")[k]
        centre, size = rng.uniform(-0.03, 0.03, 3) + ((0.0, 0.0, 0.1) if k < 3 else (0.1, 0.0, 0.0)), 0.02 * mass
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="{centre[0]} {centre[1]} {centre[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{size}" ixy="{0.1 * size}" ixz="{-0.08 * size}" iyy="{0.9 * size}" iyz="{0.05 * size}" '
            f'izz="{0.6 * size}"/></inertial></link><joint name="j{k}" type="revolute"><parent link="l{k - 1}"/>'
            f'<child link="l{k}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="2.5" effort="100"/></joint>'
        )
    return "".join(parts) + "</robot>"


def measure_with_zero(robot: Robot, drawn: int, joint: int, off: float) -> Recording:
    motion = fourier_motion(robot, 15.0, 100.0, drawn)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 1.5 * np.sign(motion.dq) + 2.0 * motion.dq
    tau += 0.3 * np.random.default_rng(drawn).normal(size=tau.shape)
    return replace(record(robot, replace(motion, q=motion.q + off * (np.arange(6) == joint)), tau), name=f"run{off:g}")


@pytest.mark.parametrize("seed", [3, 4])
def test_a_zero_of_the_last_joint_that_another_recording_lacks_may_be_a_load(seed: int) -> None:
    """A load on the other side of the flange looks like another zero of the last joint, in its own recording alone."""
    inertias = ROBOT.inertias.copy()
    inertias[-1] += np.array([0.06, 0, 0, 0.06, 0, 0.01, 0.12, 0.0, 0.2, 2.0])
    robot = replace(ROBOT, inertias=inertias)
    drawn = enumerate((0.0, -1.2, -1.2))
    plain, turned, turned_too = (measure_with_zero(robot, seed + 10 * k, 5, off) for k, off in drawn)
    checks = [tuple(findings(recording, robot)) for recording in (plain, turned, turned_too)]
    as_is = [RecordingMetadata()] * 3
    (_, (check,)) = refute_zeros(robot, [plain, turned], checks[:2], as_is[:2])
    assert (check.name, check.status, check.apply) == ("other_load", "warning", None)
    assert "and run0 does not have it" in check.detail
    assert refute_zeros(robot, [turned, turned_too], checks[1:], as_is[1:]) == checks[1:]
    assert [check.name for own in checks for check in own] == ["joint_zero", "joint_zero"]
    (_, (check,), _) = refute_zeros(robot, [plain, turned, turned_too], checks, as_is)
    assert "and run0 (one of 2 other recordings) does not have it" in check.detail


@pytest.mark.parametrize(("joint", "off"), [(1, 0.15), (2, 0.4), (2, -0.3), (3, 0.5)])
def test_a_zero_of_one_recording_alone_that_no_load_looks_like_keeps_its_cure(joint: int, off: float) -> None:
    """As where an encoder was homed anew: a load is among the parameters that are fitted, and this zero is not."""
    recordings = [measure_with_zero(ROBOT, 3, joint, 0.0), measure_with_zero(ROBOT, 4, joint, off)]
    checks = [tuple(findings(recording)) for recording in recordings]
    (_, (check,)) = refute_zeros(ROBOT, recordings, checks, [RecordingMetadata()] * 2)
    ((own,),) = checks[1:]
    assert (check.name, check.apply, check.remedies) == ("joint_zero", own.apply, own.remedies)
    assert check.apply.zeros == pytest.approx({f"q{joint + 1}": off}, abs=0.05)
    assert check.detail.removeprefix(own.detail) == (
        " By its torques, run0 does not have this zero: correct this recording and not the description."
    )
