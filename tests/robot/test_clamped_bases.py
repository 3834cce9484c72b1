"""A robot whose base floats in its description is read where the base is said to be clamped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import dynident as dy
from dynident.errors import DynidentError
from dynident.export import export_model
from dynident.robot import Description, Robot, robot_from_description
from dynident.robot.description_and_json import robot_from_document, robot_to_document, set_base
from dynident.robot.pinocchio_conversion import compute_described_torque

INERTIAL = """<inertial><origin xyz="0 0.01 -0.1"/><mass value="2"/>
<inertia ixx=".02" iyy=".03" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>"""
URDF = """<robot name="leg"><link name="world"/><link name="trunk">{inertial}</link><link name="thigh">{inertial}</link>
<joint name="base" type="{kind}"><parent link="world"/><child link="trunk"/><origin xyz="0 0 1" rpy="0.2 0 0"/></joint>
<joint name="hip" type="revolute"><parent link="trunk"/><child link="thigh"/><origin xyz="0 0.1 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="9" effort="9"/></joint></robot>"""
MJCF = """<mujoco model="leg"><worldbody><body name="trunk" pos="0 0 1" euler="11.459155902616464 0 0">{joint}
<inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
<body name="thigh" pos="0 0.1 0"><joint name="hip" axis="0 1 0"/>
<inertial pos="0 0.01 -0.1" mass="2" diaginertia=".02 .03 .01"/></body></body></worldbody>{key}</mujoco>"""


def urdf(kind: str) -> Description:
    return Description("urdf", URDF.format(kind=kind, inertial=INERTIAL))


def mjcf(joint: str, key: str = "") -> Description:
    return Description("mjcf", MJCF.format(joint=joint, key=key))


def leg(description: Description, **locked: float) -> Robot:
    return robot_from_description("leg", description, locked_joints=locked)


@pytest.mark.parametrize(
    ("description", "name"),
    [
        *((urdf(kind), "base") for kind in ("floating", "planar")),
        (mjcf('<freejoint name="root"/>', '<keyframe><key qpos="0 0 1 1 0 0 0 .3"/></keyframe>'), "root"),
        (mjcf('<joint type="free"/>'), "trunk_joint"),
        (mjcf('<joint name="neck" type="ball"/>'), "neck"),
    ],
)
def test_the_message_names_the_lock_with_which_it_is_read_as_if_it_were_fixed(
    description: Description, name: str
) -> None:
    with pytest.raises(DynidentError, match=rf'"locked_joints": {{"{name}": 0}}'):
        set_base(robot_from_description("leg", description), "fixed")
    with pytest.raises(DynidentError, match=r"only be locked at (its origin \(0\)|0)"):
        leg(description, **{name: 0.5})
    with pytest.raises(DynidentError, match="There is no joint 'other'"):
        leg(description, **{name: 0.0}, other=0.0)
    robot, fixed = leg(description, **{name: 0.0}), leg(urdf("fixed"))
    assert robot.joint_names == ("hip",)
    rng = np.random.default_rng(7)
    motion = [rng.normal(size=(20, 1)) for _ in range(3)]
    np.testing.assert_allclose(
        compute_described_torque(robot, *motion), compute_described_torque(fixed, *motion), atol=1e-9
    )
    assert robot_from_document(json.loads(json.dumps(robot_to_document(robot)))).joint_names == robot.joint_names


def test_such_a_robot_goes_through_identification_and_into_a_urdf_of_a_fixed_base(tmp_path: Path) -> None:
    file, log = tmp_path / "leg.urdf", tmp_path / "log.csv"
    file.write_text(URDF.format(kind="floating", inertial=INERTIAL))
    robot = dy.load_robot(file, locked_joints={"base": 0.0})
    t = np.arange(0.0, 20.0, 0.01)
    q, dq, ddq = (0.8 * values[:, None] for values in (np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)))
    torque = (
        compute_described_torque(robot, q, dq, ddq)
        + 0.3 * np.sign(dq)
        + np.random.default_rng(1).normal(0, 0.01, q.shape)
    )
    np.savetxt(log, np.column_stack([t, q, torque]), delimiter=",", header="t,q1,tau1", comments="")
    model = dy.identify(robot, dy.read_recordings(log, robot=robot))
    (tmp_path / "exported.urdf").write_bytes(export_model(model.identification, "urdf", nearest=True).content)
    exported = dy.load_robot(tmp_path / "exported.urdf")
    assert exported.joint_names == ("hip",)
