"""What is easily overlooked between a wish and a verified motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.motion import Box, Surroundings
from dynident.motion.collision.free_space import build_free_space
from dynident.motion.limits.bounds import ImpossibleLimitsError
from dynident.motion.limits.limit_margins import are_limits_kept
from dynident.robot import Limits, robot_from_urdf
from dynident.robot.link_meshes import build_hulls, find_mesh_file, read_surface

FRICTION = (EffectChoice("coulomb"), EffectChoice("viscous"))
SHORT = TrajectoryRequest(duration=4.0, harmonics=3, sampling_rate=100.0)
QUICK = DesignRequest(effects=FRICTION, trajectory=SHORT, kind="random", random_trajectories=3)
ARM = """<robot name="arm"><link name="base"/>
<link name="boom"><inertial><origin xyz="0.4 0 0"/><mass value="4"/><inertia ixx="0.1" iyy="0.3" izz="0.3" ixy="0"
 ixz="0" iyz="0"/></inertial></link>
<link name="slider"><inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0"
 ixz="0" iyz="0"/></inertial><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="2" effort="60"/></joint>
<joint name="slide" type="prismatic"><parent link="boom"/><child link="slider"/><axis xyz="1 0 0"/>
<limit velocity="1" effort="60"/></joint></robot>"""


def test_a_box_within_the_range_that_only_the_request_states_is_seen():
    """How far a point can travel rests on the range that holds, not on the description's, which has none."""
    robot = robot_from_urdf("arm", ARM.replace("<limit velocity", '<limit lower="-9" upper="9" velocity'))
    robot = replace(
        robot, joints=(robot.joints[0], replace(robot.joints[1], limits=replace(robot.joints[1].limits, position=None)))
    )
    box = Surroundings(boxes=(Box("post", (1.5, 0.0, 0.0), (0.02, 0.02, 0.02)),))
    space = build_free_space(robot, box, np.array([-3.0, 0.0]), np.array([3.0, 2.0]))
    path = np.column_stack([np.linspace(-3, 3, 5001), np.full(5001, 1.5)])
    assert space.find_complaint(path) is not None


@pytest.mark.parametrize("effort", [19.0, 20.0, 21.0])
def test_the_ways_from_and_to_home_keep_the_limits_as_the_exciting_part_does(effort):
    robot = robot_from_urdf("arm", ARM.replace('xyz="0 0 1"', 'xyz="0 1 0"'))
    limits = {"turn": Limits(effort=effort), "slide": Limits(position=(0.0, 0.5))}
    try:
        design = design_experiment(robot, replace(QUICK, limits=limits, home=(-2.4, 0.1)))
    except ImpossibleLimitsError:
        return
    assert are_limits_kept(design.margins)
    torque = build_design_model(robot, FRICTION).torque(design.q, design.dq, design.ddq)
    assert np.abs(torque[:, 0]).max() <= effort


def test_a_slower_pace_is_valued_as_it_is_run(scara):
    effects = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
    asked = replace(QUICK, effects=effects, trajectory=replace(SHORT, paces=(0.5,)))
    design = design_experiment(scara, asked)
    inside = (design.t >= design.exciting[0]) & (design.t < design.exciting[1])
    w = build_design_model(scara, effects).observe(design.q[inside], design.dq[inside], design.ddq[inside])
    assert design.period == pytest.approx(8.0)
    assert np.linalg.cond(w) == pytest.approx(design.criterion_values.condition_number, rel=0.05)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: {"trajectory": replace(SHORT, periods=10**400)},
        lambda: {"trajectory": replace(SHORT, sampling_rate=1e9), "kind": "constant_velocity"},
        lambda: {"trajectory": replace(SHORT, duration=1e9), "kind": "slow_sweep"},
        lambda: {"trajectory": replace(SHORT, sampling_rate=1e5, duration=86_400.0), "kind": "slow_sweep"},
        lambda: {"starts": 10**400},
        lambda: {"random_trajectories": 10**30},
    ],
)
def test_what_is_too_much_is_refused(scara, wrong):
    with pytest.raises(DynidentError, match=r"at most|it must be .* to"):
        design_experiment(scara, replace(QUICK, **wrong()))


def test_a_flat_mesh_is_a_thin_body(tmp_path: Path):
    plate = tmp_path / "plate.obj"
    plate.write_text("v 0 0 0\nv 1 0 0\nv 1 0.5 0\nv 0 0.5 0\nf 1 2 3\nf 1 3 4\n", encoding="utf-8")
    bodies = build_hulls(read_surface(plate, np.ones(3), np.eye(4)))
    assert all(min(body.size) == pytest.approx(1e-4) for body in bodies)
    robot = robot_from_urdf(
        "arm",
        ARM.replace('<sphere radius="0.02"/>', '<mesh filename="plate.obj"/>').replace(
            "<limit vel", '<limit lower="0" upper="1" vel'
        ),
    )
    near = Surroundings(boxes=(Box("post", (2.5, 0.0, 0.0), (0.1, 0.1, 0.1)),), mesh_folders=(str(tmp_path),))
    space = build_free_space(robot, near, np.array([-3.0, 0.0]), np.array([3.0, 1.0]))
    distance = space.contacts.find_approaches(np.array([[0.0, 1.0], [0.0, 0.9]]))[0].distance
    assert distance == pytest.approx(2.45 - 2.0, abs=2e-3)


def test_a_description_opens_no_file_outside_of_the_folders_that_are_named(tmp_path: Path):
    inside, outside = tmp_path / "meshes", tmp_path / "secret.stl"
    inside.mkdir()
    (inside / "a.stl").touch()
    outside.touch()
    assert find_mesh_file(str(outside), [inside]) is None
    assert find_mesh_file(f"file://{outside}", []) is None
    assert find_mesh_file("../secret.stl", [inside]) is None
    assert find_mesh_file(str(inside / "a.stl"), [inside]) == inside / "a.stl"
