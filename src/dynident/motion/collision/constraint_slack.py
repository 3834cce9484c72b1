"""How far a posture is from limits of passive joints, singular postures of closed loops, and contact of thick links.

Everything has derivatives. Holds what a missing metre of clearance weighs, and what is asked of the balance of a robot
on its feet.

Follower joints have limits, and closed loops a distance to singular postures. Like the clearances of bodies, their
slack is a function of the driven joints' posture alone, with exact derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.motion.collision.exact_distances import ContactCheck, SolidPair
from dynident.motion.collision.smooth_clearance import ClearanceSlack, PointMap, normalise
from dynident.motion.collision.surroundings import Standing
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.limits_and_drives import Limits
from dynident.robot.loop_equations import FAR_FROM_SINGULAR
from dynident.robot.robot_model import Linkage, Robot


class Slack(Protocol):
    """Slack at m postures: `values` (m, K), negative where a constraint is violated."""

    @property
    def values(self) -> FloatArray:
        """Slack (m, K)."""
        ...

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂values (m, K)."""
        ...


class Constraints(Protocol):
    """Slack of constraints as a function of the posture."""

    @property
    def count(self) -> int:
        """Number of constraints K."""
        ...

    def evaluate(self, q: FloatArray) -> Slack:
        """Return the slack at postures q (m, n)."""
        ...

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest slack (m,) at postures q (m, n)."""
        ...


METRES_OF_A_SHARE = 0.5
"""Missing clearance, m, that weighs as much as a limit that is exceeded twofold."""


@dataclass(frozen=True, eq=False)
class BalanceExtremes:
    """How near a motion comes to what ends the balance of a robot on its feet.

    Parameters
    ----------
    distance : float
        Smallest distance of the centre of pressure from the edge of the support, m; negative outside, -∞ where the
        ground would have to pull.
    friction : float
        Largest coefficient of friction that is needed.
    torque : (k,)
        Largest torques of the joints that are held, N m or N.
    """

    distance: float
    friction: float
    torque: FloatArray


class MotionSlack(Slack, Protocol):
    """Slack at samples of a motion."""

    def pull_back_motion(self, gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈ (m, n) from ∂/∂values (m, K)."""
        ...


class Balance(Constraints, Protocol):
    """Balance of a robot on its feet: as a constraint of the posture it holds at rest."""

    @property
    def standing(self) -> Standing:
        """Feet, friction and margin."""
        ...

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the k joints that are held."""
        ...

    @property
    def torque_limits(self) -> FloatArray:
        """Their torque limits (k,), N m or N; infinite where there is none."""
        ...

    @property
    def note(self) -> str:
        """What the balance was computed from, in words for the user."""
        ...

    def hold(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position limits (n,) in which these joints have no range."""
        ...

    def evaluate_motion(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> MotionSlack:
        """Return the slack of a motion q, q̇, q̈ (m, n)."""
        ...

    def is_kept(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> bool:
        """Return whether the robot balances in a motion q, q̇, q̈ (m, n)."""
        ...

    def measure(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> BalanceExtremes:
        """Return how near a motion q, q̇, q̈ (m, n) comes to the limits."""
        ...

    def find_complaint(self, q: FloatArray) -> str | None:
        """Return what does not balance at rest along a path q (m, n), as the end of a sentence."""
        ...

    def find_broken(self, q: FloatArray) -> BoolArray:
        """Return in which of postures q (m, n) the robot does not balance at rest: (m,)."""
        ...


def word_fall(distance: float, margin: float) -> str:
    """Say that the centre of pressure comes too near the edge of the support.

    Parameters
    ----------
    distance : float
        Its smallest distance from the edge, m; negative outside, -∞ where the ground would have to pull.
    margin : float
        Distance that has to be kept, m.
    """
    if distance == -np.inf:
        return "the robot would leave the ground."
    where = f"{distance:.3g} m inside" if distance >= 0 else f"{-distance:.3g} m outside of"
    return f"the centre of pressure would be {where} the support of the feet; it must be at least {margin:g} m inside."


def word_slip(friction: float, stated: float) -> str:
    """Say that feet slip.

    Parameters
    ----------
    friction : float
        Coefficient of friction that they need.
    stated : float
        Coefficient of friction that they have.
    """
    return f"the feet would slip: they need a coefficient of friction of {friction:.3g}, and {stated:g} is stated."


@dataclass(frozen=True, eq=False)
class _JoinedSlack:
    parts: tuple[Slack, ...]

    @property
    def values(self) -> FloatArray:
        """Slack (m, K) of all parts."""
        return np.concatenate([part.values for part in self.parts], axis=1)

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂values (m, K)."""
        # The gradient is that of all slacks side by side, so it is cut where one kind ends and the next begins.
        ends = np.cumsum([part.values.shape[1] for part in self.parts])[:-1]
        pieces = np.split(gradient, ends, axis=1)
        return np.asarray(sum(part.pull_back(piece) for part, piece in zip(self.parts, pieces, strict=True)))


@dataclass(frozen=True, eq=False)
class JoinedConstraints:
    """Several kinds of constraints.

    Parameters
    ----------
    parts : tuple of Constraints
        The kinds, whose slacks stand side by side in this order.
    """

    parts: tuple[Constraints, ...]

    @property
    def count(self) -> int:
        """Number of constraints K."""
        return sum(part.count for part in self.parts)

    def evaluate(self, q: FloatArray) -> Slack:
        """Return the slack at postures q (m, n)."""
        return _JoinedSlack(tuple(part.evaluate(q) for part in self.parts))

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest slack (m,) at postures q (m, n)."""
        return np.asarray(np.min([part.find_least(q) for part in self.parts], axis=0))


@dataclass(frozen=True, eq=False)
class ExactClearances:
    """Exact distances of pairs of solids that capsules are too thick for, such as the hips of a humanoid.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    pairs : tuple of SolidPair
        The pairs.
    clearance : (K,)
        Distance to keep, m.
    """

    robot: Robot
    pairs: tuple[SolidPair, ...]
    clearance: FloatArray

    @property
    def count(self) -> int:
        """Number of distances K."""
        return len(self.pairs)

    def evaluate(self, q: FloatArray) -> ClearanceSlack:
        """Return the distances beyond the clearance at postures q (m, n)."""
        frames, tree = joint_frames(self.robot, q), self.robot.tree
        # Of its own: searches run in several threads, and a check belongs to one.
        check = ContactCheck(self.robot, self.pairs)
        closest = [check.find_closest_points(pair, frames) for pair in self.pairs]
        distance = np.stack([each for each, _ in closest], axis=1)
        here, there = np.moveaxis(np.stack([points for _, points in closest], axis=1), (2, 3), (0, 1))
        # Where solids overlap, the distance is negative and its points lie the other way round.
        away = normalise(here - there)[1] * np.where(distance < 0, -1.0, 1.0)
        numbers = [*range(self.count), *range(self.count)]
        joints = [pair.moving.joint for pair in self.pairs] + [pair.other.joint for pair in self.pairs]
        return ClearanceSlack(
            distance - self.clearance,
            np.concatenate([away, -away], axis=2),
            np.concatenate([here, there], axis=2),
            frames,
            PointMap(numbers, joints, tree.n),
            tree,
            None if self.robot.linkage is None else self.robot.linkage.compute_jacobian(q),
        )

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest distance beyond the clearance (m,) at postures q (m, n)."""
        check = ContactCheck(self.robot, self.pairs)
        distances = [check.compute_distances(pair, q) for pair in self.pairs]
        return np.asarray((np.stack(distances, axis=1) - self.clearance).min(axis=1))


_SPARE = 0.005
"""Share of a range, at either end, that is kept free while optimising, as the motion goes on between the samples."""
_SPARE_CONDITION = 0.95
_PER_LOG = 0.5
"""Room in m or rad per unit of ln(condition): twice the largest condition is as bad as 0.35 rad too far."""
_OPEN = -2.0
"""Room where the loops are open: far beyond every limit."""


@dataclass(frozen=True, eq=False)
class LoopSlack:
    """At m postures: `values` (m, K) in rad or m, negative where a limit is broken, and their slopes (m, K, n)."""

    values: FloatArray
    slopes: FloatArray

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂values (m, K)."""
        return np.asarray(np.einsum("mk,mkn->mn", gradient, self.slopes))


@dataclass(frozen=True, eq=False)
class FollowerRates:
    """Limits of velocity and acceleration of joints that follow others.

    Parameters
    ----------
    linkage : Linkage
        How follower joints depend on the driven ones.
    joints : tuple of int
        Indices of the limited joints in the tree.
    names : tuple of str
        Names of these r joints.
    velocity : (r,)
        Velocity limits, rad/s or m/s; infinite where there is none.
    acceleration : (r,)
        Acceleration limits, rad/s² or m/s²; infinite where there is none.
    """

    linkage: Linkage
    joints: tuple[int, ...]
    names: tuple[str, ...]
    velocity: FloatArray
    acceleration: FloatArray

    @classmethod
    def from_robot(cls, robot: Robot, stated: Mapping[str, Limits]) -> FollowerRates | None:
        """Return those of a robot, tightened by the stated limits; None where there are none.

        Parameters
        ----------
        robot : Robot
            The robot, as its description gives it.
        stated : mapping of str to Limits
            Limits that the request states, by joint name.
        """
        if robot.linkage is None:
            return None
        rates: dict[int, tuple[float, float]] = {}
        for place in robot.linkage.passive:
            joint = robot.tree.joints[place]
            both = (joint.limits, stated.get(joint.name, Limits()))
            velocity = min((limits.velocity for limits in both if limits.velocity is not None), default=np.inf)
            acceleration = min(
                (limits.acceleration for limits in both if limits.acceleration is not None), default=np.inf
            )
            if np.isfinite([velocity, acceleration]).any():
                rates[place] = velocity, acceleration
        if not rates:
            return None
        velocities, accelerations = np.array(list(rates.values())).T
        names = tuple(robot.tree.joint_names[place] for place in rates)
        return cls(robot.linkage, tuple(rates), names, velocities, accelerations)

    def find_largest(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the largest velocities and accelerations (r,) in a motion q, q̇, q̈ (m, n) of the driven joints.

        Parameters
        ----------
        q, dq, ddq : (m, n)
            Motion of the driven joints: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
        """
        _, speed, acceleration = self.linkage.compute_motion(q, dq, ddq)
        own = list(self.joints)
        return np.abs(speed[:, own]).max(axis=0), np.abs(acceleration[:, own]).max(axis=0)

    def are_kept(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> bool:
        """Return whether a motion of the driven joints keeps all of them.

        Parameters
        ----------
        q, dq, ddq : (m, n)
            Motion of the driven joints: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
        """
        velocity, acceleration = self.find_largest(q, dq, ddq)
        return bool((velocity <= self.velocity).all() and (acceleration <= self.acceleration).all())


@dataclass(frozen=True, eq=False)
class LoopConstraints:
    """Limits of the joints of a machine that are not driven.

    Parameters
    ----------
    linkage : Linkage
        How follower joints depend on the driven ones.
    joints : (k,)
        Indices of the joints in the tree.
    names : tuple of str
        Names of these joints.
    low, high : (k,)
        Position limits, rad or m.
    largest_condition : float
        Limit of the condition of closed loops, where there are any.
    rated : FollowerRates, optional
        Limits of rates.
    """

    linkage: Linkage
    joints: tuple[int, ...]
    names: tuple[str, ...]
    low: FloatArray
    high: FloatArray
    largest_condition: float = FAR_FROM_SINGULAR
    rated: FollowerRates | None = None

    @classmethod
    def from_robot(cls, robot: Robot, stated: Mapping[str, Limits]) -> LoopConstraints | None:
        """Return those of a robot, tightened by the stated limits; None where only its driven joints are limited.

        Parameters
        ----------
        robot : Robot
            The robot, as its description gives it.
        stated : mapping of str to Limits
            Limits that the request states, by joint name.
        """
        if robot.linkage is None:
            return None
        # Of the description's and the stated limits the tighter end counts, either side for itself.
        position_ranges: dict[int, tuple[float, float]] = {}
        for place in robot.linkage.passive:
            joint = robot.tree.joints[place]
            ranges = [limits.position for limits in (joint.limits, stated.get(joint.name, Limits())) if limits.position]
            if ranges:
                position_ranges[place] = (max(low for low, _ in ranges), min(high for _, high in ranges))
        rated = FollowerRates.from_robot(robot, stated)
        # A closed loop is a constraint even where no joint in it is limited: it may come to a singular posture.
        if not position_ranges and rated is None and robot.linkage.closure is None:
            return None
        low, high = np.array(list(position_ranges.values())).reshape(-1, 2).T
        names = tuple(robot.tree.joint_names[place] for place in position_ranges)
        return cls(robot.linkage, tuple(position_ranges), names, low, high, rated=rated)

    @property
    def count(self) -> int:
        """Number of slacks K."""
        return 2 * len(self.joints) + (self.linkage.closure is not None)

    def compute_positions(self, q: FloatArray) -> FloatArray:
        """Return the positions (m, k) of the limited joints."""
        return self.linkage.compute_positions(q)[:, list(self.joints)]

    def compute_conditions(self, q: FloatArray) -> FloatArray:
        """Return the condition (m,) of the loops; infinite where they are open, 1 where there are none."""
        closure = self.linkage.closure
        return np.ones(len(q)) if closure is None else np.exp(closure.compute_log_condition(q)[0])

    def evaluate(self, q: FloatArray) -> LoopSlack:
        """Return the slacks at postures q (m, n)."""
        slopes = self.linkage.compute_jacobian(q)[:, list(self.joints)]
        at, spare = self.compute_positions(q), _SPARE * (self.high - self.low)
        values = [at - (self.low + spare), (self.high - spare) - at]
        ways = [slopes, -slopes]
        if self.linkage.closure is not None:
            near, way = self.linkage.closure.compute_log_condition(q)
            # The logarithm makes a smooth slack of a condition that grows without limit towards a singular posture.
            slack = _PER_LOG * (np.log(_SPARE_CONDITION * self.largest_condition) - near)
            is_open = ~np.isfinite(slack)
            values.append(np.where(is_open, _OPEN, slack)[:, None])
            ways.append(-_PER_LOG * way[:, None])
            # Positions of an open loop mean nothing.
            values[:2] = [np.where(is_open[:, None], 0.0, rows) for rows in values[:2]]
            ways[:2] = [np.where(is_open[:, None, None], 0.0, rows) for rows in ways[:2]]
        return LoopSlack(np.concatenate(values, axis=1), np.concatenate(ways, axis=1))

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest slack (m,) at postures q (m, n)."""
        return np.asarray(self.evaluate(q).values.min(axis=1, initial=np.inf))

    def find_complaint(self, q: FloatArray) -> str | None:
        """Return what is not kept along a path q (m, n), as the end of a sentence; None where all is."""
        condition = float(self.compute_conditions(q).max())
        if condition > self.largest_condition:
            return word_singularity(condition, self.largest_condition)
        at = self.compute_positions(q)
        for name, low, high, values in zip(self.names, self.low, self.high, at.T, strict=True):
            if values.min() < low or values.max() > high:
                reached = f"[{values.min():.4g}, {values.max():.4g}]"
                return (
                    f"joint '{name}', which follows, would be in {reached}, beyond its limits [{low:.4g}, {high:.4g}]."
                )
        return None

    def find_broken(self, q: FloatArray) -> BoolArray:
        """Return at which of postures q (m, n) a limit is broken: (m,)."""
        at = self.compute_positions(q)
        outside = ((at < self.low) | (at > self.high)).any(axis=1)
        return np.asarray(outside | (self.compute_conditions(q) > self.largest_condition))


def word_singularity(condition: float, largest: float) -> str:
    """Say that the loops come too near a posture in which the driven joints do not determine the passive ones.

    Parameters
    ----------
    condition : float
        Worst condition of the loops; infinite where they are open.
    largest : float
        Largest condition that is allowed.
    """
    if not np.isfinite(condition):
        return "the closed loops would be open: no position of the passive joints closes them there."
    return (
        f"the closed loops would come near a singular posture: condition number {condition:.3g}, above the limit "
        f"{largest:g}."
    )
