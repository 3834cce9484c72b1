"""Export the identified torque as a CasADi function, to call, differentiate, or use in optimal control."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import casadi as ca

from dynident.export.formula import TorqueFormula, build_torque_formula
from dynident.identification import Identification


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
    """Return the formula as a CasADi function."""
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
