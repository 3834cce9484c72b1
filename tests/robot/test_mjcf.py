"""Robots as MJCF has them, against MuJoCo's own computation on the same text."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from support.closed_loop_robots import MACHINES, machine, mjcf, states, torque_of_mujoco

from dynident.effects import EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.errors import DynidentError, Remedy
from dynident.identification.recording_faults.description_fit import describe_weightlessness
from dynident.regressors.observation_matrix import Observation
from dynident.robot import Robot, robot_from_mjcf
from dynident.robot.description_and_json import robot_from_document, robot_to_document

ARM = """<?xml version="1.0"?>
<!-- an arm -->
<mujoco model="arm">
  <compiler angle="degree" eulerseq="ZYX"/>
  <option gravity="0 1 -9"/>
  <asset><mesh name="shell" file="shell.stl"/><material name="red"/></asset>
  <default>
    <joint axis="0 1 0" damping="3"/>
    <geom material="red"/>
    <default class="wrist"><joint range="-90 45" armature="0.1"/></default>
  </default>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="1 1 1"/>
    <body name="shoulder" pos="0 0 0.3" euler="20 10 0">
      <geom type="mesh" mesh="shell"/>
      <inertial pos="0.1 0 0.02" mass="3" fullinertia="0.2 0.3 0.25 0.01 0.02 -0.01"/>
      <joint name="turn" axis="0 0.6 0.8" pos="0.05 0 0" ref="15"/>
      <joint name="lift" type="slide" axis="0 0 1" range="0 0.4"/>
      <frame pos="0.2 0.1 0" euler="0 30 0">
        <body pos="0.3 0 0" childclass="wrist">
          <joint/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.03"/>
          <body name="plate" pos="0 0 0.1" quat="1 1 0 0">
            <inertial pos="0 0.01 0" mass="0.5" diaginertia="0.01 0.02 0.015"/>
          </body>
        </body>
      </frame>
    </body>
  </worldbody>
  <actuator>
    <motor joint="turn" gear="50" ctrlrange="-2 2"/>
    <position joint="lift" kp="10" forcerange="-30 30"/>
    <muscle joint="lift" lengthrange="0 1"/>
  </actuator>
</mujoco>
"""


def torque(robot: Robot, q, dq, ddq) -> np.ndarray:
    signals = Signals(robot)
    observation = Observation.from_columns(robot, build_columns([EffectChoice("rigid_body")], signals), signals)
    entries = observation.evaluate(
        q, dq, ddq, reference=ReferenceParameters.massless(robot), memory=np.zeros((len(q), 0))
    )
    return observation.compute_torque(entries, robot.inertias.reshape(-1))


def test_the_torque_of_an_arm_is_mujocos_whatever_the_file_leaves_to_defaults() -> None:
    robot = robot_from_mjcf("arm", ARM)
    assert robot.joint_names == ("turn", "lift", "body_joint")
    assert robot.gravity.tolist() == [0, 1, -9]
    limits = [joint.limits for joint in robot.joints]
    assert (limits[0].position, limits[0].effort) == (None, 100.0)
    assert (limits[1].position, limits[1].effort) == ((0.0, 0.4), None)
    assert limits[2].position == pytest.approx((-np.pi / 2, np.pi / 4))
    text = ARM.replace('<geom type="mesh" mesh="shell"/>', "").replace('<mesh name="shell" file="shell.stl"/>', "")
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_damping[:] = model.dof_armature[:] = 0
    data = mujoco.MjData(model)
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, 20, 3))
    expected = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(q, dq, ddq, strict=True):
        acceleration = data.qacc.copy()
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qacc[:] = acceleration
        needed = np.zeros(3)
        mujoco.mj_rne(model, data, 1, needed)
        expected.append(needed)
    np.testing.assert_allclose(torque(robot, q, dq, ddq), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.sweep
@pytest.mark.parametrize("name", MACHINES)
def test_equalities_of_mujoco_are_read_as_loops_and_ties_that_move_as_mujocos_do(name: str) -> None:
    robot = robot_from_mjcf(name, mjcf(machine(name)))
    assert set(robot.joint_names) == set(machine(name).joint_names)
    q, dq, ddq = states(robot, 20)
    # The same text, written again from what was read.
    expected = torque_of_mujoco(robot, *robot.linkage.compute_motion(q, dq, ddq))
    order = [robot.joint_names.index(joint) for joint in machine(name).joint_names]
    as_described = torque(machine(name), q[:, order], dq[:, order], ddq[:, order])
    found = torque(robot, q, dq, ddq)
    assert np.abs(found - expected).max() < 1e-8 * np.abs(expected).max()
    assert np.abs(found[:, order] - as_described).max() < 1e-9 * np.abs(as_described).max()


def four_bar(equality: str, keys: str = "", drive: str = '<motor joint="crank"/>') -> str:
    inertia = '<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
    return f"""<mujoco><compiler angle="radian"/><default><joint axis="0 1 0"/></default><worldbody>
    <body name="a"><joint name="crank" range="-0.5 0.5"/>{inertia}
      <body name="b" pos="0 0 0.2"><joint name="rod"/>{inertia}<site name="tip" pos="0.5 0 0"/></body></body>
    <body name="c" pos="0.5 0 0"><joint name="rocker"/>{inertia}<site name="top" pos="0 0 0.2"/></body>
    </worldbody><equality>{equality}</equality><actuator>{drive}</actuator>{keys}</mujoco>"""


HELD = {
    "bodies": '<connect body1="b" body2="c" anchor="0.5 0 0"/>',
    "sites": '<connect site1="top" site2="tip"/>',
    "two points of a pin": '<connect body1="b" body2="c" anchor="0.5 0 0"/>'
    '<connect body1="b" body2="c" anchor="0.5 0.1 0"/>',
    "switched off": '<connect body1="b" body2="c" anchor="0.5 0 0"/><weld body1="a" body2="c" active="false"/>',
}


@pytest.mark.parametrize("how", HELD)
def test_a_parallelogram_in_a_plane_is_one_however_mujoco_holds_it(how: str) -> None:
    robot = robot_from_mjcf("bars", four_bar(HELD[how]))
    assert robot.joint_names == ("crank",)
    assert sum(loop.count for loop in robot.linkage.closure.loops) == 2
    q = np.linspace(-0.5, 0.5, 7)[:, None]
    np.testing.assert_allclose(robot.linkage.compute_positions(q), np.hstack([q, -q, q]), atol=1e-12)


def test_a_weld_holds_frames_wholly_and_its_repetitions_in_a_plane_are_left_out() -> None:
    text = four_bar('<weld body1="b" body2="d"/>').replace(
        "</worldbody>",
        '<body name="d" pos="0.5 0 0.2"><joint name="far" pos="0 0 -0.2"/><joint name="pin"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>',
    )
    robot = robot_from_mjcf("bars", text.replace('<joint name="rocker"/>', ""))
    q = np.linspace(-0.5, 0.5, 7)[:, None]
    np.testing.assert_allclose(robot.linkage.compute_positions(q), np.hstack([q, -q, q, -q]), atol=1e-12)


def test_a_fixed_tendon_ties_as_many_joints_as_it_has() -> None:
    text = four_bar(
        '<tendon tendon1="sum" polycoef="0.1 0 0 0 0"/>', drive='<motor joint="crank"/><motor joint="rocker"/>'
    ).replace(
        "<equality>",
        '<tendon><fixed name="sum"><joint joint="crank" coef="1"/><joint joint="rod" coef="2"/>'
        '<joint joint="rocker" coef="-4"/></fixed></tendon><equality>',
    )
    robot = robot_from_mjcf("tied", text)
    assert robot.joint_names == ("crank", "rocker")
    np.testing.assert_allclose(robot.linkage.compute_positions(np.array([[0.2, 0.3]])), [[0.2, 0.55, 0.3]])


def test_a_joint_tied_to_none_stands_still() -> None:
    robot = robot_from_mjcf("held", four_bar('<joint joint1="rod" polycoef="0.3 0 0 0 0"/>'))
    assert robot.joint_names == ("crank", "rocker")
    expected = robot_from_mjcf("held", four_bar(""), locked_joints={"rod": 0.3})
    np.testing.assert_allclose(robot.inertias, expected.inertias)


def test_a_machine_from_mjcf_comes_back_from_its_document() -> None:
    robot = robot_from_mjcf("bars", four_bar(HELD["bodies"]))
    again = robot_from_document(robot_to_document(robot))
    assert again.joint_names == robot.joint_names
    np.testing.assert_allclose(again.inertias, robot.inertias)


BAD = {
    "": "The MJCF is empty",
    "<mujoco>": "line 1: The XML is malformed",
    "<robot/>": "line 1: The root element is <robot>; an MJCF file needs the root element <mujoco>",
    "<mujoco/>": "The model has no <body>",
    '<mujoco>\n<include file="/etc/passwd"/></mujoco>': "line 2: <include> adds elements that are not in this text",
    '<mujoco><worldbody><replicate count="9"/></worldbody></mujoco>': "<replicate> adds elements",
    '<mujoco><worldbody>\n<body name="a">\n<freejoint/></body></worldbody></mujoco>': (
        "MuJoCo rejects the model: .* mass and inertia"
    ),
    '<mujoco><worldbody><body name="a"><joint type="ball"/></body></worldbody></mujoco>': "connected by a ball joint",
    '<mujoco><worldbody><body name="a"><joint/>\n<geom type="mesh" mesh="m"/></body></worldbody></mujoco>': (
        "line 2: The mass of its body comes from the mesh 'm', and mesh files are not read: add the <inertial>"
    ),
    '<mujoco><worldbody>\n\n<body name="a"><joint type="hing"/></body></worldbody></mujoco>': "MuJoCo .*line 3",
    '<mujoco><worldbody><body name="a"><joint/></body></worldbody></mujoco>': "mass and inertia of moving bodies",
    four_bar('<connect body1="b" body2="c" anchor="0.5 0 0"/>', drive=""): (
        r"line 5: No actuator acts on a joint of loop 'loop1'. Add a <motor joint=…/> for each of .* crank, rod"
    ),
    four_bar('<connect site1="top" site2="tip"/>', '<keyframe><key qpos="0 0 2"/></keyframe>').replace(
        'name="tip" pos="0.5', 'name="tip" pos="1.5'
    ): r"line 5: Loop 'loop1' does not close: .* [\d.]+ m apart, and at least [\d.]+ m",
    four_bar('<connect site1="top" site2="tip"/>').replace('pos="0.5 0 0"/></body>', 'pos="0.5 0.01 0"/></body>'): (
        r"does not close: .* at least 0.01 m"
    ),
    four_bar('<weld body1="b" body2="c"/>'): "equations of loop1 fix the driven joints crank at their start",
    four_bar('<connect body1="a" body2="a" anchor="0 0 0"/>', drive=""): "MuJoCo rejects|same body",
    four_bar('<joint joint1="crank" joint2="rod" polycoef="0 1 2 0 0"/>'): "polycoef .* only the first two",
    four_bar(
        '<joint joint1="crank" joint2="rod"/>', drive='<motor joint="crank"/><motor joint="rod"/>'
    ): "ties crank, rod, but each of them has an actuator",
    four_bar(HELD["bodies"], drive='<motor joint="crank"/><motor joint="rod"/>'): "fix the driven joints crank, rod",
    four_bar('<distance geom1="a" geom2="b"/>'): "<distance> is not a supported equality",
}


@pytest.mark.parametrize("text", BAD)
def test_what_cannot_be_used_is_said_with_its_line(text: str) -> None:
    with pytest.raises(DynidentError, match=BAD[text]):
        robot_from_mjcf("bad", text)


def test_files_with_looks_need_no_meshes_and_masses_from_primitive_shapes_count() -> None:
    robot = robot_from_mjcf("arm", ARM)
    assert robot.inertias[2, 9] == pytest.approx(0.5 + 1000 * np.pi * 0.03**2 * (np.sqrt(0.1) + 0.04), rel=1e-9)


def test_gravity_that_the_simulation_takes_off_all_bodies_is_told():
    remedy = Remedy("gravity", (0.0, 0.0, 0.0))
    for compensated in (False, True):
        text = ARM.replace("<body ", '<body gravcomp="1" ') if compensated else ARM
        cure, remedies = describe_weightlessness(robot_from_mjcf("arm", text))
        assert remedies == ((remedy,) if compensated else ())
        assert (str(remedy) in cure) is compensated
    # One body that hangs from its joint is enough.
    one = ARM.replace('<body name="shoulder"', '<body gravcomp="1" name="shoulder"')
    assert describe_weightlessness(robot_from_mjcf("arm", one)) == ("", ())
