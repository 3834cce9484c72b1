from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from support.robots_with_collision_geometry import safe_robot

from dynident.effects import EffectChoice
from dynident.excitation import CriterionChoice, DesignRequest
from dynident.excitation.criteria.optimality_criteria import build_smooth_criterion
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.design_result import find_nearest_along
from dynident.excitation.optimisation.design_problem import DesignProblem, Multipliers
from dynident.motion import Box, Surroundings, ToolRange, Wall
from dynident.motion.collision.obstacle_geometry import build_block
from dynident.motion.collision.smooth_clearance import compute_block_distance, find_closest_shares
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import Bounds, build_bounds
from dynident.robot import Limits
from dynident.robot.forward_kinematics import joint_frames

CELL = Surroundings(
    floor=-0.2,
    walls=(Wall("fence", (-0.6, 0, 0), (1, 0.2, 0)),),
    boxes=(Box("table", (0.5, 0.1, 0.0), (0.4, 0.6, 0.5), (0.1, 0.2, 0.3)),),
    tool_range=ToolRange(low=(None, -0.4, 0.05), high=(0.6, None, None), point=(0, 0, 0.1)),
)


def bounds_in_cell(name: str) -> Bounds:
    robot = safe_robot(name)
    power = {joint.name: Limits(power=0.05 * (joint.limits.effort or 50.0)) for joint in robot.joints}
    return build_bounds(robot, power, surroundings=CELL)


@pytest.mark.parametrize("name", ["franka_panda", "gantry"])
def test_the_gradient_of_every_room_is_exact(name):
    bounds = bounds_in_cell(name)
    assert bounds.space is not None
    clearances = bounds.space.clearances
    assert clearances is not None
    rng = np.random.default_rng(1)
    q = rng.uniform(bounds.position_low, bounds.position_high, (30, len(bounds.names)))
    rooms = clearances.evaluate(q)
    weights = rng.normal(size=rooms.values.shape)
    exact = rooms.pull_back(weights)
    for j in range(q.shape[1]):
        step = np.zeros(q.shape[1])
        step[j] = 1e-6
        change = clearances.evaluate(q + step).values - clearances.evaluate(q - step).values
        # The directions in which meshes come nearer are those of coal, which knows them to some 1e-5.
        np.testing.assert_allclose((change / 2e-6 * weights).sum(axis=1), exact[:, j], atol=1e-4 * np.abs(exact).max())


@pytest.mark.parametrize("name", ["franka_panda", "ur10", "gantry"])
def test_capsules_never_promise_more_room_than_the_shapes_have(name):
    bounds = bounds_in_cell(name)
    space = bounds.space
    assert space is not None
    assert space.contacts is not None
    q = np.random.default_rng(2).uniform(bounds.position_low, bounds.position_high, (150, len(bounds.names)))
    clear = q[space.compute_least_slack(q) >= 0]
    exact = np.array([space.contacts.compute_distances(pair, clear) for pair in space.contacts.pairs])
    # Pairs that came near in none of the postures looked at first are left to the verdict.
    assert np.mean(exact.min(axis=0) < CELL.clearance) <= 0.05


def test_the_nearest_approach_along_a_motion_is_found_without_looking_at_every_sample():
    bounds = bounds_in_cell("franka_panda")
    space = bounds.space
    assert space is not None
    assert space.contacts is not None
    t = np.linspace(0, 2 * np.pi, 800)[:, None]
    q = bounds.middle + 0.8 * bounds.half_range * np.sin(t * np.arange(1, 8) + np.arange(7))
    brute = {pair.name: float(space.contacts.compute_distances(pair, q).min()) for pair in space.contacts.pairs}
    for approach, body in zip(space.contacts.find_approaches(q), space.contacts.bodies, strict=True):
        own = [brute[pair.name] for pair in space.contacts.pairs if pair.moving.joint == body]
        assert min(own) <= approach.distance <= min(own) + 1e-3 + 0.06 * max(min(own), 0)
        assert approach.distance >= brute[approach.name] - 1e-9


def test_what_a_link_is_nearest_to_is_told_with_the_points_that_the_distance_lies_between():
    robot = safe_robot("gantry")
    bounds = bounds_in_cell("gantry")
    q = np.random.default_rng(3).uniform(bounds.position_low, bounds.position_high, (60, robot.n))
    assert bounds.space is not None
    contacts = bounds.space.contacts
    assert contacts is not None
    frames = joint_frames(robot, q)

    def in_base(joint: int, k: int, point: np.ndarray) -> np.ndarray:
        return point if joint < 0 else frames[k, joint, :3, :3] @ point + frames[k, joint, :3, 3]

    found = find_nearest_along(robot, DesignRequest(surroundings=CELL), q)
    assert [one.body.joint for one in found] == list(contacts.bodies)
    for one in found:
        own = [pair for pair in contacts.pairs if pair.moving.joint == one.body.joint]
        rooms = np.array([contacts.compute_distances(pair, q) - pair.clearance for pair in own])
        np.testing.assert_allclose(one.distance - one.wanted, rooms.min(axis=0), atol=1e-9)
        for k, place in enumerate(one.to):
            there = in_base(one.others[place].joint, k, one.there[k])
            apart = np.linalg.norm(in_base(one.body.joint, k, one.here[k]) - there)
            assert apart == pytest.approx(abs(one.distance[k]), abs=1e-9)
    assert {one.others[k].name for one in found for k in one.to} >= {"floor", "box 'table'"}
    nothing = Surroundings(self_collision=False, assume_floor=False)
    assert find_nearest_along(robot, DesignRequest(surroundings=nothing), q) == ()


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_closest_points_of_segments_are_the_closest(seed):
    a, a_end, b, b_end = np.random.default_rng(seed).normal(size=(4, 3))
    s, t = find_closest_shares(a, a_end, b, b_end)

    def distance(shares: np.ndarray) -> float:
        return float(np.linalg.norm(a + shares[0] * (a_end - a) - b - shares[1] * (b_end - b)))

    best = minimize(lambda x: distance(x) ** 2, [0.5, 0.5], bounds=[(0, 1)] * 2, tol=1e-14)
    assert distance(np.array([s, t])) <= np.sqrt(max(best.fun, 0.0)) + 1e-6


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_distance_from_a_box_is_that_of_its_nearest_point(seed):
    rng = np.random.default_rng(seed)
    box = Box("b", tuple(rng.normal(size=3)), tuple(rng.uniform(0.2, 1, 3)), tuple(rng.normal(size=3)))
    block, point = build_block(box), rng.normal(size=3)
    distance, gradient = compute_block_distance(point, block)
    local = block.placement[:3, :3].T @ (point - block.placement[:3, 3])
    nearest = np.clip(local, -0.5 * block.size, 0.5 * block.size)
    outside = np.linalg.norm(local - nearest)
    inside = (0.5 * block.size - np.abs(local)).min()
    assert distance == pytest.approx(outside if outside > 0 else -inside)
    ahead, _ = compute_block_distance(point + 1e-6 * gradient, block)
    assert ahead - distance == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize("name", ["franka_panda", "gantry"])
def test_the_gradient_is_exact_with_obstacles_and_limits_of_power(name):
    robot, bounds = safe_robot(name), bounds_in_cell(name)
    model = build_design_model(robot, (EffectChoice("rigid_body"), EffectChoice("viscous")))
    a_priori = np.ones(model.n_parameters)
    problem = DesignProblem(FourierFamily(3, 3.0), model, build_smooth_criterion(CriterionChoice(), a_priori), bounds)
    rng = np.random.default_rng(0)
    x = rng.normal(size=(5, robot.n))
    x[0] = bounds.middle
    none = problem.create_multipliers(3.0)
    multipliers = Multipliers(
        rng.uniform(0, 1, none.values.shape), rng.uniform(0, 1, none.crowding.shape), none.penalty
    )
    flat = x.ravel()
    at = problem.evaluate(flat, multipliers)
    assert (at.excess[5] > 0).any()
    assert (at.crowding > 0).any()
    for k in rng.choice(flat.size, 8, replace=False):
        step = np.zeros(flat.size)
        step[k] = 1e-6
        difference = (
            problem.evaluate(flat + step, multipliers).lagrangian
            - problem.evaluate(flat - step, multipliers).lagrangian
        )
        assert difference / 2e-6 == pytest.approx(at.gradient[k], rel=2e-4, abs=2e-3 * np.abs(at.gradient).max())
