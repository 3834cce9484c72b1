"""M, C, g, friction and other effects of a model as CasADi expressions, for controllers and observers.

M(q) q̈ + C(q, q̇) q̇ + g(q) + friction + other effects = τ. Links are those of the base parameters: a base parameter
is the value of its own standard parameter where all standard parameters that are grouped into it are zero, so that the
recursions below skip most of the terms of ordinary links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from dynident.array_types import FloatArray
from dynident.effects import Column, RunSignal, Signals, get_effect, get_role
from dynident.effects.dependent_joint_dynamics import build_all_positions
from dynident.effects.friction import bound_friction
from dynident.effects.hysteresis_states import build_step_expression
from dynident.effects.newton_euler import build_inverse_dynamics
from dynident.effects.rigid_body_rows import build_frames, cross_product, to_constant
from dynident.identification.identified_models.identification_result import Estimate
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

_TEN = len(INERTIAL_NAMES)


@dataclass(frozen=True, eq=False)
class Argument:
    """One input of the formula.

    Parameters
    ----------
    name : str
        Its name in exported programs.
    symbol : SX (k, 1)
        The column vector that stands for it in the expression.
    meaning : str
        What it is, with its unit.
    """

    name: str
    symbol: ca.SX
    meaning: str

    @property
    def size(self) -> int:
        """Number of its entries."""
        return int(self.symbol.numel())


@dataclass(frozen=True, eq=False)
class EquationOfMotion:
    """Terms of the equation of motion, as expressions of `arguments`, parameters and load.

    Attributes
    ----------
    robot : Robot
        The robot that the model is of.
    base : SX (b, 1)
        Base parameters.
    payload : SX (10, 1)
        Inertial parameters of a load on the last link, in its frame, in the order of `INERTIAL_NAMES`.
    arguments : tuple of Argument
        Signals that any term depends on; q, dq and ddq in any case; the state `z` where the model has hysteresis.
    torque : SX (n, 1)
        All terms together, τ in N m or N.
    gravity, coriolis, friction : SX (n, 1)
        Their torques; `coriolis` is C(q, q̇) q̇, and friction is that of the effects that are friction.
    effects : SX (n, 1)
        Torque of all effects other than links and rotors, friction among them.
    mass : SX (n, n)
        Mass matrix of links and rotors.
    momentum : SX (n, 1)
        Generalised momentum M(q) q̇.
    momentum_rate : SX (n, 1)
        Rate of the momentum without motors and effects: ∂T/∂q - g, where T is the kinetic energy.
    z_next : SX (number of hysteresis states, 1)
        The states after the step from `q_before` to q.
    q_before : SX (n, 1)
        Positions of the sample before.
    """

    robot: Robot
    base: ca.SX
    payload: ca.SX
    arguments: tuple[Argument, ...]
    torque: ca.SX
    gravity: ca.SX
    coriolis: ca.SX
    friction: ca.SX
    effects: ca.SX
    mass: ca.SX
    momentum: ca.SX
    momentum_rate: ca.SX
    z_next: ca.SX
    q_before: ca.SX

    @property
    def acceleration_obstacle(self) -> str:
        """Why the acceleration is no explicit function of the torque; empty where it is one."""
        higher = [a.symbol for a in self.arguments if a.name in ("ddq", "dddq", "ddddq")]
        if any(ca.depends_on(self.effects, symbol) for symbol in higher):
            return "an effect of this model depends on the acceleration itself"
        if self.weightless_joints:
            return f"the model has no inertia at {', '.join(self.weightless_joints)}"
        return ""

    @property
    def weightless_joints(self) -> tuple[str, ...]:
        """Joints at which the model has no inertia."""
        unloaded = ca.substitute(ca.diag(self.mass), self.payload, ca.SX.zeros(_TEN, 1))
        return tuple(name for j, name in enumerate(self.robot.joint_names) if unloaded[j].is_zero())

    def get_symbol(self, name: str) -> ca.SX:
        """Return the symbol of an argument."""
        return next(argument.symbol for argument in self.arguments if argument.name == name)

    @property
    def observer_obstacle(self) -> str:
        """Why no observer of contacts can use the model; empty where one can."""
        foreign = [a.name for a in self.arguments if a.name in ("time", "temperature", "runs")]
        return f"effects of this model depend on {', '.join(foreign)}" if foreign else ""

    def build_observer_terms(self) -> ca.SX:
        """Return the momentum and its rate without motors and contacts (2 n, 1), for an observer of contacts.

        Effects that depend on the acceleration are taken without it: accelerations would bring in the noise that the
        momentum avoids.
        """
        terms = ca.vertcat(self.momentum, self.momentum_rate - self.effects)
        for argument in self.arguments:
            if argument.name in ("ddq", "dddq", "ddddq"):
                terms = ca.substitute(terms, argument.symbol, ca.SX.zeros(argument.size, 1))
        return ca.densify(terms)

    def build_acceleration(self, tau: ca.SX) -> ca.SX:
        """Return q̈ (n, 1) under the motors' torque tau (n, 1): forward dynamics."""
        return solve_symmetric(self.mass, tau - self.coriolis - self.gravity - self.effects)


def build_equation_of_motion(estimate: Estimate) -> EquationOfMotion:
    """Return the terms of an identified model's equation of motion.

    Loads that effects depend on (friction that grows with the load) are predicted with the identified parameters,
    whatever the payload.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters.

    Returns
    -------
    EquationOfMotion
        The terms, as expressions.

    Raises
    ------
    DynidentError
        For a robot with contacts, whose projected equations are none of its own motion.
    """
    model = estimate.model
    model.robot.require_no_contacts("equation of its motion")
    robot, signals, observation = model.robot, model.signals, model.observation
    n = robot.n
    base, payload = ca.SX.sym("base", len(observation.columns)), ca.SX.sym("payload", _TEN)
    inertial = [get_effect(column.effect).is_inertia and not column.runs for column in observation.columns]
    links = _Links(robot, observation.columns, inertial, base, payload)
    if robot.linkage is None:
        rigid, mass = links.build_torque(signals.q, signals.dq, signals.ddq), links.build_mass_matrix(signals.q)
    else:
        # Where joints follow others, the columns themselves are the only derivation there is.
        rows = signals.mechanics.rows[:, _TEN * (robot.tree.n - 1) :]
        rigid = ca.densify(ca.mtimes(rows, payload) + links.sum_columns())
        mass = ca.jacobian(rigid, signals.ddq)
    rest = ca.SX.zeros(n, 1)
    gravity = ca.substitute(rigid, ca.vertcat(signals.dq, signals.ddq), ca.SX.zeros(2 * n, 1))
    moving = ca.substitute(rigid, signals.ddq, rest)
    if robot.linkage is None:
        still = ca.SX.zeros(3, 1)
        coriolis = links.build_torque(signals.q, signals.dq, rest, still)
        momentum = links.build_torque(signals.q, rest, signals.dq, still)
    else:
        coriolis, momentum = moving - gravity, ca.mtimes(mass, signals.dq)
    energy = ca.dot(signals.dq, momentum) / 2
    friction, effects = sum_effects(observation.columns, base, inertial, signals.dq, get_known_speeds(estimate))
    fixed = ca.SX(ca.DM(estimate.reference.vector))
    effects, friction = (ca.substitute(ca.densify(part), signals.reference, fixed) for part in (effects, friction))
    states, before = [signals.memory(item) for item in observation.memory], ca.SX.sym("q_before", n)
    z, z_next = ca.SX.sym("z", len(states)), ca.SX(0, 1)
    if states:
        effects, friction = (ca.substitute(part, ca.vertcat(*states), z) for part in (effects, friction))
        moved = build_all_positions(robot, signals.q) - build_all_positions(robot, before)
        z_next = ca.vertcat(
            *(build_step_expression(item, z[k], moved[item.joint]) for k, item in enumerate(observation.memory))
        )
    candidates = [*list_motion_arguments(signals), Argument("z", z, "hysteresis states, -1 to 1")]
    if observation.runs:
        present = ca.vertcat(*(signals.in_runs(item) for item in observation.runs))
        candidates.append(Argument("runs", present, describe_runs(observation.runs)))
    always = ("q", "dq", "ddq")
    arguments = tuple(a for a in candidates if a.name in always or ca.depends_on(effects, a.symbol))
    return EquationOfMotion(
        robot=robot,
        base=base,
        payload=payload,
        arguments=arguments,
        torque=rigid + effects,
        gravity=gravity,
        coriolis=coriolis,
        friction=friction,
        effects=effects,
        mass=mass,
        momentum=momentum,
        momentum_rate=ca.gradient(energy, signals.q) - gravity,
        z_next=z_next,
        q_before=before,
    )


def get_known_speeds(estimate: Estimate) -> FloatArray | None:
    """Return the largest recorded speeds (n,), beyond which friction must not fall; None if unknown."""
    # Friction of joints that follow others depends on the speeds of several.
    return None if estimate.model.robot.linkage is not None else estimate.speeds


def sum_effects(
    columns: Sequence[Column], base: ca.SX, left_out: Sequence[bool], dq: ca.SX, speeds: FloatArray | None
) -> tuple[ca.SX, ca.SX]:
    """Return the torque (n, 1) of the effects that are friction, and of all effects.

    Parameters
    ----------
    columns : sequence of Column
        Columns of the base parameters.
    base : SX (b, 1)
        Base parameters.
    left_out : sequence of bool
        Columns that are no effects: those of links and rotors.
    dq : SX (n, 1)
        Velocities.
    speeds : (n,), optional
        Largest recorded speeds, beyond which friction does not fall.
    """
    of_speed, of_load, others = (ca.SX.zeros(dq.numel(), 1) for _ in range(3))
    for k, column in enumerate(columns):
        if left_out[k]:
            continue
        effect = get_effect(column.effect)
        # The load depends on the speed, too, but friction by the load does not grow with it.
        if effect.is_friction and not effect.needs_load:
            of_speed += column.torque * base[k]
        elif effect.is_friction:
            of_load += column.torque * base[k]
        else:
            others += column.torque * base[k]
    friction = of_load + (of_speed if speeds is None else bound_friction(of_speed, dq, speeds))
    return friction, friction + others


def list_motion_arguments(signals: Signals) -> tuple[Argument, ...]:
    """Return the signals that torque may depend on besides hysteresis and runs, with their meaning."""
    return (
        Argument("q", signals.q, "joint positions, rad or m"),
        Argument("dq", signals.dq, "joint velocities, rad/s or m/s"),
        Argument("ddq", signals.ddq, "joint accelerations, rad/s^2 or m/s^2"),
        Argument("dddq", signals.dddq, "third derivative of q, rad/s^3 or m/s^3"),
        Argument("ddddq", signals.ddddq, "fourth derivative of q, rad/s^4 or m/s^4"),
        Argument("time", signals.time, "time since the session began, s"),
        Argument("period", signals.period, "sampling period, s"),
        Argument("temperature", signals.temperature, "temperature of each joint, degrees Celsius"),
    )


def describe_runs(runs: tuple[RunSignal, ...]) -> str:
    """Return a text on the meaning of the entries of the argument `runs`."""
    kinds = [
        f"those like {', '.join(signal.runs)}" if signal.runs else "those that carry the payload" for signal in runs
    ]
    return "1 in runs of a kind, 0 in others: " + "; ".join(kinds)


@dataclass(frozen=True, eq=False)
class _Links:
    """Links and rotors whose standard parameters are the base parameters, zero but for those that are kept."""

    robot: Robot
    columns: Sequence[Column]
    inertial: Sequence[bool]
    base: ca.SX
    payload: ca.SX

    def build_torque(self, q: ca.SX, dq: ca.SX, ddq: ca.SX, gravity: ca.SX | None = None) -> ca.SX:
        """Return the torque of links and rotors, by the recursion of Newton and Euler."""
        field = to_constant(self.robot.gravity) if gravity is None else gravity
        inertia, rotors = self._sort_parameters()
        return ca.densify(build_inverse_dynamics(self.robot, q, dq, ddq, field, inertia) + rotors * ddq)

    def build_mass_matrix(self, q: ca.SX) -> ca.SX:
        """Return the mass matrix by composite bodies: each joint moves the links beyond it as one rigid body."""
        robot, frames = self.robot, build_frames(self.robot, q)
        inertia, rotors = self._sort_parameters()
        bodies = [_Body.from_parameters(inertia[_TEN * j : _TEN * (j + 1)]) for j in range(robot.n)]
        mass = ca.diag(ca.densify(rotors))
        for j in reversed(range(robot.n)):
            joint, body = robot.joints[j], bodies[j]
            axis = to_constant(joint.axis)
            if joint.kind == "revolute":
                force, moment = cross_product(axis, body.first), ca.mtimes(body.inertia, axis)
            else:
                force, moment = body.mass * axis, cross_product(body.first, axis)
            mass[j, j] += ca.dot(axis, moment if joint.kind == "revolute" else force)
            here = j
            # What the joints before it feel of a unit acceleration: the wrench, carried on to their frames.
            while robot.joints[here].parent >= 0:
                frame, here = frames[here], robot.joints[here].parent
                force = ca.mtimes(frame.rotation, force)
                moment = ca.mtimes(frame.rotation, moment) + cross_product(frame.origin, force)
                other = robot.joints[here]
                shared = ca.dot(to_constant(other.axis), moment if other.kind == "revolute" else force)
                mass[here, j] = mass[j, here] = shared
            if joint.parent >= 0:
                moved = body.move(frames[j].rotation, frames[j].origin)
                bodies[joint.parent] = bodies[joint.parent].join(moved)
        return ca.densify(mass)

    def sum_columns(self) -> ca.SX:
        """Return the torque of links and rotors by their columns of the observation matrix."""
        torque = ca.SX.zeros(self.robot.n, 1)
        for k, column in enumerate(self.columns):
            if self.inertial[k]:
                torque += column.torque * self.base[k]
        return torque

    def _sort_parameters(self) -> tuple[ca.SX, ca.SX]:
        """Return standard inertial parameters (10 n, 1) with the load, and the rotors' inertias (n, 1)."""
        names = self.robot.joint_names
        # Without an entry a parameter is zero by structure, and no operation is spent on it.
        inertia, rotors = ca.SX(_TEN * self.robot.n, 1), ca.SX(self.robot.n, 1)
        for k, column in enumerate(self.columns):
            if not self.inertial[k]:
                continue
            j = names.index(column.link)
            if get_role(column) == "rotor":
                rotors[j] += self.base[k]
            else:
                inertia[_TEN * j + INERTIAL_NAMES.index(column.parameter)] += self.base[k]
        tip = _TEN * (self.robot.n - 1)
        inertia[tip : tip + _TEN] += self.payload
        return inertia, rotors


@dataclass(frozen=True, eq=False)
class _Body:
    """Mass, first moment (3, 1) and inertia (3, 3) of a rigid body, about the origin of a frame."""

    mass: ca.SX
    first: ca.SX
    inertia: ca.SX

    @classmethod
    def from_parameters(cls, k: ca.SX) -> _Body:
        rows = ca.vertcat(ca.horzcat(k[0], k[1], k[2]), ca.horzcat(k[1], k[3], k[4]), ca.horzcat(k[2], k[4], k[5]))
        return cls(k[9], k[6:9], rows)

    def move(self, rotation: ca.SX, origin: ca.SX) -> _Body:
        """Return the same body in the antecedent's frame, where this frame stands at `rotation` and `origin`."""
        first = ca.mtimes(rotation, self.first)
        inertia = ca.mtimes(ca.mtimes(rotation, self.inertia), rotation.T)
        # Steiner's theorem about a frame's origin that is not the centre of mass: a first moment crosses twice.
        cross, lever = ca.mtimes(origin, first.T), first + self.mass * origin / 2
        inertia = inertia + 2 * ca.dot(origin, lever) * ca.SX.eye(3)
        inertia = inertia - cross - cross.T - self.mass * ca.mtimes(origin, origin.T)
        return _Body(self.mass, first + self.mass * origin, inertia)

    def join(self, other: _Body) -> _Body:
        """Return both bodies as one."""
        return _Body(self.mass + other.mass, self.first + other.first, self.inertia + other.inertia)


def solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return the solution (n, 1) of a symmetric positive definite system, unrolled: M = L D Lᵀ without square roots.

    Parameters
    ----------
    matrix : SX (n, n)
        The symmetric matrix.
    right : SX (n, 1)
        The right-hand side.
    """
    n = right.numel()
    lower: list[list[ca.SX]] = [[ca.SX(0.0)] * n for _ in range(n)]
    diagonal, inverse = [ca.SX(0.0)] * n, [ca.SX(0.0)] * n
    # From the last row upward, as in Featherstone's factorisation: joints on different branches then stay uncoupled.
    for k in reversed(range(n)):
        diagonal[k] = matrix[k, k] - sum((lower[i][k] ** 2 * diagonal[i] for i in range(k + 1, n)), start=ca.SX(0.0))
        inverse[k] = 1.0 / diagonal[k]
        for j in range(k):
            coupled = sum((lower[i][k] * lower[i][j] * diagonal[i] for i in range(k + 1, n)), start=ca.SX(0.0))
            lower[k][j] = (matrix[k, j] - coupled) * inverse[k]
    solution = [right[k] for k in range(n)]
    for k in reversed(range(n)):
        for j in range(k):
            solution[j] = solution[j] - lower[k][j] * solution[k]
    solution = [solution[k] * inverse[k] for k in range(n)]
    for k in range(n):
        for j in range(k):
            solution[k] = solution[k] - lower[k][j] * solution[j]
    return ca.vertcat(*solution)
