from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dynident.errors import DynidentError
from dynident.robot import joint_frames, library_names, library_source, robot_from_library, to_pinocchio
from dynident.robot.pinocchio_conversion import to_dynamic_parameters


def test_the_library_holds_arms_a_prismatic_joint_and_a_tree():
    assert library_names() == ("dual_arm", "franka_panda", "scara", "ur10", "ur10e", "ur5")


@pytest.mark.parametrize("name", library_names())
def test_every_arm_has_all_limits_that_a_design_needs_and_names_its_source(name):
    robot = robot_from_library(name)
    for joint in robot.joints:
        limits = joint.limits
        assert None not in (limits.position, limits.velocity, limits.acceleration, limits.effort)
    assert len(library_source(name)) > 50


@pytest.mark.parametrize("name", library_names())
def test_every_link_is_one_that_could_be_built(name):
    for inertial in robot_from_library(name).inertias:
        body = pin.Inertia.FromDynamicParameters(to_dynamic_parameters(inertial))
        smallest, middle, largest = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0
        assert smallest > 0
        assert smallest + middle >= largest * (1 - 1e-9)


@pytest.mark.parametrize("name", library_names())
def test_holding_the_arm_up_takes_less_than_the_torque_limits(name):
    robot = robot_from_library(name)
    model = to_pinocchio(robot)
    data = model.createData()
    low, high = np.array([joint.limits.position for joint in robot.joints]).T
    effort = np.array([joint.limits.effort for joint in robot.joints])
    for q in np.random.default_rng(0).uniform(low, high, (200, robot.n)):
        assert np.all(np.abs(pin.computeGeneralizedGravity(model, data, q)) < effort)


@pytest.mark.parametrize(("name", "rank"), [("franka_panda", 43), ("ur10", 36), ("ur5", 36)])
def test_the_number_of_base_parameters_is_the_published_one(name, rank):
    model = to_pinocchio(robot_from_library(name))
    data = model.createData()
    random = np.random.default_rng(1)
    rows = [pin.computeJointTorqueRegressor(model, data, *random.uniform(-2, 2, (3, model.nv))) for _ in range(60)]
    assert np.linalg.matrix_rank(np.vstack(rows), tol=1e-8) == rank


@pytest.mark.parametrize(
    ("name", "d", "a"),
    [
        ("ur10", (0.1273, 0, 0, 0.163941, 0.1157, 0.0922), (0, -0.612, -0.5723, 0, 0, 0)),
        ("ur5", (0.089159, 0, 0, 0.10915, 0.09465, 0.0823), (0, -0.425, -0.39225, 0, 0, 0)),
    ],
)
def test_the_last_frame_is_that_of_the_published_classical_parameters(name, d, a):
    alpha = np.array([0.5, 0, 0, 0.5, -0.5, 0]) * np.pi
    q = np.array([0.3, -1.1, 0.8, 2.0, -0.7, 0.4])
    frame = pin.SE3.Identity()
    for theta, offset, length, twist in zip(q, d, a, alpha, strict=True):
        frame = frame * pin.SE3(pin.rpy.rpyToMatrix(0, 0, theta), np.array([0, 0, offset]))
        frame = frame * pin.SE3(pin.rpy.rpyToMatrix(twist, 0, 0), np.array([length, 0, 0]))
    np.testing.assert_allclose(joint_frames(robot_from_library(name), q[None])[0, -1], frame.homogeneous, atol=1e-12)


def test_an_unknown_arm_is_told_which_there_are():
    with pytest.raises(DynidentError, match="no arm 'puma'; choose from: dual_arm, franka_panda"):
        robot_from_library("puma")
