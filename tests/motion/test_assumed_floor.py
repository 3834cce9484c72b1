"""Where nothing around a robot is stated, no design takes an arm that stands on its base through the floor there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.motion import Surroundings
from dynident.motion.collision.obstacle_geometry import (
    FLOOR_ALONE,
    FLOOR_ASSUMED,
    NOTHING_STATED,
    assume_floor,
    measure_reach,
)
from dynident.robot import Robot, library_names, robot_from_library, robot_from_urdf
from dynident.robot.urdf_writer import urdf_from_robot

PENDULUM = """<robot name="p"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -0.4"/><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="bob"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="3" effort="20"/></joint>
<joint name="turn" type="revolute"><parent link="rod"/><child link="bob"/><origin xyz="0 0 -0.5"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="3" effort="20"/></joint></robot>"""
QUICK = DesignRequest(kind="random", trajectory=TrajectoryRequest(duration=6.0), starts=1, random_trajectories=20)


def limits_of(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    position = [joint.limits.position or (-np.pi, np.pi) for joint in robot.joints]
    return np.array([low for low, _ in position]), np.array([high for _, high in position])


def floor_of(robot: Robot, surroundings: Surroundings) -> float | None:
    return assume_floor(robot, surroundings, *limits_of(robot))[0].floor


def test_a_floor_is_assumed_under_upright_arms_and_nowhere_else() -> None:
    for name in library_names():
        assert floor_of(robot_from_library(name), Surroundings()) == 0.0, name
    arm = robot_from_library("ur5")
    for gravity in ([0, 0, 9.81], [-9.81, 0, 0], [0, -6.9, -6.9], [0, 0, 0]):
        assert floor_of(replace(arm, gravity=np.array(gravity, dtype=float)), Surroundings()) is None
    assert floor_of(robot_from_urdf("p", PENDULUM), Surroundings()) is None
    assert floor_of(arm, Surroundings(assume_floor=False)) is None
    assert floor_of(arm, Surroundings(floor=-0.7)) == -0.7


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["ur5", "ur10", "scara"])
def test_no_joint_goes_through_it_with_or_without_collision_geometry(name: str) -> None:
    described = robot_from_library(name)
    bare = robot_from_urdf(name, urdf_from_robot(described))
    for robot in (described, bare):
        found = design_experiment(robot, QUICK)
        assert measure_reach(robot, found.t, found.q).lowest >= 0.0
        assert FLOOR_ASSUMED in found.notes
        assert getattr(found.notes[-1], "code", "") == FLOOR_ALONE
        anywhere = design_experiment(robot, replace(QUICK, surroundings=Surroundings(assume_floor=False)))
        assert getattr(anywhere.notes[-1], "code", "") == NOTHING_STATED
        assert FLOOR_ASSUMED not in anywhere.notes
