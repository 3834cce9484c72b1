"""Write the identified inverse dynamic model as one C99 file that needs only a C compiler and its math library.

The file declares and defines one function that computes the torque of a sample, and where the model has hysteresis a
state with a function that relaxes it. Compile the file as it is; to get the declarations alone, define
`…_DECLARATIONS_ONLY` and include it.
"""

from __future__ import annotations

import textwrap

from dynident.export.c_instructions import SIGN_FUNCTION, write_c_statements
from dynident.export.casadi_function import build_function
from dynident.export.formula import Argument, TorqueFormula, build_torque_formula
from dynident.export.names import escape_c_comment, make_slug
from dynident.export.summary import SIGNS, describe_identification, describe_origin, list_joints
from dynident.identification import Identification

_WIDTH = 110
_STATE = ("z", "q_before")


def make_c_name(identification: Identification) -> str:
    """Return the prefix of all names in the file."""
    return f"dynident_{make_slug(identification.model.robot.name)}"


def to_c(identification: Identification) -> str:
    """Return the C99 source of the identified inverse dynamic model.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    str

    Raises
    ------
    DynidentError
        For an effect of another distribution whose columns use an operation that C code is not written for.
    """
    formula, name = build_torque_formula(identification.estimate), make_c_name(identification)
    guard = name.upper()
    parts = [
        _write_comment(_write_header(identification, formula, name)),
        f"#ifndef {guard}_H\n#define {guard}_H\n",
        f"#define {guard}_JOINTS {formula.robot.n}\n",
        _write_declarations(formula, name),
        f"#endif /* {guard}_H */\n",
        f"#ifndef {guard}_DECLARATIONS_ONLY\n\n#include <math.h>\n",
        _write_definitions(formula, name),
        f"#endif /* {guard}_DECLARATIONS_ONLY */\n",
    ]
    return "\n".join(parts)


def _write_header(identification: Identification, formula: TorqueFormula, name: str) -> list[str]:
    lines = [f"{name}.c: inverse dynamic model of a robot, {describe_origin()}.", ""]
    lines += [*describe_identification(identification), "", SIGNS, "", "Joints, in the order of every array:"]
    lines += [f"  [{j.number - 1}] {j.name}: {j.kind}, torque in {j.unit}" for j in list_joints(identification)]
    lines += ["", f"Arguments of {name}_torque:"]
    lines += [f"  {argument.name}: {argument.meaning}" for argument in formula.arguments if argument.name not in _STATE]
    if formula.memory:
        lines.append(f"  state: the past of the run, for effects with hysteresis; {name}_start at its start, then one")
        lines.append("      call a sample, in the order of time")
    lines += ["  tau: the torque (out); another array than the others", "", "Base parameters:"]
    for parameter in identification.parameters:
        deviation = f"(s. d. {parameter.standard_deviation:.2g})"
        lines.append(f"  {parameter.name} = {parameter.value:.9g} {parameter.unit} {deviation}: {parameter.grouping}")
    return lines


def _write_comment(lines: list[str]) -> str:
    wrapped = []
    for line in lines:
        indent = " " * (len(line) - len(line.lstrip()))
        text = escape_c_comment(line).rstrip()
        wrapped += textwrap.wrap(text, _WIDTH, subsequent_indent=f"{indent}    ") or [""]
    # Text is made safe before wrapping. That is enough, because wrapping breaks at blanks only and so joins no
    # characters to a new */ or /*.
    return "/*\n" + "".join(f" * {line}".rstrip() + "\n" for line in wrapped) + " */\n"


def _write_declarations(formula: TorqueFormula, name: str) -> str:
    text = '#ifdef __cplusplus\nextern "C" {\n#endif\n\n'
    if formula.memory:
        text += (
            "typedef struct {\n"
            f"    double z[{len(formula.memory)}]; /* hysteresis states, -1 to 1 */\n"
            f"    double q_before[{formula.robot.n}];\n"
            "    int started;\n"
            f"}} {name}_state;\n\n"
            f"void {name}_start({name}_state *state);\n"
        )
    return text + f"{_write_signature(formula, name)};\n\n#ifdef __cplusplus\n}}\n#endif\n"


def _write_signature(formula: TorqueFormula, name: str) -> str:
    arguments = [_write_parameter(argument) for argument in formula.arguments if argument.name not in _STATE]
    if formula.memory:
        arguments.append(f"{name}_state *state")
    arguments.append(f"double tau[{formula.robot.n}]")
    separator = ",\n    "
    return f"void {name}_torque(\n    {separator.join(arguments)})"


def _write_parameter(argument: Argument) -> str:
    if argument.name in ("time", "period"):
        return f"double {_name_argument(argument)}"
    return f"const double {argument.name}[{argument.size}]"


def _name_argument(argument: Argument) -> str:
    # `time` is a function of C's standard library.
    return "t" if argument.name == "time" else argument.name


def _write_definitions(formula: TorqueFormula, name: str) -> str:
    inputs = [_list_entries(argument) for argument in formula.arguments]
    outputs = [[f"tau[{j}]" for j in range(formula.robot.n)]]
    if formula.memory:
        outputs.append([f"state->z[{k}]" for k in range(len(formula.memory))])
    statements, read = write_c_statements(build_function(formula), inputs, outputs)
    body: list[str] = []
    # At the first sample no position was before: q itself makes the displacement zero.
    if formula.memory:
        body += ["int j;", f"double q_before[{formula.robot.n}];"]
        body.append(
            f"for (j = 0; j < {formula.robot.n}; j++) q_before[j] = state->started ? state->q_before[j] : q[j];"
        )
    # Compilers warn of parameters that are never read.
    body += [
        f"(void){_name_argument(argument)};"
        for argument, places in zip(formula.arguments, inputs, strict=True)
        if argument.name not in _STATE and not read & set(places)
    ]
    body += statements
    if formula.memory:
        body.append(f"for (j = 0; j < {formula.robot.n}; j++) state->q_before[j] = q[j];")
        body.append("state->started = 1;")
    functions = [SIGN_FUNCTION] if any("sign_of(" in line for line in statements) else []
    if formula.memory:
        functions.append(_write_start_function(formula, name))
    functions.append(f"{_write_signature(formula, name)}\n{_write_block(body)}")
    return "\n\n".join(functions) + "\n"


def _write_start_function(formula: TorqueFormula, name: str) -> str:
    body = [
        "int k;",
        f"for (k = 0; k < {len(formula.memory)}; k++) state->z[k] = 0.0;",
        f"for (k = 0; k < {formula.robot.n}; k++) state->q_before[k] = 0.0;",
        "state->started = 0;",
    ]
    return f"void {name}_start({name}_state *state)\n{_write_block(body)}"


def _write_block(body: list[str]) -> str:
    return "{\n" + "".join(f"    {line}\n" for line in body) + "}"


def _list_entries(argument: Argument) -> list[str]:
    """Return C expressions of the entries of an argument."""
    if argument.name in ("time", "period"):
        return [_name_argument(argument)]
    owner = "state->z" if argument.name == "z" else argument.name
    return [f"{owner}[{k}]" for k in range(argument.size)]
