"""A trunk that sways over standing feet: they stay where they are, by Pinocchio, and its legs can be identified."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from support.standing_engine import build_engine, play
from support.standing_robots import FEET, HOME, SOLE, SQUATTER, STANDER

import dynident as dy
from dynident.errors import DynidentError
from dynident.excitation import CriterionChoice, Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.design_observation_matrix import lock_model
from dynident.excitation.optimisation.design_problem import DesignProblem
from dynident.excitation.standing_feet import stand_on_feet
from dynident.excitation.swaying_trunk import Sway, build_swaying_model
from dynident.identification import IdentifiedParameter
from dynident.motion import Margin, Standing
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import Bounds, build_bounds
from dynident.presentation.design_tables import build_limits_table
from dynident.reports.figures.design import draw_design
from dynident.robot import Description, Limits, Robot, robot_from_description
from dynident.robot.contacts import compute_contact_projection
from dynident.robot.forward_kinematics import joint_frames

FloatArray = NDArray[np.float64]
BENT = {"thigh_joint": -0.4, "shank_joint": 0.8, "ankle_joint": -0.4, "shoulder": 0.2, "elbow": 0.2}
TOLERANCE = 1e-9
"""m, rad, and their rates."""


@cache
def squatter() -> Robot:
    return robot_from_description("squatter", Description("urdf", SQUATTER))


def bend(robot: Robot, posture: dict[str, float]) -> tuple[float, ...]:
    """Return the posture in which joints whose names end so have these positions, and all others zero."""
    return tuple(
        next((value for end, value in posture.items() if name.endswith(end)), 0.0) for name in robot.joint_names
    )


REQUEST = DesignRequest(
    trajectory=TrajectoryRequest(duration=4.0, harmonics=3, periods=2),
    home=bend(squatter(), BENT),
    standing=Standing(FEET, sway=(0.05, 0.15)),
    starts=1,
    random_trajectories=3,
)
HELD = replace(REQUEST, standing=Standing(FEET))


def build_request(**changes: object) -> DesignRequest:
    """Return the request of a random motion, which takes less time than an optimised one."""
    return replace(REQUEST, kind="random", **changes)  # type: ignore[arg-type]


@cache
def designed() -> Design:
    return design_experiment(squatter(), build_request())


def find_margin(design: Design, limit: str) -> Margin:
    return next(margin for margin in design.margins if margin.limit == limit)


class FreeFlyer:
    """The whole motion of a robot whose left sole stays where it is, by Pinocchio."""

    def __init__(self, urdf: str, names: tuple[str, ...], home: FloatArray) -> None:
        self.model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        self.order = np.array([self.model.joints[self.model.getJointId(name)].idx_v for name in names])
        self.feet = [self.model.getFrameId(name) for name in FEET]
        self.home = self._place_feet(home)

    def _place_feet(self, q: FloatArray, base: pin.SE3 | None = None) -> list[pin.SE3]:
        pin.framesForwardKinematics(self.model, self.data, self._configure(q, base or pin.SE3.Identity()))
        return [self.data.oMf[foot].copy() for foot in self.feet]

    def _configure(self, q: FloatArray, base: pin.SE3) -> FloatArray:
        configuration = pin.neutral(self.model)
        configuration[:7] = pin.SE3ToXYZQUAT(base)
        configuration[self.order + 1] = q
        return configuration

    def follow(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return configuration, velocity and acceleration with which the left sole stays where it is."""
        base = self.home[0] * self._place_feet(q)[0].inverse()
        configuration = self._configure(q, base)
        rates = np.zeros((2, self.model.nv))
        rates[0, self.order], rates[1, self.order] = dq, ddq
        jacobian = pin.computeFrameJacobian(self.model, self.data, configuration, self.feet[0])
        for k, measure in enumerate((pin.getFrameVelocity, pin.getFrameAcceleration)):
            pin.forwardKinematics(self.model, self.data, configuration, *rates)
            rates[k, :6] = -np.linalg.solve(
                jacobian[:, :6], measure(self.model, self.data, self.feet[0], pin.LOCAL).vector
            )
        return configuration, rates[0], rates[1]

    def measure_right_foot(self, state: tuple[FloatArray, FloatArray, FloatArray]) -> float:
        """Return how far the right sole has moved or turned, or how fast it does (m, rad, s)."""
        pin.forwardKinematics(self.model, self.data, *state)
        pin.updateFramePlacements(self.model, self.data)
        away = pin.log6(self.home[1].inverse() * self.data.oMf[self.feet[1]]).vector
        speed = pin.getFrameVelocity(self.model, self.data, self.feet[1]).vector
        acceleration = pin.getFrameAcceleration(self.model, self.data, self.feet[1]).vector
        return float(np.abs([away, speed, acceleration]).max())

    @property
    def points(self) -> FloatArray:
        """Points (8, 3) of the soles."""
        return np.concatenate([SOLE @ foot.rotation.T + foot.translation for foot in self.home])

    def compute_forces(self, state: tuple[FloatArray, FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return the wrench of the ground about the origin of the world, and the torque with forces of least norm."""
        torque = pin.rnea(self.model, self.data, *state)
        base = pin.XYZQUATToSE3(state[0][:7])
        wrench = base.act(pin.Force(torque[:6])).vector
        grasp = np.hstack([np.vstack([np.eye(3), pin.skew(point)]) for point in self.points])
        forces = np.linalg.lstsq(grasp, wrench)[0].reshape(-1, 3)
        for foot, own in zip(self.feet, np.split(np.arange(8), 2), strict=True):
            jacobian = pin.computeFrameJacobian(self.model, self.data, state[0], foot, pin.LOCAL_WORLD_ALIGNED)
            place = self.data.oMf[foot].translation
            moment = np.cross(self.points[own] - place, forces[own]).sum(axis=0)
            torque = torque - jacobian.T @ np.concatenate([forces[own].sum(axis=0), moment])
        assert np.abs(torque[:6]).max() < 1e-6
        return wrench, torque[self.order]


def follow_design(design: Design, every: int = 1) -> tuple[FreeFlyer, list[tuple[FloatArray, FloatArray, FloatArray]]]:
    flyer = FreeFlyer(SQUATTER, design.joint_names, np.array(REQUEST.home))
    rows = zip(design.q[::every], design.dq[::every], design.ddq[::every], strict=True)
    return flyer, [flyer.follow(*row) for row in rows]


def test_the_feet_stay_where_they_are_while_the_trunk_sways() -> None:
    design = designed()
    flyer, states = follow_design(design)
    assert max(flyer.measure_right_foot(state) for state in states) < TOLERANCE
    way = np.ptp([state[0][:3] for state in states], axis=0)
    assert (way > 0.04).all()
    assert (way < 0.1 + TOLERANCE).all()
    # From home to home, at rest.
    for end in (0, -1):
        np.testing.assert_allclose(design.q[end], REQUEST.home, atol=TOLERANCE)
        np.testing.assert_allclose(design.dq[end], 0.0, atol=TOLERANCE)
    assert np.ptp(design.q, axis=0).min() > 0.02


def test_velocities_and_accelerations_are_those_of_the_positions() -> None:
    trajectory = replace(REQUEST.trajectory, sampling_rate=1000.0)
    design = design_experiment(
        squatter(), replace(REQUEST, kind="random", trajectory=trajectory, random_trajectories=1)
    )
    for value, rate in ((design.q, design.dq), (design.dq, design.ddq)):
        slope = (value[2:] - value[:-2]) * 500.0
        # Moves have jumps of the jerk, beside which the difference of velocities is wrong in the first order.
        assert np.abs(slope - rate[1:-1]).max() < 2e-2 * np.abs(rate).max()
        assert np.median(np.abs(slope - rate[1:-1])) < 1e-5 * np.abs(rate).max()


def test_balance_and_torque_of_the_legs_are_those_of_a_free_flyer() -> None:
    design = designed()
    flyer, states = follow_design(design)
    still = np.zeros((2, flyer.model.nv))
    distances, torques = [], []
    hull = ConvexHull(flyer.points[:, :2])
    for state in states:
        for each in (state, (state[0], *still)):
            wrench, torque = flyer.compute_forces(each)
            pressure = np.array([-wrench[4], wrench[3]]) / wrench[2]
            # The moment is about the origin, so that the height of the soles counts with the forces along the ground.
            pressure += flyer.points[0, 2] * wrench[:2] / wrench[2]
            distances.append(-(hull.equations[:, :2] @ pressure + hull.equations[:, 2]).max())
            torques.append(np.abs(torque))
    reached = find_margin(design, "balance").value
    assert 0.01 <= reached <= min(distances) + 1e-12 < reached + 2e-3
    for name, largest in zip(design.joint_names, np.max(torques, axis=0), strict=True):
        margin = next(row for row in design.margins if (row.joint, row.limit) == (name, "torque"))
        assert 1.0 - 1e-9 <= margin.value / largest < 1.02


def test_every_limit_of_the_legs_is_kept() -> None:
    limits = {"left_thigh_joint": Limits(position=(-0.5, -0.3), velocity=0.2, acceleration=0.4)}
    design = design_experiment(squatter(), build_request(limits=limits))
    own = [margin for margin in design.margins if margin.joint == "left_thigh_joint"]
    assert {margin.limit for margin in own} == {"position_min", "position_max", "velocity", "acceleration", "torque"}
    assert all(margin.share <= 1.0 for margin in own)
    index = design.joint_names.index("left_thigh_joint")
    assert -0.5 <= design.q[:, index].min() < design.q[:, index].max() <= -0.3
    assert np.abs(design.dq[:, index]).max() <= 0.2
    assert np.abs(design.ddq[:, index]).max() <= 0.4
    # Of the other legs, rates that no description states are limited as of any joint.
    assert any((margin.joint, margin.limit) == ("right_foot_joint", "acceleration") for margin in design.margins)


def build_sway() -> tuple[Sway, Bounds]:
    _, request, balance = stand_on_feet(squatter(), REQUEST)
    assert balance is not None
    assert balance.sway is not None
    bounds = build_bounds(balance.sway.robot, {}, surroundings=request.surroundings, balance=balance)
    return balance.sway, bounds


def draw_motion(sway: Sway, bounds: Bounds, count: int) -> list[FloatArray]:
    rng = np.random.default_rng(1)
    q = sway.home + 0.5 * bounds.half_range * rng.uniform(-1, 1, (count, sway.robot.n))
    return [q, *rng.standard_normal((2, count, sway.robot.n))]


def test_the_rows_are_those_of_an_identification_with_contacts() -> None:
    sway, bounds = build_sway()
    model = build_swaying_model(sway, REQUEST.effects_or_default, bounds)
    motion = draw_motion(sway, bounds, 5)
    rows = model.observe(*motion).reshape(5, sway.robot.n, -1)
    whole = sway.expand(*motion)
    standing = dy.set_base(squatter(), "floating", FEET)
    w = model.whole.observe(whole.q, whole.dq, whole.ddq).reshape(5, standing.n, -1)
    projected = compute_contact_projection(standing, whole.q) @ w
    for own, other in zip(rows, projected, strict=True):
        np.testing.assert_allclose(own.T @ own, other.T @ other, atol=1e-9 * np.abs(other.T @ other).max())


def test_the_gradient_of_the_whole_problem_is_exact() -> None:
    sway, bounds = build_sway()
    model = build_swaying_model(sway, REQUEST.effects_or_default, bounds)
    model = lock_model(model, sway.home, np.full(sway.robot.n, True))
    family = FourierFamily(2, 4.0)
    problem = DesignProblem(family, model, lambda rows: (0.5 * float(np.sum(rows**2)), rows), bounds)
    rng = np.random.default_rng(2)
    x = 0.05 * rng.standard_normal((family.n_coefficients, sway.robot.n))
    x[0] += sway.home
    multipliers = problem.create_multipliers(1.0)
    multipliers = replace(multipliers, values=multipliers.values + 0.1, crowding=multipliers.crowding + 0.1)
    gradient = problem.evaluate(x.ravel(), multipliers).gradient
    for _ in range(4):
        way = rng.standard_normal(x.size)
        ends = [problem.evaluate(x.ravel() + step * way, multipliers).lagrangian for step in (1e-6, -1e-6)]
        assert gradient @ way == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4)


def record(design: Design, seed: int) -> dy.Recordings:
    """Return a recording of a robot whose feet stand, with noise of its sensors."""
    rng = np.random.default_rng(seed)
    flyer, states = follow_design(design)
    torque = np.array([flyer.compute_forces(state)[1] for state in states])
    torque += 0.5 * np.tanh(design.dq / 1e-3) + 0.3 * design.dq
    torque += 0.05 * rng.standard_normal(torque.shape)
    pose = np.array([state[0][:7] for state in states])
    table = {"t": design.t, **dict(zip(("base_x", "base_y", "base_z"), pose[:, :3].T, strict=True))}
    table |= dict(zip(("base_qx", "base_qy", "base_qz", "base_qw"), pose[:, 3:].T, strict=True))
    for j, name in enumerate(design.joint_names):
        table |= {f"q_{name}": design.q[:, j] + 1e-6 * rng.standard_normal(len(design.t)), f"tau_{name}": torque[:, j]}
    return dy.read_recordings(table, robot=dy.set_base(squatter(), "floating", FEET))


def identify(request: DesignRequest) -> dict[str, IdentifiedParameter]:
    """Return the parameters from a recording of a design, by name; the description stands in where it tells nothing."""
    design = design_experiment(squatter(), request)
    assert design.baseline is not None
    assert design.criterion_values.criterion < 0.7 * design.baseline.best.criterion
    standing = dy.set_base(squatter(), "floating", FEET)
    model = dy.identify(standing, record(design, 0), choices=dy.IdentificationChoices(prior="description"))
    return {row.name: row for row in model.parameters}


def test_a_sway_determines_the_legs_and_held_legs_do_not() -> None:
    swaying, held = identify(REQUEST), identify(HELD)
    # Of both legs: thigh, shank and ankle pitch.
    for number in (9, 10, 11, 15, 16, 17):
        own = swaying[f"Fc{number}"]
        assert own.judgement == "determined"
        assert own.value == pytest.approx(0.5, abs=4 * own.standard_deviation)
        assert held[f"Fc{number}"].judgement != "determined"
    for name in ("MZ9", "MZ15"):
        assert swaying[name].standard_deviation < 0.1 * held[name].standard_deviation
    counts = [sum(row.judgement == "determined" for row in rows.values()) for rows in (swaying, held)]
    assert counts[0] > 2 * counts[1]


STRETCHED = tuple(0.0 for _ in range(14))
REFUSED: dict[str, tuple[Robot, DesignRequest, str, str]] = {
    "one joint a leg": (
        robot_from_description("stander", Description("urdf", STANDER)),
        build_request(home=HOME),
        "/standing/feet/0",
        r"has 1 joints \(left_hip\).*needs 6",
    ),
    "a point of a leg of six joints": (
        squatter(),
        build_request(
            standing=Standing((*(f"left_foot@{x},{y},-0.02" for x, y, _ in SOLE), "right_foot"), sway=(0.1, 0.0))
        ),
        "/standing/feet/0",
        "needs 3",
    ),
    "a foot twice": (
        squatter(),
        build_request(standing=Standing((*FEET, FEET[0]), sway=(0.1, 0.0))),
        "/standing/feet/2",
        "named twice",
    ),
    "stretched": (squatter(), build_request(home=STRETCHED), "/home", "bend its knee"),
    "several paces": (
        squatter(),
        build_request(trajectory=replace(REQUEST.trajectory, paces=(1.0, 0.5))),
        "/standing/sway",
        "at one pace",
    ),
    "one joint at a time": (squatter(), replace(REQUEST, kind="slow_sweep"), "/standing/sway", "all joints"),
    "prediction": (
        squatter(),
        build_request(criterion=CriterionChoice("prediction")),
        "/standing/sway",
        "prediction of torque",
    ),
    "a leg by itself": (
        squatter(),
        build_request(trajectory=replace(REQUEST.trajectory, joints=("left_thigh_joint",))),
        "/trajectory/joints",
        "left_thigh_joint cannot move",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_sway_is_refused_with_a_reason(case: str) -> None:
    robot, request, pointer, reason = REFUSED[case]
    with pytest.raises(DynidentError, match=reason) as refused:
        design_experiment(robot, request)
    assert refused.value.pointer == pointer


def test_the_request_of_a_result_gives_the_same_motion_again() -> None:
    first = design_experiment(squatter(), build_request(random_trajectories=2))
    assert first.request.home == REQUEST.home
    assert any("Home is " + ", ".join(f"{value:g}" for value in REQUEST.home) in note for note in first.notes)
    assert any("moves by up to 0.05 m and turns by up to 0.15 rad" in note for note in first.notes)
    assert any(note.startswith("No velocity limit is known for the base: ") for note in first.notes)
    again = dy.design(squatter(), first.request)
    np.testing.assert_allclose(again.design.q, first.q, atol=1e-9)
    assert [name for name in again.to_frame().columns if name.startswith("q_left")]
    table = {
        tuple(cell.text for cell in row[:2]): row[3].text for row in build_limits_table(squatter(), first.margins).rows
    }
    assert table["base_x", "velocity"].endswith("0.250 m/s")
    assert table["base_yaw", "position max"].endswith("0.150 rad")
    assert "<svg" in draw_design(first, squatter())
    with pytest.raises(DynidentError, match="cannot be simulated"):
        again.simulate()


def test_a_squat_alone_moves_both_legs_alike() -> None:
    """Arms that are locked at home, and a trunk that only moves: joints and coordinates without range stay."""
    trajectory = replace(REQUEST.trajectory, joints=("elbow",))
    standing, limits = Standing(FEET, sway=(0.05, 0.0)), {"base_z": Limits(velocity=0.05)}
    design = design_experiment(squatter(), build_request(trajectory=trajectory, standing=standing, limits=limits))
    assert next(row.bound for row in design.margins if (row.joint, row.limit) == ("base_z", "velocity")) == 0.05
    _, states = follow_design(design, 20)
    poses = np.array([state[0][:7] for state in states])
    np.testing.assert_allclose(poses[:, 3:], [[0.0, 0.0, 0.0, 1.0]] * len(poses), atol=TOLERANCE)
    assert np.ptp(poses[:, 2]) > 0.01
    assert np.ptp(design.q[:, design.joint_names.index("shoulder")]) == 0.0


def test_a_quadruped_sways_over_the_points_of_its_feet() -> None:
    robot, legs = dy.load_robot("go2"), ("FL", "FR", "RL", "RR")
    standing = Standing(tuple(f"{leg}_calf@0,0,-0.213" for leg in legs), sway=(0.03, 0.1))
    home = bend(robot, {"thigh_joint": 0.8, "calf_joint": -1.6})
    design = design_experiment(robot, build_request(home=home, standing=standing, random_trajectories=2))
    assert np.ptp(design.q, axis=0).min() > 0.02
    calves = [robot.joint_names.index(f"{leg}_calf_joint") for leg in legs]
    feet = joint_frames(robot, design.q)[:, calves, :3] @ np.array([0.0, 0.0, -0.213, 1.0])
    apart = np.linalg.norm(feet[:, :, None] - feet[:, None], axis=3)
    assert np.ptp(apart, axis=0).max() < TOLERANCE


@pytest.mark.slow
def test_servos_in_mujoco_keep_the_feet_where_they_are() -> None:
    design = design_experiment(squatter(), build_request(standing=Standing(FEET, margin=0.02, sway=(0.05, 0.15))))
    model = build_engine(
        SQUATTER, dict.fromkeys(FEET, SOLE + np.array([0.0, 0.0, 0.005])), 0.005, squatter().joint_names
    )
    flyer = FreeFlyer(SQUATTER, design.joint_names, np.array(REQUEST.home))
    lowest, up = float(flyer.points[:, 2].min()), np.array([0.0, 0.0, 1.0])
    turn, move = play(model, design, up, lowest, FEET)
    trunk_turn, trunk_move = play(model, design, up, lowest)
    assert turn < 0.02
    assert move < 0.005
    assert trunk_turn > 0.1
    assert trunk_move > 0.03
