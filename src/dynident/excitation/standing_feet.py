"""Balance of a robot on standing feet: forces of the ground, and whether feet can exert them in a motion.

The legs that stand are held, so that the base does not move, and the other joints move; or the trunk sways, and the
legs follow. The six equations of the base then give the wrench w of the ground on the robot. All that has to hold is
linear in it:

* centre of pressure: its distance from every edge of the support (the convex hull of the points that touch) is at least
  the margin, which no wrench that pulls can keep,
* friction: w is a sum of forces at these points, each inside its friction cone (the contact wrench cone of Caron,
  Pham and Nakamura, ICRA 2015; the cones are pyramids of eight sides within the true ones),
* torque of the legs that stand: that of their own links, less Jᵀf. Many forces f have the sum w; the one of least norm
  counts, as of equally stiff points.

All of it has to hold at rest in every posture, too. The wrench at a part s of the speed lies between both, by the share
s², so that it then holds at every lower speed as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import Signals
from dynident.errors import DynidentError
from dynident.excitation.design_request import DesignRequest
from dynident.excitation.swaying_trunk import Sway, build_sway
from dynident.expressions import Program
from dynident.motion.collision.constraint_slack import METRES_OF_A_SHARE, BalanceExtremes, word_fall
from dynident.motion.collision.obstacle_geometry import NOT_STANDING, Ground, fit_ground
from dynident.motion.collision.surroundings import Standing, Surroundings, Wall
from dynident.motion.collision_free_paths import check_home
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, build_bounds, select_moving_joints
from dynident.motion.limits.postures_within_limits import list_usual_homes
from dynident.robot.collision_reader import BASE, collision_geometry
from dynident.robot.cut_joint import FrameOnJoint, Loop, build_gap
from dynident.robot.description_and_json import set_base
from dynident.robot.description_formats import BASE_JOINTS
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.joint import join_joint_names
from dynident.robot.json_fields import join_names
from dynident.robot.robot_model import Robot

_SPARE = 0.001
"""Distance (m) beyond the margin that is designed for, as the motion goes on between the samples."""
_SPARE_SHARE = 0.99
"""Share of friction and torque that is designed for, for the same reason."""
_SIDES = 8
"""Sides of the pyramid within a friction cone: it is at most 8 % narrower."""
_NO_FRICTION = 1e-7
"""Part of a unit normal of the cone below which it has nothing to do with friction."""


@dataclass(frozen=True, eq=False)
class MotionSlack:
    """Slack at N samples of a motion: `values` (N, K) in m, negative where the robot does not balance."""

    values: FloatArray
    _balance: StandingBalance
    _motion: tuple[FloatArray, FloatArray, FloatArray]

    def pull_back_motion(self, gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈ (N, n) from ∂/∂values (N, K)."""
        return self._balance.pull_back(self._motion, gradient)

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (N, n) from ∂/∂values (N, K)."""
        return self.pull_back_motion(gradient)[0]


@dataclass(frozen=True, eq=False)
class StandingBalance:
    """Balance of a robot on its feet, as a function of the motion of all joints, or of the driven ones of a sway.

    Parameters
    ----------
    robot : Robot
        The robot on a fixed base, or on a floating one that sways, with gravity against the normal of the ground.
    root : (10,)
        Inertial parameters of its root link where the base is fixed; zeros otherwise.
    ground : Ground
        The ground under the feet.
    standing : Standing
        Feet, friction and margin, as the request states them.
    home : (n,)
        Posture in which it stands, rad or m.
    held : (n,) of bool
        Joints of the legs that stand.
    torque_limits : (k,)
        Torque limits of these joints, N m or N; infinite where there is none.
    sway : Sway, optional
        How the legs follow the trunk; they are held where left out.
    """

    robot: Robot
    root: FloatArray
    ground: Ground
    standing: Standing
    home: FloatArray
    held: BoolArray
    torque_limits: FloatArray
    sway: Sway | None = None

    @cached_property
    def weight(self) -> float:
        """Weight of the robot, N."""
        assert self.robot.inertias is not None
        return float((self.root[9] + self.robot.inertias[:, 9].sum()) * np.linalg.norm(self.robot.gravity))

    @cached_property
    def held_names(self) -> tuple[str, ...]:
        """Names of the joints that are held."""
        return tuple(np.array(self.robot.joint_names)[self.held].tolist())

    @cached_property
    def _programs(self) -> tuple[Program, Program]:
        """Wrench and torque (6 + k) as a function of the motion, and their transposed derivative."""
        signals = Signals(self.robot)
        inertias = ca.DM(np.asarray(self.robot.inertias).reshape(-1))
        mass, moment = self.root[9], self.root[6:9]
        of_root = -np.concatenate([mass * self.robot.gravity, np.cross(moment, self.robot.gravity)])
        wrench = ca.mtimes(signals.mechanics.wrenches, inertias) + ca.DM(of_root)
        # Of all forces f with this wrench, those of least norm count: the points stay where they are, so that their
        # map to the wrench does not depend on the motion. They take Jᵀf off the torque of the legs.
        forces = ca.mtimes(ca.DM(np.linalg.pinv(self.ground.forces_to_wrench)), wrench)
        carried = ca.jtimes(self._place_points(signals.q), signals.q, forces, True)
        torque = ca.mtimes(signals.mechanics.rows, inertias) - carried
        output = ca.densify(ca.vertcat(wrench, *(torque[int(j)] for j in np.flatnonzero(self.held))))
        state, seeds = ca.vertcat(signals.q, signals.dq, signals.ddq), ca.SX.sym("seeds", output.numel())
        reverse = ca.densify(ca.jtimes(output, state, seeds, True))
        return Program([signals.q, signals.dq, signals.ddq], output), Program([state, seeds], reverse)

    def _place_points(self, q: ca.SX) -> ca.SX:
        """Return the points of the feet SX (3 p, 1) that touch the ground at home, as functions of the posture."""
        tree, home = self.robot.tree, joint_frames(self.robot, self.home[None])[0]
        positions = ca.SX(tree.n, 1)
        positions[range(tree.n) if self.robot.linkage is None else list(self.robot.linkage.driven)] = q
        places = []
        for link, point in zip(self.ground.links, self.ground.points, strict=True):
            end = np.eye(4)
            end[:3, 3] = home[link, :3, :3].T @ (point - home[link, :3, 3])
            ends = (FrameOnJoint(BASE, np.eye(4)), FrameOnJoint(link, end))
            places.append(build_gap(Loop("", "point", ends), tree.joints, positions))
        return ca.vertcat(*places)

    @cached_property
    def _outline(self) -> scipy.spatial.ConvexHull:
        return scipy.spatial.ConvexHull(self.ground.places)

    @cached_property
    def _edges(self) -> FloatArray:
        """Rows (e, 6): f_z times the distance of the centre of pressure from an edge, of a wrench w."""
        # The normals of the hull point outwards: normal · x + offset ≤ 0 inside. The centre of pressure is
        # (-m_y, m_x) / f_z.
        outward, offset = self._outline.equations[:, :2], self._outline.equations[:, 2]
        rows = np.zeros((len(offset), 6))
        rows[:, 2], rows[:, 3], rows[:, 4] = -offset, -outward[:, 1], outward[:, 0]
        return np.asarray(np.unique(rows.round(12), axis=0) @ self.ground.transform)

    @cached_property
    def _size(self) -> float:
        """Radius of the support, m."""
        return float(np.linalg.norm(self.ground.places, axis=1).max())

    @cached_property
    def _cone(self) -> tuple[FloatArray, FloatArray]:
        """Rows (c, 6), for horizontal force and turning moment, and for the rest: their sum is positive on the cone."""
        angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        slopes = self.standing.friction * np.column_stack([np.cos(angles), np.sin(angles)])
        forces = np.column_stack([slopes, np.ones(_SIDES)])
        # A force at a point within the outline is a sum of forces at the corners.
        corners = self.ground.places[self._outline.vertices]
        places = np.column_stack([corners / self._size, np.zeros(len(corners))])
        rays = np.array([np.concatenate([force, np.cross(place, force)]) for place in places for force in forces])
        # Facets of the hull of rays and apex that contain the apex are those of the cone.
        normals = scipy.spatial.ConvexHull(np.vstack([np.zeros(6), rays])).equations
        normals = np.unique(-normals[np.abs(normals[:, 6]) < 1e-9, :6].round(9), axis=0)
        is_sliding = np.array([True, True, False, False, False, True])
        normals = normals[np.abs(normals[:, is_sliding]).max(axis=1) > _NO_FRICTION]
        scale = np.diag([1.0, 1.0, 1.0, *[1.0 / self._size] * 3]) @ self.ground.transform
        return (normals * is_sliding) @ scale, (normals * ~is_sliding) @ scale

    @cached_property
    def _rows(self) -> tuple[FloatArray, FloatArray]:
        """The matrix (K, 6 + k) and the constants (K,) of the slack that is designed for, m."""
        k = int(self.held.sum())
        upward = np.concatenate([self.ground.axes[:, 2], np.zeros(3)])
        edges = (self._edges - (self.standing.margin + _SPARE) * upward) / self.weight
        sliding, rest = self._cone
        friction = self._size * (sliding / _SPARE_SHARE + rest) / self.weight
        limited = np.isfinite(self.torque_limits)
        legs = np.hstack([np.zeros((k, 6)), np.eye(k)])[limited] / self.torque_limits[limited, None]
        legs *= METRES_OF_A_SHARE / _SPARE_SHARE
        matrix = np.vstack([np.hstack([rows, np.zeros((len(rows), k))]) for rows in (edges, friction)])
        constants = np.concatenate([np.zeros(len(matrix)), np.full(2 * len(legs), METRES_OF_A_SHARE)])
        return np.vstack([matrix, -legs, legs]), constants

    @property
    def count(self) -> int:
        """Number of slacks K."""
        return len(self._rows[1])

    def hold(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position limits (n,) in which legs that are held have no range."""
        if self.sway is not None:
            return low, high
        return np.where(self.held, self.home, low), np.where(self.held, self.home, high)

    def evaluate_motion(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> MotionSlack:
        """Return the slack of a motion q, q̇, q̈ (N, n)."""
        matrix, constants = self._rows
        values = self._programs[0](*self._expand(q, dq, ddq)) @ matrix.T + constants
        return MotionSlack(values, self, (q, dq, ddq))

    def _expand(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, q̇, q̈ of all joints of the robot."""
        if self.sway is None:
            return q, dq, ddq
        motion = self.sway.expand(q, dq, ddq)
        return motion.q, motion.dq, motion.ddq

    def evaluate(self, q: FloatArray) -> MotionSlack:
        """Return the slack at rest in postures q (N, n)."""
        return self.evaluate_motion(q, np.zeros_like(q), np.zeros_like(q))

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest slack (N,) at rest in postures q (N, n), m."""
        return np.asarray(self.evaluate(q).values.min(axis=1))

    def pull_back(self, motion: tuple[FloatArray, FloatArray, FloatArray], gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈ (N, n) at a motion from the derivative by the slack (N, K)."""
        state = np.concatenate(self._expand(*motion), axis=1)
        swept = self._programs[1](state, np.ascontiguousarray(gradient @ self._rows[0]))
        gradients = list(np.split(swept, 3, axis=1))
        return gradients if self.sway is None else self.sway.expand(*motion).pull_back(gradients)

    def is_kept(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> bool:
        """Return whether the robot balances in a motion q, q̇, q̈ (N, n), with what is to spare."""
        return bool((self.evaluate_motion(q, dq, ddq).values >= 0.0).all())

    def measure(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> BalanceExtremes:
        """Return how near a motion q, q̇, q̈ (N, n) comes to falling, slipping and the torque limits of the legs."""
        output = self._programs[0](*self._expand(q, dq, ddq))
        wrench = output[:, :6]
        upward = wrench[:, :3] @ self.ground.axes[:, 2]
        sliding, rest = (wrench @ rows.T for rows in self._cone)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(upward > 0.0, (wrench @ self._edges.T).min(axis=1) / upward, -np.inf)
            # Friction scales the forces along the ground, so that it is known which friction the cone would need.
            needed = np.where(sliding < 0.0, np.where(rest > 0.0, -sliding / rest, np.inf), 0.0).max(axis=1)
        torque = np.abs(output[:, 6:])
        return BalanceExtremes(
            float(distance.min()), float(self.standing.friction * needed.max()), torque.max(axis=0, initial=0.0)
        )

    def find_complaint(self, q: FloatArray) -> str | None:
        """Return what does not balance at rest along a path q (N, n), as the end of a sentence; None where all does.

        As in the design, something has to be left to spare. At rest on level ground no friction is needed.
        """
        still = np.zeros_like(q)
        extremes = self.measure(q, still, still)
        if extremes.distance < self.standing.margin + _SPARE:
            return word_fall(extremes.distance, self.standing.margin + _SPARE)
        for name, torque, limit in zip(self.held_names, extremes.torque, self.torque_limits, strict=True):
            if torque > _SPARE_SHARE * limit:
                return (
                    f"joint '{name}' of a leg that stands would need {torque:.3g}, and its torque limit is "
                    f"{limit:.3g}, of which 1 % has to be to spare."
                )
        return None

    def find_broken(self, q: FloatArray) -> BoolArray:
        """Return in which of postures q (N, n) the robot does not balance at rest: (N,)."""
        return np.asarray(self.find_least(q) < 0.0)

    def add_ground(self, surroundings: Surroundings) -> Surroundings:
        """Return surroundings with the ground as a wall, where nothing around the robot is stated.

        The feet that stand are not checked against it, as no motion changes their distance. Without any shape of a link
        that moves there is nothing to check.
        """
        stated = surroundings.has_obstacles or surroundings.tool_range is not None
        if stated or not surroundings.assume_floor:
            return surroundings
        geometry = collision_geometry(self.robot, mesh_folders=_list_folders(surroundings))
        names = self.robot.tree.joint_names
        if not any(body.joint != BASE and names[body.joint] not in self.held_names for body in geometry.bodies):
            return surroundings
        point, normal = self.ground.centre.tolist(), self.ground.axes[:, 2].tolist()
        return replace(surroundings, walls=(Wall("ground", tuple(point), tuple(normal)),))

    @property
    def note(self) -> str:
        """What the balance was computed from, in words for the user."""
        gravity = ",".join(f"{value + 0.0:.4g}" for value in self.robot.gravity.round(4))
        return (
            f"The robot stands on {join_names(self.standing.feet)}. {self._describe_legs()} The forces of the ground "
            "follow from the masses in the robot's description. The torque of the legs that stand is that of forces of "
            "least norm at the feet, without friction in the joints. The robot balances at every lower speed as well. "
            f"Gravity in the frame of the base{'' if self.sway is None else ' at home'} is {gravity} m/s²."
        )

    def _describe_legs(self) -> str:
        names = join_joint_names(self.held_names, self.robot.joint_names[self.robot.n_base :])
        if self.sway is None:
            return f"The base does not move, nor do the joints between it and these feet: {names}."
        way, turn = self.standing.sway
        return (
            f"The base moves by up to {way:g} m and turns by up to {turn:g} rad along and about each axis; the joints "
            f"between it and these feet follow, so that the feet stay where they are: {names}."
        )


def stand_on_feet(robot: Robot, request: DesignRequest) -> tuple[Robot, DesignRequest, StandingBalance | None]:
    """Hold a robot by the legs that a request lets stand.

    Parameters
    ----------
    robot : Robot
        The robot, with any base.
    request : DesignRequest
        The design request.

    Returns
    -------
    tuple of Robot, DesignRequest, StandingBalance or None
        The robot on a fixed base, with gravity against the normal of the ground; a request in which no joint of the
        legs moves by itself, and the ground is a wall; and the balance, of which `sway` has the robot that moves if its
        trunk sways. Both as they are, and no balance, where no foot stands.

    Raises
    ------
    DynidentError
        As `build_standing_balance`, and where a joint shall move that is held.
    """
    if not request.standing.feet:
        if any(request.standing.sway):
            raise DynidentError(
                "A trunk sways over feet that stand, and none is named: name them, or leave the sway out.",
                pointer="/standing/sway",
            )
        return robot, request, None
    robot = robot if robot.base == "fixed" else set_base(robot, "fixed")
    # A trunk that sways has limits like a joint, and is none of the joints that stand.
    trunk = BASE_JOINTS["floating"] if request.standing.sways else ()
    limits = {name: limit for name, limit in request.limits.items() if name not in trunk}
    bounds = build_bounds(robot, limits, torque_margin=request.torque_margin)
    if request.home is not None:
        check_home(request.home, bounds)
    home = list_usual_homes(bounds)[0] if request.home is None else np.asarray(request.home, dtype=np.float64)
    balance = build_standing_balance(robot, request.standing, home, bounds.torque, request.surroundings)
    moving = select_moving_joints(request.trajectory.joints, robot.joint_names)
    blocked = [name for name in request.trajectory.joints if name in balance.held_names]
    if blocked:
        raise DynidentError(
            f"{join_names(blocked)} cannot move: between the base and a foot that stands, joints are held, or follow "
            "the trunk; move other joints, or let the foot not stand",
            pointer="/trajectory/joints",
        )
    names = tuple(np.array(robot.joint_names)[moving & ~balance.held].tolist())
    # The legs are held at home, so that a design cannot choose another one.
    stated = replace(
        request,
        home=tuple(home.tolist()),
        trajectory=replace(request.trajectory, joints=names),
        surroundings=balance.add_ground(request.surroundings),
    )
    held_robot = balance.robot
    if request.standing.sways:
        balance = release_legs(balance, bounds)
    return held_robot, stated, balance


def release_legs(balance: StandingBalance, bounds: Bounds) -> StandingBalance:
    """Return the balance of a robot whose trunk sways.

    Parameters
    ----------
    balance : StandingBalance
        The balance while its legs are held.
    bounds : Bounds
        Limits of its joints.
    """
    robot = replace(set_base(balance.robot, "floating"), gravity=balance.robot.gravity)
    base = np.zeros(robot.n_base)
    return replace(
        balance,
        robot=robot,
        # The root link is one of the links of a floating base.
        root=np.zeros_like(balance.root),
        ground=replace(balance.ground, links=tuple(robot.n_base + link for link in balance.ground.links)),
        home=np.concatenate([base, balance.home]),
        held=np.concatenate([base.astype(bool), balance.held]),
        sway=build_sway(robot, balance.standing, balance.home, balance.held, bounds),
    )


def build_standing_balance(
    robot: Robot, standing: Standing, home: FloatArray, torque_limits: FloatArray, surroundings: Surroundings
) -> StandingBalance:
    """Set up the balance of a robot that stands in a posture.

    Parameters
    ----------
    robot : Robot
        The robot on a fixed base, with the inertias of its description.
    standing : Standing
        Feet, friction and margin.
    home : (n,)
        Posture in which it stands, rad or m.
    torque_limits : (n,)
        Torque limits of its joints, N m or N.
    surroundings : Surroundings
        Where the meshes of its soles are looked for.

    Returns
    -------
    StandingBalance

    Raises
    ------
    DynidentError
        For feet that are no links, or whose points are not known.
    ImpossibleLimitsError
        Where the robot does not stand or balance in this posture.
    """
    root = set_base(robot, "floating")
    if robot.inertias is None or root.inertias is None:
        raise DynidentError(
            "The robot's description has no inertias, so the forces on its feet are not known.",
            pointer="/standing",
            title=NOT_STANDING,
        )
    ground = fit_ground(robot, standing, home, _list_folders(surroundings))
    held = _find_held_joints(robot, ground.links)
    if held.all() and not standing.sways:
        raise ImpossibleLimitsError(
            "Every joint belongs to a leg that stands, so none is left to move; name the feet of fewer legs, or let "
            "the trunk sway.",
            pointer="/standing/feet",
            title=NOT_STANDING,
        )
    balance = StandingBalance(
        replace(robot, gravity=-float(np.linalg.norm(robot.gravity)) * ground.axes[:, 2]),
        root.inertias[root.n_base - 1],
        ground,
        standing,
        home,
        held,
        torque_limits[held],
    )
    complaint = balance.find_complaint(home[None])
    if complaint is not None:
        raise ImpossibleLimitsError(
            f"The robot does not balance at home: {complaint} Choose another home posture, or other feet.",
            pointer="/home",
            title=NOT_STANDING,
        )
    return balance


def _list_folders(surroundings: Surroundings) -> list[Path]:
    return [Path(folder) for folder in surroundings.mesh_folders]


def _find_held_joints(robot: Robot, links: Sequence[int]) -> BoolArray:
    """Return which joints (n,) are held: all between the base and a foot that stands."""
    names = robot.tree.joint_names
    held = {names[joint] for link in links for joint in robot.tree.list_ancestors(link)}
    followers = sorted(held - set(robot.joint_names))
    if followers:
        raise DynidentError(
            f"A leg that stands has joints that follow others ({join_names(followers)}), which is not supported.",
            pointer="/standing/feet",
            title=NOT_STANDING,
        )
    return np.array([name in held for name in robot.joint_names])
