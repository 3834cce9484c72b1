"""Equation of motion of a virtual robot and one time step, with dry friction solved exactly.

The step is explicit in the positions and implicit in the velocities, and exact for dry friction.

Positions and velocities are staggered in time by half a step (leapfrog), so that at every step the position, the
velocity (mean of the two around it) and the acceleration are central differences of one discrete path, and the torque
that belongs to them is known exactly.

Dry friction follows Coulomb: against the velocity where a joint slides, and where it rests whatever torque
holds it, up to its largest. Which joints rest follows from the velocity *after* the step (Moreau's time stepping), so
that a joint that stops stands still from then on: it does not creep, and it does not tremble. Newton iterations on the
friction alone, with the rigid body evaluated once a step, guess which joints rest, solve for the velocities of the
others and correct the guess: the primal-dual active set method. The first guess is the set that rested in the last
step. If the guess is still wrong after the last iteration, the step is consistent with it all the same, and the next
step begins with a better one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import MemorySignal, ReferenceParameters, RunSignal, get_effect
from dynident.effects.dependent_joint_dynamics import build_all_positions
from dynident.effects.friction import bound_friction
from dynident.effects.hysteresis_states import build_step_expression
from dynident.expressions import Program, Recurrence
from dynident.robot.robot_model import Robot
from dynident.simulation.simulated_signals import SimulatedSignals, Sliding
from dynident.simulation.true_effects import TrueColumns, TrueEffect, build_reference, build_true_columns


@dataclass(frozen=True, eq=False)
class Expressions:
    """Symbolic parts of the equation of motion M ddq + c + position torque + rest = tau.

    Parameters
    ----------
    mass : casadi.SX
        Mass matrix of the links, (n, n).
    bias : casadi.SX
        Torque c of the links without acceleration, (n, 1).
    position_torque : casadi.SX
        Torque of the effects that depend on the position alone, (n, 1).
    rest : casadi.SX
        Torque of all other effects, (n, 1).
    rest_mass : casadi.SX
        Derivative of `rest` by the acceleration, (n, n).
    rest_slope : casadi.SX
        Derivative of `rest` by the velocity with the directions of friction held, (n, n).
    dry : casadi.SX
        Derivative of `rest` by the directions of friction, (n, number of sliding velocities).
    """

    mass: ca.SX
    bias: ca.SX
    position_torque: ca.SX
    rest: ca.SX
    rest_mass: ca.SX
    rest_slope: ca.SX
    dry: ca.SX


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Equation of motion of one virtual robot.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    signals : SimulatedSignals
        Symbols of the motion within a step.
    sliding : tuple of Sliding
        The relative velocities with dry friction: those of the n joints first, then any others.
    runs : tuple of RunSignal
        The run signals among its inputs, each 1 in its runs and 0 in all others.
    parts : Expressions
        The torque, sorted by what determines it.
    rigid : Program
        (q, dq, ddq) -> torque of the links.
    mass_diagonal : Program
        q -> diagonal of the mass matrix with all inertia, that of rotors included.
    rest : Program
        (q, dq, ddq, load, z, time, temperature, runs) -> torque of all effects other than the links.
    """

    robot: Robot
    signals: SimulatedSignals
    sliding: tuple[Sliding, ...]
    runs: tuple[RunSignal, ...]
    parts: Expressions
    rigid: Program
    mass_diagonal: Program
    rest: Program

    @property
    def n_state(self) -> int:
        """Length of the state of a step."""
        return 4 * self.robot.n + len(self.signals.memory_signals) + len(self.sliding)

    @property
    def n_inputs(self) -> int:
        """Length of the inputs of a step."""
        return 4 * self.robot.n + 1 + len(self.runs)


def build_dynamics(
    robot: Robot, effects: Sequence[TrueEffect], inertias: FloatArray, speeds: FloatArray | None = None
) -> Dynamics:
    """Build the equation of motion of a robot.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effects : sequence of TrueEffect
        What acts besides the links; effects of the sensors alone are left out.
    inertias : (n, 10)
        Inertial parameters of the links.
    speeds : (n,), optional
        Speeds in rad/s or m/s beyond which friction does not fall.

    Returns
    -------
    Dynamics
        The equation of motion, in symbols and as compiled functions.
    """
    signals = SimulatedSignals(robot)
    truth = build_true_columns(effects, signals)
    parts, sliding = _build_expressions(signals, truth, inertias, build_reference(robot, effects, inertias), speeds)
    runs = signals.find_run_signals(parts.rest)
    links = ca.mtimes(parts.mass, signals.ddq) + parts.bias
    others = _substitute_sliding_signs(parts.rest, sliding) + parts.position_torque
    # What turns with acceleration does so whatever the velocity, load and history.
    irrelevant = [
        signals.load,
        signals.memory_symbols,
        signals.dq,
        signals.time,
        signals.temperature,
        stack_run_symbols(signals, runs),
        stack_directions(sliding),
    ]
    zeros = [ca.SX.zeros(item.numel(), 1) for item in irrelevant]
    inertia = ca.substitute([parts.mass + parts.rest_mass], irrelevant, zeros)[0]
    return Dynamics(
        robot=robot,
        signals=signals,
        sliding=sliding,
        runs=runs,
        parts=parts,
        rigid=Program([signals.q, signals.dq, signals.ddq], ca.densify(links)),
        mass_diagonal=Program([signals.q], ca.densify(ca.diag(inertia))),
        rest=Program(list_rest_inputs(signals, runs), ca.densify(others)),
    )


def stack_directions(sliding: Sequence[Sliding]) -> ca.SX:
    """Return the symbols of the directions of friction, SX (number of sliding velocities, 1)."""
    return ca.vertcat(*(relative.direction for relative in sliding))


def _substitute_sliding_signs(torque: ca.SX, sliding: Sequence[Sliding]) -> ca.SX:
    """Return the torque with every direction of friction set to the sign of its velocity."""
    return ca.substitute(
        torque, stack_directions(sliding), ca.vertcat(*(ca.sign(relative.velocity) for relative in sliding))
    )


def stack_run_symbols(signals: SimulatedSignals, runs: Sequence[RunSignal]) -> ca.SX:
    """Return the run signals, SX (number of runs, 1)."""
    return ca.vertcat(*(signals.in_runs(run) for run in runs)) if runs else ca.SX(0, 1)


def list_rest_inputs(signals: SimulatedSignals, runs: Sequence[RunSignal]) -> list[ca.SX]:
    """Return the inputs of all effects other than the links, besides the directions of friction.

    Parameters
    ----------
    signals : SimulatedSignals
        Symbols of the motion within a step.
    runs : sequence of RunSignal
        Run signals that the torque depends on.
    """
    return [
        signals.q,
        signals.dq,
        signals.ddq,
        signals.load,
        signals.memory_symbols,
        signals.time,
        signals.temperature,
        stack_run_symbols(signals, runs),
    ]


def _build_expressions(
    signals: SimulatedSignals,
    truth: TrueColumns,
    inertias: FloatArray,
    reference: ReferenceParameters,
    speeds: FloatArray | None,
) -> tuple[Expressions, tuple[Sliding, ...]]:
    """Sort the torque by its cause: the mass matrix, the position, or the velocity and memory."""
    n = signals.robot.n
    standard = ca.DM(inertias.reshape(-1))
    links = ca.mtimes(signals.mechanics.rows, standard)
    kinetic, _ = signals.mechanics.energies
    position_torque, rest, friction = (ca.SX.zeros(n, 1) for _ in range(3))
    for column, value in zip(truth.columns, truth.parameters, strict=True):
        # Effects of the measurement, such as drive gains, change what a sensor shows and not the motion.
        if not signals.is_part_of_motion(column.torque):
            continue
        torque = ca.substitute(column.torque, signals.reference, ca.SX(ca.DM(reference.vector))) * float(value)
        # Torque of the position alone is known at the beginning of a step; only the rest has to be iterated.
        if {symbol.name() for symbol in ca.symvar(torque)} <= {symbol.name() for symbol in ca.symvar(signals.q)}:
            position_torque += torque
        elif get_effect(column.effect).is_friction and not get_effect(column.effect).needs_load:
            friction += torque
        else:
            rest += torque
    rest += (
        friction
        if speeds is None or signals.robot.linkage is not None
        else bound_friction(friction, signals.dq, speeds)
    )
    # Only now are all relative velocities with dry friction known: building the columns has registered them.
    sliding = signals.list_sliding(rest)
    parts = Expressions(
        # From the kinetic energy: 2.6 times fewer operations than the derivative of the rows by the acceleration.
        mass=ca.hessian(ca.mtimes(kinetic, standard), signals.dq)[0],
        bias=ca.substitute(links, signals.ddq, ca.SX.zeros(n, 1)),
        position_torque=position_torque,
        rest=rest,
        rest_mass=ca.jacobian(rest, signals.ddq),
        rest_slope=ca.jacobian(rest, signals.dq),
        dry=ca.jacobian(rest, stack_directions(sliding)),
    )
    return parts, sliding


# A fixed number: the iterations are unrolled into one compiled expression, which cannot end early.
ITERATIONS = 6
# Velocity (rad/s or m/s) below which the slope of friction is taken to be what it is there: a root of the velocity has
# none at zero, and a Newton iteration that saw how steep it is close to zero would never leave it.
_STEEPEST = 1e-4
# Dry friction (N m or N) below which there is none to hold anything.
_NO_FRICTION = 1e-9
# By this share friction at rest holds more than it takes to slide. Without it a joint that creeps up to where friction
# balances its controller would come to rest in infinite time.
_HELD = 1e-6
# Response of a relative velocity to its friction (rad/s, m/s) below which it cannot move: what it joins is at rest.
_RIGID = 1e-12


@dataclass(frozen=True, eq=False)
class Step:
    """One step of a robot under joint control.

    Parameters
    ----------
    recurrence : Recurrence
        Compiled function from one state to the next.
    """

    recurrence: Recurrence

    def run(
        self, state: FloatArray, inputs: FloatArray, h: float, stiffness: FloatArray, damping: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Run m steps.

        Parameters
        ----------
        state : (s,)
            As `build_first_state` makes it.
        inputs : (m, w)
            [q_r, dq_r, feed-forward torque, time, temperature (n), runs].
        h : float
            Length of a step in s.
        stiffness, damping : (n,)
            Gains of the joint controller on the errors of position and velocity.

        Returns
        -------
        state : (s,)
            After m steps.
        samples : (m, 4 n)
            [q, dq, ddq, tau] at every step.
        """
        return self.recurrence.run(state, inputs, np.concatenate([[h], stiffness, damping]))

    def run_many(
        self, states: FloatArray, inputs: FloatArray, h: float, stiffness: FloatArray, damping: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Run m steps from each of k states (k, s) side by side, with inputs (m, k, w); samples are (m, k, 4 n)."""
        return self.recurrence.run_many(states, inputs, np.concatenate([[h], stiffness, damping]))


def build_first_state(dynamics: Dynamics, q: FloatArray, dq: FloatArray, ddq: FloatArray, h: float) -> FloatArray:
    """Return the state of a run that begins with a given motion.

    The state is [q, v, a, q_last, z, directions of friction]: v is the velocity half a step before q, a and q_last are
    acceleration and position of the step before, z the hysteresis states there.

    Parameters
    ----------
    dynamics : Dynamics
        Equation of motion of the robot.
    q, dq, ddq : (n,)
        Position, velocity and acceleration at the start: rad, rad/s, rad/s² or m, m/s, m/s².
    h : float
        Length of a step, s.

    Returns
    -------
    (s,)
        The state, with the hysteresis relaxed.
    """
    # Leapfrog: the velocity of the state belongs to half a step before the position.
    before = dq - 0.5 * h * ddq
    joints = np.sign(before)
    others = np.zeros(len(dynamics.sliding) - len(q))
    return np.concatenate([q, before, ddq, q, np.zeros(len(dynamics.signals.memory_signals)), joints, others])


@dataclass(frozen=True, eq=False)
class _StepConstants:
    """Constants of one step: its length, velocity before it, mass matrix, bias, torque of the drives less that of q."""

    h: ca.SX
    velocity: ca.SX
    mass: ca.SX
    bias: ca.SX
    drive: ca.SX


@dataclass(frozen=True, eq=False)
class _Iterate:
    """An iterate: velocity at the step, velocity after it, and the directions of friction to try next."""

    middle: ca.SX
    after: ca.SX
    direction: ca.SX


def build_step(dynamics: Dynamics) -> Step:
    """Build the step of a robot under joint control.

    Parameters
    ----------
    dynamics : Dynamics
        Equation of motion of the robot.

    Returns
    -------
    Step
        The step, compiled.
    """
    signals, parts, h = dynamics.signals, dynamics.parts, ca.SX.sym("h")
    robot, n = dynamics.robot, dynamics.robot.n
    stiffness, damping = ca.SX.sym("stiffness", n), ca.SX.sym("damping", n)
    velocity, before, last = ca.SX.sym("v", n), ca.SX.sym("a", n), ca.SX.sym("q_last", n)
    memory = ca.SX.sym("z", len(signals.memory_signals))
    direction = ca.SX.sym("s", len(dynamics.sliding))
    reference, reference_rate = ca.SX.sym("q_r", n), ca.SX.sym("dq_r", n)
    feed_forward = ca.SX.sym("tau_ff", n)

    # The velocity at the step is not known yet; extrapolated with the last acceleration it is exact to second order,
    # which is enough for the controller and for the velocity-dependent inertial forces.
    predicted = velocity + 0.5 * h * before
    tau = feed_forward + stiffness * (reference - signals.q) + damping * (reference_rate - predicted)
    tau = ca.vertcat(*(_limit_torque(tau[j], robot.joints[j].limits.effort) for j in range(n)))
    # Hysteresis depends on the path of the positions, which the step knows already, so it needs no iteration.
    states = _advance_memory(
        signals.memory_signals,
        memory,
        build_all_positions(signals.robot, signals.q) - build_all_positions(signals.robot, last),
    )
    rigid = ca.Function("rigid", [signals.q, signals.dq], [parts.mass, parts.bias, parts.position_torque])
    mass, bias, position_torque = rigid(signals.q, predicted)
    known = _StepConstants(h, velocity, mass, bias, tau - position_torque)
    iteration = _Iteration(dynamics, states)
    # The set of resting joints of the last step is the first guess: few joints start or stop in any one step.
    iterate = _Iterate(predicted, predicted, direction)
    for _ in range(ITERATIONS):
        iterate = iteration.improve(iterate, known)

    # The velocity at the step is the mean of those half a step before and after, so the acceleration is twice the mean
    # less the first, over h.
    ddq = 2 * (iterate.middle - velocity) / h
    runs = list_rest_inputs(signals, dynamics.runs)[-1]
    state = ca.vertcat(signals.q, velocity, before, last, memory, direction)
    inputs = ca.vertcat(reference, reference_rate, feed_forward, signals.time, signals.temperature, runs)
    following = ca.vertcat(signals.q + h * iterate.after, iterate.after, ddq, signals.q, states, iterate.direction)
    sample = ca.vertcat(signals.q, iterate.middle, ddq, tau)
    return Step(Recurrence(state, inputs, ca.vertcat(h, stiffness, damping), following, sample))


class _Iteration:
    """One Newton iteration on the velocity at a step and on the set of resting joints, for one robot's friction."""

    def __init__(self, dynamics: Dynamics, states: ca.SX) -> None:
        signals, parts, self._n = dynamics.signals, dynamics.parts, dynamics.robot.n
        inputs = list_rest_inputs(signals, dynamics.runs)
        self._states, self._still = states, (signals.time, signals.temperature, inputs[-1])
        self._q = signals.q
        self._friction = ca.Function(
            "friction",
            [*inputs, stack_directions(dynamics.sliding)],
            [parts.rest, parts.rest_mass, parts.dry],
        )
        self._slope = ca.Function("slope", [*inputs, stack_directions(dynamics.sliding)], [parts.rest_slope])
        others = ca.vertcat(ca.SX(0, 1), *(sliding.velocity for sliding in dynamics.sliding[self._n :]))
        self._others = ca.Function("others", [signals.q, signals.dq], [others, ca.jacobian(others, signals.dq)])

    def improve(self, iterate: _Iterate, known: _StepConstants) -> _Iterate:
        """Return a better velocity and better directions of friction."""
        n, h, velocity = self._n, known.h, known.velocity
        middle, joints = iterate.middle, iterate.direction[:n]
        ddq = 2 * (middle - velocity) / h
        load = ca.mtimes(known.mass, ddq) + known.bias
        others = (ddq, load, self._states, *self._still, iterate.direction)
        torque, inertia, dry = self._friction(self._q, middle, *others)
        # The slope is evaluated away from zero velocity, where friction that grows with a root of the velocity is
        # infinitely steep.
        slope = self._slope(self._q, ca.copysign(ca.fmax(ca.fabs(middle), _STEEPEST), middle), *others)
        residual = load + torque - known.drive
        # The acceleration is 2 (middle - velocity) / h, hence the factor 2 / h on whatever depends on the acceleration.
        jacobian = ca.densify(2 / h * (known.mass + inertia) + slope)

        # What rests has no velocity after the step, hence half of its velocity before it in the middle.
        rests = ca.fabs(joints) < 1
        moves = 1 - rests
        stop = rests * (0.5 * velocity - middle)
        # Rows and columns of resting joints are replaced by those of the identity: one factorisation serves every set.
        of_moving = ca.mtimes(ca.diag(moves), ca.mtimes(jacobian, ca.diag(moves)))
        factors = ca.ldl(ca.densify(of_moving + ca.diag(rests)), False)
        change = stop - ca.ldl_solve(moves * (residual + ca.mtimes(jacobian, stop)), *factors)
        better = ca.if_else(rests, 0.5 * velocity, middle + change)
        after = moves * (2 * better - velocity)

        # Friction as it has to be for the joint to rest; of one that moves, as it would have to be to stop it.
        largest = ca.fmax(ca.diag(dry[:, :n]), _NO_FRICTION)
        missing = residual + ca.mtimes(jacobian, change)
        needed = joints + (0.5 * ca.diag(jacobian) * after - missing) / largest
        directions_next = [_clip_direction(needed / (1 + _HELD))]
        for k in range(n, iterate.direction.numel()):
            # Relative velocities other than those of joints, such as in a coupled gear: the direction moves by what
            # would stop the sliding, as far as friction can act on that velocity at all.
            relative, along = self._others(self._q, after)
            along = along[k - n, :]
            response = 2 * ca.mtimes(along, ca.ldl_solve(moves * dry[:, k], *factors))
            directions_next.append(_clip_direction(iterate.direction[k] + relative[k - n] / ca.fmax(response, _RIGID)))
        return _Iterate(better, after, ca.vertcat(*directions_next))


def _clip_direction(direction: ca.SX) -> ca.SX:
    return ca.fmin(1.0, ca.fmax(-1.0, direction))


def _limit_torque(torque: ca.SX, limit: float | None) -> ca.SX:
    return torque if limit is None else ca.fmin(limit, ca.fmax(-limit, torque))


def _advance_memory(memory: Sequence[MemorySignal], states: ca.SX, displacement: ca.SX) -> ca.SX:
    """Return the hysteresis states after a displacement (n, 1)."""
    moved = (build_step_expression(signal, states[k], displacement[signal.joint]) for k, signal in enumerate(memory))
    return ca.vertcat(ca.SX(0, 1), *moved)
