"""Designs over HTTP that keep clear of what stands around the robot."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.standing_robots import SQUATTER, STANDER

from dynident.robot import library_table
from dynident_client import Client, JobFailed, ProblemError

SMALL = {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0}
CELL = {
    "floor": -0.3,
    "boxes": [{"name": "table", "center": [0.9, 0, 0.1], "size": [0.4, 1.0, 0.4]}],
    "walls": [{"name": "fence", "point": [-0.9, 0, 0], "normal": [1, 0, 0]}],
    "tool_range": {"low": [None, None, 0.1]},
    "clearance": 0.03,
}


def test_a_design_tells_how_near_it_comes_to_the_surroundings(live: Client) -> None:
    robot = live.robots.create("panda", modified_dh=library_table("franka_panda"))
    quick = {"kind": "random", "trajectory": SMALL, "random_trajectories": 3, "effects": [{"effect": "viscous"}]}
    design = live.designs.create(robot, **quick, surroundings=CELL, torque_margin=0.1).wait()
    margins = design.result["margins"]
    clearances = [margin for margin in margins if margin["limit"] == "clearance"]
    assert {margin["joint"].split(" – ")[0] for margin in clearances} >= {f"joint{j}" for j in range(2, 8)}
    assert all(margin["value"] >= margin["bound"] == 0.03 for margin in clearances)
    (tool,) = (margin for margin in margins if margin["limit"] == "tool_min")
    assert tool["joint"] == "tool z"
    assert tool["value"] >= tool["bound"] == 0.1
    assert next(m["bound"] for m in margins if m["limit"] == "torque") == pytest.approx(87 / 1.1)
    # What the links are nearest to on the way is there for a picture; the margins are those of a finer grid.
    along = live.designs.clearances(design, points=80)
    assert len(along["t"]) == 80
    assert (along["t"][0], along["t"][-1]) == (0.0, pytest.approx(design.result["duration"], abs=0.02))
    least = {margin["joint"].split(" – ")[0]: margin["value"] for margin in clearances}
    assert {one["name"] for one in along["links"]} == set(least)
    for one in along["links"]:
        assert min(one["distance"]) >= least[one["name"]] - 1e-3
        assert set(map(len, (one["to"], one["here"], one["there"], one["wanted"]))) == {80}
    with pytest.raises(ProblemError) as refused:
        live.designs.clearances(design, points=1)
    assert refused.value.status == 422


def test_what_stands_around_the_robot_has_outlines_for_a_picture(live: Client) -> None:
    robot = live.robots.create("panda", modified_dh=library_table("franka_panda"))
    shelf = {"name": "shelf", "center": [3.0, 0.0, 0.5], "size": [0.2, 0.4, 0.6], "rpy": [0.0, 0.0, math.pi / 2]}
    around = {"boxes": [shelf], "walls": [{"name": "fence", "point": [-3.0, 0, 0], "normal": [2, 0, 0]}]}
    quick = {"kind": "random", "trajectory": SMALL, "random_trajectories": 3, "effects": [{"effect": "viscous"}]}
    found = live.designs.clearances(live.designs.create(robot, **quick, surroundings=around).wait(), points=2)
    edges = np.array(found["edges"])
    assert edges.shape == (12, 2, 3)
    # Turned by a right angle about z: what was along x is along y.
    low, high = edges.min(axis=(0, 1)), edges.max(axis=(0, 1))
    np.testing.assert_allclose([low, high], [[2.8, -0.1, 0.2], [3.2, 0.1, 0.8]], atol=1e-5)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat([0.2, 0.4, 0.6], 4), atol=1e-5)
    (wall,) = found["walls"]
    axes = np.array([[1.0, 0.0, 0.0], *wall["along"]])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def test_what_is_no_obstacle_is_refused_with_its_field(live: Client) -> None:
    robot = live.robots.create("panda", modified_dh=library_table("franka_panda"))
    for wrong, pointer in (
        ({"surroundings": {"clearance": 0}}, "/surroundings/clearance"),
        (
            {"surroundings": {"boxes": [{"name": "a", "center": [0, 0, 0], "size": [1, 0, 1]}]}},
            "/surroundings/boxes/0/size/1",
        ),
        ({"surroundings": {"mesh_folders": ["/etc"]}}, "/surroundings/mesh_folders"),
        ({"torque_margin": -1}, "/torque_margin"),
    ):
        with pytest.raises(ProblemError) as refused:
            live.designs.create(robot, **wrong)
        assert refused.value.status == 422
        assert refused.value.errors[0]["pointer"] == pointer


def test_a_robot_on_its_feet_keeps_its_balance_and_the_ground_is_drawn(live: Client) -> None:
    robot = live.robots.create("stander", urdf=STANDER, base="floating")
    body = {
        "kind": "random",
        "trajectory": SMALL,
        "random_trajectories": 3,
        "standing": {"feet": ["left_foot", "right_foot"], "friction": 0.6, "margin": 0.02},
    }
    design = live.designs.create(robot, **body).wait()
    margins = {margin["limit"]: margin for margin in design.result["margins"]}
    assert margins["balance"]["value"] >= margins["balance"]["bound"] == 0.02
    assert margins["friction"]["value"] <= margins["friction"]["bound"] == 0.6
    (ground,) = live.designs.clearances(design, points=10)["walls"]
    assert ground["point"][2] == pytest.approx(-0.52, abs=0.01)
    with pytest.raises(JobFailed, match="does not balance at home"):
        live.designs.create(robot, **body, home=[-0.35, 0.0, -0.35, 0.0, 0.0]).wait()


def test_a_trunk_that_sways_is_designed_and_not_simulated_on_a_held_base(live: Client) -> None:
    robot = live.robots.create("squatter", urdf=SQUATTER)
    leg = [0.0, 0.0, -0.4, 0.8, -0.4, 0.0]
    body = {"kind": "random", "trajectory": SMALL, "random_trajectories": 2, "home": [*leg, *leg, 0.0, 0.0]}
    standing = {"feet": ["left_foot", "right_foot"], "sway": [0.03, 0.1]}
    design = live.designs.create(robot, **body, standing=standing).wait()
    with pytest.raises(JobFailed, match="sways over its feet cannot be simulated"):
        live.simulations.create(robot, design=design).wait()
    with pytest.raises((JobFailed, ProblemError), match="none is named"):
        live.designs.create(robot, **body, standing={"sway": [0.03, 0.1]}).wait()
