"""Machines with joints that follow others, and closed loops, as they are read."""

from __future__ import annotations

import json
from typing import Any

import casadi as ca
import numpy as np
import pytest
from support.closed_loop_robots import delta, five_bar, machine, palletiser, six_axis
from support.urdf_texts import joint, link
from support.urdf_texts import machine as urdf

from dynident.errors import DynidentError
from dynident.robot import robot_from_urdf, urdf_from_robot
from dynident.robot.description_and_json import robot_from_document, robot_to_document
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.modified_dh import robot_from_modified_dh

AXIS_Z = '<axis xyz="0 0 1"/>'


def gripper(mimic: str = '<mimic joint="left" multiplier="-0.5" offset="0.1"/>') -> str:
    return urdf(
        link("base"), link("hand"), link("l"), link("r"),
        joint("wrist", "base", "hand", inside=AXIS_Z),
        joint("left", "hand", "l", "prismatic", inside=AXIS_Z),
        joint("right", "hand", "r", "prismatic", inside=AXIS_Z + mimic),
    )  # fmt: skip


def test_data_and_limits_are_of_the_driven_joints_and_the_links_are_all_there() -> None:
    robot = robot_from_urdf("gripper", gripper())
    assert robot.joint_names == ("left", "wrist") or robot.joint_names == ("wrist", "left")
    assert robot.tree.n == 3
    assert robot.inertias.shape == (3, 10)
    q = np.array([[0.3, 0.3]])
    at = dict(zip(robot.tree.joint_names, robot.linkage.compute_positions(q)[0], strict=True))
    assert at["right"] == pytest.approx(-0.5 * at["left"] + 0.1, abs=1e-15)


def test_a_robot_with_ties_comes_back_from_its_document_and_from_its_urdf() -> None:
    robot = robot_from_urdf("gripper", gripper())
    for again in (
        robot_from_document(json.loads(json.dumps(robot_to_document(robot)))),
        robot_from_urdf("gripper", urdf_from_robot(robot)),
    ):
        assert again.joint_names == robot.joint_names
        np.testing.assert_allclose(again.linkage.ratios, robot.linkage.ratios)
        np.testing.assert_allclose(again.linkage.offsets, robot.linkage.offsets)
        np.testing.assert_allclose(again.inertias, robot.inertias, atol=1e-14)


def test_a_joint_whose_leader_is_locked_stands_where_that_puts_it() -> None:
    robot = robot_from_urdf("gripper", gripper(), locked_joints={"left": 0.2})
    assert robot.joint_names == ("wrist",)
    assert robot.linkage is None
    expected = robot_from_urdf("gripper", gripper(""), locked_joints={"left": 0.2, "right": 0.0})
    np.testing.assert_allclose(robot.inertias, expected.inertias)


@pytest.mark.parametrize("name", ["five_bar", "palletiser", "delta", "six_axis"])
def test_the_cut_frames_of_a_loop_coincide_at_all_driven_positions(name: str) -> None:
    robot = machine(name)
    closure = robot.linkage.closure
    q = closure.draw_postures(np.random.default_rng(1), 100)
    gaps, conditions = closure.compute_gaps_and_conditions(q)
    assert gaps.max() < 1e-10
    assert conditions.max() < 1e3
    frames = joint_frames(robot, q)
    for loop in closure.loops:
        first, second = (frames[:, end.joint] @ end.frame for end in loop.ends)
        assert np.abs(first[:, :3, 3] - second[:, :3, 3]).max() < 1e-10


def test_the_passive_joints_stay_on_the_branch_of_the_start() -> None:
    other = five_bar()
    other["joints"][1]["start"], other["joints"][3]["start"] = -2.9, 2.6
    robots = [machine("five_bar"), robot_from_modified_dh("below", other)]
    q = np.array([[2.1, 1.0], [2.3, 0.8]])
    tips = [(joint_frames(robot, q)[:, 1] @ np.array([0.4, 0, 0, 1]))[:, 1] for robot in robots]
    assert np.all(tips[0] > 0.3)
    assert np.all(tips[1] < 0.3)


def levelled() -> dict[str, Any]:
    """A palletiser in a plane whose wrist two further parallelograms keep level: each carries the next one."""
    return {
        "gravity": [0, -9.81, 0],
        "joints": [
            {"name": "arm", "antecedent": "base", "start": 1.4, "limits": {"position": [0.8, 2.0]}},
            {"name": "forearm", "d": 0.8, "passive": True, "start": -1.6},
            {"name": "lever", "antecedent": "base", "start": 2.9, "limits": {"position": [2.5, 3.5]}},
            {"name": "rod", "d": 0.25, "passive": True, "start": -1.5},
            {"name": "stay", "antecedent": "base", "d": -0.2, "passive": True, "start": 1.4},
            {"name": "plate", "antecedent": "arm", "d": 0.8, "passive": True, "start": -1.4},
            {"name": "upper_stay", "gamma": "pi/2", "d": 0.25, "passive": True, "start": -1.77},
            {"name": "wrist", "antecedent": "forearm", "d": 0.9, "passive": True, "start": 0.2},
        ],
        "loops": [
            {"name": name, "kind": "planar", "between": [{"joint": one, "at": here}, {"joint": other, "at": there}]}
            for name, one, here, other, there in (
                ("level", "upper_stay", [0.9, 0, 0], "wrist", [0, 0.25, 0]),
                ("drive", "rod", [0.8, 0, 0], "forearm", [-0.25, 0, 0]),
                ("stays", "stay", [0.8, 0, 0], "plate", [-0.2, 0, 0]),
            )
        ],
    }


def four_bar(*, turned_over: bool) -> dict[str, Any]:
    """A crank with both passive joints behind it, the second one about the opposite axis or not."""
    follower = {"alpha": "pi", "start": 1.5} if turned_over else {"start": -1.5}
    return {
        "joints": [
            {"name": "crank", "antecedent": "base", "start": 1.0, "limits": {"position": [0.4, 2.6]}},
            {"name": "coupler", "d": 0.3, "passive": True, "start": -0.6},
            {"name": "follower", "d": 0.55, "passive": True} | follower,
        ],
        "loops": [
            {
                "name": "pin",
                "kind": "planar",
                "between": [{"joint": "base", "at": [0.5, 0, 0]}, {"joint": "follower", "at": [0.35, 0, 0]}],
            }
        ],
    }


def slider() -> dict[str, Any]:
    """A driven slider that folds two rods: a side of the triangle changes its length."""
    return {
        "joints": [
            {"name": "slide", "antecedent": "base", "gamma": "pi/2", "alpha": "pi/2", "sigma": 1}
            | {"start": 0.6, "limits": {"position": [0.35, 0.8]}},
            {"name": "near", "antecedent": "base", "passive": True, "start": 0.9},
            {"name": "far", "d": 0.5, "passive": True, "start": -1.8},
        ],
        "loops": [
            {
                "name": "pin",
                "kind": "planar",
                "between": [{"joint": "far", "at": [0.5, 0, 0]}, {"joint": "slide", "at": [0, 0, 0]}],
            }
        ],
    }


IN_CLOSED_FORM = {
    "five_bar": five_bar(),
    "palletiser": palletiser(),
    "levelled": levelled(),
    "four_bar": four_bar(turned_over=False),
    "four_bar, turned over": four_bar(turned_over=True),
    "slider": slider(),
}


@pytest.mark.parametrize("name", [*IN_CLOSED_FORM, "delta"])
def test_passive_positions_are_those_that_newtons_method_follows_and_their_sines_are_theirs(name: str) -> None:
    closure = robot_from_modified_dh(name, IN_CLOSED_FORM.get(name) or delta()).linkage.closure
    q = closure.draw_postures(np.random.default_rng(1), 200)
    followed, fine = closure.follow_branch(q)
    found = closure.solution.map(len(q)).call([q.T])
    x, cosines, sines = (one.full().T for one in found)
    assert np.abs(x - followed)[fine].max() < 1e-12
    angles = np.array(closure.are_angles)
    assert np.abs(cosines - np.cos(x))[:, angles].max() < 1e-14
    assert np.abs(sines - np.sin(x))[:, angles].max() < 1e-14
    assert closure.compute_gaps_and_conditions(q)[0].max() < 1e-14
    operations = {closure.solution.instruction_id(k) for k in range(closure.solution.n_instructions())}
    assert (ca.OP_ATAN2 in operations) == (name in IN_CLOSED_FORM)


def test_beyond_the_reach_of_a_loop_positions_are_numbers_and_the_loop_is_open() -> None:
    closure = machine("five_bar").linkage.closure
    apart, fine = np.array([[3.1, 0.0]]), closure.draw_postures(np.random.default_rng(1), 5)
    gaps, _ = closure.compute_gaps_and_conditions(np.vstack([apart, fine]))
    assert gaps[0] > 0.01
    assert gaps[1:].max() < 1e-14
    assert np.isfinite(closure.solve_passive(apart)).all()
    assert np.isfinite(closure.compute_rates(apart, closure.solve_passive(apart))).all()


CHANGED_JOINTS: dict[str, dict[str, dict[str, Any]]] = {
    "itself": {"flange": {"tie": {"flange": 2}}},
    "each other": {"flange": {"tie": {"yaw": 2}}, "yaw": {"tie": {"flange": 1}}},
    "nobody": {"flange": {"tie": {"elbow": 1}}},
    "none": {"flange": {"tie": {"yaw": 0}}},
    "both": {"rod": {"tie": {"arm": 1}}},
    "free": {"flange": {"passive": True}},
    "undriven": {"arm": {"passive": True}, "lever": {"passive": True}},
}


def table(change: str) -> dict[str, Any]:
    if change == "singular":
        return singular_five_bar()
    made = palletiser(rod=2.8) if change == "too short" else palletiser()
    for row in made["joints"]:
        row |= CHANGED_JOINTS.get(change, {}).get(row["name"], {})
    loop = made["loops"][0]
    if change in ("redundant", "kind"):
        loop["kind"] = {"redundant": "point", "kind": "weld"}[change]
    elif change in ("same body", "unknown body"):
        loop["between"][1]["joint"] = {"same body": "rod", "unknown body": "elbow"}[change]
    return made


def singular_five_bar() -> dict[str, Any]:
    made = five_bar()
    made["joints"][0] |= {"start": np.pi, "limits": {"position": [3.0, 3.3]}}
    made["joints"][2] |= {"start": 0.0, "d": 0.2, "limits": {"position": [-0.2, 0.2]}}
    made["joints"][1]["start"], made["joints"][3]["start"] = -np.pi, np.pi
    return made


BAD = {
    "itself": ("/joints/5/tie", "'flange' follows 'flange': a joint cannot follow itself"),
    "each other": ("/tie", "'yaw' follows 'flange' follows 'yaw': a joint cannot follow itself"),
    "nobody": ("/joints/5/tie", "follows 'elbow', which is not a moving joint; moving joints: yaw, arm"),
    "none": ("/joints/5/tie", "by 0.0; expected a number other than 0"),
    "both": ("/joints/4/passive", "give either passive or tie"),
    "too short": (
        "/loops/0",
        r"'parallelogram' does not close: .* its frames are [\d.]+ m apart, and at least [\d.]+ m",
    ),
    "redundant": ("/loops/0", "'parallelogram' has redundant constraints: 3 equations for 2 passive"),
    "free": ("/loops", "The passive joints flange belong to no loop"),
    "undriven": ("/loops/0", "No driven joint moves loop 'parallelogram'|4 passive joints .* for 2 equations"),
    "same body": ("/loops/0/between", "on the same body"),
    "unknown body": ("/loops/0/between/1/joint", "There is no moving joint 'elbow'; expected base or one of yaw"),
    "kind": ("/loops/0/kind", "Expected planar, point, full"),
    "singular": ("/loops/0", r"singular at the start \(condition"),
}


@pytest.mark.parametrize("change", BAD)
def test_what_cannot_be_closed_or_followed_is_said_with_its_place(change: str) -> None:
    where, what = BAD[change]
    with pytest.raises(DynidentError, match=what) as caught:
        robot_from_modified_dh("bad", table(change))
    assert caught.value.pointer.endswith(where)


def test_a_passive_joint_has_no_drive() -> None:
    from dynident.robot import Drive

    with pytest.raises(
        DynidentError, match="'rod' follows other joints, so it cannot have a drive; driven joints: yaw, arm"
    ):
        robot_from_modified_dh("bad", palletiser(), drives={"rod": Drive(drive_gain=2.0)})


def test_every_kind_of_machine_has_its_driven_joints() -> None:
    assert machine("delta").joint_names == ("arm0", "arm1", "arm2")
    assert robot_from_modified_dh("d", delta()).tree.n == 12
    assert len(six_axis()["joints"]) == 10
    assert machine("six_axis").joint_names == ("yaw", "arm", "lever", "roll", "pitch", "turn", "finger")
