"""Contacts whose forces are eliminated from the equations of a robot whose base floats."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.floating_robots import WALKER, build_model, draw_motion

import dynident as dy
from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.recordings.conditioning.angle_wrapping import compute_base_angles
from dynident.robot import Description, Robot, robot_from_description
from dynident.robot.contacts import (
    compute_contact_heights,
    compute_contact_jacobian,
    compute_contact_projection,
    find_largest_zero_errors,
    find_mixed_joints,
    parse_contact,
    yield_mixing_matrices,
)
from dynident.robot.description_and_json import robot_from_document, robot_to_document, set_base
from dynident.robot.joint import Contact
from dynident_cli.option_parsers import split_contacts

DESCRIPTION = Description("urdf", WALKER)


def test_no_force_on_the_contacts_is_left_in_the_projected_torques() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    robot = replace(floating, contacts=(Contact("shin", (0.0, 0.02, -0.4)), Contact("arm")))
    model, motion = build_model(), draw_motion(3, 0.5, 50.0)
    data = model.createData()
    sole = model.addFrame(
        pin.Frame("sole", model.getJointId("knee"), 0, pin.SE3(np.eye(3), np.array([0, 0.02, -0.4])), pin.OP_FRAME)
    )
    data = model.createData()
    q = np.hstack([motion.q[:, :3], compute_base_angles(motion.q[:, 3:7]), motion.q[:, 7:]])
    jacobian, projection = compute_contact_jacobian(robot, q), compute_contact_projection(robot, q)
    assert jacobian.shape == (len(q), 9, robot.n)
    for k in range(len(q)):
        # The joints' columns are Pinocchio's; those of the base span the same velocities as its twist.
        for rows, frame in ((slice(0, 3), sole), (slice(3, 9), model.getFrameId("arm"))):
            theirs = pin.computeFrameJacobian(model, data, motion.q[k], frame, pin.LOCAL_WORLD_ALIGNED)
            count = rows.stop - rows.start
            np.testing.assert_allclose(jacobian[k, rows, 6:], theirs[:count, 6:], atol=1e-10)
        np.testing.assert_allclose(projection[k] @ jacobian[k].T, 0.0, atol=1e-12)
        np.testing.assert_allclose(projection[k] @ projection[k], projection[k], atol=1e-12)
        assert round(np.trace(projection[k])) == robot.n - np.linalg.matrix_rank(jacobian[k])


def test_contacts_are_named_in_text_and_kept_with_the_robot(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", ["shin@0,0,-0.4", "arm"])
    assert robot.contacts == (Contact("shin", (0.0, 0.0, -0.4)), Contact("arm"))
    again = robot_from_document(json.loads(json.dumps(robot_to_document(robot))))
    assert again.contacts == robot.contacts
    with pytest.raises(DynidentError, match="no link 'foot' that moves by itself; links: trunk, thigh, shin, arm"):
        dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", ["foot"])
    with pytest.raises(DynidentError, match="floating base, but walker has a fixed one"):
        dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), contacts=["shin"])
    wrong_points = ("shin@0,0", "shin@", "shin@0,0,nan", "shin@inf,0,0", "shin@1e300,0,0", "shin@0,0,0,-1")
    for wrong in (*wrong_points, "shin^", "shin^0", "shin^nan", "shin@0,0,0^x"):
        with pytest.raises(DynidentError, match="cannot be read; write a link, its point as three numbers"):
            parse_contact(wrong)
    for text in ("shin", "shin@0.0,0.0,-0.4", "shin@0.0,0.0,-0.4,0.02", "shin^0.03", "shin@0.0,0.0,-0.4,0.02^0.03"):
        assert str(parse_contact(text)) == text


def test_the_force_on_a_ball_acts_where_it_touches_the_ground() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    robot = replace(floating, contacts=(Contact("shin", (0.0, 0.02, -0.4), radius=0.03),))
    model, motion = build_model(), draw_motion(3, 0.5, 50.0)
    sole = model.addFrame(
        pin.Frame("sole", model.getJointId("knee"), 0, pin.SE3(np.eye(3), np.array([0, 0.02, -0.4])), pin.OP_FRAME)
    )
    data = model.createData()
    q = np.hstack([motion.q[:, :3], compute_base_angles(motion.q[:, 3:7]), motion.q[:, 7:]])
    jacobian = compute_contact_jacobian(robot, q)
    for k in range(len(q)):
        theirs = pin.computeFrameJacobian(model, data, motion.q[k], sole, pin.LOCAL_WORLD_ALIGNED)[:, 6:]
        below = np.cross(theirs[3:], np.array([0.0, 0.0, -0.03]), axis=0)
        np.testing.assert_allclose(jacobian[k, :, 6:], theirs[:3] + below, atol=1e-10)


def test_a_lifted_foot_is_not_eliminated_and_forces_on_the_other_are() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    feet = (Contact("shin", (0.0, 0.0, -0.4), lift=0.05), Contact("arm", (0.3, 0.0, 0.0), lift=0.05))
    robot, shin = replace(floating, contacts=feet), replace(floating, contacts=feet[:1])
    both = replace(floating, contacts=tuple(replace(foot, lift=None) for foot in feet))
    # The shoulder turns about x, so that the end of the arm rises above the foot of the shin with the roll of the base.
    q = np.zeros((40001, robot.n))
    q[:, 5] = np.linspace(-np.pi, np.pi, 40001)
    projection = compute_contact_projection(robot, q)
    alone = compute_contact_projection(shin, q)
    together = compute_contact_projection(both, q)
    is_alone = np.abs(projection - alone).max(axis=(1, 2)) < 1e-9
    are_both = np.abs(projection - together).max(axis=(1, 2)) < 1e-9
    assert is_alone.any()
    assert are_both.any()
    # Wherever the shin is the lower foot, no force on it is left, however far the arm is lifted.
    forces = np.swapaxes(compute_contact_jacobian(shin, q), 1, 2)
    is_lower = compute_contact_heights(shin, q)[:, 0] <= compute_contact_heights(robot, q)[:, 1]
    np.testing.assert_allclose((projection @ forces)[is_lower], 0.0, atol=1e-9)
    # Between the two it changes smoothly: measured positions and filtered ones give nearly the same.
    steps = np.abs(np.diff(projection, axis=0)).max(axis=(1, 2))
    assert steps.max() < 0.03


def test_feet_that_stand_show_the_zero_positions_of_their_joints() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    robot = replace(floating, contacts=(Contact("shin", (0.0, 0.02, -0.4)), Contact("arm", (0.1, 0.1, 0.1))))
    motion = draw_motion(3, 4.0, 50.0)
    q = np.hstack([motion.q[:, :3], compute_base_angles(motion.q[:, 3:7]), motion.q[:, 7:]])
    # Velocities with which neither contact moves, whatever the joints do.
    wished = np.random.default_rng(4).standard_normal((len(q), robot.n))
    dq = np.einsum("mij,mj->mi", compute_contact_projection(robot, q), wished)
    dq += 1e-4 * np.random.default_rng(5).standard_normal(dq.shape)
    names = robot.joint_names[6:]
    sound = find_largest_zero_errors(robot, [(q, dq)])
    assert set(sound) == set(names)
    assert max(sound.values()) < 1e-3
    shifted = q.copy()
    shifted[:, robot.joint_names.index("knee")] -= 0.05
    assert 0.04 < find_largest_zero_errors(robot, [(shifted, dq)])["knee"] < 0.2
    # Nothing is known where the joints do not move, nor without contacts.
    assert find_largest_zero_errors(robot, [(q, 0.0 * dq)]) == {}
    assert find_largest_zero_errors(floating, [(q, dq)]) == {}


def test_the_projection_of_contacts_that_hold_each_other_is_the_same() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    once = replace(floating, contacts=(Contact("shin"),))
    # Two points of a link that has all six directions already: J does not have full rank.
    twice = replace(floating, contacts=(Contact("shin"), Contact("shin", (0.0, 0.1, 0.0))))
    motion = draw_motion(3, 0.5, 50.0)
    q = np.hstack([motion.q[:, :3], compute_base_angles(motion.q[:, 3:7]), motion.q[:, 7:]])
    projection = compute_contact_projection(once, q)
    np.testing.assert_allclose(compute_contact_projection(twice, q), projection, atol=1e-9)
    jacobian = compute_contact_jacobian(once, q)
    expected = np.eye(robot_size := once.n) - np.linalg.pinv(jacobian) @ jacobian
    assert projection.shape[1:] == (robot_size, robot_size)
    np.testing.assert_allclose(projection, expected, atol=1e-12)


def project_without(robot: Robot, q: FloatArray, unknown: BoolArray) -> FloatArray:
    """Return 1 - J⁺J (m, n, n), with a row more in J for each unknown torque."""
    jacobian, projections = compute_contact_jacobian(robot, q), np.empty((len(q), robot.n, robot.n))
    for k in range(len(q)):
        longer = np.vstack([jacobian[k], np.eye(robot.n)[unknown[k]]])
        projections[k] = np.eye(robot.n) - np.linalg.pinv(longer, rcond=1e-8) @ longer
    return projections


def test_an_unknown_torque_is_eliminated_as_a_row_of_the_jacobian_would() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    robot = replace(floating, contacts=(Contact("shin", (0.0, 0.0, -0.4)), Contact("arm", (0.3, 0.0, 0.0))))
    motion = draw_motion(3, 0.5, 50.0)
    q = np.hstack([motion.q[:, :3], compute_base_angles(motion.q[:, 3:7]), motion.q[:, 7:]])
    unknown = np.zeros(q.shape, dtype=bool)
    unknown[::2, 7], unknown[::3, 8] = True, True
    assert find_mixed_joints(robot).all()
    eliminated = np.concatenate([mixing for _, mixing, _ in yield_mixing_matrices(robot, q, unknown)])
    np.testing.assert_allclose(eliminated, project_without(robot, q, unknown), atol=1e-9)


def test_matrices_that_come_a_few_samples_at_a_time_are_those_of_all_samples() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    robot = replace(floating, contacts=(Contact("shin", (0.0, 0.0, -0.4)),))
    mixed = np.ix_(find_mixed_joints(robot), find_mixed_joints(robot))
    q = np.random.default_rng(5).uniform(-1.0, 1.0, (600, robot.n))
    unknown = np.zeros(q.shape, dtype=bool)
    unknown[:270:3, 7] = True
    nothing = np.zeros_like(unknown)
    for positions, standing in ((q, unknown), (q, None), (np.zeros_like(q, dtype=int), unknown)):
        projection = project_without(robot, positions, nothing)
        expected = project_without(robot, positions, nothing if standing is None else standing)
        count = 0
        for part, mixing, elimination in yield_mixing_matrices(robot, positions, standing):
            own = np.eye(len(mixing[0])) if elimination is None else elimination
            for k, sample in enumerate(range(len(q))[part]):
                np.testing.assert_allclose(mixing[k], expected[sample][mixed], atol=1e-9)
                count += 1
            np.testing.assert_allclose(own @ [each[mixed] for each in projection[part]], mixing, atol=1e-9)
        assert count == len(q)


def test_matrices_follow_lengths_that_are_written_into_the_robot() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    robot = replace(floating, contacts=(Contact("shin", (0.0, 0.0, -0.4)), Contact("arm", (0.3, 0.0, 0.0))))
    q = np.random.default_rng(6).uniform(-1.0, 1.0, (20, robot.n))
    ((_, before, _),) = yield_mixing_matrices(robot, q, None)
    for joint in robot.tree.joints:
        joint.placement[:3, 3] *= 1.5
    ((_, after, _),) = yield_mixing_matrices(robot, q, None)
    np.testing.assert_allclose(after, compute_contact_projection(robot, q), atol=1e-12)
    assert np.abs(after - before).max() > 0.01


def test_an_unknown_torque_of_a_leg_that_is_half_lifted_is_eliminated_and_a_hidden_one_does_no_harm() -> None:
    floating = set_base(robot_from_description("walker", DESCRIPTION), "floating")
    feet = (Contact("shin", (0.0, 0.0, -0.4), lift=0.3), Contact("arm", (0.3, 0.0, 0.0), lift=0.3))
    robot = replace(floating, contacts=feet)
    q = np.zeros((401, robot.n))
    q[:, 5] = np.linspace(-np.pi, np.pi, 401)
    unknown = np.zeros(q.shape, dtype=bool)
    unknown[:, 8] = True
    for _, mixing, elimination in yield_mixing_matrices(robot, q, unknown):
        assert elimination is not None
        assert np.isfinite(elimination).all()
        np.testing.assert_allclose(mixing[:, :, 8], 0.0, atol=0.011)
        assert np.abs(elimination).max() < 101.0


@pytest.mark.parametrize(
    ("contacts", "message"),
    [
        (["shin^0.03"], "there is no other one. Name all feet"),
        (["shin^0.03", "arm@0.3,0,0"], "some are points and some are links"),
        ([1], "Expected a non-empty text"),
        (5, "Expected a list of names"),
        ("shin", "Expected a list of names"),
    ],
)
def test_contacts_that_cannot_be_are_refused_with_the_reason(tmp_path: Path, contacts: object, message: str) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    with pytest.raises(DynidentError, match=message):
        dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", contacts)  # type: ignore[arg-type]
    body = {"description": {"format": "urdf", "content": WALKER}, "base": "floating", "contacts": contacts}
    (tmp_path / "walker.json").write_text(json.dumps(body))
    with pytest.raises(DynidentError, match=message) as refused:
        dy.load_robot(tmp_path / "walker.json")
    assert str(refused.value.pointer).startswith("/contacts")


def test_contacts_of_an_option_have_commas_or_semicolons_between_them() -> None:
    assert split_contacts("left, right^0.03") == ["left", "right^0.03"]
    assert split_contacts("left; right^0.03") == ["left", "right^0.03"]
    assert split_contacts("calf@0,0,-0.2") == ["calf@0,0,-0.2"]
    assert split_contacts("a@0,0,-0.2,0.02^0.01;b@0,0,-0.2") == ["a@0,0,-0.2,0.02^0.01", "b@0,0,-0.2"]
    for text in ("a@0,0,-0.2,b@0,0,-0.2", "a,b@0,0,-0.2"):
        with pytest.raises(DynidentError, match="write semicolons between the contacts"):
            split_contacts(text)
