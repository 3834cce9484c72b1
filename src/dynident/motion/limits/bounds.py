"""The limits that a motion must keep: from the description and the request, assumed where unknown; locked joints.

Holds the assumed acceleration and jerk per velocity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError, Note, Remedy, describe_missing_joint
from dynident.motion.collision.constraint_slack import Balance, FollowerRates, LoopConstraints
from dynident.motion.collision.free_space import FreeSpace, build_free_space
from dynident.motion.collision.obstacle_geometry import Surroundings, check_surroundings
from dynident.number_format import format_percent
from dynident.robot import Limits, Robot
from dynident.robot.joint import WIDEST_RANGE, Joint, join_joint_names
from dynident.robot.json_fields import join_names, make_pointer
from dynident.robot.limits_and_drives import LARGEST


def select_moving_joints(selected: Sequence[str], names: Sequence[str]) -> BoolArray:
    """Return which of the joints `names` move.

    Parameters
    ----------
    selected : sequence of str
        Joints that move; all where there are none.
    names : sequence of str
        All n joints.

    Returns
    -------
    (n,) array of bool
        True for each joint that moves.

    Raises
    ------
    DynidentError
        There is no such joint.
    """
    unknown = [name for name in selected if name not in names]
    if unknown:
        raise DynidentError(
            describe_missing_joint(unknown[0], names),
            pointer="/trajectory/joints",
            title="Unknown joint",
        )
    return np.array([not selected or name in selected for name in names])


def lock_bounds(bounds: Bounds, posture: FloatArray, moving: BoolArray) -> Bounds:
    """Return bounds in which the joints that do not move have no range but their position in a posture.

    Parameters
    ----------
    bounds : Bounds
        Limits of all joints.
    posture : (n,)
        Positions of the locked joints, rad or m.
    moving : (n,)
        Which joints move.

    Returns
    -------
    Bounds
        The same limits, with no range for the locked joints.
    """
    return replace(
        bounds,
        position_low=np.where(moving, bounds.position_low, posture),
        position_high=np.where(moving, bounds.position_high, posture),
    )


class TorqueModel(Protocol):
    """A model that predicts the torque of a motion."""

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque at q, q̇, q̈ (m, n); raise `DynidentError` where it is not known."""


# Where nothing is known: slow enough for any arm of that kind.
_REVOLUTE_VELOCITY, _PRISMATIC_VELOCITY = 1.0, 0.25
_ACCELERATION_PER_VELOCITY = 4.0
"""Assumed acceleration limit over velocity limit, 1/s: full velocity is reached from rest in a quarter of a second."""
_JERK_PER_ACCELERATION = 20.0
"""Assumed jerk limit over acceleration limit, 1/s: full acceleration is reached within 50 ms."""
_FROM_DESCRIPTION = (
    "Torque is predicted from the inertias in the robot's description, without rotor inertia and friction."
)
_IDENTIFIED = Remedy("identification_id")
_LEAVE_ROOM = Note(
    f"Leave room in the torque limits for both, or give an identified model, which knows them: {_IDENTIFIED}.",
    (_IDENTIFIED,),
)
# Share by which limits are tightened for the design.
_HAIR = 1e-6


class ImpossibleLimitsError(DynidentError):
    """Raised where no motion keeps the limits; the message names the one that makes it impossible.

    Parameters
    ----------
    detail : str
        The sentence for the user.
    pointer : str
        The place: a JSON pointer into the request, or "".
    title : str
        A few words for the kind of problem.
    """


@dataclass(frozen=True, eq=False)
class Bounds:
    """Limits of all joints, infinite where there is none.

    Parameters
    ----------
    names : (n,)
        Names of the joints.
    position_low, position_high : (n,)
        Position limits, rad or m.
    velocity, acceleration, jerk, torque, power : (n,)
        Largest absolute values: rad/s, rad/s², rad/s³, N m, W (m/s, m/s², m/s³, N, W where prismatic).
    notes : tuple of str
        What was assumed, or is not checked.
    space : FreeSpace, optional
        What the whole robot must stay clear of.
    """

    names: tuple[str, ...]
    position_low: FloatArray
    position_high: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    torque: FloatArray
    power: FloatArray
    notes: tuple[str, ...]
    space: FreeSpace | None = None

    @property
    def middle(self) -> FloatArray:
        """Middle of the position ranges (n,)."""
        return 0.5 * (self.position_low + self.position_high)

    @property
    def half_range(self) -> FloatArray:
        """Half the position ranges (n,)."""
        return 0.5 * (self.position_high - self.position_low)

    def tighten(self) -> Bounds:
        """Return slightly tighter limits, so that rounding never carries a motion beyond a limit."""
        # The range shrinks about its middle, so that both ends move inwards whatever their signs.
        share = 1.0 - _HAIR
        return replace(
            self,
            position_low=self.middle - share * self.half_range,
            position_high=self.middle + share * self.half_range,
            velocity=share * self.velocity,
            acceleration=share * self.acceleration,
            jerk=share * self.jerk,
            torque=share * self.torque,
            power=share * self.power,
        )

    @property
    def has_torque_limits(self) -> bool:
        """Whether the torque or the power of any joint is limited."""
        return bool(np.isfinite(self.torque).any() or np.isfinite(self.power).any())

    @property
    def follower_rates(self) -> FollowerRates | None:
        """Limits of the rates of follower joints, if there are any."""
        return None if self.space is None or self.space.loops is None else self.space.loops.rated

    @property
    def balance(self) -> Balance | None:
        """Balance of the robot on its feet, if it stands on any."""
        return None if self.space is None else self.space.balance

    def are_rates_and_balance_kept(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> bool:
        """Return whether follower joints keep their rates in a motion q, q̇, q̈ (m, n), and the robot its balance.

        Parameters
        ----------
        q, dq, ddq : (m, n)
            Motion of the driven joints: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
        """
        if self.follower_rates is not None and not self.follower_rates.are_kept(q, dq, ddq):
            return False
        return self.balance is None or self.balance.is_kept(q, dq, ddq)


def build_bounds(
    robot: Robot,
    overrides: Mapping[str, Limits],
    *,
    torque_margin: float = 0.0,
    surroundings: Surroundings | None = None,
    torque_note: str | None = None,
    at: str = "/limits",
    balance: Balance | None = None,
) -> Bounds:
    """Return the limits of a design: the robot's, tightened by the experiment's own, completed by cautious assumptions.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    overrides : mapping of str to Limits
        Limits of this experiment by joint name.
    torque_margin : float
        By what share the torque may be larger than predicted.
    surroundings : Surroundings, optional
        What the robot must stay clear of; nothing, and not itself, where not given.
    torque_note : str, optional
        What the torque is predicted from, where that is more than the inertias of the description.
    at : str
        Pointer to the overrides in the request.
    balance : Balance, optional
        Balance of the robot, if it stands on its feet.

    Returns
    -------
    Bounds
        Limits of all joints, and notes on what was assumed.

    Raises
    ------
    DynidentError
        A limit is for an unknown joint or not a valid limit, a prismatic joint's range is unknown, or there are
        surroundings but no shape of the robot is known.
    ImpossibleLimitsError
        A stated range lies outside the robot's own.
    """
    # Where a trunk sways over feet, its coordinates are joints without a motor.
    if balance is None:
        robot.require_fixed_base("design of a motion, unless you name the feet that it stands on,")
    # Names first: the limits of a misspelt joint would otherwise be ignored.
    for name in overrides:
        if name not in robot.tree.joint_names:
            raise DynidentError(
                describe_missing_joint(name, robot.tree.joint_names),
                pointer=make_pointer(name, within=at),
                title="Unknown joint",
            )
    # Assumptions are collected over all joints, for one note a kind of limit.
    assumed = _Assumptions()
    completed = [_complete_limits(joint, overrides.get(joint.name, Limits()), assumed, at) for joint in robot.joints]
    notes = [*_note_wide_limits(robot, overrides), *assumed.list_notes(robot.joint_names, robot.n_base)]
    torque = np.array([np.inf if limit.effort is None else limit.effort for limit in completed])
    motors = list(zip(robot.joint_names, torque, strict=True))[robot.n_base :]
    unlimited = [name for name, bound in motors if not np.isfinite(bound)]
    power = np.array([np.inf if limit.power is None else limit.power for limit in completed])
    if robot.inertias is None and torque_note is None:
        # Without inertias no torque can be predicted, so its limits cannot be checked.
        torque[:] = power[:] = np.inf
        notes.append("Torque is not checked: the robot's description gives no inertias to predict it with.")
    elif unlimited:
        notes.append(f"Torque is not checked for {join_names(unlimited)}: no limit is known.")
    if np.isfinite(torque).any() or np.isfinite(power).any():
        notes.append(torque_note or _FROM_DESCRIPTION)
        if torque_margin:
            notes.append(
                f"It may be {format_percent(torque_margin, 2)} larger: limits of torque and power are divided by "
                f"{1 + torque_margin:g}."
            )
        elif torque_note is None:
            # The recordings of a robot that stands give no model of its legs, which an identified model has to have.
            notes.append(_LEAVE_ROOM if balance is None else "Leave room in the torque limits for both.")
    low, high = (np.array([_require_position(limit)[end] for limit in completed]) for end in (0, 1))
    # Legs that stand have no range, so that the ground under them is no obstacle.
    ends = (low, high) if balance is None else balance.hold(low, high)
    space = _build_space(robot, overrides, surroundings, ends, balance)
    notes += [] if space is None else space.notes
    if robot.linkage is not None:
        notes += _note_follower_limits(robot, overrides, () if balance is None else balance.held_names)
    if balance is not None:
        notes.append(balance.note)
        # The ground carries the legs that stand, and the torque of hanging ones says nothing: the balance limits it.
        stands = np.isin(robot.joint_names, balance.held_names)
        torque[stands] = power[stands] = np.inf
    return Bounds(
        names=robot.joint_names,
        position_low=low,
        position_high=high,
        velocity=np.array([limit.velocity for limit in completed], dtype=np.float64),
        acceleration=np.array([limit.acceleration for limit in completed], dtype=np.float64),
        jerk=np.array([limit.jerk for limit in completed], dtype=np.float64),
        # Torque that turns out larger than predicted by this share still keeps the true limits.
        torque=torque / (1 + torque_margin),
        power=power / (1 + torque_margin),
        notes=tuple(notes),
        space=space,
    )


def _build_space(
    robot: Robot,
    overrides: Mapping[str, Limits],
    surroundings: Surroundings | None,
    ends: tuple[FloatArray, FloatArray],
    balance: Balance | None,
) -> FreeSpace | None:
    space = None
    if surroundings is not None:
        check_surroundings(surroundings, robot.joint_names)
        space = build_free_space(robot, surroundings, *ends)
    # Followers are limited also where no surroundings are stated: then nothing else is in the free space.
    loops = LoopConstraints.from_robot(robot, overrides)
    if loops is None and balance is None:
        return space
    empty = FreeSpace(robot, None, None, None, ())
    return replace(empty if space is None else space, loops=loops, balance=balance)


def _note_follower_limits(robot: Robot, stated: Mapping[str, Limits], legs: Sequence[str]) -> list[str]:
    """Return a note on the limits of follower joints that are not kept: all but those of position and its rates.

    Of the description's own limits that is the jerk; a joint without a drive has no torque of its own. The balance
    keeps the torque of `legs` that stand.
    """
    followers = [joint for joint in robot.tree.joints if joint.name not in robot.joint_names]
    names = [
        f"{kind} of {joint.name}"
        for joint in followers
        for kind in ("jerk", "effort", "power")
        if (
            getattr(stated.get(joint.name, Limits()), kind) is not None
            and not (kind == "effort" and joint.name in legs)
        )
        or (kind == "jerk" and joint.limits.jerk is not None)
    ]
    if not names:
        return []
    return [
        "For joints that follow others, only position, velocity and acceleration are limited; not checked: "
        f"{join_names(names)}."
    ]


def _note_wide_limits(robot: Robot, stated: Mapping[str, Limits]) -> list[str]:
    """Return a note on stated limits that are ignored because the robot's own are tighter."""
    names = []
    for joint in robot.joints:
        request = stated.get(joint.name, Limits())
        for kind in ("velocity", "acceleration", "jerk", "effort", "power"):
            own, requested = getattr(joint.limits, kind), getattr(request, kind)
            if own is not None and requested is not None and requested > own:
                names.append(f"{kind} {requested:g} of {joint.name} (its own is {own:g})")
        reach, requested = joint.reach, request.position
        if reach is not None and requested is not None and (requested[0] < reach[0] or requested[1] > reach[1]):
            names.append(f"position {list(requested)} of {joint.name} (its own is [{reach[0]:g}, {reach[1]:g}])")
    if not names:
        return []
    return [f"Limits wider than the robot's own are ignored: {join_names(names)}. Change the robot's description."]


def _is_limitless(position: tuple[float, float], joint: Joint) -> bool:
    return replace(joint, limits=Limits(position)).has_limitless_range


def _require_position(limits: Limits) -> tuple[float, float]:
    assert limits.position is not None
    return limits.position


def _complete_limits(joint: Joint, stated: Limits, assumed: _Assumptions, at: str) -> Limits:
    """Return the tighter of the robot's and the stated limits of one joint, with assumptions where neither is known."""
    own = joint.limits
    position = _choose_tighter_range(joint, stated, at)
    limitless = joint.has_limitless_range if position is None else _is_limitless(position, joint)
    if position is None or limitless:
        # A turn is a natural range of a revolute joint. A sliding joint has none, and a guess could hit its end stop.
        if joint.kind == "prismatic":
            raise DynidentError(
                f"Joint '{joint.name}' slides, and its range is not known"
                f"{': its limits are wider than any machine' if limitless else ''}; state its position limits.",
                pointer=make_pointer(joint.name, "position", within=at),
                title="Missing limit",
            )
        # A range that was stated but is wider than any machine's is no range: the same assumption, another note.
        position = (-np.pi, np.pi)
        (assumed.limitless if limitless else assumed.position).append(joint.name)
    velocity = _choose_tighter(own.velocity, stated.velocity)
    if velocity is None:
        velocity = _REVOLUTE_VELOCITY if joint.kind == "revolute" else _PRISMATIC_VELOCITY
        assumed.velocity.append(joint.name)
    acceleration = _choose_tighter(own.acceleration, stated.acceleration)
    if acceleration is None:
        acceleration = min(_ACCELERATION_PER_VELOCITY * velocity, LARGEST)
        assumed.acceleration.append(joint.name)
    jerk = _choose_tighter(own.jerk, stated.jerk)
    if jerk is None:
        jerk = min(_JERK_PER_ACCELERATION * acceleration, LARGEST)
        assumed.jerk.append(joint.name)
    effort, power = _choose_tighter(own.effort, stated.effort), _choose_tighter(own.power, stated.power)
    return Limits(position, velocity, acceleration, jerk, effort, power)


@dataclass
class _Assumptions:
    """Names of joints whose limits are assumed, for the notes."""

    position: list[str] = field(default_factory=list)
    limitless: list[str] = field(default_factory=list)
    velocity: list[str] = field(default_factory=list)
    acceleration: list[str] = field(default_factory=list)
    jerk: list[str] = field(default_factory=list)

    def list_notes(self, joints: Sequence[str], n_base: int) -> list[str]:
        """Return the notes; `joints` are all of the robot's, with coordinates of its base before them."""

        def join(names: Sequence[str]) -> str:
            # "All but elbow" would count the legs of a trunk that sways, which have limits of their own.
            base = ["the base"] if set(joints[:n_base]) & set(names) else []
            driven = [name for name in names if name not in joints[:n_base]]
            return " and ".join([*base, join_joint_names(driven, joints[n_base:])] if driven else base)

        kinds = (
            (self.position, "position", "the motion stays within ±π rad"),
            (
                self.velocity,
                "velocity",
                f"{_REVOLUTE_VELOCITY:g} rad/s ({_PRISMATIC_VELOCITY:g} m/s where it slides) was assumed",
            ),
            (
                self.acceleration,
                "acceleration",
                f"{_ACCELERATION_PER_VELOCITY:g}/s x the velocity limit was assumed",
            ),
            (self.jerk, "jerk", f"{_JERK_PER_ACCELERATION:g}/s x the acceleration limit was assumed"),
        )
        notes = [
            f"No {kind} limit is known for {join(names)}: {assumption}." for names, kind, assumption in kinds if names
        ]
        if self.limitless:
            turns = WIDEST_RANGE["revolute"] / (2 * np.pi)
            notes.append(
                f"The position limits of {join_names(self.limitless)} are wider than {turns:g} turns and count as no "
                "limits: the motion stays within ±π rad."
            )
        return notes


def _choose_tighter(own: float | None, stated: float | None) -> float | None:
    known = [value for value in (own, stated) if value is not None]
    return min(known) if known else None


def _choose_tighter_range(joint: Joint, stated: Limits, at: str) -> tuple[float, float] | None:
    own = joint.reach
    if own is None or stated.position is None:
        return own if stated.position is None else stated.position
    low, high = max(own[0], stated.position[0]), min(own[1], stated.position[1])
    if low >= high:
        raise ImpossibleLimitsError(
            f"The position limits {list(stated.position)} of joint '{joint.name}' lie outside of its own {list(own)}.",
            pointer=make_pointer(joint.name, "position", within=at),
            title="Impossible limits",
        )
    return low, high


def slow_down_limits(robot: Robot, limits: Mapping[str, Limits], share: float) -> dict[str, Limits]:
    """Return limits with a share of the velocities, and of the accelerations that these reach in the same time.

    Parameters
    ----------
    robot : Robot
        The robot, with the limits of its description.
    limits : mapping of str to Limits
        Tighter limits by joint name.
    share : float
        Share of the velocities.
    """
    bounds = build_bounds(robot, limits)
    # Limits of joints that follow others stay as they are stated.
    return {**limits} | {
        name: replace(
            limits.get(name, Limits()),
            velocity=share * float(bounds.velocity[j]),
            acceleration=share * float(bounds.acceleration[j]),
        )
        for j, name in enumerate(robot.joint_names)
    }
