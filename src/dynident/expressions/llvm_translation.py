"""Translate CasADi's instructions to LLVM assembly, four samples side by side."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from dynident.errors import DynidentError

_ARITHMETIC: dict[int, str] = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_COMPARISONS: dict[int, str] = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
# By LLVM itself, in registers.
_INTRINSICS: dict[int, str] = {
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "fabs",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
}
# By the C library: all lanes in one call where it has such a function, else one sample after the other.
_CALLS: dict[int, str] = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_EXPM1: "expm1",
    ca.OP_LOG1P: "log1p",
    ca.OP_HYPOT: "hypot",
    ca.OP_ERF: "erf",
    ca.OP_FMOD: "fmod",
}

LIBRARY_FUNCTIONS = frozenset(_CALLS.values())


class UnsupportedOperationError(DynidentError):
    """Error: an expression, such as a column of somebody's own effect, uses an operation that has no translation here.

    Parameters
    ----------
    detail : str
        Which operation it is, and which ones there are.
    pointer, title : str, optional
        JSON pointer to the cause in the caller's request, and short name of the kind of error.
    """


def _unsupported_operation_error(operation: int) -> UnsupportedOperationError:
    codes = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
    supported = {*_ARITHMETIC, *_COMPARISONS, *_INTRINSICS, *_CALLS, *_SPECIAL}
    words = ", ".join(sorted(codes[code].removeprefix("OP_").lower() for code in supported))
    return UnsupportedOperationError(
        f"a column uses CasADi's operation {codes[operation].removeprefix('OP_').lower()}, which cannot be evaluated "
        f"here; write it with these: {words}",
        pointer="/effects",
        title="Unsupported operation",
    )


def translate_to_llvm(function: ca.Function, widths: Sequence[int], lanes: int, at_once: Mapping[str, str]) -> str:
    """Translate a function to LLVM assembly of `run(n, out, out_stride, results, in_0, stride_0, in_1, stride_1, …)`.

    It evaluates `function` (one input vector, one output vector) at n samples, `lanes` of them at once; n is at least
    `lanes`, and the last lanes are taken from the end of the samples, some a second time where n is no multiple.
    The function's input is the inputs of `widths` one behind the other. Entry j of input k at sample s is
    in_k[s stride_k + j], that of the output out[s out_stride + j]: strides count numbers, and a stride of 0 holds one
    value for all samples. `results` is room for all outputs of `lanes` samples: written side by side there and then
    handed out by a loop, they take half the time to compile of numbers stored one by one.

    Parameters
    ----------
    function : casadi.Function
        One input vector, one output vector.
    widths : sequence of int
        Widths of the inputs that make up the input vector.
    lanes : int
        Samples in one register.
    at_once : mapping
        Vector functions of the C library, for all lanes in one call, by the name of the function for one number.

    Returns
    -------
    str
        LLVM assembly of one function, with the declarations that it needs.

    Raises
    ------
    UnsupportedOperationError
        For an operation that has no translation.
    """
    return _Translation(function, widths, lanes, at_once).text


def _find_common_divisors(function: ca.Function) -> frozenset[int]:
    """Return the numbers of the divisions whose divisor divides another number as well."""
    # CasADi's registers are reused, so that a divisor is known by the instruction that made it, not by its register.
    made_by: dict[int, int] = {}
    divisions: dict[int, list[int]] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        if operation == ca.OP_DIV:
            divisions.setdefault(made_by[function.instruction_input(k)[1]], []).append(k)
        if operation != ca.OP_OUTPUT:
            made_by[function.instruction_output(k)[0]] = k
    return frozenset(k for those in divisions.values() if len(those) > 1 for k in those)


class _Translation:
    """The assembly text while it is written."""

    def __init__(self, function: ca.Function, widths: Sequence[int], lanes: int, at_once: Mapping[str, str]) -> None:
        self._lanes, self._at_once = lanes, at_once
        self._type = f"<{lanes} x double>"
        self._lines: list[str] = []
        self._declared: dict[str, str] = {}
        self._count = 0
        self._inputs = [(k, j) for k, width in enumerate(widths) for j in range(width)]
        self._translate_instructions(function)
        input_arguments = [f"ptr readonly %in{k}, i64 %stride{k}" for k in range(len(widths))]
        arguments = ", ".join(["i64 %n", "ptr %out", "i64 %out_stride", "ptr %results", *input_arguments])
        self.text = "\n".join(
            [
                *self._declared.values(),
                f"define void @run({arguments}) {{",
                *self._emit_loop_head(len(widths)),
                *self._lines,
                *self._emit_loop_end(int(function.numel_out(0))),
                "}",
            ]
        )

    def _emit_loop_head(self, n_inputs: int) -> list[str]:
        """Return the head of the loop over the samples: where every lane finds its sample."""
        lines = [
            "entry:",
            f"  %last = sub i64 %n, {self._lanes}",
            "  br label %loop",
            "loop:",
            "  %first = phi i64 [0, %entry], [%next, %onward]",
            # The last pass starts `lanes` before the end, so that no lane reads beyond it.
            "  %beyond = icmp sgt i64 %first, %last",
            "  %start = select i1 %beyond, i64 %last, i64 %first",
        ]
        for lane in range(self._lanes):
            lines.append(f"  %s{lane} = add i64 %start, {lane}")
            places = [("out", "out_stride"), *((f"in{k}", f"stride{k}") for k in range(n_inputs))]
            for name, stride in places:
                lines.append(f"  %{name}.o{lane} = mul i64 %s{lane}, %{stride}")
                lines.append(f"  %{name}.{lane} = getelementptr double, ptr %{name}, i64 %{name}.o{lane}")
        return lines

    def _emit_loop_end(self, n_outputs: int) -> list[str]:
        """Return the end of the loop: results go to the rows of their samples, then follow the next samples."""
        lines = [
            "  br label %hand_out",
            "hand_out:",
            "  %entry_number = phi i64 [0, %loop], [%next_entry, %hand_out]",
            f"  %together = getelementptr {self._type}, ptr %results, i64 %entry_number",
        ]
        for lane in range(self._lanes):
            lines += [
                f"  %from{lane} = getelementptr double, ptr %together, i64 {lane}",
                f"  %result{lane} = load double, ptr %from{lane}, align 8",
                f"  %to{lane} = getelementptr double, ptr %out.{lane}, i64 %entry_number",
                f"  store double %result{lane}, ptr %to{lane}, align 8",
            ]
        return [
            *lines,
            "  %next_entry = add i64 %entry_number, 1",
            f"  %more_entries = icmp slt i64 %next_entry, {n_outputs}",
            "  br i1 %more_entries, label %hand_out, label %onward",
            "onward:",
            f"  %next = add i64 %first, {self._lanes}",
            "  %more = icmp slt i64 %next, %n",
            "  br i1 %more, label %loop, label %done",
            "done:",
            "  ret void",
        ]

    def _translate_instructions(self, function: ca.Function) -> None:
        """Translate CasADi's register machine into single assignments.

        What several numbers are divided by is inverted once: a quotient takes as long as eight products.
        """
        # By CasADi's register: the name of the LLVM value that it holds now. Each instruction makes a new value, as
        # LLVM wants it, whereas CasADi overwrites its registers.
        holds: dict[int, str] = {}
        inverted: dict[str, str] = {}
        common = _find_common_divisors(function)
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            target, source = function.instruction_output(k), function.instruction_input(k)
            if operation == ca.OP_INPUT:
                holds[target[0]] = self._emit_load(source[1])
            elif operation == ca.OP_CONST:
                holds[target[0]] = self._format_constant(float(function.instruction_constant(k)))
            elif operation == ca.OP_OUTPUT:
                self._emit_store(holds[source[0]], target[1])
            elif k in common:
                divisor = holds[source[1]]
                if divisor not in inverted:
                    inverted[divisor] = self._emit_inverse(divisor)
                holds[target[0]] = self._emit_operation(ca.OP_MUL, [holds[source[0]], inverted[divisor]])
            else:
                holds[target[0]] = self._emit_operation(operation, [holds[register] for register in source])

    def _emit_value(self, expression: str) -> str:
        name = f"%v{self._count}"
        self._count += 1
        self._lines.append(f"  {name} = {expression}")
        return name

    def _format_constant(self, value: float) -> str:
        # Hexadecimal bits, since LLVM refuses decimals that are not exact.
        bits = "0x" + struct.pack(">d", value).hex().upper()
        return "<" + ", ".join([f"double {bits}"] * self._lanes) + ">"

    def _emit_load(self, entry: int) -> str:
        name, j = self._inputs[entry]
        lanes = []
        for lane in range(self._lanes):
            place = self._emit_value(f"getelementptr double, ptr %in{name}.{lane}, i64 {j}")
            lanes.append(self._emit_value(f"load double, ptr {place}, align 8"))
        return self._join_lanes(lanes)

    def _emit_store(self, value: str, entry: int) -> None:
        place = self._emit_value(f"getelementptr {self._type}, ptr %results, i64 {entry}")
        self._lines.append(f"  store {self._type} {value}, ptr {place}, align 8")

    def _extract_lane(self, value: str, lane: int) -> str:
        return self._emit_value(f"extractelement {self._type} {value}, i32 {lane}")

    def _join_lanes(self, lanes: Sequence[str]) -> str:
        value = "undef"
        for lane, number in enumerate(lanes):
            value = self._emit_value(f"insertelement {self._type} {value}, double {number}, i32 {lane}")
        return value

    def _emit_operation(self, operation: int, values: list[str]) -> str:
        if operation in _ARITHMETIC:
            return self._emit_value(f"{_ARITHMETIC[operation]} {self._type} {values[0]}, {values[1]}")
        if operation in _COMPARISONS:
            return self._convert_truth_to_number(self._emit_comparison(_COMPARISONS[operation], *values))
        if operation in _INTRINSICS:
            return self._emit_intrinsic(_INTRINSICS[operation], values)
        if operation in _CALLS:
            return self._emit_library_call(_CALLS[operation], values)
        special = _SPECIAL.get(operation)
        if special is None:
            raise _unsupported_operation_error(operation)
        return special(self, *values)

    def _emit_comparison(self, how: str, first: str, second: str) -> str:
        return self._emit_value(f"fcmp {how} {self._type} {first}, {second}")

    def _convert_truth_to_number(self, truth: str) -> str:
        return self._emit_value(f"uitofp <{self._lanes} x i1> {truth} to {self._type}")

    def _emit_select(self, truth: str, if_true: str, if_false: str) -> str:
        flags = f"<{self._lanes} x i1> {truth}"
        return self._emit_value(f"select {flags}, {self._type} {if_true}, {self._type} {if_false}")

    def _emit_intrinsic(self, name: str, values: Sequence[str]) -> str:
        return self._call_for_all_lanes(f"llvm.{name}.v{self._lanes}f64", values)

    def _call_for_all_lanes(self, name: str, values: Sequence[str]) -> str:
        self._declared[name] = f"declare {self._type} @{name}({', '.join([self._type] * len(values))})"
        return self._emit_value(f"call {self._type} @{name}({', '.join(f'{self._type} {value}' for value in values)})")

    def _emit_library_call(self, name: str, values: Sequence[str]) -> str:
        if name in self._at_once:
            return self._call_for_all_lanes(self._at_once[name], values)
        self._declared[name] = f"declare double @{name}({', '.join(['double'] * len(values))})"
        lanes = []
        for lane in range(self._lanes):
            numbers = ", ".join(f"double {self._extract_lane(value, lane)}" for value in values)
            lanes.append(self._emit_value(f"call double @{name}({numbers})"))
        return self._join_lanes(lanes)

    # Operations that take more than one instruction, or one with a constant.

    def _emit_assignment(self, x: str) -> str:
        return x

    def _emit_negative(self, x: str) -> str:
        return self._emit_value(f"fneg {self._type} {x}")

    def _emit_square(self, x: str) -> str:
        return self._emit_value(f"fmul {self._type} {x}, {x}")

    def _emit_twice(self, x: str) -> str:
        return self._emit_value(f"fadd {self._type} {x}, {x}")

    def _emit_inverse(self, x: str) -> str:
        return self._emit_value(f"fdiv {self._type} {self._format_constant(1.0)}, {x}")

    def _emit_not(self, x: str) -> str:
        return self._convert_truth_to_number(self._emit_comparison("oeq", x, self._format_constant(0.0)))

    def _emit_sign(self, x: str) -> str:
        """Return -1, 0 or 1; NaN stays NaN."""
        zero = self._format_constant(0.0)
        below = self._emit_select(self._emit_comparison("olt", x, zero), self._format_constant(-1.0), x)
        return self._emit_select(self._emit_comparison("ogt", x, zero), self._format_constant(1.0), below)

    def _emit_if_else_zero(self, condition: str, x: str) -> str:
        return self._emit_select(
            self._emit_comparison("une", condition, self._format_constant(0.0)), x, self._format_constant(0.0)
        )

    def _emit_minimum(self, x: str, y: str) -> str:
        return self._emit_extreme("olt", x, y)

    def _emit_maximum(self, x: str, y: str) -> str:
        return self._emit_extreme("ogt", x, y)

    def _emit_extreme(self, how: str, x: str, y: str) -> str:
        """Return the smaller or larger value; NaN if either of the two is."""
        # "uno" is true where one of the two is NaN; their sum is NaN then.
        either = self._emit_select(self._emit_comparison(how, x, y), x, y)
        return self._emit_select(
            self._emit_comparison("uno", x, y), self._emit_value(f"fadd {self._type} {x}, {y}"), either
        )

    def _emit_and(self, x: str, y: str) -> str:
        return self._emit_logical("and", x, y)

    def _emit_or(self, x: str, y: str) -> str:
        return self._emit_logical("or", x, y)

    def _emit_logical(self, how: str, x: str, y: str) -> str:
        zero = self._format_constant(0.0)
        first, second = self._emit_comparison("une", x, zero), self._emit_comparison("une", y, zero)
        return self._convert_truth_to_number(self._emit_value(f"{how} <{self._lanes} x i1> {first}, {second}"))


_SPECIAL: dict[int, Callable[..., str]] = {
    ca.OP_ASSIGN: _Translation._emit_assignment,
    ca.OP_NEG: _Translation._emit_negative,
    ca.OP_SQ: _Translation._emit_square,
    ca.OP_TWICE: _Translation._emit_twice,
    ca.OP_INV: _Translation._emit_inverse,
    ca.OP_NOT: _Translation._emit_not,
    ca.OP_SIGN: _Translation._emit_sign,
    ca.OP_IF_ELSE_ZERO: _Translation._emit_if_else_zero,
    ca.OP_FMIN: _Translation._emit_minimum,
    ca.OP_FMAX: _Translation._emit_maximum,
    ca.OP_AND: _Translation._emit_and,
    ca.OP_OR: _Translation._emit_or,
}
