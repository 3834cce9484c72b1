"""Robots of one joint, with what its axis may hide: gravity, first moments, products of inertia."""

from __future__ import annotations

from functools import cache

import numpy as np
from support.oracles import fourier_motion, pinocchio_torque, record

import dynident as dy
from dynident.api.recording_collection import CheckedRecording
from dynident.recordings import Recording
from dynident.robot import Robot, robot_from_urdf

# kind of joint, its axis (gravity acts along -z), centre of mass of the link
ONE_JOINT: dict[str, tuple[str, str, str]] = {
    "pendulum": ("revolute", "0 1 0", "0.2 0.01 -0.05"),
    "shaft": ("revolute", "0 1 0", "0 0.1 0"),
    "turntable": ("revolute", "0 0 1", "0.2 0.01 -0.05"),
    "spindle": ("revolute", "0 0 1", "0 0 0"),
    "lift": ("prismatic", "0 0 1", "0.2 0.01 -0.05"),
    "rail": ("prismatic", "1 0 0", "0.2 0.01 -0.05"),
}


def one_joint_urdf(name: str) -> str:
    """The URDF of one of them."""
    kind, axis, centre = ONE_JOINT[name]
    low, high = (-0.4, 0.4) if kind == "prismatic" else (-2.5, 2.5)
    return (
        f'<robot name="{name}"><link name="base"/><link name="body"><inertial><origin xyz="{centre}"/>'
        '<mass value="4"/><inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.04"/></inertial></link>'
        f'<joint name="axis" type="{kind}"><parent link="base"/><child link="body"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" velocity="2" effort="120"/></joint></robot>'
    )


@cache
def one_joint_robot(name: str) -> Robot:
    """One of the robots."""
    return robot_from_urdf(name, one_joint_urdf(name))


@cache
def one_joint_run(name: str, seed: int, coulomb: float = 1.5) -> Recording:
    """A run with Coulomb, viscous and Stribeck friction."""
    robot = one_joint_robot(name)
    motion = fourier_motion(robot, 20.0, 100.0, seed, amplitude=0.3 if "prismatic" in ONE_JOINT[name] else 1.2)
    v = motion.dq
    tau = pinocchio_torque(robot, motion.q, v, motion.ddq) + coulomb * np.sign(v) + 0.8 * v
    tau += 1.0 * np.exp(-((v / 0.1) ** 2)) * np.sign(v)
    tau += np.random.default_rng(seed).normal(0.0, 0.05, tau.shape)
    return record(robot, motion, tau, f"run{seed}")


@cache
def one_joint_recordings(name: str) -> dy.Recordings:
    """Two runs of the robot, and one of another day with more friction."""
    robot = one_joint_robot(name)
    runs = (one_joint_run(name, 1), one_joint_run(name, 2), one_joint_run(name, 3, 2.5))
    return dy.Recordings(tuple(CheckedRecording(run, (), robot) for run in runs))
