from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.urdf_texts import EVERY_KIND, EVERY_KIND_JOINTS, joint, link, machine, one_joint

from dynident.robot import (
    Limits,
    Robot,
    joint_frames,
    robot_from_library,
    robot_from_urdf,
    to_pinocchio,
    urdf_from_robot,
)
from dynident.robot.pinocchio_conversion import compute_described_torque, from_dynamic_parameters

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
MODEL = pin.buildModelFromXML(EVERY_KIND)
ROBOT = robot_from_urdf("machine", EVERY_KIND)


def configuration(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Pinocchio's configuration vector: an unlimited joint counts as (cos, sin)."""
    parts = [[np.cos(x), np.sin(x)] if j.nq == 2 else [x] for j, x in zip(list(model.joints)[1:], q, strict=True)]
    return np.concatenate(parts)


def pinocchio_frames(model: pin.Model, q: np.ndarray) -> np.ndarray:
    data = model.createData()
    pin.forwardKinematics(model, data, configuration(model, q))
    return np.array([placement.homogeneous for placement in list(data.oMi)[1:]])


@settings(max_examples=50, deadline=None)
@given(q=arrays(float, 6, elements=st.floats(-10, 10)))
def test_frames_of_every_kind_of_joint_are_those_of_pinocchio(q):
    np.testing.assert_allclose(joint_frames(ROBOT, q[None])[0], pinocchio_frames(MODEL, q), atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(q=arrays(float, 6, elements=st.floats(-10, 10)), dq=arrays(float, 6, elements=st.floats(-3, 3)))
def test_torques_of_the_robot_read_are_those_of_pinocchio(q, dq):
    ours, theirs = to_pinocchio(ROBOT), MODEL
    ddq = dq[::-1]
    np.testing.assert_allclose(
        pin.rnea(ours, ours.createData(), q, dq, ddq),
        pin.rnea(theirs, theirs.createData(), configuration(theirs, q), dq, ddq),
        atol=1e-10,
    )


def test_every_kind_of_joint_is_read():
    assert ROBOT.joint_names == EVERY_KIND_JOINTS
    kinds = [joint.kind for joint in ROBOT.joints]
    assert kinds == ["revolute", "revolute", "prismatic", "revolute", "revolute", "prismatic"]
    assert [joint.parent for joint in ROBOT.joints] == [-1, 0, 1, 2, 2, 4]
    assert [joint.link for joint in ROBOT.joints] == ["column", "boom", "slider", "left", "right", "tool"]
    np.testing.assert_allclose(ROBOT.joints[1].axis, np.array([1, 2, 3]) / np.sqrt(14), atol=1e-15)


def test_inertial_parameters_are_about_the_origin_of_the_joint_frame():
    rotation = pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)
    center = np.array([0.1, 0.02, -0.03])
    tensor = np.array([[0.1, 0.01, -0.02], [0.01, 0.2, 0.03], [-0.02, 0.03, 0.25]])
    about_origin = rotation @ tensor @ rotation.T + 2 * (center @ center * np.eye(3) - np.outer(center, center))
    expected = [*about_origin[np.triu_indices(3)], *(2 * center), 2]
    np.testing.assert_allclose(robot_from_urdf("r", one_joint()).inertias, [expected], atol=1e-15)


def test_limits_come_from_the_urdf():
    limits = robot_from_urdf("r", one_joint()).joints[0].limits
    assert limits == Limits(position=(-1.0, 2.0), velocity=3.0, effort=4.0)


def test_stated_limits_win_field_by_field():
    limits = robot_from_urdf("r", one_joint(), limits={"j": Limits(velocity=1.5, jerk=100.0)}).joints[0].limits
    assert limits == Limits(position=(-1.0, 2.0), velocity=1.5, jerk=100.0, effort=4.0)


@pytest.mark.parametrize(
    "limit",
    [
        "",
        '<limit velocity="0" effort="0"/>',
        '<limit velocity="-1" effort="-1"/>',
        '<limit lower="-inf" upper="inf"/>',
    ],
)
def test_limits_that_say_nothing_are_unknown(limit):
    assert robot_from_urdf("r", one_joint(limit=limit)).joints[0].limits == Limits()


def test_a_continuous_joint_has_no_position_limit():
    assert robot_from_urdf("r", one_joint("continuous")).joints[0].limits == Limits(velocity=3.0, effort=4.0)


@pytest.mark.parametrize(
    "locked", [{"lift": 0.4}, {"turn": 2.0, "right_slide": -0.3}, {"slide": 0.1, "right_turn": -2.5}]
)
def test_a_locked_joint_leaves_the_torques_of_the_others_as_they_were(locked):
    robot = robot_from_urdf("r", EVERY_KIND, locked_joints=locked)
    assert robot.joint_names == tuple(name for name in EVERY_KIND_JOINTS if name not in locked)
    free = [EVERY_KIND_JOINTS.index(name) for name in robot.joint_names]
    q = np.array([locked.get(name, 0.3 * i - 0.5) for i, name in enumerate(EVERY_KIND_JOINTS)])
    dq = np.zeros(6)
    dq[free] = np.linspace(-1, 1, len(free))
    reduced = to_pinocchio(robot)
    tau = pin.rnea(reduced, reduced.createData(), q[free], dq[free], 2 * dq[free])
    expected = pin.rnea(MODEL, MODEL.createData(), configuration(MODEL, q), dq, 2 * dq)[free]
    np.testing.assert_allclose(tau, expected, atol=1e-11)


def test_a_locked_joint_may_be_a_mimic_joint():
    mimic = '<mimic joint="lift" multiplier="2"/>'
    text = EVERY_KIND.replace('<axis xyz="1 0 0"/>', f'<axis xyz="1 0 0"/>{mimic}')
    assert robot_from_urdf("r", text, locked_joints={"right_slide": 0.0}).joint_names == EVERY_KIND_JOINTS[:-1]


def test_no_inertia_in_the_urdf_means_no_inertias():
    assert robot_from_urdf("r", machine(link("base"), link("arm", ""), joint("j", "base", "arm"))).inertias is None


def test_a_rounded_right_angle_is_mended_and_a_rough_one_only_when_asked():
    def placement(angle: str, **options: float) -> np.ndarray:
        text = one_joint(inside=f'<origin xyz="0 0 1" rpy="{angle} 0 0"/>')
        return robot_from_urdf("r", text, **options).joints[0].placement

    exact = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 1], [0, 0, 0, 1.0]])
    np.testing.assert_array_equal(placement("1.57079632679"), exact)
    assert np.any(placement("1.5708") != exact)
    np.testing.assert_array_equal(placement("1.5708", rounding_tolerance=1e-5), exact)


def test_a_mended_rotation_is_still_a_rotation():
    rotation = robot_from_urdf("r", one_joint(inside='<origin rpy="1.570796 -2.7549 0.3"/>'), rounding_tolerance=1e-5)
    matrix = rotation.joints[0].placement[:3, :3]
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)


def test_meshes_colours_and_extensions_are_not_looked_at(capfd):
    extras = '<material name="m"/><transmission name="t"/><gazebo/>'
    visual = '<visual><geometry><mesh filename="nowhere.stl"/></geometry><material name="unknown"/></visual>'
    text = (
        one_joint()
        .replace("</robot>", extras + "</robot>")
        .replace('<link name="base">', f'<link name="base">{visual}')
    )
    assert robot_from_urdf("r", text).n == 1
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


@pytest.mark.parametrize("name", ["franka_panda", "ur10", "scara", "dual_arm"])
def test_a_robot_written_as_urdf_reads_back_the_same(name):
    robot = robot_from_library(name)
    again = robot_from_urdf(name, urdf_from_robot(robot))
    assert_same(again, robot)
    theirs = pin.buildModelFromXML(urdf_from_robot(robot))
    q = np.linspace(-1.0, 1.0, robot.n)
    np.testing.assert_allclose(joint_frames(robot, q[None])[0], pinocchio_frames(theirs, q), atol=1e-12)
    dynamic = np.array([body.toDynamicParameters() for body in list(theirs.inertias)[1:]])
    np.testing.assert_allclose(from_dynamic_parameters(dynamic), robot.inertias, atol=1e-12)


def test_turned_axes_and_locked_joints_survive_writing_as_urdf():
    robot = robot_from_urdf("r", EVERY_KIND, locked_joints={"lift": 0.4})
    assert_same(robot_from_urdf("r", urdf_from_robot(robot)), robot)


def assert_same(left: Robot, right: Robot) -> None:
    for ours, theirs in zip(left.joints, right.joints, strict=True):
        assert (ours.name, ours.kind, ours.parent) == (theirs.name, theirs.kind, theirs.parent)
        assert (ours.limits.position, ours.limits.velocity, ours.limits.effort) == (
            theirs.limits.position,
            theirs.limits.velocity,
            theirs.limits.effort,
        )
        np.testing.assert_allclose(ours.placement, theirs.placement, atol=1e-14)
        np.testing.assert_allclose(ours.axis, theirs.axis, atol=1e-15)
    np.testing.assert_allclose(left.inertias, right.inertias, atol=1e-13)


@pytest.mark.real_data
@pytest.mark.parametrize("arm", ["kr300", "tx40", "ur10", "ur10e", "airbot_play"])
def test_urdfs_of_real_arms_load(arm):
    path = DATA / arm / "robot.urdf"
    if not path.exists():
        pytest.skip(f"recordings of real robots are not part of the project: {path.parent.name} is absent")
    text = path.read_text()
    robot, model = robot_from_urdf(arm, text), pin.buildModelFromXML(text)
    assert robot.n == 6
    assert robot.joint_names == tuple(model.names)[1:]
    q = np.array([0.3, -0.5, 0.7, -0.9, 1.1, -1.3])
    np.testing.assert_allclose(joint_frames(robot, q[None])[0], pinocchio_frames(model, q), atol=1e-9)


def test_links_without_a_mass_need_no_torque_of_their_own() -> None:
    robot = robot_from_library("scara")
    inertias = robot.inertias.copy()
    inertias[-1] = 0.0
    bare, rng = replace(robot, inertias=inertias), np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1, 1, (3, 5, robot.n))
    torque = compute_described_torque(bare, q, dq, ddq)
    assert np.isfinite(torque).all()
    np.testing.assert_allclose(torque[:, -1], 0.0, atol=1e-12)


def test_a_world_that_no_element_describes_is_a_link_without_mass():
    welded = '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>'
    arm = (
        '<link name="base"/><link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    assert robot_from_urdf("one", f'<robot name="one">{welded}{arm}</robot>').joint_names == ("j",)
