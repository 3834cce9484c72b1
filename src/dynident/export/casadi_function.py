"""The identified torque as a CasADi function: to be called, differentiated, or put into an optimal control problem."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import casadi as ca

from dynident.export.formula import TorqueFormula, torque_formula
from dynident.identification import Identification


def to_casadi(identification: Identification) -> ca.Function:
    """Return the identified inverse dynamic model as a CasADi function.

    Its inputs are column vectors, called by name: q, dq, ddq (rad, rad/s, rad/s²; m for prismatic joints), and where an
    effect needs them dddq, ddddq, time (s), period (s), temperature (°C), z and q_before, runs. Its output is tau
    (n, 1) in N m or N; a model with hysteresis also gives z_next, which is z of the next sample. Without z or q_before
    (z = 0 and q_before = q at the start of a motion) its torque is not a number. Joints stand in the robot's order.
    """
    return function_of(torque_formula(identification.estimate))


def function_of(formula: TorqueFormula) -> ca.Function:
    """The formula as a function."""
    outputs, names = [formula.torque], ["tau"]
    if formula.memory:
        outputs.append(formula.z_next)
        names.append("z_next")
    symbols = [argument.symbol for argument in formula.arguments]
    # CasADi takes what is not given as its default. That is 0 by itself, which would lose the hysteresis unseen.
    defaults = [math.nan if name in ("z", "q_before") else 0.0 for name in formula.names]
    options = {"default_in": defaults}
    return ca.Function("inverse_dynamics", symbols, ca.cse(outputs), list(formula.names), names, options)


def casadi_bytes(identification: Identification) -> bytes:
    """The function as a file that `casadi.Function.load` reads."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.casadi"
        to_casadi(identification).save(str(path))
        return path.read_bytes()
