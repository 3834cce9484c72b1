"""Write the inverse dynamic model as one C99 file; also the translation of CasADi expressions to C statements.

The file declares and defines one function that computes the torque of a sample, and where the model has hysteresis a
state with a function that relaxes it. Compile the file as it is; to get the declarations alone, define
`…_DECLARATIONS_ONLY` and include it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import casadi as ca

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.export.casadi_function import TorqueFormula, build_function, build_torque_formula
from dynident.export.comments_and_names import (
    SIGNS,
    describe_identification,
    describe_origin,
    escape_c_comment,
    list_joints,
    make_slug,
)
from dynident.identification import Identification
from dynident.identification.identified_models.equation_of_motion import Argument
from dynident.validation.contact_detection import ContactDetection
from dynident.validation.momentum_observer import SETTLED

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
        raise DynidentError(
            f"the model contains the number {value}, which C code cannot represent", title="Not expressible in C"
        )
    text = repr(float(value))
    # In brackets: after an operator a minus sign would make two of them, and C reads -- as one of its own.
    return f"({text})" if text.startswith("-") else text


def write_c_statements(
    function: ca.Function, inputs: Sequence[Sequence[str]], outputs: Sequence[Sequence[str]]
) -> tuple[list[str], set[str]]:
    """Return the statements that compute a function of SX, and the names of the inputs that they read.

    Parameters
    ----------
    function : casadi.Function
        Function of SX, expanded to scalar operations.
    inputs, outputs : sequence of sequence of str
        C expressions such as `q[0]`, one for every entry of every input, and of every (dense) output.

    Returns
    -------
    statements : list of str
        C statements, in the order in which they are to run.
    read : set of str
        C expressions of the inputs that they read.

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
        # Inputs, constants and outputs need no variable of their own: their C expressions are put where they are used.
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
                f"the model uses an operation (number {operation} of CasADi) that the C export does not support; "
                "export a CasADi function instead",
                title="Not expressible in C",
            )
    # Outputs are written last, because a caller may pass the same array as an input and as the output.
    return statements + ends, read


_WIDTH = 110
_STATE = ("z", "q_before")


def make_c_name(identification: Identification) -> str:
    """Return the prefix of all names in the file."""
    return f"dynident_{make_slug(identification.model.robot.name)}"


def to_c(identification: Identification, notes: Sequence[str] = ()) -> str:
    """Return the C99 source of the identified inverse dynamic model.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    notes : sequence of str
        Sentences that users must know, for the head of the file.

    Returns
    -------
    str
        The text of one file.

    Raises
    ------
    DynidentError
        For an effect of another distribution whose columns use an operation that C code is not written for.
    """
    formula, name = build_torque_formula(identification.estimate), make_c_name(identification)
    # One file serves as header and as source: the guard lets others include its declarations alone.
    guard = name.upper()
    parts = [
        write_c_comment(_write_header(identification, formula, name, notes)),
        f"#ifndef {guard}_H\n#define {guard}_H\n",
        f"#define {guard}_JOINTS {formula.robot.n}\n",
        _write_declarations(formula, name),
        f"#endif /* {guard}_H */\n",
        f"#ifndef {guard}_DECLARATIONS_ONLY\n\n#include <math.h>\n",
        _write_definitions(formula, name),
        f"#endif /* {guard}_DECLARATIONS_ONLY */\n",
    ]
    return "\n".join(parts)


def _write_header(identification: Identification, formula: TorqueFormula, name: str, notes: Sequence[str]) -> list[str]:
    lines = [f"{name}.c: inverse dynamic model of a robot, {describe_origin()}.", ""]
    lines += [*describe_identification(identification), "", SIGNS, *notes, "", "Joints, in the order of every array:"]
    lines += [f"  [{j.number - 1}] {j.name}: {j.kind}, torque in {j.unit}" for j in list_joints(identification)]
    lines += ["", f"Arguments of {name}_torque:"]
    lines += [f"  {argument.name}: {argument.meaning}" for argument in formula.arguments if argument.name not in _STATE]
    if formula.memory:
        lines.append(f"  state: the state of effects with hysteresis; call {name}_start at the start of a run, then")
        lines.append(f"      {name}_torque once per sample, in order of time")
    lines += ["  tau: the torque (out); must not overlap the other arrays", "", "Base parameters:"]
    for parameter in identification.parameters:
        deviation = f"(s. d. {parameter.standard_deviation:.2g})"
        lines.append(f"  {parameter.name} = {parameter.value:.9g} {parameter.unit} {deviation}: {parameter.grouping}")
    return lines


def write_c_comment(lines: list[str]) -> str:
    """Return lines as one C comment, wrapped and without comment marks of their own."""
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
        # The state is kept last: until then the statements read the position before.
        body.append(f"for (j = 0; j < {formula.robot.n}; j++) state->q_before[j] = q[j];")
        body.append("state->started = 1;")
    functions = [SIGN_FUNCTION] if any("sign_of(" in line for line in statements) else []
    if formula.memory:
        functions.append(_write_start_function(formula, name))
    functions.append(f"{_write_signature(formula, name)}\n{write_c_block(body)}")
    return "\n\n".join(functions) + "\n"


def _write_start_function(formula: TorqueFormula, name: str) -> str:
    body = [
        "int k;",
        f"for (k = 0; k < {len(formula.memory)}; k++) state->z[k] = 0.0;",
        f"for (k = 0; k < {formula.robot.n}; k++) state->q_before[k] = 0.0;",
        "state->started = 0;",
    ]
    return f"void {name}_start({name}_state *state)\n{write_c_block(body)}"


def write_c_block(body: list[str]) -> str:
    """Return statements as an indented block."""
    return "{\n" + "".join(f"    {line}\n" for line in body) + "}"


def _list_entries(argument: Argument) -> list[str]:
    """Return C expressions of the entries of an argument."""
    if argument.name in ("time", "period"):
        return [_name_argument(argument)]
    owner = "state->z" if argument.name == "z" else argument.name
    return [f"{owner}[{k}]" for k in range(argument.size)]


OBSERVER = """\
/* Observer of contacts by the generalised momentum; residual: torque of contacts, positive where it drives q */
typedef struct {
    double q[N];
    double dq[N];
    double tau[N];
    double momentum[N];
    double residual[N];
    double since_slow[N]; /* time constants of the residual since a joint was slow */
    int started;
    STATE
} PREFIX_observer;

/* Begin at rest and without contact */
static inline void PREFIX_observer_start(PREFIX_observer *o)
{
    int j;
    for (j = 0; j < N; j++) {
        o->q[j] = o->dq[j] = o->tau[j] = o->momentum[j] = o->residual[j] = o->since_slow[j] = 0.0;
    }
    o->started = 0;
    START
}

/* Next sample: positions, motor torques, sampling period in s, bandwidth of the residual in 1/s (30 as a rule) */
static inline void PREFIX_observe(
    const PREFIX_parameters *p, PREFIX_observer *o, const double q[N], const double tau[N], double period, double gain)
{
    const double rate = 4.0 * gain * period;
    double dq[N], terms[2N];
    int j;
    for (j = 0; j < N; j++) {
        const double before = o->started ? o->q[j] : q[j];
        o->q[j] = (before + rate * q[j]) / (1.0 + rate);
        o->tau[j] = ((o->started ? o->tau[j] : tau[j]) + rate * tau[j]) / (1.0 + rate);
        dq[j] = (o->q[j] - before) / period;
        o->dq[j] = dq[j];
        o->since_slow[j] = fabs(dq[j]) < SLOW ? 0.0 : o->since_slow[j] + gain * period;
    }
    ADVANCE
    PREFIX_observer_terms(p, ARGUMENTS, terms);
    for (j = 0; j < N; j++) {
        const double change = o->started ? terms[j] - o->momentum[j] - period * (terms[N + j] + o->tau[j]) : 0.0;
        o->residual[j] = (o->residual[j] + gain * change) / (1.0 + gain * period);
        o->momentum[j] = terms[j];
    }
    o->started = 1;
}"""
"""Observer of contacts in C, in which `export.c_header` replaces the words in capitals."""

_CONTACTS = """\
/* Whether a value is a finite number. Its bits tell, because -ffast-math takes it for granted in comparisons */
static inline int PREFIX_is_finite(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (bits >> 52 & 0x7ffu) != 0x7ffu;
}

/* After every PREFIX_observe with a gain of GAIN: contacts[j] is 1 where the residual of joint j is beyond its
   threshold, in N m or N; returns how many are. A residual that is not a number counts as beyond, and stays so until
   PREFIX_observer_start: after such a sample no contact would show. The first threshold holds while a joint is slow or
   has just been, the others for classes of its speed, up to the speeds in rad/s or m/s */
static inline int PREFIX_find_contacts(const PREFIX_observer *o, int contacts[N])
{
    static const double speeds[N][CLASSES] = SPEEDS;
    static const double thresholds[N][COUNT] = THRESHOLDS;
    int j, k, class_of_speed, found = 0;
    for (j = 0; j < N; j++) {
        class_of_speed = 0;
        if (o->since_slow[j] >= SETTLED) {
            class_of_speed = 1;
            for (k = 0; k < CLASSES; k++) class_of_speed += fabs(o->dq[j]) > speeds[j][k];
        }
        contacts[j] = !PREFIX_is_finite(o->residual[j]) || fabs(o->residual[j]) > thresholds[j][class_of_speed];
        found += contacts[j];
    }
    return found;
}"""


def write_contacts(contact: ContactDetection, name: str) -> str:
    """Return the C function that compares the observer's residual with its thresholds.

    Parameters
    ----------
    contact : ContactDetection
        The thresholds.
    name : str
        Prefix of all names in the file.
    """
    text = _CONTACTS
    for place, content in (
        ("PREFIX", name),
        ("CLASSES", str(contact.speeds.shape[1])),
        ("COUNT", str(contact.thresholds.shape[1])),
        ("SPEEDS", _write_table(contact.speeds)),
        ("THRESHOLDS", _write_table(contact.thresholds)),
        ("SETTLED", format_c_number(SETTLED)),
        ("GAIN", format_c_number(contact.gain)),
        ("[N]", f"[{len(contact.speeds)}]"),
        ("< N", f"< {len(contact.speeds)}"),
    ):
        text = text.replace(place, content)
    return text


def _write_table(rows: FloatArray) -> str:
    # A joint that was not recorded long enough has no threshold: nothing is above the largest number. Infinity would be
    # refused by compilers that are told -ffast-math.
    cells = (", ".join(format_c_number(float(x)) if math.isfinite(x) else "DBL_MAX" for x in row) for row in rows)
    return "{" + ", ".join(f"{{{row}}}" for row in cells) + "}"
