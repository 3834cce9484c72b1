"""Motions of machines with closed loops keep the limits of passive joints and stay away from singular postures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import resample
from support.closed_loop_robots import five_bar, palletiser

from dynident.effects import EffectChoice
from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.motion import Box, ImpossibleLimitsError, Surroundings
from dynident.motion.collision.constraint_slack import LoopConstraints
from dynident.motion.collision.smooth_clearance import CapsulePart, ClearanceConstraints, ClearancePairs
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import Limits, Robot
from dynident.robot.collision_shapes import Capsule
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.modified_dh import robot_from_modified_dh

LARGEST_CONDITION = 30.0
ROD = (-1.75, -0.95)
QUICK = DesignRequest(
    effects=(EffectChoice("rigid_body"),),
    trajectory=TrajectoryRequest(duration=4.0, harmonics=4, sampling_rate=250.0, periods=1),
    starts=1,
    random_trajectories=15,
)


@cache
def wide(limited: bool = True) -> Robot:
    """A five-bar whose driven joints may go where it is stretched."""
    table = five_bar()
    table["joints"][0]["limits"] = {"position": [1.3, 3.1], "velocity": 3}
    table["joints"][2]["limits"] = {"position": [0.05, 1.85], "velocity": 3}
    if limited:
        table["joints"][1]["limits"] = {"position": list(ROD)}
    return robot_from_modified_dh("wide", table)


def angles_and_condition(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The left rod's angle to its crank, and the condition of the two rods' loop, by circles that meet."""
    left, right = (0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=1) for angle in q.T)
    right = right + np.array([0.25, 0.0])
    apart = right - left
    length = np.linalg.norm(apart, axis=1)
    up = np.stack([-apart[:, 1], apart[:, 0]], axis=1) / length[:, None]
    tip = 0.5 * (left + right) + np.sqrt(0.4**2 - 0.25 * length**2)[:, None] * up
    slopes = np.stack([np.stack([-(tip - one)[:, 1], (tip - one)[:, 0]], axis=1) for one in (left, right)], axis=2)
    rod = np.arctan2(*(tip - left).T[::-1]) - q[:, 0]
    return (rod + np.pi) % (2 * np.pi) - np.pi, np.linalg.cond(slopes)


def everywhere(design: Design) -> np.ndarray:
    """The positions of the motion, and one period between the samples as well."""
    if design.period is None:
        return design.q
    first, steps = round(design.exciting[0] * design.sampling_rate), round(design.period * design.sampling_rate)
    return np.vstack([design.q, resample(design.q[first : first + steps], 8 * steps)])


@pytest.mark.parametrize("kind", ["fourier", "point_to_point", "slow_sweep"])
def test_a_motion_keeps_the_limits_of_passive_joints_and_stays_away_from_singular_postures(kind: str) -> None:
    points = TrajectoryRequest(family="point_to_point", points=5, sampling_rate=250.0)
    request = {
        "fourier": QUICK,
        "point_to_point": replace(QUICK, trajectory=points),
        "slow_sweep": replace(QUICK, kind="slow_sweep"),
    }[kind]
    design = design_experiment(wide(), request)
    rod, condition = angles_and_condition(everywhere(design))
    assert ROD[0] <= rod.min() < rod.max() <= ROD[1]
    assert condition.max() <= LARGEST_CONDITION
    told = {(margin.joint, margin.limit): margin for margin in design.margins}
    assert told["left_rod", "position_min"].value == pytest.approx(rod.min(), abs=2e-3)
    assert told["left_rod", "position_max"].value == pytest.approx(rod.max(), abs=2e-3)
    assert told["tip", "condition"].value == pytest.approx(condition.max(), rel=0.02)
    assert all(margin.share <= 1 for margin in design.margins)


def test_without_a_limit_the_passive_joint_goes_further() -> None:
    rod, condition = angles_and_condition(everywhere(design_experiment(wide(limited=False), QUICK)))
    assert rod.min() < ROD[0] or rod.max() > ROD[1]
    assert condition.max() <= LARGEST_CONDITION


def test_a_limit_of_a_passive_joint_can_be_stated_for_one_experiment() -> None:
    design = design_experiment(wide(limited=False), replace(QUICK, limits={"left_rod": Limits(position=ROD)}))
    rod, _ = angles_and_condition(everywhere(design))
    assert ROD[0] <= rod.min() < rod.max() <= ROD[1]


@pytest.mark.parametrize("by_description", [True, False])
def test_a_limit_of_a_passive_joint_that_is_not_kept_is_told(by_description: bool) -> None:
    table = five_bar()
    if by_description:
        table["joints"][1]["limits"] = {"jerk": 200.0}
    stated = {} if by_description else {"left_rod": Limits(jerk=200.0)}
    told = build_bounds(robot_from_modified_dh("rated", table), stated).notes
    told_so = "only position, velocity and acceleration are limited; not checked: jerk of left_rod."
    assert any(told_so in note for note in told)


@pytest.mark.parametrize("kind", ["fourier", "point_to_point", "slow_sweep"])
def test_a_motion_keeps_the_velocity_and_acceleration_of_passive_joints(kind: str) -> None:
    points = TrajectoryRequest(family="point_to_point", points=5, sampling_rate=250.0)
    request = {
        "fourier": QUICK,
        "point_to_point": replace(QUICK, trajectory=points),
        "slow_sweep": replace(QUICK, kind="slow_sweep", trajectory=replace(QUICK.trajectory, duration=1.0)),
    }[kind]
    free = {"left_rod": Limits(velocity=100.0, acceleration=1000.0)}
    unlimited = reached(design_experiment(wide(), replace(request, limits=free)))
    half = Limits(velocity=0.5 * unlimited[0], acceleration=0.5 * unlimited[1])
    design = design_experiment(wide(), replace(request, limits={"left_rod": half}))
    speed, acceleration = reached(design)
    assert 0.2 * half.velocity < speed <= 1.001 * half.velocity
    assert 0.1 * half.acceleration < acceleration <= 1.01 * half.acceleration
    told = {(margin.joint, margin.limit): margin for margin in design.margins}
    assert told["left_rod", "velocity"].value == pytest.approx(speed, rel=0.02)
    assert told["left_rod", "acceleration"].value == pytest.approx(acceleration, rel=0.05)
    assert all(margin.share <= 1 for margin in design.margins)


def reached(design: Design) -> tuple[float, float]:
    """The largest velocity and acceleration of the left rod, by differences of its angle."""
    rod, _ = angles_and_condition(design.q)
    speed = np.gradient(rod, 1.0 / design.sampling_rate)
    return float(np.abs(speed).max()), float(np.abs(np.gradient(speed, 1.0 / design.sampling_rate)).max())


def test_limits_that_no_posture_keeps_are_refused_with_the_joint() -> None:
    nowhere = {"left_rod": Limits(position=(0.5, 0.9))}
    with pytest.raises(
        ImpossibleLimitsError, match=r"joint 'left_rod', which follows, would be in .* its limits \[0.5, 0.9\]"
    ):
        design_experiment(wide(limited=False), replace(QUICK, limits=nowhere))


def test_a_home_in_which_the_loop_is_open_is_refused() -> None:
    with pytest.raises(ImpossibleLimitsError, match=r"At home, the closed loops would be open"):
        design_experiment(wide(limited=False), replace(QUICK, home=(3.05, 0.1)))


def test_rooms_have_the_slopes_of_their_differences() -> None:
    robot = wide()
    rooms = LoopConstraints.from_robot(robot, {})
    q = robot.linkage.closure.draw_postures(np.random.default_rng(1), 40)
    found, h = rooms.evaluate(q), 1e-6
    assert found.values.shape == (40, rooms.count) == (40, 3)
    for j in range(2):
        step = h * np.eye(2)[j]
        differences = (rooms.evaluate(q + step).values - rooms.evaluate(q - step).values) / (2 * h)
        np.testing.assert_allclose(found.slopes[:, :, j], differences, atol=1e-7)


def test_rods_of_a_loop_are_kept_from_obstacles_with_exact_slopes() -> None:
    robot = robot_from_modified_dh("palletiser", palletiser())
    forearm, rod = (robot.tree.joint_names.index(name) for name in ("forearm", "rod"))
    bars = [
        CapsulePart(j, Capsule(np.zeros(3), np.array([length, 0, 0]), 0.04))
        for j, length in ((forearm, 0.9), (rod, 0.8))
    ]
    base = CapsulePart(-1, Capsule(np.array([0.5, 0.3, 0.0]), np.array([0.5, 0.3, 1.0]), 0.1))
    clearances = ClearanceConstraints(robot, ClearancePairs(pairs=tuple((bar, base) for bar in bars), clearance=0.05))
    q = robot.linkage.closure.draw_postures(np.random.default_rng(1), 30)
    found, h = clearances.evaluate(q), 1e-6
    weights = np.random.default_rng(2).uniform(0.5, 1, found.values.shape)
    slopes = found.pull_back(weights)
    for j in range(robot.n):
        step = h * np.eye(robot.n)[j]
        ahead, behind = clearances.evaluate(q + step).values, clearances.evaluate(q - step).values
        np.testing.assert_allclose(slopes[:, j], ((ahead - behind) * weights).sum(axis=1) / (2 * h), atol=1e-6)
    # A point on the forearm's axis, as the frames have it.
    along = joint_frames(robot, q)[:, forearm] @ np.array([[0.0, 0, 0, 1], [0.9, 0, 0, 1]]).T
    assert np.all(np.isfinite(along))


def test_the_passive_links_of_a_machine_are_checked_for_contacts_where_they_are() -> None:
    table = palletiser()
    for row, length in zip(table["joints"], (0.1, 0.8, 0.9, 0.25, 0.8, 0.05), strict=True):
        row["capsules"] = [{"from": [0, 0, 0.02], "to": [length, 0, 0], "radius": 0.04}]
        row["limits"] = {**row.get("limits", {}), "velocity": 2}
    robot = robot_from_modified_dh("palletiser", table)
    centre, size = np.array([1.2, 0.0, 0.5]), np.array([0.3, 0.8, 0.4])
    box = Box("crate", tuple(centre), tuple(size))
    request = replace(QUICK, surroundings=Surroundings(self_collision=False, boxes=(box,), clearance=0.02))
    nearest = {}
    for asked in (request, QUICK):
        q = design_experiment(robot, asked).q
        frames = joint_frames(robot, q)[:, robot.tree.joint_names.index("forearm")]
        axis = np.stack([np.linspace(0, 0.9, 40), *np.zeros((2, 40)), np.ones(40)])
        outside = np.maximum(np.abs((frames @ axis)[:, :3] - centre[:, None]) - 0.5 * size[:, None], 0.0)
        nearest[asked is request] = float(np.linalg.norm(outside, axis=1).min())
    assert nearest[True] >= 0.02 + 0.04 - 1e-3
    assert nearest[False] < 0.02
