"""Bodies near each other at zero keep a smaller clearance, and their joints make smaller motions."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.motion import Surroundings
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import Robot, robot_from_urdf

GAP = 0.008


def robot_with(gap: float, axis: str = "0 1 0") -> Robot:
    """A trunk, an arm of two joints whose second link hangs beside it, and an arm on the other side, far away."""

    def link(name: str, size: str, at: str) -> str:
        shape = f'<origin xyz="{at}"/><geometry><box size="{size}"/></geometry>'
        inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
        return (
            f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="1"/>{inertia}</inertial>'
            f"<collision>{shape}</collision></link>"
        )

    def joint(name: str, parent: str, child: str, at: str, axis: str) -> str:
        return (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{at}"/><axis xyz="{axis}"/>'
            '<limit lower="-0.3" upper="1.5" velocity="2" effort="100"/></joint>'
        )

    # The fore link's inner face is `gap` away from the trunk's side at y = 0.1.
    return robot_from_urdf(
        "near",
        '<robot name="near">'
        + link("trunk", "0.2 0.2 0.6", "0 0 0.3")
        + link("upper", "0.04 0.04 0.04", "0 0.05 0")
        + link("fore", "0.04 0.04 0.3", f"0 {0.02 + gap - 0.05} -0.2")
        + link("other", "0.04 0.04 0.3", "0 -0.3 -0.2")
        + joint("shoulder", "trunk", "upper", "0 0.15 0.55", axis)
        + joint("elbow", "upper", "fore", "0 0 0", "1 0 0")
        + joint("far", "trunk", "other", "0 -0.15 0.55", "0 1 0")
        + "</robot>",
    )


def test_links_that_are_near_at_zero_keep_half_of_that_distance():
    bounds = build_bounds(robot_with(GAP), {}, surroundings=Surroundings(assume_floor=False))
    (pair,) = [pair for pair in bounds.space.contacts.pairs if pair.name == "fore – trunk"]
    assert pair.clearance == pytest.approx(GAP / 2)
    assert any(f"fore – trunk ({GAP / 2:.3g} m)" in note for note in bounds.notes)
    assert bounds.space.find_complaint(np.zeros((1, 3))) is None


def test_links_that_touch_at_zero_are_checked_all_the_same():
    bounds = build_bounds(robot_with(-0.001), {}, surroundings=Surroundings(assume_floor=False))
    (pair,) = [pair for pair in bounds.space.contacts.pairs if pair.name == "fore – trunk"]
    assert pair.clearance == Surroundings().clearance
    assert bounds.space.find_complaint(np.zeros((1, 3))) is not None


def test_only_the_joints_between_two_bodies_move_them():
    robot = robot_with(0.1)
    space = build_bounds(robot, {}, surroundings=Surroundings(assume_floor=False)).space
    moving = {
        name: {robot.joint_names[joint] for joint in space.contacts.list_moving_joints(name)}
        for name in ("fore – trunk", "fore – other", "no such pair")
    }
    assert moving["fore – trunk"] == {"shoulder", "elbow"}
    assert moving["fore – other"] == moving["no such pair"] == {"shoulder", "elbow", "far"}


def test_a_motion_is_designed_and_keeps_the_distances():
    trajectory = TrajectoryRequest(duration=3.0, harmonics=2, sampling_rate=50.0)
    request = DesignRequest(
        starts=1, random_trajectories=5, trajectory=trajectory, surroundings=Surroundings(assume_floor=False)
    )
    robot = robot_with(GAP)
    design = design_experiment(robot, request)
    near = [margin for margin in design.margins if margin.limit == "clearance"]
    assert near
    assert all(margin.value >= margin.bound for margin in near)
    # The arm that is near nothing is not held back by the one that is.
    assert np.ptp(design.q[:, robot.joint_names.index("far")]) > 0.5


def test_links_whose_capsules_always_overlap_are_kept_apart_by_their_shapes():
    # Aslant: between parallel edges and faces, the nearest points are any.
    robot = robot_with(GAP, axis="0.3 0.9 0.3")
    space = build_bounds(robot, {}, surroundings=Surroundings(assume_floor=False)).space
    (pair,) = [pair for pair in space.contacts.pairs if pair.name == "fore – trunk"]
    assert space.exact.pairs == (pair,)
    q = np.random.default_rng(1).uniform(-0.3, 0.6, (20, 3))
    distance = space.contacts.compute_distances(pair, q)
    assert distance.min() < 0 < distance.max()
    slack = space.exact.evaluate(q)
    np.testing.assert_allclose(slack.values[:, 0], distance - 1.1 * pair.clearance, atol=1e-9)
    np.testing.assert_allclose(space.exact.find_least(q), slack.values[:, 0], atol=1e-9)
    slope, step = slack.pull_back(np.ones((len(q), 1))), 1e-5
    for joint in range(robot.n):
        move = step * np.eye(robot.n)[joint]
        ends = [space.exact.evaluate(q + sign * move).values[:, 0] for sign in (1, -1)]
        np.testing.assert_allclose(slope[:, joint], (ends[0] - ends[1]) / (2 * step), atol=1e-3)
    assert (space.compute_least_slack(q) <= slack.values[:, 0] + 1e-9).all()
