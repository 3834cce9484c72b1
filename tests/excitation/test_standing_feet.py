"""Designs for robots on their feet keep the centre of pressure inside the support, by Pinocchio and in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from support.standing_engine import build_engine, play
from support.standing_robots import BOX, FEET, HOME, LEGS, SOLE, STANDER

import dynident as dy
from dynident.errors import DynidentError
from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.standing_feet import StandingBalance, build_standing_balance
from dynident.motion import Margin, Standing, Surroundings
from dynident.number_format import format_number
from dynident.presentation.design_tables import describe_design
from dynident.reports.figures.design import draw_design
from dynident.robot import Description, Robot, robot_from_description

FloatArray = NDArray[np.float64]
REQUEST = DesignRequest(
    trajectory=TrajectoryRequest(duration=4.0, harmonics=4, periods=1),
    home=HOME,
    standing=Standing(FEET),
    starts=1,
    random_trajectories=20,
)


@cache
def stander() -> Robot:
    return robot_from_description("stander", Description("urdf", STANDER))


@cache
def designed() -> Design:
    return design_experiment(stander(), REQUEST)


def find_margin(design: Design, limit: str) -> Margin:
    return next(margin for margin in design.margins if margin.limit == limit)


class FreeFlyer:
    """Wrench of the ground, and place of the soles, by Pinocchio."""

    def __init__(self) -> None:
        self.model = pin.buildModelFromXML(STANDER, pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        self.order = [self.model.joints[self.model.getJointId(name)].idx_v - 6 for name in stander().joint_names]

    def place(self, q: FloatArray) -> FloatArray:
        """Return a configuration with the trunk at the origin of the world."""
        configuration = pin.neutral(self.model)
        configuration[7 + np.array(self.order)] = q
        return configuration

    def locate_soles(self, q: FloatArray) -> tuple[FloatArray, FloatArray, list[int]]:
        """Return the points (8, 3) of the soles, their normal, and the joints that carry them."""
        pin.framesForwardKinematics(self.model, self.data, self.place(q))
        frames = [self.data.oMf[self.model.getFrameId(name)] for name in FEET]
        points = np.concatenate([SOLE @ frame.rotation.T + frame.translation for frame in frames])
        joints = [self.model.frames[self.model.getFrameId(name)].parentJoint for name in FEET for _ in SOLE]
        return points, frames[0].rotation[:, 2], joints

    def compute(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the wrench about the trunk's origin, and the torque of all joints without forces at the feet."""
        self.model.gravity.linear = -9.81 * self.locate_soles(np.array(HOME))[1]
        rates = np.zeros((2, self.model.nv))
        rates[:, 6 + np.array(self.order)] = dq, ddq
        torque = pin.rnea(self.model, self.data, self.place(q), *rates)
        return torque[:6], torque[6 + np.array(self.order)]


def compute_pressure_distance(wrench: FloatArray, points: FloatArray, normal: FloatArray) -> float:
    """Return how far inside of the hull of the points the centre of pressure is."""
    centre = points.mean(axis=0)
    moment = wrench[3:] - np.cross(centre, wrench[:3])
    along = np.linalg.svd(np.outer(normal, normal))[2][1:]
    pressure = along @ np.cross(normal, moment) / (normal @ wrench[:3])
    hull = ConvexHull((points - centre) @ along.T)
    return float(-(hull.equations[:, :2] @ pressure + hull.equations[:, 2]).max())


def find_needed_friction(wrench: FloatArray, points: FloatArray, normal: FloatArray) -> float:
    """Return the least friction with which forces at the points have a wrench, by bisection; cones of 32 sides."""
    along = np.linalg.svd(np.outer(normal, normal))[2][1:]
    angles = 2 * np.pi * np.arange(32) / 32
    low, high = 0.0, 2.0
    for _ in range(20):
        friction = 0.5 * (low + high)
        edges = normal + friction * np.column_stack([np.cos(angles), np.sin(angles)]) @ along
        rays = np.array([[*edge, *np.cross(point, edge)] for point in points for edge in edges]).T
        feasible = linprog(np.zeros(rays.shape[1]), A_eq=rays, b_eq=wrench).status == 0
        low, high = (low, friction) if feasible else (friction, high)
    return high


def test_balance_friction_and_torque_of_the_legs_are_those_of_a_free_flyer() -> None:
    design, pinocchio = designed(), FreeFlyer()
    points, normal, carriers = pinocchio.locate_soles(np.array(HOME))
    assert normal[2] < 0.999  # the trunk leans
    still = np.zeros(5)
    wrenches, torques = [], []
    for q, dq, ddq in zip(design.q, design.dq, design.ddq, strict=True):
        for rates in ((dq, ddq), (still, still)):
            wrench, torque = pinocchio.compute(q, *rates)
            wrenches.append(wrench)
            forces = np.linalg.lstsq(np.hstack([np.vstack([np.eye(3), pin.skew(p)]) for p in points]), wrench)[0]
            for point, force, carrier in zip(points, forces.reshape(-1, 3), carriers, strict=True):
                axis = pinocchio.data.oMi[carrier].rotation[:, 1]
                index = stander().joint_names.index(pinocchio.model.names[carrier])
                torque[index] -= axis @ np.cross(point - pinocchio.data.oMi[carrier].translation, force)
            torques.append(np.abs(torque))
    distances = [compute_pressure_distance(wrench, points, normal) for wrench in wrenches]
    # The design looks at ten times as many samples.
    reached = find_margin(design, "balance").value
    assert 0.01 <= reached <= min(distances) + 1e-12 < reached + 5e-4
    largest = np.max(torques, axis=0)
    for name in ("left_hip", "right_hip"):
        margin = next(row for row in design.margins if (row.joint, row.limit) == (name, "torque"))
        assert 1.0 <= margin.value / largest[stander().joint_names.index(name)] < 1.01
    sideways = [np.linalg.norm(wrench[:3] - normal * (normal @ wrench[:3])) for wrench in wrenches]
    worst = wrenches[int(np.argmax(sideways))]
    balance = build_balance()
    # The pyramids of eight sides are up to 8 % narrower than the cones.
    k = int(np.argmax(sideways)) // 2
    reported = balance.measure(design.q[k : k + 1], design.dq[k : k + 1], design.ddq[k : k + 1]).friction
    needed = find_needed_friction(worst, points, normal)
    assert needed * 0.999 <= reported <= needed * 1.09
    assert reported <= find_margin(design, "friction").value <= 0.5


def build_balance(standing: Standing = REQUEST.standing) -> StandingBalance:
    return build_standing_balance(stander(), standing, np.array(HOME), np.full(5, 60.0), Surroundings())


def test_legs_stay_and_the_result_says_where_the_pressure_goes() -> None:
    design = designed()
    assert design.request.trajectory.joints == ("mast_joint", "shoulder", "elbow")
    np.testing.assert_array_equal(design.q[:, LEGS], np.full((len(design.q), 2), 0.1))
    balance = find_margin(design, "balance")
    assert balance.joint == "left_foot, right_foot"
    assert balance.share == pytest.approx(balance.bound / balance.value)
    sentence = describe_design(design)
    assert f"stays {format_number(balance.value)} m inside the support" in sentence
    assert f"friction of {format_number(find_margin(design, 'friction').value, 2)}." in sentence
    assert any("stands on left_foot, right_foot" in note for note in design.notes)
    assert design.baseline is not None
    assert design.criterion_values.criterion < design.baseline.best.criterion
    # The hand is kept off the ground; the feet, which stand on it, are not.
    assert [wall.name for wall in design.request.surroundings.walls] == ["ground"]
    assert any("no motion changes their distance: left_foot – wall 'ground'" in note for note in design.notes)


def test_the_slack_has_exact_derivatives() -> None:
    balance, rng = build_balance(), np.random.default_rng(1)
    motion = [np.array(HOME) + 0.2 * rng.standard_normal((4, 5)), *rng.standard_normal((2, 4, 5))]
    slack = balance.evaluate_motion(*motion)
    weights = rng.standard_normal(slack.values.shape)
    for part, gradient in enumerate(slack.pull_back_motion(weights)):
        for joint in range(5):
            ends = []
            for sign in (1, -1):
                moved = [array.copy() for array in motion]
                moved[part][:, joint] += sign * 1e-6
                ends.append((balance.evaluate_motion(*moved).values * weights).sum(axis=1))
            np.testing.assert_allclose(gradient[:, joint], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6)


def test_what_holds_at_rest_and_at_full_speed_holds_at_every_lower_speed() -> None:
    design, balance = designed(), build_balance()
    full = np.minimum(
        balance.evaluate_motion(design.q, design.dq, design.ddq).values, balance.evaluate(design.q).values
    )
    for speed in (0.3, 0.7):
        slack = balance.evaluate_motion(design.q, speed * design.dq, speed**2 * design.ddq).values
        assert (slack >= full - 1e-12).all()


def test_points_are_as_good_as_a_sole() -> None:
    points = tuple(f"{foot}@{','.join(map(str, point))}" for foot in FEET for point in SOLE)
    balance = build_balance(replace(REQUEST.standing, feet=points))
    q = np.array(HOME)[None]
    assert balance.measure(q, 0 * q, 0 * q).distance == pytest.approx(build_balance().measure(q, 0 * q, 0 * q).distance)


def build_round_soles(folder: Path, corners: int) -> Robot:
    """Return the robot with round soles of a mesh."""
    angles = 2.0 * np.pi * np.arange(corners) / corners
    rim = np.column_stack([0.04 + 0.1 * np.cos(angles), 0.05 * np.sin(angles), np.full(corners, -0.02)])
    vertices = np.concatenate([rim, rim + np.array([0.0, 0.0, 0.02])])
    faces = [(k, (k + 1) % corners, k + corners) for k in range(corners)]
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / f"sole{corners}.obj").write_text("\n".join(lines))
    mesh = f'<collision><geometry><mesh filename="sole{corners}.obj"/></geometry></collision>'
    return robot_from_description("stander", Description("urdf", STANDER.replace(BOX, mesh)))


def test_a_finer_mesh_of_a_sole_costs_nothing_and_claims_no_more_support(tmp_path: Path) -> None:
    q, still, counts, torques = np.array(HOME)[None], np.zeros((1, 5)), [], []
    for corners in (32, 512):
        balance = build_standing_balance(
            build_round_soles(tmp_path, corners),
            REQUEST.standing,
            q[0],
            np.full(5, 60.0),
            Surroundings(mesh_folders=(str(tmp_path),)),
        )
        assert len(balance.ground.points) == 16
        extremes = balance.measure(q, still, still)
        counts.append(balance.count)
        torques.append(extremes.torque)
        # Inside of the true ellipse, by little of its half width of 0.05 m.
        heel_to_toe = np.ptp(balance.ground.points, axis=0)
        assert 0.92 * 0.2 < np.hypot(heel_to_toe[0], heel_to_toe[2]) <= 0.2 + 1e-9
        assert 0.24 + 0.92 * 0.1 < heel_to_toe[1] <= 0.24 + 0.1 + 1e-9
    assert counts[1] < 1.5 * counts[0]
    np.testing.assert_allclose(torques[1], torques[0], rtol=0.01)


def test_points_within_the_outline_of_a_foot_change_nothing() -> None:
    inside = tuple(f"{foot}@{x},{y},-0.02" for foot in FEET for x in (0.0, 0.04, 0.1) for y in (-0.03, 0.0, 0.03))
    points = tuple(f"{foot}@{','.join(map(str, point))}" for foot in FEET for point in SOLE)
    few, many = build_balance(replace(REQUEST.standing, feet=points)), build_balance(Standing(points + inside))
    assert many.count == few.count
    q, rates = np.array(HOME)[None], np.ones((1, 5))
    np.testing.assert_allclose(many.measure(q, rates, rates).torque, few.measure(q, rates, rates).torque)


REFUSED: dict[str, tuple[DesignRequest, str, str]] = {
    "falls": (replace(REQUEST, home=(-0.35, 0.0, -0.35, 0.2, 0.0)), "/home", "the centre of pressure"),
    "not flat": (replace(REQUEST, home=(0.0, 0.0, 0.2, 0.0, 0.0)), "/home", "not on one plane"),
    "a line": (
        replace(REQUEST, standing=Standing(("left_foot@0,0,0", "right_foot@0,0,0"))),
        "/standing/feet",
        "a line",
    ),
    "no link": (replace(REQUEST, standing=Standing(("hand",))), "/standing/feet/0", "no link 'hand'"),
    "no sole": (
        replace(REQUEST, standing=Standing(("left_foot", "mast"))),
        "/standing/feet/1",
        "no collision geometry",
    ),
    "a lift": (replace(REQUEST, standing=Standing(("left_foot", "right_foot^0.03"))), "/standing/feet/1", "not lifted"),
    # The centre of pressure is 0.09858 m inside.
    "hardly balances": (replace(REQUEST, standing=Standing(FEET, margin=0.098)), "/home", "at least 0.099 m inside"),
    "unreadable": (replace(REQUEST, standing=Standing(("left_foot@1",))), "/standing/feet/0", "cannot be read"),
    "a leg moves": (
        replace(REQUEST, trajectory=replace(REQUEST.trajectory, joints=("left_hip", "elbow"))),
        "/trajectory/joints",
        "left_hip cannot move",
    ),
    "a set": (replace(REQUEST, kind="sequential"), "/kind", "legs that stand"),
    "weak legs": (
        replace(REQUEST, limits={"left_hip": dy.Limits(effort=0.5)}),
        "/home",
        "'left_hip' of a leg that stands",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_stand_is_refused_with_a_reason(case: str) -> None:
    request, pointer, reason = REFUSED[case]
    with pytest.raises(DynidentError, match=reason) as refused:
        design_experiment(stander(), request)
    assert refused.value.pointer == pointer


def test_no_foot_is_as_slippery_as_rounding() -> None:
    with pytest.raises(DynidentError, match=r"0\.01 to 10") as refused:
        Standing(FEET, friction=0.001)
    assert refused.value.pointer == "/friction"
    balance = build_balance(Standing(FEET, friction=0.01))
    assert balance.find_least(np.array(HOME)[None])[0] > 0.001


def test_only_the_torque_of_legs_that_stand_is_near_a_limit() -> None:
    design = designed()
    assert {margin.limit for margin in design.margins if margin.joint in ("left_hip", "right_hip")} == {"torque"}
    assert {margin.limit for margin in design.margins if margin.joint == "elbow"} > {"position_min", "velocity"}
    # Its figure then has no curves of these legs.
    assert "<svg" in draw_design(design, stander())


def test_no_note_asks_for_a_model_that_standing_gives_not() -> None:
    assert any("Leave room in the torque limits" in note for note in designed().notes)
    assert not any("identified model" in note for note in designed().notes)
    assert any("identified model" in note for note in designed_while_held().notes)


def test_a_recording_is_identified_with_the_legs_locked(tmp_path: Path) -> None:
    motion = dy.design(stander(), REQUEST)
    home = dict(zip(stander().joint_names, HOME, strict=True))
    table = motion.simulate().to_frame()
    file = tmp_path / "stander.urdf"
    file.write_text(STANDER)
    legs = {name: home[name] for name in ("left_hip", "right_hip")}
    robot = dy.load_robot(file, gravity=motion.robot.gravity.tolist(), locked_joints=legs)
    model = dy.identify(robot, dy.read_recordings(table, robot=robot))
    true = model.true_params()
    for name in ("MZ1", "MX2", "MX3"):
        assert next(row.value for row in model.parameters if row.name == name) == pytest.approx(true[name], rel=0.02)


def test_stated_gravity_moves_no_sole() -> None:
    motion = dy.design(stander(), replace(REQUEST, kind="random", random_trajectories=2))
    # Its gravity is inclined by 0.1 rad, by which heel and toe of a sole differ by 2 cm.
    again = dy.design(motion.robot, motion.design.request)
    np.testing.assert_allclose(again.design.q, motion.design.q, atol=1e-6)


def test_a_floating_robot_is_held_by_its_feet() -> None:
    floating = dy.set_base(stander(), "floating", FEET)
    request = replace(REQUEST, kind="random", random_trajectories=2)
    design = design_experiment(floating, request)
    assert design.joint_names == stander().joint_names
    np.testing.assert_array_equal(design.q, design_experiment(stander(), request).q)
    # Its samples, and a simulation of it, are those of the joints alone, with gravity as the trunk leans.
    motion = dy.design(floating, request)
    assert len(motion.to_frame()) == len(design.t)
    assert motion.robot.base == "fixed"
    assert motion.robot.gravity[0] == pytest.approx(-9.81 * np.sin(0.1))
    assert motion.simulate().recordings[0].joint_names == stander().joint_names
    with pytest.raises(DynidentError, match="feet that it stands on"):
        design_experiment(floating, replace(request, standing=Standing()))


def test_one_joint_at_a_time_and_points_keep_the_balance() -> None:
    for request in (
        replace(REQUEST, kind="slow_sweep"),
        replace(REQUEST, trajectory=replace(REQUEST.trajectory, family="point_to_point", points=4)),
    ):
        design = design_experiment(stander(), replace(request, random_trajectories=5))
        assert find_margin(design, "balance").value >= 0.01
        np.testing.assert_array_equal(np.ptp(design.q[:, LEGS], axis=0), 0.0)


@cache
def designed_while_held() -> Design:
    """Return the design of a robot whose trunk is held, with the same joints."""
    names = designed().request.trajectory.joints
    return design_experiment(
        stander(), replace(REQUEST, standing=Standing(), trajectory=replace(REQUEST.trajectory, joints=names))
    )


def test_without_feet_the_same_request_would_tip_the_robot() -> None:
    design = designed_while_held()
    assert build_balance().measure(design.q, design.dq, design.ddq).distance < 0.0


@pytest.mark.slow
def test_a_robot_in_mujoco_stands_through_a_design_and_tips_without_the_constraint() -> None:
    points, up, _ = FreeFlyer().locate_soles(np.array(HOME))
    model = build_engine(STANDER, dict.fromkeys(FEET, SOLE + np.array([0.0, 0.0, 0.005])), 0.005, stander().joint_names)
    lowest = float((points @ up).min())
    turn, move = play(model, designed(), up, lowest)
    assert turn < 0.025
    assert move < 0.02
    # Its soles leave the ground.
    assert play(model, designed_while_held(), up, lowest)[0] > 0.05


@pytest.mark.slow
def test_a_humanoid_in_mujoco_stands_while_its_arms_and_waist_move() -> None:
    robot = dy.load_robot("g1")
    feet = ("left_ankle_roll_link", "right_ankle_roll_link")
    request = DesignRequest(
        # The servos give a little: with a margin of 0.01 m some of these motions tip the robot over.
        trajectory=TrajectoryRequest(duration=5.0, periods=1),
        standing=Standing(feet, margin=0.02),
        starts=1,
        random_trajectories=10,
    )
    design = design_experiment(robot, request)
    assert len(design.request.trajectory.joints) == 17
    assert find_margin(design, "balance").value >= 0.02
    soles = np.array([[-0.05, 0.025, -0.03], [-0.05, -0.025, -0.03], [0.12, 0.03, -0.03], [0.12, -0.03, -0.03]])
    model = build_engine(robot.description.content, dict.fromkeys(feet, soles), 0.005, robot.joint_names)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn, move = play(model, design, np.array([0.0, 0.0, 1.0]), float(data.body(feet[0]).xpos[2]) - 0.035)
    assert turn < 0.03
    assert move < 0.02
