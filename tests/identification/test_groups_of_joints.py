"""What is wrong with several joints alike is one finding: exchanged legs, drives in other units, joints that lack."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import FloatArray, guess, legged, log, log_of, read, signals
from support.oracles import arm, crooked_urdf

from dynident.errors import Remedy
from dynident.identification import identify
from dynident.identification.recording_faults.torque_scale import find_excess_friction
from dynident.identification.recording_faults.tree_fit import list_chains, list_trees
from dynident.recordings import Check, RecordingError, Revision
from dynident.robot import Robot, robot_from_urdf
from dynident.verdict import verdict
from dynident_cli.request_options import write_option

pytestmark = pytest.mark.sweep


def refused(robot: Robot, folder: Path, columns: dict[str, FloatArray]) -> list[Check]:
    with pytest.raises(RecordingError) as raised:
        read(robot, folder, columns)
    return [one for one in raised.value.checks if one.status != "ok"]


@pytest.mark.parametrize(("legs", "order", "kind"), [
    (2, (1, 0), "tau"),
    (2, (1, 0), "q"),
    (3, (1, 2, 0), "tau"),
    (4, (2, 3, 0, 1), "q"),
    (4, (1, 2, 3, 0), "tau"),
    pytest.param(4, (1, 2, 3, 0), "q", marks=pytest.mark.slow),
    *(pytest.param(4, order, kind, marks=pytest.mark.thorough)
      for order in ((1, 0, 2, 3), (1, 0, 3, 2), (0, 3, 2, 1), (3, 1, 0, 2)) for kind in ("tau", "q")),
])  # fmt: skip
def test_exchanged_legs_are_one_finding_with_one_cure(
    tmp_path: Path, legs: int, order: tuple[int, ...], kind: str
) -> None:
    given = log_of(legged(legs, seed=legs), seed=legs)
    exchanged = np.concatenate([3 * leg + np.arange(3) for leg in order])
    columns = given.columns(**{kind: (given.tau if kind == "tau" else given.q)[:, exchanged]})
    found = refused(given.robot, tmp_path, columns)
    assert [one.name for one in found] in (["torque_order"], ["joint_order"])
    assert found[0].apply is not None
    cured = read(given.robot, tmp_path, columns, cures=1)
    q, tau = signals(cured)
    # Exchanged torques and exchanged positions are the same, but for what the legs are called.
    of_leg = {tuple(np.round(q[200, 3 * leg : 3 * leg + 3], 3)): tau[200, 3 * leg] for leg in range(legs)}
    for leg in range(legs):
        own = tuple(np.round(given.q[200, 3 * leg : 3 * leg + 3], 3))
        assert of_leg[own] == pytest.approx(given.tau[200, 3 * leg], abs=1e-6)


@pytest.mark.parametrize("kind", ["tau", "q"])
def test_all_recordings_of_a_robot_get_the_same_cure_of_exchanged_legs(tmp_path: Path, kind: str) -> None:
    """Exchanged torques and exchanged positions leave alike where nothing is known of the masses."""
    robot = replace(legged(2, seed=2), inertias=None)
    cures = []
    for seed in range(4):
        given = log_of(legged(2, seed=2), seed=seed)
        columns = given.columns(**{kind: (given.tau if kind == "tau" else given.q)[:, [3, 4, 5, 0, 1, 2]]})
        cures.append(refused(robot, tmp_path, columns)[0].apply)
    assert cures == [Revision(permutation={"tau": (4, 5, 6, 1, 2, 3)})] * 4


def test_trees_that_stand_side_by_side_share_no_fit_and_a_moving_trunk_joins_them() -> None:
    assert list_trees(legged(2)) == [[0, 1, 2], [3, 4, 5]]
    assert list_trees(log().robot) == [list(range(6))]
    assert list_trees(arm("dual_arm")) == [list(range(arm("dual_arm").n))]


def test_columns_from_the_last_joint_on_are_one_finding(tmp_path: Path) -> None:
    given = log("ur10", 5)
    found = refused(given.robot, tmp_path, given.columns(tau=given.tau[:, ::-1]))
    assert [one.name for one in found] == ["torque_order"]
    q, tau = signals(read(given.robot, tmp_path, given.columns(tau=given.tau[:, ::-1]), cures=1))
    np.testing.assert_allclose(tau, given.tau, atol=1e-9)
    np.testing.assert_allclose(q, given.q, atol=1e-9)


def test_untouched_legs_have_no_finding(tmp_path: Path) -> None:
    for legs in (2, 4):
        given = log_of(legged(legs, seed=legs + 5), seed=legs)
        assert [one for one in read(given.robot, tmp_path, given.columns()).checks if one.status != "ok"] == []


def test_chains_of_a_tree_end_where_it_branches() -> None:
    assert list_chains(legged(2)) == [[0, 1, 2], [3, 4, 5]]
    assert list_chains(log().robot) == [list(range(6))]


@pytest.mark.parametrize(("name", "seed", "first", "times"), [
    ("ur10", 1, 3, 207.0), ("ur10", 2, 3, 45.0), ("ur10", 3, 4, 1900.0), ("franka_panda", 4, 4, 130.0),
    ("ur10", 5, 2, 1.0 / 300.0),
])  # fmt: skip
def test_drives_of_another_make_are_one_group_with_a_ratio(
    tmp_path: Path, name: str, seed: int, first: int, times: float
) -> None:
    given = log(name, seed)
    factors = np.where(np.arange(given.robot.n) >= first, times, 1.0)
    columns = given.columns(tau=given.tau * factors)
    try:
        checks = read(given.robot, tmp_path, columns).checks
    except RecordingError as error:
        checks = error.checks
    found = [one for one in checks if one.status != "ok" and one.name not in ("saturation", "registers")]
    assert [one.name for one in found] == ["torque_scale"]
    for joint, joint_name in enumerate(given.robot.joint_names):
        assert (joint_name in found[0].detail) == (joint >= first), found[0].detail
    questions = [one for one in guess(given.robot, columns).questions if one.field == "units/tau"]
    assert len(questions) == 1


@pytest.mark.parametrize(("seed", "gain"), [(1, 900.0), (2, 4000.0), (3, 250.0)])
def test_an_error_of_a_controller_in_the_place_of_a_torque_is_asked_and_never_fit_for_use(
    tmp_path: Path, seed: int, gain: float
) -> None:
    given = log("ur10", seed)
    columns = given.columns(tau=given.tau / gain)
    named = {key.replace("tau", "effort_"): values for key, values in columns.items()}
    asked = {one.field: one for one in guess(given.robot, named).questions}
    assert "the error of a controller" in asked["units/tau"].detail
    found = read(given.robot, tmp_path, columns)
    model = identify(given.robot, [found.recording], [found.recording])
    judged = verdict(model, [found.recording], checks={"log": found.checks})
    assert not any(use.fit for use in judged.uses)


@pytest.mark.parametrize("position", [0.0, 0.4])
@pytest.mark.parametrize("by_name", [True, False])
def test_a_finger_that_stands_and_has_no_torque_is_to_be_locked(position: float, by_name: bool) -> None:
    given = log("ur10", 7)
    finger = "wrist_3_joint"
    columns = given.columns(q=np.column_stack([given.q[:, :5], np.full(len(given.t), position)]))
    del columns["tau6"]
    if by_name:
        names = given.robot.joint_names
        columns = {key if key == "t" else f"{key[:-1]}_{names[int(key[-1]) - 1]}": v for key, v in columns.items()}
    (asked,) = guess(given.robot, columns).questions
    at = f"={position:g}" if position else ""
    assert write_option(asked.remedies[0]) == f"--lock {finger}{at}"
    assert asked.detail == f"{finger} stands still and has no torque: lock it, {asked.remedies[0]}."


def test_a_joint_of_the_robot_that_the_file_has_not_is_to_be_locked_and_one_of_the_file_alone_is_told() -> None:
    given = log("ur10", 7)
    names = given.robot.joint_names
    lacking = {f"{names[int(key[-1]) - 1]}/{key[:-1]}" if key != "t" else key: v for key, v in given.columns().items()}
    whole = dict(lacking)
    for kind in ("q", "tau"):
        del lacking[f"wrist_3_joint/{kind}"]
    (asked,) = guess(given.robot, lacking).questions
    (lock,) = asked.remedies
    assert asked.detail == f"wrist_3_joint is in the robot, but not in the file: lock it, {lock}."
    assert lock == Remedy("locked_joints", {"wrist_3_joint": 0})
    whole |= {"finger_joint/q": 0.1 * np.sin(given.t), "finger_joint/tau": np.cos(given.t)}
    found = guess(given.robot, whole)
    assert found.questions == ()
    assert "finger_joint/q, finger_joint/tau" in [one.value for one in found.guesses if one.field == "columns"]


def test_a_joint_that_moves_without_a_column_of_torque_is_used_without() -> None:
    given = log("ur10", 8)
    columns = given.columns()
    del columns["tau5"]
    found = guess(given.robot, columns)
    assert found.questions == ()
    assert found.columns["tau5"] == "none"
    assert found.columns["tau6"] == "tau6"


def test_a_joint_with_far_more_friction_than_others_with_a_drive_like_its_own_is_told() -> None:
    robot = log().robot
    size = np.array([15.0, 15.0, 10.0, 1.0, 1.0, 10.0])
    limits = [joint.limits.effort for joint in robot.joints]
    assert limits[3] == limits[4] == limits[5]
    assert find_excess_friction(robot, np.tile(size, (10, 1))) == {5: pytest.approx(10.0)}
    assert find_excess_friction(robot, np.tile(np.where(size == 10.0, 2.4, size), (10, 1))) == {}


@pytest.mark.parametrize("value", [0.035, 0.0])
@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_a_finger_that_stands_beside_torques_of_zero_is_to_be_locked(value: float, noise: float) -> None:
    given = log("ur10", 5)
    rng = np.random.default_rng(6)
    columns = given.columns()
    columns["q6"] = value + noise * rng.normal(size=len(given.t))
    columns["tau6"] = np.zeros(len(given.t))
    at = f"={value:g}" if value else ""
    (asked,) = guess(given.robot, columns).questions
    assert (asked.field, asked.detail.split(":")[0]) == ("robot", "wrist_3_joint stands still and has no torque")
    assert write_option(asked.remedies[0]) == f"--lock wrist_3_joint{at}"


def test_joints_that_wait_on_their_brakes_while_another_moves_are_not_to_be_locked() -> None:
    given = log("ur10", 5)
    for waiting in ([2], [1, 2, 3, 4, 5]):
        columns = given.columns()
        for joint in waiting:
            columns[f"q{joint + 1}"] = np.full(len(given.t), 0.4)
            columns[f"tau{joint + 1}"] = np.zeros(len(given.t))
        assert "robot" not in [question.field for question in guess(given.robot, columns).questions]


def test_a_gripper_with_a_name_beside_joints_that_are_counted_is_one_of_them() -> None:
    names = [*(f"joint{k}" for k in range(1, 6)), "jointGripper"]
    text = re.sub(r'(?<=<joint name=")j(\d)(?=")', lambda name: names[int(name[1])], crooked_urdf())
    given = log_of(robot_from_urdf("arm", text), 4)
    robot = given.robot
    assert list(robot.joint_names) == names
    for pattern in ("{}/position", "q of {}"):
        columns = {"t": given.t, **{pattern.format(name): given.q[:, k] for k, name in enumerate(names)}}
        columns["gripper/position"] = np.full(len(given.t), 0.04)
        columns |= {f"{name}/effort": given.tau[:, k] for k, name in enumerate(names)}
        found = guess(robot, columns)
        assert [found.columns[f"q{k + 1}"] for k in range(6)] == [pattern.format(name) for name in names]
        assert [found.columns[f"tau{k + 1}"] for k in range(6)] == [f"{name}/effort" for name in names]
