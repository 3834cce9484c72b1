"""Translate CasADi's list of instructions to C99 statements, one constant for each intermediate value."""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca

from dynident.errors import DynidentError

_UNARY = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "({0} == 0.0) ? 1.0 : 0.0",
    ca.OP_SIGN: "sign_of({0})",
    ca.OP_FABS: "fabs({0})",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_EXP: "exp({0})",
    ca.OP_LOG: "log({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_TAN: "tan({0})",
    ca.OP_ASIN: "asin({0})",
    ca.OP_ACOS: "acos({0})",
    ca.OP_ATAN: "atan({0})",
    ca.OP_SINH: "sinh({0})",
    ca.OP_COSH: "cosh({0})",
    ca.OP_TANH: "tanh({0})",
    ca.OP_FLOOR: "floor({0})",
    ca.OP_CEIL: "ceil({0})",
    ca.OP_ERF: "erf({0})",
}
_BINARY = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    ca.OP_FMIN: "fmin({0}, {1})",
    ca.OP_FMAX: "fmax({0}, {1})",
    ca.OP_FMOD: "fmod({0}, {1})",
    ca.OP_ATAN2: "atan2({0}, {1})",
    ca.OP_COPYSIGN: "copysign({0}, {1})",
    ca.OP_LT: "({0} < {1}) ? 1.0 : 0.0",
    ca.OP_LE: "({0} <= {1}) ? 1.0 : 0.0",
    ca.OP_EQ: "({0} == {1}) ? 1.0 : 0.0",
    ca.OP_NE: "({0} != {1}) ? 1.0 : 0.0",
    ca.OP_AND: "({0} != 0.0 && {1} != 0.0) ? 1.0 : 0.0",
    ca.OP_OR: "({0} != 0.0 || {1} != 0.0) ? 1.0 : 0.0",
    ca.OP_IF_ELSE_ZERO: "({0} != 0.0) ? {1} : 0.0",
}
_C: dict[int, str] = _UNARY | _BINARY

SIGN_FUNCTION = "static double sign_of(double x)\n{\n    return (double)((x > 0.0) - (x < 0.0));\n}"
"""C function that the statements call beside those of <math.h>."""


def format_c_number(value: float) -> str:
    """Return a number as C writes it, to the last digit."""
    if not math.isfinite(value):
        raise DynidentError(f"the model holds the number {value}, which C code cannot", title="Not expressible in C")
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def write_c_statements(
    function: ca.Function, inputs: Sequence[Sequence[str]], outputs: Sequence[Sequence[str]]
) -> tuple[list[str], set[str]]:
    """Return the statements that compute a function of SX, and the names of the inputs that they read.

    Parameters
    ----------
    function : casadi.Function
    inputs, outputs : a C expression for every entry of every input, and of every (dense) output
        `q[0]`, `q[1]`, …

    Raises
    ------
    DynidentError
        For an operation that C code is not written for.
    """
    # CasADi reuses its work slots: `holds` maps a slot to the C expression that is in it at this instruction.
    holds: dict[int, str] = {}
    statements: list[str] = []
    ends: list[str] = []
    read: set[str] = set()
    for k in range(function.n_instructions()):
        operation, target, source = (
            function.instruction_id(k),
            function.instruction_output(k),
            function.instruction_input(k),
        )
        if operation == ca.OP_INPUT:
            holds[target[0]] = inputs[source[0]][source[1]]
            read.add(holds[target[0]])
        elif operation == ca.OP_CONST:
            holds[target[0]] = format_c_number(float(function.instruction_constant(k)))
        elif operation == ca.OP_OUTPUT:
            ends.append(f"{outputs[target[0]][target[1]]} = {holds[source[0]]};")
        elif operation in _C:
            statements.append(f"const double v{k} = {_C[operation].format(*(holds[r] for r in source))};")
            holds[target[0]] = f"v{k}"
        else:
            raise DynidentError(
                f"the model uses an operation (number {operation} of CasADi) that C code is not written for; export a "
                "CasADi function instead",
                title="Not expressible in C",
            )
    # Outputs are written last, because a caller may pass the same array as an input and as the output.
    return statements + ends, read
