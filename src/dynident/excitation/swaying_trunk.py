"""Sway of the trunk over feet that stand: motion of the legs, rows of the criterion, and the model of such a design.

The base floats. Its six coordinates and the joints that are in no leg that stands are driven. The joints of these legs
are passive, as in closed loops from the ground through each of them: so the feet stay where they are, and position,
velocity and acceleration of the legs follow. With G the velocities of all joints per velocity of the driven ones,
rows Gᵀ W contain no force on a foot. An identification with contacts projects by P, and P = G (GᵀG)⁻¹ Gᵀ: rows L⁻¹ Gᵀ W
with GᵀG = L Lᵀ have the same products, WᵀP W.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import EffectChoice
from dynident.effects.dependent_joint_dynamics import OpenMotion
from dynident.effects.hysteresis_states import PathMemory
from dynident.errors import DynidentError
from dynident.excitation.design_observation_matrix import (
    DesignModel,
    ObservationGradient,
    build_design_model,
)
from dynident.excitation.expected_torque import JUMP_TIME
from dynident.expressions import Program
from dynident.motion.collision.obstacle_geometry import NOT_STANDING
from dynident.motion.collision.surroundings import Standing
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError
from dynident.regressors.observation_matrix import FurtherSignals, Observation
from dynident.robot.contacts import find_contact_link, parse_contact
from dynident.robot.cut_joint import EQUATIONS, FrameOnJoint, Loop
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.json_fields import join_names
from dynident.robot.limits_and_drives import Limits
from dynident.robot.linkage import build_driven_robot
from dynident.robot.loop_closure import Closure
from dynident.robot.loop_equations import CLOSED, FAR_FROM_SINGULAR
from dynident.robot.loop_numerics import compute_condition
from dynident.robot.robot_model import Linkage, Robot

_BASE = 6
"""Coordinates of the trunk."""
_ROUNDS, _CLOSED, _LONGEST = 25, 1e-14, 0.3
"""Most steps of Newton's method, the gap (m, rad) at which it ends, and its longest step (rad, m)."""
_KEPT = 8
"""Motions whose legs are kept: limits, balance and criterion ask for those of the same motion one after the other."""
_STATES_PER_COLUMN = 2


@dataclass(frozen=True, eq=False)
class StandingLegs(Closure):
    """Loops from the ground through legs that stand, which are solved by Newton's method from home.

    The trunk stays near home, so that no other posture of a leg is near. Where a foot is out of reach the loop remains
    open, and the limits of closed loops forbid the posture.
    """

    def solve_passive(self, q: FloatArray) -> FloatArray:
        """Return the positions of the legs (m, p) at driven positions (m, n)."""
        return self._solve_again(np.ascontiguousarray(q, dtype=np.float64).tobytes())

    @cached_property
    def _solve_again(self) -> Callable[[bytes], FloatArray]:
        return lru_cache(_KEPT)(lambda content: self._solve(np.frombuffer(content).reshape(-1, self.n)))

    def _solve(self, q: FloatArray) -> FloatArray:
        x = np.tile(self.start[self.n :], (len(q), 1))
        for _ in range(_ROUNDS):
            gap, slopes = self.evaluate(q, x)
            is_open = np.abs(gap).max(axis=1) > _CLOSED
            if not is_open.any():
                break
            # A stretched leg has slopes without an inverse.
            move = np.linalg.pinv(slopes[is_open]) @ -gap[is_open, :, None]
            x[is_open] += move[:, :, 0] * np.minimum(1.0, _LONGEST / np.abs(move).max(axis=1).clip(_CLOSED))
        return x


@dataclass(frozen=True, eq=False)
class SwayedMotion:
    """Motion of all N joints, the base's coordinates first, at m samples of a motion of the driven ones.

    Parameters
    ----------
    q, dq, ddq : (m, N)
        Positions, velocities and accelerations: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
    mixing : (m, 6, 6 + p)
        How the equations of the base and of the p joints of the legs become six without forces on the feet.
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    mixing: FloatArray
    _sway: Sway
    _state: FloatArray

    def eliminate_forces(self, w: FloatArray) -> FloatArray:
        """Return the rows (m, n, c) of the driven joints from those of all joints (m, N, c)."""
        coupled, free = self._sway.trunk_and_legs, self._sway.free
        return np.concatenate([self.mixing @ w[:, coupled], w[:, free]], axis=1)

    def pull_back_rows(self, w: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ∂/∂W (m, N, c) and ∂/∂mixing from W and ∂/∂rows (m, n, c)."""
        coupled, free, of_w = self._sway.trunk_and_legs, self._sway.free, np.zeros_like(w)
        of_w[:, coupled] = np.swapaxes(self.mixing, 1, 2) @ gradient[:, :_BASE]
        of_w[:, free] = gradient[:, _BASE:]
        return of_w, gradient[:, :_BASE] @ np.swapaxes(w[:, coupled], 1, 2)

    def pull_back(self, gradients: Sequence[FloatArray], of_mixing: FloatArray | None = None) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈ (m, n) of the driven joints from those of all joints (m, N)."""
        of_mixing = np.zeros_like(self.mixing) if of_mixing is None else of_mixing
        # CasADi stores matrices by columns.
        seeds = np.concatenate([*gradients, np.swapaxes(of_mixing, 1, 2).reshape(len(of_mixing), -1)], axis=1)
        return list(np.split(self._sway.programs[1](self._state, seeds), 3, axis=1))


@dataclass(frozen=True, eq=False)
class Sway:
    """A robot whose trunk sways over feet that stand.

    Parameters
    ----------
    robot : Robot
        The driven joints, those of the base first, with a linkage whose tree has all joints.
    home : (n,)
        Posture of the driven joints, rad or m.
    moves : (n,) of bool
        Which of them may move: not the coordinates of the trunk that have no range.
    """

    robot: Robot
    home: FloatArray
    moves: BoolArray

    @cached_property
    def linkage(self) -> Linkage:
        """How the legs follow the driven joints."""
        assert self.robot.linkage is not None
        return self.robot.linkage

    @cached_property
    def trunk_and_legs(self) -> list[int]:
        """Indices in the tree of the base's coordinates, then of the legs' joints."""
        return [*range(_BASE), *self.linkage.passive]

    @cached_property
    def free(self) -> list[int]:
        """Indices in the tree of the driven joints behind the base."""
        return list(self.linkage.driven[_BASE:])

    @cached_property
    def programs(self) -> tuple[Program, Program]:
        """Motion of all joints and mixing as a function of (q, x, q̇, q̈), and their transposed derivative."""
        closure = self.linkage.closure
        assert closure is not None
        (q, x), n = closure.symbols, closure.n
        dq, ddq = ca.SX.sym("dq", n), ca.SX.sym("ddq", n)
        motion = OpenMotion(self.linkage, (q, dq, ddq))
        rates = closure.rates(q, x)
        mixing = _orthonormalise(ca.horzcat(ca.SX.eye(_BASE), rates[:, :_BASE].T))
        output = ca.densify(ca.vertcat(motion.q, motion.dq, motion.ddq, ca.vec(ca.densify(mixing))))
        state, seeds = ca.vertcat(q, x, dq, ddq), ca.SX.sym("seeds", output.numel())
        swept = ca.jtimes(output, state, seeds, True)
        # The positions of the legs follow from the driven ones: their share of the gradient goes back to these.
        of_q = swept[:n] + ca.mtimes(rates.T, swept[n : n + closure.p])
        return Program([state], output), Program([state, seeds], ca.densify(ca.vertcat(of_q, swept[n + closure.p :])))

    def expand(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> SwayedMotion:
        """Return the motion of all joints at a motion q, q̇, q̈ (m, n) of the driven ones."""
        closure, count = self.linkage.closure, self.linkage.tree.n
        assert closure is not None
        state = np.concatenate([q, closure.solve_passive(q), dq, ddq], axis=1)
        output = self.programs[0](state)
        mixing = output[:, 3 * count :].reshape(len(q), -1, _BASE).swapaxes(1, 2)
        whole = np.split(output[:, : 3 * count], 3, axis=1)
        return SwayedMotion(whole[0], whole[1], whole[2], mixing, self, state)

    def list_joint_motion(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, ...]:
        """Return q, q̇, q̈ of the robot's joints, without the base, at a motion (m, n) of the driven ones."""
        motion = self.expand(q, dq, ddq)
        return motion.q[:, _BASE:], motion.dq[:, _BASE:], motion.ddq[:, _BASE:]


def _orthonormalise(rows: ca.SX) -> ca.SX:
    """Return L⁻¹ A with A Aᵀ = L Lᵀ for rows A SX (k, m)."""
    upper, done = ca.chol(ca.mtimes(rows, rows.T)), list[ca.SX]()
    for k in range(rows.shape[0]):
        rest = sum((upper[i, k] * done[i] for i in range(k)), ca.SX(1, rows.shape[1]))
        done.append((rows[k, :] - rest) / upper[k, k])
    return ca.vertcat(*done)


def build_sway(robot: Robot, standing: Standing, home: FloatArray, held: BoolArray, bounds: Bounds) -> Sway:
    """Return the robot whose legs follow its trunk.

    Parameters
    ----------
    robot : Robot
        The robot with a floating base, which is the world's frame at home.
    standing : Standing
        The feet, and how far the trunk may move and turn.
    home : (n,)
        Posture of the robot's joints in which it stands, rad or m.
    held : (n,) of bool
        Joints of the legs that stand.
    bounds : Bounds
        Limits of the robot's joints, from which those that the description lacks are taken.

    Raises
    ------
    DynidentError
        For a leg that cannot keep its foot where it is while the trunk moves.
    ImpossibleLimitsError
        For legs that are stretched at home.
    """
    if robot.linkage is not None:
        raise DynidentError(
            "The trunk of a robot with joints that follow others cannot sway; leave sway out.",
            pointer="/standing/sway",
            title=NOT_STANDING,
        )
    whole_home = np.concatenate([np.zeros(_BASE), home])
    loops = [_close_leg(robot, text, whole_home, f"/standing/feet/{index}") for index, text in enumerate(standing.feet)]
    _refuse_repeated_feet(standing)
    joints = list(robot.joints)
    reach = np.repeat(standing.sway, 3)
    # A coordinate without a range is locked as a joint is, so that its limits do not matter.
    largest = np.where(reach > 0.0, reach, 1.0)
    for k in range(_BASE):
        joints[k] = replace(joints[k], limits=Limits(position=(-float(largest[k]), float(largest[k]))))
    legs = [_BASE + int(k) for k in np.flatnonzero(held)]
    for j in legs:
        fastest, hardest = float(bounds.velocity[j - _BASE]), float(bounds.acceleration[j - _BASE])
        joints[j] = replace(joints[j], limits=replace(joints[j].limits, velocity=fastest, acceleration=hardest))
    tree = replace(robot, joints=tuple(joints))
    driven = [j for j in range(tree.n) if j not in legs]
    ratios = np.eye(tree.n)[:, [*driven, *legs]]
    low = np.concatenate([-reach, bounds.position_low[~held]])
    high = np.concatenate([reach, bounds.position_high[~held]])
    names = tuple(tree.joint_names[j] for j in (*driven, *legs))
    start = whole_home[[*driven, *legs]]
    closure = StandingLegs(tree.joints, tuple(loops), ratios, np.zeros(tree.n), start, low, high, names)
    slopes = closure.evaluate(start[None, : closure.n], start[None, closure.n :])[1]
    if compute_condition(slopes)[0] > FAR_FROM_SINGULAR:
        raise ImpossibleLimitsError(
            "At home, a leg that stands is stretched or nearly so, so that the trunk cannot sway in all directions; "
            "bend its knee in the home posture.",
            pointer="/home",
            title=NOT_STANDING,
        )
    linkage = Linkage(tree, tuple(driven), ratios, np.zeros(tree.n), {}, closure)
    return Sway(build_driven_robot(linkage), start[: closure.n], np.concatenate([reach > 0.0, ~held[~held]]))


def _refuse_repeated_feet(standing: Standing) -> None:
    """Refuse two points of one foot: its leg has as many joints as one of them fixes directions."""
    links = [parse_contact(text, "/standing/feet").link for text in standing.feet]
    for index, link in enumerate(links):
        if link in links[:index]:
            raise DynidentError(
                f"For the trunk to sway, a leg keeps one point or one sole in place, and {link} is named twice; name "
                "it once.",
                pointer=f"/standing/feet/{index}",
                title=NOT_STANDING,
            )


def _close_leg(robot: Robot, text: str, home: FloatArray, pointer: str) -> Loop:
    """Return the loop from the ground through the leg of a foot."""
    contact = parse_contact(text, pointer)
    joint = find_contact_link(robot, contact, pointer)
    count = EQUATIONS["full" if contact.point is None else "point"]
    own = [j for j in robot.list_ancestors(joint) if j >= _BASE]
    if len(own) != count:
        raise DynidentError(
            f"The leg of {contact.link} has {len(own)} joints ({join_names(robot.joint_names[j] for j in own)}). For "
            f"the trunk to sway while {'the sole' if count == 6 else 'a point of the foot'} stays where it is, it "
            f"needs {count}; leave sway out, or state the foot as {'a point' if count == 6 else 'a link'}.",
            pointer=pointer,
            title=NOT_STANDING,
        )
    place = np.eye(4)
    place[:3, 3] = contact.point or (0.0, 0.0, 0.0)
    at_home = joint_frames(robot, home[None])[0, joint] @ place
    ends = (FrameOnJoint(-1, at_home), FrameOnJoint(joint, place))
    return Loop(contact.link, "full" if contact.point is None else "point", ends, pointer)


@dataclass(frozen=True, eq=False)
class SwayingModel(DesignModel):
    """Model of a design in which the trunk sways: its rows are those of the driven joints, without forces on the feet.

    Parameters
    ----------
    sway : Sway
        The robot; `robot` has its driven joints, and all symbols and columns are those of the tree.
    ranges : (2, n)
        Between which positions of the driven joints their base parameters are found, rad or m.
    """

    sway: Sway | None = None
    ranges: FloatArray | None = None

    @property
    def whole(self) -> DesignModel:
        """The model of all joints, with the same columns and base parameters."""
        own = {field.name: getattr(self, field.name) for field in fields(DesignModel)}
        tree = self.robot.tree
        return DesignModel(**{**own, "robot": tree, "counted": np.full(tree.n, True)})

    @cached_property
    def observation(self) -> Observation:
        """W of all joints for the base parameters of the chosen effects."""
        return self.whole.observation

    @property
    def present_entries(self) -> BoolArray:
        """Entries (n, b) of the rows that are not zero in every motion."""
        assert self.sway is not None
        whole = self.whole.present_entries
        of_base = np.broadcast_to(whole[self.sway.trunk_and_legs].any(axis=0), (_BASE, whole.shape[1]))
        return np.concatenate([of_base, whole[self.sway.free]])

    def compute_memory(self, q: FloatArray, *, periodic: bool = False) -> FloatArray:
        """Return hysteresis states along a path q (m, n) of the driven joints."""
        assert self.sway is not None
        path = self.sway.linkage.compute_positions(q)
        return PathMemory(self.observation.memory).compute_states(path, periodic=periodic)

    def observe(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        *,
        dddq: FloatArray | None = None,
        ddddq: FloatArray | None = None,
        memory: FloatArray | None = None,
        runs: FloatArray | None = None,
    ) -> FloatArray:
        """Return the rows (m n, b) at m samples of the driven joints, dense; no column needs a higher derivative."""
        assert self.sway is not None
        motion = self.sway.expand(q, dq, ddq)
        w = self._evaluate(self.observation, motion, memory, runs)
        rows = motion.eliminate_forces(w)
        rows[:, ~self.counted] = 0.0
        return rows.reshape(-1, rows.shape[2])

    def _evaluate(
        self, observation: Observation, motion: SwayedMotion, memory: FloatArray | None, runs: FloatArray | None
    ) -> FloatArray:
        count = len(motion.q)
        entries = observation.evaluate(
            motion.q,
            motion.dq,
            motion.ddq,
            reference=self.reference,
            memory=np.zeros((count, observation.n_memory)) if memory is None else memory,
            further=FurtherSignals(runs=np.ones(len(observation.runs)) if runs is None else runs, period=JUMP_TIME),
        )
        w = np.zeros((count, observation.n_rows, observation.n_columns))
        w[:, observation.entry_rows, observation.entry_columns] = entries
        return w

    def sample_observation(self, posture: FloatArray, moving: BoolArray) -> FloatArray:
        """Return the rows (m, n, c) of all columns at random states that keep the feet where they are."""
        assert self.sway is not None
        assert self.ranges is not None
        # A fixed seed: the same robot has the same base parameters in every run.
        rng = np.random.default_rng(0)
        low, high = self.ranges
        count = _STATES_PER_COLUMN * len(self.columns) + 20
        q = np.where(moving, rng.uniform(low, high, (count, self.robot.n)), posture)
        rates = moving * self.sway.moves * rng.uniform(-1, 1, (2, count, self.robot.n))
        dq, ddq = 2.0 * rates[0], 5.0 * rates[1]
        # Some states at rest: what depends on position alone must not hide behind large accelerations.
        dq[::4] *= 0.05
        ddq[::4] = 0.0
        motion = self.sway.expand(q, dq, ddq)
        closure = self.sway.linkage.closure
        assert closure is not None
        reached = closure.compute_gaps_and_conditions(q)[0] < CLOSED
        observation = Observation.from_columns(self.robot.tree, self.columns, self.signals)
        memory = rng.uniform(-1, 1, (count, observation.n_memory))
        return motion.eliminate_forces(self._evaluate(observation, motion, memory, None))[reached]

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque (m, n) of the driven joints; zero for the base, which no motor moves."""
        assert self.sway is not None
        motion = self.sway.expand(q, dq, ddq)
        torque = np.zeros_like(q)
        torque[:, _BASE:] = self._torque_of_all(motion.q, motion.dq, motion.ddq)[:, self.sway.free]
        return torque

    @cached_property
    def _torque_of_all(self) -> Callable[[FloatArray, FloatArray, FloatArray], FloatArray]:
        return self.whole.torque


class SwayingGradient(ObservationGradient):
    """Rows of a model in which the trunk sways, at N samples of a period, and their transposed derivative."""

    def __init__(self, model: SwayingModel, n_samples: int, smooth_sign: float) -> None:
        assert model.sway is not None
        super().__init__(model.whole, n_samples, smooth_sign)
        self._sway = model.sway

    def evaluate(self, *derivatives: FloatArray) -> FloatArray:
        """Return the rows (N, n, c) at q and its derivatives (N, n) of the driven joints."""
        self._motion = self._sway.expand(*derivatives[:3])
        w = super().evaluate(self._motion.q, self._motion.dq, self._motion.ddq)
        return self._motion.eliminate_forces(w)

    def pull_back(self, gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈ (N, n) from ∂/∂rows (N, n, c), at the states of the last `evaluate`."""
        w = self._w.reshape(self.n_samples, self.n, self.n_columns)
        of_w, of_mixing = self._motion.pull_back_rows(w, gradient)
        return self._motion.pull_back(super().pull_back(of_w), of_mixing)


def build_observation_gradient(model: DesignModel, n_samples: int, smooth_sign: float) -> ObservationGradient:
    """Return the rows of a model at the samples of a period, with their transposed derivative.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    n_samples : int
        Number of samples N.
    smooth_sign : float
        Velocity (rad/s, m/s) over which sign(q̇) is rounded.
    """
    if isinstance(model, SwayingModel):
        return SwayingGradient(model, n_samples, smooth_sign)
    return ObservationGradient(model, n_samples, smooth_sign)


def build_swaying_model(sway: Sway, effects: Sequence[EffectChoice], bounds: Bounds) -> SwayingModel:
    """Set up the model of a design in which the trunk sways; its base parameters are found by `lock_model`.

    Parameters
    ----------
    sway : Sway
        The robot.
    effects : sequence of EffectChoice
        Effects to be identified.
    bounds : Bounds
        Limits of the driven joints.
    """
    whole = build_design_model(sway.linkage.tree, effects, has_jerk=False)
    own = {field.name: getattr(whole, field.name) for field in fields(DesignModel)}
    own |= {"robot": sway.robot, "counted": np.full(sway.robot.n, True)}
    ends = (bounds.position_low, bounds.position_high)
    return SwayingModel(**own, sway=sway, ranges=np.stack([np.where(sway.moves, end, sway.home) for end in ends]))
