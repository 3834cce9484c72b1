"""One step of a robot with friction: explicit in the positions, implicit in the velocities.

Positions and velocities are staggered in time by half a step (leapfrog), so that at every step the position, the
velocity (mean of the two around it) and the acceleration are central differences of one discrete path, and the torque
that belongs to them is known exactly. Friction is stiff near zero velocity; the velocity at a step is therefore solved
for by a few Newton iterations that see friction alone, the rigid body being evaluated once a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynident.effects import MemorySignal, RunSignal
from dynident.expressions import Program, Recurrence
from dynident.robot.model import FloatArray, Robot
from dynident.simulation.signals import SimulatedSignals
from dynident.simulation.truth import TrueColumns, TrueEffect, true_columns, true_reference

NEWTON_ITERATIONS = 6
# Powers of the velocity have no derivative at exactly zero.
_NOT_ZERO = 1e-12


@dataclass(frozen=True, eq=False)
class _Expressions:
    """Symbolic parts of the equation of motion M ddq + c + position torque + rest = tau."""

    mass: ca.SX
    bias: ca.SX
    position_torque: ca.SX
    rest: ca.SX
    rest_mass: ca.SX
    rest_slope: ca.SX


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The equation of motion of one virtual robot.

    rigid : (q, dq, ddq) -> torque of the links
    mass_diagonal : q -> diagonal of the mass matrix with all that turns with acceleration
    rest : (q, dq, ddq, load, z, time, temperature, runs) -> torque of all effects other than the links
    runs : the run signals among its inputs, each 1 in its runs and 0 in all others
    """

    robot: Robot
    signals: SimulatedSignals
    runs: tuple[RunSignal, ...]
    parts: _Expressions
    rigid: Program
    mass_diagonal: Program
    rest: Program

    @property
    def n_state(self) -> int:
        """Length of a step's state."""
        return 4 * self.robot.n + len(self.signals.memory_signals)

    @property
    def n_inputs(self) -> int:
        """Length of a step's inputs."""
        return 4 * self.robot.n + 1 + len(self.runs)


def build_dynamics(
    robot: Robot, effects: Sequence[TrueEffect], inertias: FloatArray, *, smooth_sign: float
) -> Dynamics:
    """Build the equation of motion of a robot.

    Parameters
    ----------
    robot : Robot
    effects : sequence of TrueEffect
        What acts besides the links; what is a matter of the sensors alone is left out.
    inertias : (n, 10)
    smooth_sign : float
        Velocity (rad/s or m/s) over which the sign of friction changes.
    """
    signals = SimulatedSignals(robot, smooth_sign=smooth_sign)
    truth = true_columns(effects, signals)
    parts = _expressions(signals, truth, inertias, true_reference(robot, effects, inertias))
    runs = signals.runs_in(parts.rest)
    links = ca.mtimes(parts.mass, signals.ddq) + parts.bias
    # What turns with acceleration does so whatever the velocity, load and history.
    anything = [
        signals.load,
        signals.memory_symbols,
        signals.dq,
        signals.time,
        signals.temperature,
        _run_symbols(signals, runs),
    ]
    still = [ca.SX.zeros(item.numel(), 1) for item in anything]
    inertia = ca.substitute([parts.mass + parts.rest_mass], anything, still)[0]
    return Dynamics(
        robot=robot,
        signals=signals,
        runs=runs,
        parts=parts,
        rigid=Program([signals.q, signals.dq, signals.ddq], ca.densify(links)),
        mass_diagonal=Program([signals.q], ca.densify(ca.diag(inertia))),
        rest=Program(_rest_inputs(signals, runs), ca.densify(parts.rest + parts.position_torque)),
    )


def _run_symbols(signals: SimulatedSignals, runs: Sequence[RunSignal]) -> ca.SX:
    return ca.vertcat(*(signals.in_runs(run) for run in runs)) if runs else ca.SX(0, 1)


def _rest_inputs(signals: SimulatedSignals, runs: Sequence[RunSignal]) -> list[ca.SX]:
    return [
        signals.q,
        signals.dq,
        signals.ddq,
        signals.load,
        signals.memory_symbols,
        signals.time,
        signals.temperature,
        _run_symbols(signals, runs),
    ]


def _expressions(
    signals: SimulatedSignals, truth: TrueColumns, inertias: FloatArray, reference: FloatArray
) -> _Expressions:
    """Sort the torque into what the mass matrix, the position, and the velocity or memory determine."""
    n = signals.robot.n
    standard = ca.DM(inertias.reshape(-1))
    links = ca.mtimes(signals.mechanics.rows, standard)
    kinetic, _ = signals.mechanics.energies
    position_torque, rest = ca.SX.zeros(n, 1), ca.SX.zeros(n, 1)
    for column, value in zip(truth.columns, truth.parameters, strict=True):
        if not signals.moves(column.torque):
            continue
        torque = ca.substitute(column.torque, signals.reference, ca.SX(ca.DM(reference))) * float(value)
        if {symbol.name() for symbol in ca.symvar(torque)} <= {symbol.name() for symbol in ca.symvar(signals.q)}:
            position_torque += torque
        else:
            rest += torque
    return _Expressions(
        # From the kinetic energy: 2.6 times fewer operations than the derivative of the rows by the acceleration.
        mass=ca.hessian(ca.mtimes(kinetic, standard), signals.dq)[0],
        bias=ca.substitute(links, signals.ddq, ca.SX.zeros(n, 1)),
        position_torque=position_torque,
        rest=rest,
        rest_mass=ca.jacobian(rest, signals.ddq),
        rest_slope=ca.jacobian(rest, signals.dq),
    )


@dataclass(frozen=True, eq=False)
class Step:
    """One step of a robot under joint control, `h` s long."""

    recurrence: Recurrence

    def run(
        self, state: FloatArray, inputs: FloatArray, h: float, stiffness: FloatArray, damping: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The state (s,) after m steps, and the samples (m, 4 n) at them.

        Parameters
        ----------
        state : (s,)
            [q, v, a, q_last, z]: position at the step; velocity half a step before it; acceleration and position of
            the last step; hysteresis states there.
        inputs : (m, w)
            [q_r, dq_r, feed-forward torque, time, temperature (n), runs].
        h : float
            Length of a step in s.
        stiffness, damping : (n,)
            Gains of the joint controller on the errors of position and velocity.

        Returns
        -------
        The state, and [q, dq, ddq, tau] at every step.
        """
        return self.recurrence.run(state, inputs, np.concatenate([[h], stiffness, damping]))


def build_step(dynamics: Dynamics) -> Step:
    """Build the step of a robot."""
    signals, parts, h = dynamics.signals, dynamics.parts, ca.SX.sym("h")
    robot, n = dynamics.robot, dynamics.robot.n
    stiffness, damping = ca.SX.sym("stiffness", n), ca.SX.sym("damping", n)
    velocity, before, last = ca.SX.sym("v", n), ca.SX.sym("a", n), ca.SX.sym("q_last", n)
    memory = ca.SX.sym("z", len(signals.memory_signals))
    reference, reference_rate = ca.SX.sym("q_r", n), ca.SX.sym("dq_r", n)
    feed_forward = ca.SX.sym("tau_ff", n)

    predicted = velocity + 0.5 * h * before
    tau = feed_forward + stiffness * (reference - signals.q) + damping * (reference_rate - predicted)
    tau = ca.vertcat(*(_within(tau[j], robot.joints[j].limits.effort) for j in range(n)))

    states = _moved(signals.memory_signals, memory, signals.q - last)
    rigid = ca.Function("rigid", [signals.q, signals.dq], [parts.mass, parts.bias, parts.position_torque])
    mass, bias, position_torque = rigid(signals.q, predicted)
    inputs_of_rest = _rest_inputs(signals, dynamics.runs)
    runs = inputs_of_rest[-1]
    friction = ca.Function("friction", inputs_of_rest, [parts.rest, parts.rest_mass, parts.rest_slope])

    middle = predicted
    for _ in range(NEWTON_ITERATIONS):
        ddq = 2 * (middle - velocity) / h
        load = ca.mtimes(mass, ddq) + bias
        torque, inertia, slope = friction(
            signals.q, middle + _NOT_ZERO, ddq, load, states, signals.time, signals.temperature, runs
        )
        residual = load + position_torque + torque - tau
        update = middle - ca.ldl_solve(residual, *ca.ldl(ca.densify(2 / h * (mass + inertia) + slope), False))
        # Friction is odd in the velocity and bends towards its axis on both sides: a Newton step that jumps over zero
        # may jump for ever, one from zero cannot.
        middle = update * (middle * update >= 0)
    ddq = 2 * (middle - velocity) / h
    after = velocity + h * ddq
    state = ca.vertcat(signals.q, velocity, before, last, memory)
    inputs = ca.vertcat(reference, reference_rate, feed_forward, signals.time, signals.temperature, runs)
    following = ca.vertcat(signals.q + h * after, after, ddq, signals.q, states)
    sample = ca.vertcat(signals.q, middle, ddq, tau)
    return Step(Recurrence(state, inputs, ca.vertcat(h, stiffness, damping), following, sample))


def _within(torque: ca.SX, limit: float | None) -> ca.SX:
    return torque if limit is None else ca.fmin(limit, ca.fmax(-limit, torque))


def _moved(memory: Sequence[MemorySignal], states: ca.SX, displacement: ca.SX) -> ca.SX:
    """Hysteresis states after a displacement (n, 1): `dynident.effects.memory.step` in symbols."""
    moved = []
    for k, signal in enumerate(memory):
        ratio = displacement[signal.joint] / signal.slip
        if signal.operator == "stop":
            moved.append(ca.fmin(1.0, ca.fmax(-1.0, states[k] + ratio)))
        else:
            direction = ca.sign(ratio)
            moved.append(direction - (direction - states[k]) * ca.exp(-ca.fabs(ratio)))
    return ca.vertcat(*moved) if moved else ca.SX(0, 1)
