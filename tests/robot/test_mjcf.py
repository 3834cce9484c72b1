"""An MJCF model is the robot that MuJoCo simulates: torques, ranges, gravity."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from dynident.errors import DynidentError
from dynident.robot import Description, robot_from_description
from dynident.robot.pinocchio_model import to_pinocchio

MODEL = """<mujoco model="arm">
  <compiler angle="degree"/><option gravity="0 -9.81 0"/>
  <default><default class="hinge"><joint range="-90 90"/></default></default>
  <worldbody>
    <body name="one" pos="0 0 .3">
      <inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .02"/><joint name="turn" class="hinge" axis="0 0 1"/>
      <body name="two" pos=".2 0 .4" euler="90 0 0">
        <joint name="lift" axis="0 1 0" range="-120 120" actuatorfrcrange="-50 50"/>
        <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" density="1000"/>
        <body name="three" pos=".4 0 0"><joint name="slide" type="slide" axis="1 0 0" range="0 .3"/>
          <geom type="box" size=".1 .05 .05" mass="1.5"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def test_a_model_has_the_torques_of_mujoco() -> None:
    robot = robot_from_description("arm", Description("mjcf", MODEL))
    assert robot.joint_names == ("turn", "lift", "slide")
    assert robot.gravity.tolist() == [0, -9.81, 0]
    theirs = mujoco.MjModel.from_xml_string(MODEL)
    theirs.jnt_limited[:] = 0
    state, ours = mujoco.MjData(theirs), to_pinocchio(robot)
    data = ours.createData()
    for q, dq, ddq in np.random.default_rng(0).uniform(-1, 1, (5, 3, 3)):
        state.qpos[:], state.qvel[:], state.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(theirs, state)
        np.testing.assert_allclose(pin.rnea(ours, data, q, dq, ddq), state.qfrc_inverse, atol=1e-6)


def test_ranges_are_in_rad_and_metres_whatever_the_compiler_says() -> None:
    robot = robot_from_description("arm", Description("mjcf", MODEL))
    turn, lift, slide = (joint.limits for joint in robot.joints)
    assert turn.position == pytest.approx((-np.pi / 2, np.pi / 2))
    assert lift.position == pytest.approx((-2 * np.pi / 3, 2 * np.pi / 3))
    assert lift.effort == 50
    assert slide.position == pytest.approx((0, 0.3))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<mujoco><worldbody>", "line 1: The XML is malformed"),
        ("<robot/>", "root element is <robot>"),
        ('<mujoco><include file="arm.xml"/></mujoco>', "includes arm.xml"),
        ("<mujoco><worldbody><body><geom size='.1'/></body></worldbody></mujoco>", "no joint that moves"),
        (MODEL.replace('<joint name="turn" class="hinge" axis="0 0 1"/>', "<freejoint/>"), "6 degrees of freedom"),
    ],
)
def test_what_is_no_fixed_tree_of_such_joints_is_told(text: str, told: str) -> None:
    with pytest.raises(DynidentError, match=told):
        robot_from_description("arm", Description("mjcf", text))
