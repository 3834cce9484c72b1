"""Write M, C, g, friction and a momentum observer of a model as one C or C++ header for controllers.

The header needs only a compiler and its math library. It allocates no memory and throws nothing. Parameters, load and
hysteresis states are structures of the caller. The C++ header is the C header with a class around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from dynident.export.c_code import (
    OBSERVER,
    SIGN_FUNCTION,
    format_c_number,
    make_c_name,
    write_c_block,
    write_c_comment,
    write_c_statements,
    write_contacts,
)
from dynident.export.comments_and_names import SIGNS, describe_identification, describe_origin, list_joints
from dynident.export.feasible_links_and_joints import ExportedFile
from dynident.identification import Identification
from dynident.identification.identified_models.equation_of_motion import (
    Argument,
    EquationOfMotion,
    build_equation_of_motion,
)
from dynident.recordings.joint_phases import SLOW
from dynident.robot.robot_model import INERTIAL_NAMES
from dynident.text_encoding import encode_text
from dynident.validation.contact_detection import ContactDetection

_SCALARS = ("time", "period")


_INCLUDES = "".join(f"#include <{name}.h>\n" for name in ("float", "math", "stdint", "string"))


@dataclass(frozen=True, eq=False)
class HeaderFunction:
    """One function of the header.

    Parameters
    ----------
    name, meaning : str
        Its name behind the prefix, and what it computes.
    inputs : tuple of Argument
        Its arguments behind the parameters.
    output, expression : str, SX
        Name of the array that it writes, and what stands in the array, row by row.
    """

    name: str
    meaning: str
    inputs: tuple[Argument, ...]
    output: str
    expression: ca.SX

    @property
    def size(self) -> int:
        """Number of entries of the output."""
        return int(self.expression.numel())

    @property
    def has_state(self) -> bool:
        """Whether it reads hysteresis states."""
        return any(argument.name == "z" for argument in self.inputs)


def to_c_header(
    identification: Identification, contact: ContactDetection | None = None, notes: Sequence[str] = ()
) -> ExportedFile:
    """Return the equation of motion of the identified model as a C99 header.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    contact : ContactDetection, optional
        Thresholds for the observer of contacts, of the same model.
    notes : sequence of str
        Further sentences that users must know, for the head of the file and its notes.

    Returns
    -------
    ExportedFile
        The header, with notes on what a controller must know.

    Raises
    ------
    DynidentError
        For an effect of another distribution whose columns use an operation that C code is not written for.
    """
    header = Header.from_identification(identification, contact, notes)
    return ExportedFile(f"{header.name}.h", "text/x-c", encode_text(header.write_c()), header.notes)


def to_cpp_header(
    identification: Identification, contact: ContactDetection | None = None, notes: Sequence[str] = ()
) -> ExportedFile:
    """Return the equation of motion of the identified model as a C++17 header: the C header and a class around it.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    contact : ContactDetection, optional
        Thresholds for the observer of contacts, of the same model.
    notes : sequence of str
        Further sentences that users must know, for the head of the file and its notes.

    Returns
    -------
    ExportedFile
        The header, with notes on what a controller must know.

    Raises
    ------
    DynidentError
        As `to_c_header` does.
    """
    header = Header.from_identification(identification, contact, notes)
    return ExportedFile(f"{header.name}.hpp", "text/x-c++", encode_text(header.write_cpp()), header.notes)


@dataclass(frozen=True, eq=False)
class Header:
    """The functions of an identified model, the prefix of their names, and notes for users, a sentence each."""

    identification: Identification
    equation: EquationOfMotion
    name: str
    functions: tuple[HeaderFunction, ...]
    notes: tuple[str, ...]
    contact: ContactDetection | None = None

    @classmethod
    def from_identification(
        cls, identification: Identification, contact: ContactDetection | None = None, notes: Sequence[str] = ()
    ) -> Header:
        """Return the header of an identified model, with all functions."""
        equation = build_equation_of_motion(identification.estimate)
        functions, notes = list_functions(equation), list(notes)
        if equation.acceleration_obstacle:
            notes.append(f"There is no forward_dynamics: {equation.acceleration_obstacle}.")
        if equation.observer_obstacle:
            notes.append(f"There is no observer of contacts: {equation.observer_obstacle}.")
        elif contact is not None:
            notes.append(contact.describe())
        return cls(identification, equation, make_c_name(identification), functions, tuple(notes), contact)

    @property
    def n_states(self) -> int:
        """Number of hysteresis states."""
        return int(self.equation.z_next.numel())

    def write_c(self) -> str:
        """Return the text of the C header."""
        guard = f"{self.name.upper()}_H"
        sections = [
            write_c_comment(self._write_head(f"{self.name}.h")),
            f"#ifndef {guard}\n#define {guard}\n\n{_INCLUDES}",
            self._write_body(),
            f"#endif /* {guard} */\n",
        ]
        return "\n".join(sections)

    def write_cpp(self) -> str:
        """Return the text of the C++ header."""
        guard = f"{self.name.upper()}_HPP"
        # A program may include both headers: the C part then stands in it once.
        once = f"{self.name.upper()}_H"
        sections = [
            write_c_comment(self._write_head(f"{self.name}.hpp")),
            f"#ifndef {guard}\n#define {guard}\n\n#include <array>\n#include <cmath>\n#include <cstddef>\n",
            "#ifdef DYNIDENT_USE_EIGEN\n#include <Eigen/Core>\n#endif\n",
            f"#ifndef {once}\n#define {once}\n\n{_INCLUDES}",
            self._write_body(),
            f"#endif /* {once} */\n",
            self._write_class(),
            f"#endif /* {guard} */\n",
        ]
        return "\n".join(sections)

    def _write_head(self, file: str) -> list[str]:
        lines = [f"{file}: equation of motion of a robot, {describe_origin()}.", ""]
        lines += [*describe_identification(self.identification), "", SIGNS, "", *self.notes]
        lines += ["", "Joints, in the order of every array:"]
        joints = list_joints(self.identification)
        lines += [f"  [{j.number - 1}] {j.name}: {j.kind}, torque in {j.unit}" for j in joints]
        lines += ["", "Arguments:"]
        lines += [f"  {a.name}: {a.meaning}" for a in self.equation.arguments if a.name != "z"]
        lines += [
            f"  p: parameters, which may change at run time; begin with {self.name}_identified()",
            "  p->payload: inertial parameters of a load on the last link, added to its own, in the link's frame; "
            f"{self.name}_set_payload computes them. Loads that friction depends on stay those of the identified model",
        ]
        if self.n_states:
            lines.append(
                f"  state: hysteresis; call {self.name}_start before a motion and {self.name}_advance once a sample, "
                "before the other functions"
            )
        lines += ["", "Functions:"]
        lines += [f"  {self.name}_{function.name}: {function.meaning}" for function in self.functions]
        lines += ["Results may overwrite arguments.", "", "Base parameters, in the order of p->base:"]
        for k, parameter in enumerate(self.identification.parameters):
            deviation = f"(s. d. {parameter.standard_deviation:.2g})"
            lines.append(
                f"  [{k}] {parameter.name} = {parameter.value:.9g} {parameter.unit} {deviation}: {parameter.grouping}"
            )
        return lines

    def _write_body(self) -> str:
        name, big, n = self.name, self.name.upper(), self.equation.robot.n
        values = ", ".join(format_c_number(float(value)) for value in self.identification.values)
        sections = [
            f"#define {big}_JOINTS {n}\n#define {big}_PARAMETERS {len(self.identification.values)}",
            f"typedef struct {{\n    double base[{len(self.identification.values)}];\n    double payload[{_TEN}]; "
            f"/* {' '.join(INERTIAL_NAMES)} */\n}} {name}_parameters;",
            f"static inline {name}_parameters {name}_identified(void)\n"
            + write_c_block(
                [f"const {name}_parameters p = {{{{{values}}}, {{{', '.join(['0.0'] * _TEN)}}}}};", "return p;"]
            ),
            _SET_PAYLOAD.replace("PREFIX", name),
        ]
        if self.n_states:
            sections += self._write_state()
        sections += [self._write_function(function) for function in self.functions]
        text = "\n\n".join(sections + self._write_observer())
        # Its name must differ from that in the headers of other models, which one program may include as well.
        signs = SIGN_FUNCTION.replace("static double", "static inline double") + "\n\n" if "sign_of(" in text else ""
        return (signs + text).replace("sign_of(", f"{name}_sign(") + "\n"

    def _write_state(self) -> list[str]:
        """Return the structure of the hysteresis states, and the functions that start and advance them."""
        name, n, equation = self.name, self.equation.robot.n, self.equation
        function = ca.Function("advance", [equation.get_symbol("q"), equation.q_before, equation.get_symbol("z")],
                               ca.cse([ca.densify(equation.z_next)]))  # fmt: skip
        inputs = [_list_entries(_Array("q", n)), _list_entries(_Array("q_before", n)),
                  [f"state->z[{k}]" for k in range(self.n_states)]]  # fmt: skip
        statements, read = write_c_statements(function, inputs, [[f"state->z[{k}]" for k in range(self.n_states)]])
        start = [
            "int k;",
            f"for (k = 0; k < {self.n_states}; k++) state->z[k] = 0.0;",
            f"for (k = 0; k < {n}; k++) state->q_before[k] = 0.0;",
            "state->started = 0;",
        ]
        # At the first sample no position was before: q itself makes the displacement zero.
        advance = [
            f"double q_before[{n}];",
            "int j;",
            f"for (j = 0; j < {n}; j++) q_before[j] = state->started ? state->q_before[j] : q[j];",
            *([] if read & set(inputs[1]) else ["(void)q_before;"]),
            *statements,
            f"for (j = 0; j < {n}; j++) state->q_before[j] = q[j];",
            "state->started = 1;",
        ]
        return [
            f"typedef struct {{\n    double z[{self.n_states}]; /* -1 to 1 */\n    double q_before[{n}];\n"
            f"    int started;\n}} {name}_state;",
            f"static inline void {name}_start({name}_state *state)\n{write_c_block(start)}",
            f"static inline void {name}_advance({name}_state *state, const double q[{n}])\n{write_c_block(advance)}",
        ]

    def _write_function(self, function: HeaderFunction) -> str:
        equation = self.equation
        symbols = [argument.symbol for argument in function.inputs] + [equation.base, equation.payload]
        places = [_list_entries(_Array(argument.name, argument.size)) for argument in function.inputs]
        places += [[f"p->base[{k}]" for k in range(equation.base.numel())], [f"p->payload[{k}]" for k in range(_TEN)]]
        # The transpose lists a matrix row by row, as C does.
        output = ca.densify(ca.vec(function.expression.T))
        computed = ca.Function(function.name, symbols, ca.cse([output]))
        statements, read = write_c_statements(
            computed, places, [[f"{function.output}[{k}]" for k in range(function.size)]]
        )
        unused = [
            f"(void){_name_argument(argument.name)};"
            for argument, entries in zip(function.inputs, places, strict=False)
            if not read & set(entries)
        ]
        if not read & set(places[-1] + places[-2]):
            unused.append("(void)p;")
        arguments = [f"const {self.name}_parameters *p"]
        arguments += [_write_argument(argument, self.name) for argument in function.inputs]
        arguments.append(f"double {function.output}[{function.size}]")
        return (
            f"/* {function.meaning} */\nstatic inline void {self.name}_{function.name}(\n    "
            + ",\n    ".join(arguments)
            + f")\n{write_c_block(unused + statements)}"
        )

    def _write_observer(self) -> list[str]:
        """Return the observer of contacts, where the model allows one."""
        equation, n = self.equation, self.equation.robot.n
        if equation.observer_obstacle:
            return []
        terms = equation.build_observer_terms()
        optional = [a for a in equation.arguments if a.name in ("period", "z") and ca.depends_on(terms, a.symbol)]
        inputs = (*(a for a in equation.arguments if a.name in ("q", "dq")), *optional)
        meaning = "momentum, then its rate without motors and contacts"
        function = HeaderFunction("observer_terms", meaning, inputs, "terms", terms)
        passed = {"q": "o->q", "dq": "dq", "z": "&o->state", "period": "period"}
        remembers = self.n_states > 0
        text = OBSERVER
        for place, content in (
            ("    STATE\n", f"    {self.name}_state state;\n" if remembers else ""),
            ("    START\n", f"    {self.name}_start(&o->state);\n" if remembers else ""),
            ("    ADVANCE\n", f"    {self.name}_advance(&o->state, o->q);\n" if remembers else ""),
            ("ARGUMENTS", ", ".join(passed[a.name] for a in inputs)),
            ("SLOW", format_c_number(SLOW)),
            ("PREFIX", self.name),
            ("[2N]", f"[{2 * n}]"),
            ("[N]", f"[{n}]"),
            ("< N", f"< {n}"),
            ("[N + j]", f"[{n} + j]"),
        ):
            text = text.replace(place, content)
        contacts = [] if self.contact is None else [write_contacts(self.contact, self.name)]
        return [self._write_function(function), text, *contacts]

    def _write_class(self) -> str:
        """Return the C++ class around the functions."""
        n = self.equation.robot.n
        lines = [
            f"namespace {self.name} {{",
            "",
            "/* The equation of motion with its parameters, load and, where the model has hysteresis, its state. */",
            "class Model {",
            " public:",
            f"    static constexpr std::size_t joints = {n};",
            f"    using Vector = std::array<double, {n}>;",
            f"    using Matrix = std::array<double, {n * n}>; /* row by row */",
            "",
            f"    {self.name}_parameters parameters = {self.name}_identified();",
            "",
            "    /* kg; m in the last link's frame; kg m^2 about the centre of mass: xx, xy, xz, yy, yz, zz */",
            "    void set_payload(double mass, const std::array<double, 3>& centre,",
            "                     const std::array<double, 6>& inertia = {}) noexcept",
            f"    {{ {self.name}_set_payload(&parameters, mass, centre.data(), inertia.data()); }}",
        ]
        if self.n_states:
            lines += [
                "",
                f"    void start() noexcept {{ {self.name}_start(&state_); }}",
                f"    void advance(const Vector& q) noexcept {{ {self.name}_advance(&state_, q.data()); }}",
                "",
                "    Model() noexcept { start(); }",
            ]
        for function in self.functions:
            lines += ["", f"    /* {function.meaning} */", *self._write_method(function)]
        if not self.equation.observer_obstacle:
            lines += [
                "",
                "    /* Torque of contacts; `observer` begins with start_observer(). Use parameters with the load. */",
                f"    using Observer = {self.name}_observer;",
                "    static Observer start_observer() noexcept",
                f"    {{ Observer observer; {self.name}_observer_start(&observer); return observer; }}",
                "    Vector observe(Observer& observer, const Vector& q, const Vector& tau, double period,",
                "                   double gain = 30.0) const noexcept",
                f"    {{ {self.name}_observe(&parameters, &observer, q.data(), tau.data(), period, gain);",
                "      Vector result;",
                "      for (std::size_t j = 0; j < joints; ++j) result[j] = observer.residual[j];",
                "      return result; }",
            ]
            if self.contact is not None:
                lines += [
                    "    /* Whether each joint's residual is beyond its threshold, after observe() with this gain. */",
                    f"    static constexpr double contact_gain = {format_c_number(self.contact.gain)};",
                    "    static std::array<int, joints> find_contacts(const Observer& observer) noexcept",
                    f"    {{ std::array<int, joints> found; {self.name}_find_contacts(&observer, found.data()); "
                    "return found; }",
                ]
        lines += ["", "#ifdef DYNIDENT_USE_EIGEN"]
        lines += [
            f"    using EigenVector = Eigen::Matrix<double, {n}, 1>;",
            f"    using EigenMatrix = Eigen::Matrix<double, {n}, {n}, Eigen::RowMajor>;",
        ]
        if self.n_states:
            lines.append(
                f"    void advance(const EigenVector& q) noexcept {{ {self.name}_advance(&state_, q.data()); }}"
            )
        for function in self.functions:
            lines += self._write_method(function, eigen=True)
        lines += ["#endif"]
        if self.n_states:
            lines += ["", " private:", f"    {self.name}_state state_;"]
        return "\n".join([*lines, "};", "", f"}} // namespace {self.name}", ""])

    def _write_method(self, function: HeaderFunction, *, eigen: bool = False) -> list[str]:
        n = self.equation.robot.n
        vector, matrix = ("EigenVector", "EigenMatrix") if eigen else ("Vector", "Matrix")
        result = matrix if function.output == "mass" else vector
        declared, passed = [], ["&parameters"]
        for argument in function.inputs:
            if argument.name == "z":
                passed.append("&state_")
            elif argument.name in _SCALARS:
                declared.append(f"double {_name_argument(argument.name)}")
                passed.append(_name_argument(argument.name))
            else:
                kind = (
                    vector if argument.size == n and argument.name != "runs" else f"std::array<double, {argument.size}>"
                )
                declared.append(f"const {kind}& {argument.name}")
                passed.append(f"{argument.name}.data()")
        call = f"{self.name}_{function.name}({', '.join([*passed, 'result.data()'])});"
        return [
            f"    {result} {function.name}({', '.join(declared)}) const noexcept",
            f"    {{ {result} result; {call} return result; }}",
        ]


_TEN = len(INERTIAL_NAMES)
_SET_PAYLOAD = """\
/* Load on the last link: kg; centre of mass in m in the link's frame; kg m^2 about the centre of mass: xx, xy, xz, yy,
   yz, zz */
static inline void PREFIX_set_payload(
    PREFIX_parameters *p, double mass, const double centre[3], const double inertia[6])
{
    const double x = centre[0], y = centre[1], z = centre[2];
    p->payload[0] = inertia[0] + mass * (y * y + z * z);
    p->payload[1] = inertia[1] - mass * x * y;
    p->payload[2] = inertia[2] - mass * x * z;
    p->payload[3] = inertia[3] + mass * (x * x + z * z);
    p->payload[4] = inertia[4] - mass * y * z;
    p->payload[5] = inertia[5] + mass * (x * x + y * y);
    p->payload[6] = mass * x;
    p->payload[7] = mass * y;
    p->payload[8] = mass * z;
    p->payload[9] = mass;
}"""


@dataclass(frozen=True)
class _Array:
    name: str
    size: int


def list_functions(equation: EquationOfMotion) -> tuple[HeaderFunction, ...]:
    """Return the functions of a header."""
    by_name = {argument.name: argument for argument in equation.arguments}
    q, dq, ddq = (by_name[name] for name in ("q", "dq", "ddq"))

    def extend(fixed: Sequence[Argument], expression: ca.SX) -> tuple[Argument, ...]:
        others = [a for a in equation.arguments if a not in fixed and ca.depends_on(expression, a.symbol)]
        return (*fixed, *others)

    tau = Argument("tau", ca.SX.sym("tau", equation.robot.n), "torque of the motors")
    functions = [
        HeaderFunction("inverse_dynamics", "torque of a motion, all effects together",
                  extend((q, dq, ddq), equation.torque), "tau", equation.torque),
        HeaderFunction("gravity", "torque that holds links and load", (q,), "tau", equation.gravity),
        HeaderFunction("coriolis", "Coriolis and centrifugal torque C(q, dq) dq", (q, dq), "tau", equation.coriolis),
        HeaderFunction("friction", "torque of the effects that are friction",
                  extend((q, dq), equation.friction), "tau", equation.friction),
        HeaderFunction("mass_matrix", "mass matrix of links, load and rotors, row by row", (q,), "mass", equation.mass),
    ]  # fmt: skip
    if not equation.acceleration_obstacle:
        acceleration = equation.build_acceleration(tau.symbol)
        functions.append(
            HeaderFunction("forward_dynamics", "acceleration under the motors' torque tau",
                      extend((q, dq, tau), acceleration), "ddq", acceleration)
        )  # fmt: skip
    return tuple(functions)


def _write_argument(argument: Argument, name: str) -> str:
    if argument.name == "z":
        return f"const {name}_state *state"
    if argument.name in _SCALARS:
        return f"double {_name_argument(argument.name)}"
    return f"const double {argument.name}[{argument.size}]"


def _name_argument(name: str) -> str:
    # `time` is a function of C's standard library.
    return {"time": "t", "z": "state"}.get(name, name)


def _list_entries(array: _Array) -> list[str]:
    """Return C expressions of the entries of an argument."""
    if array.name in _SCALARS:
        return [_name_argument(array.name)]
    owner = "state->z" if array.name == "z" else array.name
    return [f"{owner}[{k}]" for k in range(array.size)]
