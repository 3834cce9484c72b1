"""The torque of a model as a CasADi expression and as a serialised function."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from dynident.effects import MemorySignal, RunSignal, Signals
from dynident.effects.dependent_joint_dynamics import build_all_positions
from dynident.effects.hysteresis_states import build_step_expression
from dynident.identification import Estimate, Identification
from dynident.identification.identified_models.equation_of_motion import (
    Argument,
    describe_runs,
    get_known_speeds,
    list_motion_arguments,
    sum_effects,
)
from dynident.robot.robot_model import Robot


@dataclass(frozen=True, eq=False)
class TorqueFormula:
    """Γ = W χ of [12.4] with the identified χ, as a function of `arguments`.

    Attributes
    ----------
    robot : Robot
        The robot that the model is of.
    arguments : tuple of Argument
        The inputs that the torque depends on; q, dq and ddq in any case.
    torque : SX (n, 1)
        The expression, in N m, or N.
    memory : tuple of MemorySignal
        Hysteresis states that the model carries from sample to sample, in the order of `z`.
    runs : tuple of RunSignal
        In the order of the argument `runs`.
    z_next : SX (number of memory signals, 1)
        The states after the step from `q_before` to `q`.
    """

    robot: Robot
    arguments: tuple[Argument, ...]
    torque: ca.SX
    memory: tuple[MemorySignal, ...]
    runs: tuple[RunSignal, ...]
    z_next: ca.SX

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arguments, in their order."""
        return tuple(argument.name for argument in self.arguments)


def build_torque_formula(estimate: Estimate) -> TorqueFormula:
    """Return the torque that an identified model predicts, with all constants as numbers.

    q, dq and ddq are always among the arguments; dddq, ddddq, time, period, temperature, runs, and z with q_before only
    if an effect of the model needs them.
    """
    model = estimate.model
    signals, observation = model.signals, model.observation
    nothing_left_out = [False] * len(observation.columns)
    values = ca.SX(ca.DM(estimate.values))
    _, torque = sum_effects(observation.columns, values, nothing_left_out, signals.dq, get_known_speeds(estimate))
    reference = estimate.reference.vector
    # Loads that effects depend on are predicted with these parameters, which are numbers of the model and no inputs.
    torque = ca.substitute(ca.densify(torque), signals.reference, ca.SX(ca.DM(reference)))
    # The model's columns contain the state at the sample itself; the exported formula computes it from the state and
    # the position of the sample before.
    states = [signals.memory(item) for item in observation.memory]
    arguments = _list_motion_arguments(signals, torque)
    z_next = ca.SX(0, 1)
    if states:
        before, z = ca.SX.sym("q_before", model.robot.n), ca.SX.sym("z", len(states))
        moved = build_all_positions(model.robot, signals.q) - build_all_positions(model.robot, before)
        z_next = ca.vertcat(
            *(build_step_expression(item, z[k], moved[item.joint]) for k, item in enumerate(observation.memory))
        )
        torque = ca.substitute(torque, ca.vertcat(*states), z_next)
        arguments += [
            Argument("z", z, "hysteresis states, -1 to 1, before the step; 0 at the start of a run"),
            Argument("q_before", before, "q of the sample before; q itself at the start of a run"),
        ]
    if observation.runs:
        present = ca.vertcat(*(signals.in_runs(item) for item in observation.runs))
        arguments.append(Argument("runs", present, describe_runs(observation.runs)))
    return TorqueFormula(model.robot, tuple(arguments), torque, observation.memory, observation.runs, z_next)


def _list_motion_arguments(signals: Signals, torque: ca.SX) -> list[Argument]:
    """Return the signals that the torque depends on, and position, velocity and acceleration in any case."""
    candidates = list_motion_arguments(signals)
    return [
        argument
        for argument in candidates
        if argument.name in ("q", "dq", "ddq") or ca.depends_on(torque, argument.symbol)
    ]


def to_casadi(identification: Identification) -> ca.Function:
    """Return the identified inverse dynamic model as a CasADi function.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.

    Returns
    -------
    casadi.Function
        Its inputs are column vectors with names: q, dq, ddq (rad, rad/s, rad/s²; m for prismatic joints), and where an
        effect needs them dddq, ddddq, time (s), period (s), temperature (°C), z and q_before, runs. Its output is tau
        (n, 1) in N m or N; a model with hysteresis also returns z_next, which is z of the next sample. At the start of
        a motion z = 0 and q_before = q; without them the torque is NaN. Joints have the robot's order.
    """
    return build_function(build_torque_formula(identification.estimate))


def build_function(formula: TorqueFormula) -> ca.Function:
    """Return the formula as a CasADi function; it raises a DynidentError for a robot with contacts."""
    formula.robot.require_no_contacts("whole torque to export")
    outputs, names = [formula.torque], ["tau"]
    if formula.memory:
        outputs.append(formula.z_next)
        names.append("z_next")
    symbols = [argument.symbol for argument in formula.arguments]
    # CasADi replaces missing inputs by their defaults. The usual default 0 would silently lose the hysteresis; NaN
    # makes a forgotten state visible.
    defaults = [math.nan if name in ("z", "q_before") else 0.0 for name in formula.names]
    options = {"default_in": defaults}
    # Columns share many terms, which are computed once (cse).
    return ca.Function("inverse_dynamics", symbols, ca.cse(outputs), list(formula.names), names, options)


def to_casadi_bytes(identification: Identification) -> bytes:
    """Return the content of a file that `casadi.Function.load` reads."""
    # CasADi writes its functions to files only.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.casadi"
        to_casadi(identification).save(str(path))
        return path.read_bytes()
