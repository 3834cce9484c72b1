"""Torque of exported URDF and MJCF files."""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np
from support.models_with_chosen_parameters import (
    FloatArray,
)
from support.oracles import Motion, pinocchio_torque

from dynident.export.urdf import ROTOR_TAG
from dynident.robot import robot_from_urdf


def torque_of_urdf(text: str, gravity: FloatArray, motion: Motion) -> FloatArray:
    """What a program that reads the file and its extension computes."""
    robot = robot_from_urdf("read back", text, gravity=gravity.tolist())
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    for j, name in enumerate(robot.joint_names):
        dynamics, rotor = joints[name].find("dynamics"), joints[name].find(ROTOR_TAG)
        tau[:, j] += float(dynamics.get("damping")) * motion.dq[:, j]
        tau[:, j] += float(dynamics.get("friction")) * np.sign(motion.dq[:, j])
        tau[:, j] += 0.0 if rotor is None else float(rotor.get("inertia")) * motion.ddq[:, j]
    return tau


def torque_of_mjcf(text: str, motion: Motion) -> FloatArray:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    tau = np.empty_like(motion.q)
    for k in range(len(motion.q)):
        data.qpos, data.qvel, data.qacc = motion.q[k], motion.dq[k], motion.ddq[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse
    return tau


def moving(motion: Motion) -> FloatArray:
    """(m,): samples where every joint is well away from rest, where friction is what its sign says."""
    return np.all(np.abs(motion.dq) > 2e-3 * np.abs(motion.ddq) + 1e-2, axis=1)


OWN = """<?xml version="1.0"?>
<!-- my arm -->
<robot name="mine" xmlns:xacro="http://ros.org/xacro">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="world"/>
  <link name="base">
    <inertial><mass value="5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <link name="upper">
    <visual><geometry><mesh filename="package://mine/upper.stl"/></geometry></visual>
    <inertial>
      <origin xyz="0 0 0.2"/><mass value="4"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".02"/>
    </inertial>
  </link>
  <link name="cover">
    <inertial><mass value="0.5"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>
  </link>
  <link name="fore">
    <inertial>
      <origin xyz="0 .05 0.1"/><mass value="2"/><inertia ixx=".05" ixy="0" ixz="0" iyy=".05" iyz="0" izz=".01"/>
    </inertial>
  </link>
  <link name="finger">
    <inertial><mass value="0.3"/><inertia ixx=".001" ixy="0" ixz="0" iyy=".001" iyz="0" izz=".001"/></inertial>
  </link>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0.2 0.1 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="2" effort="50"/><dynamics damping="9" friction="8" note="kept"/>
  </joint>
  <joint name="bolt" type="fixed"><origin xyz="0.1 0 0"/><parent link="upper"/><child link="cover"/></joint>
  <joint name="elbow" type="continuous">
    <origin xyz="0 0 0.5"/><parent link="upper"/><child link="fore"/><axis xyz="1 0 0"/>
  </joint>
  <joint name="grip" type="prismatic"><origin xyz="0 0 0.3" rpy="0 0.4 0"/><parent link="fore"/><child link="finger"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.05" velocity="1" effort="5"/></joint>
  <transmission name="t1"><joint name="shoulder"/></transmission>
  <gazebo reference="upper"><selfCollide>true</selfCollide></gazebo>
</robot>
"""
