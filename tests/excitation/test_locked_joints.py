from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.criteria.design_criterion import build_design_criterion
from dynident.excitation.design_observation_matrix import build_design_model, lock_model
from dynident.excitation.optimisation.design_problem import DesignProblem, Multipliers
from dynident.motion import Surroundings
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import build_bounds, lock_bounds
from dynident.robot import Robot, to_pinocchio

LINKS = (EffectChoice("rigid_body"),)
WRIST = ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
QUICK = DesignRequest(
    effects=(*LINKS, EffectChoice("coulomb"), EffectChoice("viscous")),
    trajectory=TrajectoryRequest(duration=4.0, harmonics=4, sampling_rate=100.0, joints=WRIST),
    starts=1,
    random_trajectories=15,
)


def rank_of_moving_rows(robot: Robot, home: np.ndarray, moving: np.ndarray) -> int:
    """By Pinocchio's regressor at random states of the moving joints, the others at home."""
    model = to_pinocchio(robot)
    data = model.createData()
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(200):
        q, dq, ddq = (np.where(moving, rng.uniform(-2, 2, robot.n), still) for still in (home, 0.0, 0.0))
        rows.append(pin.computeJointTorqueRegressor(model, data, q, dq, ddq)[moving])
    sigma = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    return int((sigma > 1e-5 * sigma[0]).sum())


@pytest.mark.parametrize("joints", [(3, 4, 5), (0,), (2,), (1, 2)])
def test_the_parameters_of_a_motion_with_locked_joints_are_as_many_as_pinocchios_regressor_has_ranks(ur10, joints):
    home = np.array([0.3, -1.0, 0.5, 0.2, 0.4, 0.1])
    moving = np.isin(np.arange(6), joints)
    model = lock_model(build_design_model(ur10, LINKS), home, moving)
    assert model.n_parameters == rank_of_moving_rows(ur10, home, moving)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["optimized", "random"])
@pytest.mark.parametrize("family", ["fourier", "b_spline"])
def test_only_the_named_joints_move_and_all_that_they_show_is_determined(ur10, kind, family):
    home = (0.3, -1.0, 0.5, 0.2, 0.4, 0.1)
    request = replace(QUICK, kind=kind, home=home, trajectory=replace(QUICK.trajectory, family=family))
    design = design_experiment(ur10, request)
    assert (np.ptp(design.q, axis=0)[:3] == 0).all()
    assert (np.ptp(design.q, axis=0)[3:] > 0.1).all()
    np.testing.assert_array_equal(design.q[:, :3], np.tile(home[:3], (len(design.q), 1)))
    assert design.criterion_values.condition_number < 300
    assert {name[-1] for name in design.parameter_names} == {"4", "5", "6"}
    assert design.baseline is not None
    if kind == "optimized":
        assert design.criterion_values.condition_number < design.baseline.best.condition_number
    assert all(margin.share <= 1 for margin in design.margins)
    assert any("Locked at home: shoulder_pan_joint" in note for note in design.notes)


def test_a_joint_may_be_locked_at_its_limit(ur10):
    high = [joint.limits.position[1] for joint in ur10.joints]
    home = (0.0, -1.0, high[2], 0.0, 0.0, 0.0)
    # Folded like that the capsules of the links overlap.
    design = design_experiment(ur10, replace(QUICK, home=home, surroundings=Surroundings(self_collision=False)))
    assert (design.q[:, 2] == high[2]).all()
    assert all(margin.share <= 1 for margin in design.margins)


def test_the_gradient_is_exact_with_locked_joints_and_leaves_them_where_they_are(ur10):
    home, moving = np.array([0.3, -1.0, 0.5, 0.2, 0.4, 0.1]), np.isin(np.arange(6), (1, 4))
    model = lock_model(build_design_model(ur10, QUICK.effects_or_default), home, moving)
    bounds = lock_bounds(build_bounds(ur10, {}), home, moving)
    family = FourierFamily(4, 3.0)
    problem = DesignProblem(family, model, build_design_criterion(model, QUICK.criterion, {}).smooth_criterion, bounds)
    rng = np.random.default_rng(2)
    x = rng.standard_normal((family.n_coefficients, 6)) * moving
    x[0] = np.where(moving, x[0], home)
    multipliers = Multipliers(rng.uniform(0, 1, (6, problem.n_samples, 6)), np.zeros((problem.n_samples, 0)), 3.0)
    gradient = problem.evaluate(x.ravel(), multipliers).gradient.reshape(x.shape)
    assert (gradient[:, ~moving] == 0).all()
    for _ in range(3):
        direction = rng.standard_normal(x.shape) * moving
        ends = (problem.evaluate((x + s * direction).ravel(), multipliers).lagrangian for s in (1e-6, -1e-6))
        assert np.sum(gradient * direction) == pytest.approx(np.subtract(*ends) / 2e-6, rel=2e-4)


def test_an_unknown_joint_and_joints_that_show_nothing_are_refused(ur10):
    with pytest.raises(DynidentError, match="There is no joint 'tail'") as caught:
        design_experiment(ur10, replace(QUICK, trajectory=replace(QUICK.trajectory, joints=("tail",))))
    assert caught.value.pointer == "/trajectory/joints"
    friction = (EffectChoice("viscous", joints=("elbow_joint",)),)
    with pytest.raises(DynidentError, match="determine none of the parameters"):
        design_experiment(ur10, replace(QUICK, effects=friction))
