"""Second-order-section filter (as `scipy.signal.sosfilt`) compiled to machine code, for all columns at once.

Runs the position filter; cut-offs are chosen in recordings/preprocessing.py.
"""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from dynident.array_types import FloatArray
from dynident.expressions.compiled_expressions import NUMBER, build_engine


def filter_sections(sections: FloatArray, values: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Filter samples along time, as `scipy.signal.sosfilt` does, with the same result to the last bit.

    Parameters
    ----------
    sections : (s, 6)
        Second-order sections: b0, b1, b2, 1, a1, a2 of each.
    values : (m, n)
        Samples of n signals; the rows may stand in the opposite order (`values[::-1]`).
    state : (s, 2, n)
        State of each section before the first sample.

    Returns
    -------
    filtered : (m, n)
        The filtered samples.
    state : (s, 2, n)
        State of each section after the last sample.
    """
    # Machine code has no bounds checks.
    n_sections, (m, n) = len(sections), values.shape
    if sections.shape != (n_sections, 6) or state.shape != (n_sections, 2, n):
        raise ValueError(f"a filter of shape {sections.shape} with a state {state.shape} does not fit {values.shape}")
    filtered = np.empty((m, n))
    state = np.array(state, dtype=np.float64)
    if not m or not n:
        return filtered, state
    if values.dtype != np.float64 or values.strides[1] != NUMBER:
        values = np.ascontiguousarray(values, dtype=np.float64)
    sections = np.ascontiguousarray(sections, dtype=np.float64)
    arrays = (values, filtered, sections, state)
    _compile(n_sections, n)(m, values.strides[0], *(array.ctypes.data for array in arrays))
    return filtered, state


class _SectionFilterCode:
    """Machine code for a number of sections and of columns."""

    def __init__(self, n_sections: int, n_columns: int) -> None:
        # The loop carries the state in registers, which takes LLVM's own allocation of them.
        text = _write_llvm(n_sections, n_columns)
        self._engine = build_engine(lambda: text, optimisation=2, key=text)
        kinds = [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 4]
        self._call = ctypes.CFUNCTYPE(None, *kinds)(self._engine.get_function_address("run"))

    def __call__(self, *arguments: int) -> None:
        self._call(*arguments)


_compile = cache(_SectionFilterCode)


def _write_llvm(n_sections: int, n_columns: int) -> str:
    """Write `run(m, step, values, filtered, sections, state)` in LLVM assembly; `step` is in bytes.

    A row of samples is one vector, so that the columns, which do not depend on each other, are filtered side by side.
    Each section is in the direct form II transposed. Products and sums are rounded one by one, as in SciPy.
    """
    vector = f"<{n_columns} x double>"
    head, first, last = [], [], []
    body = [
        "%row = getelementptr i8, ptr %values, i64 %place",
        f"%x0 = load {vector}, ptr %row, align 8",
    ]
    for s in range(n_sections):
        for k in (0, 1, 2, 4, 5):
            name = f"{s}_{k}"
            head += [
                f"%p{name} = getelementptr double, ptr %sections, i64 {6 * s + k}",
                f"%n{name} = load double, ptr %p{name}, align 8",
                f"%v{name} = insertelement {vector} poison, double %n{name}, i64 0",
                f"%c{name} = shufflevector {vector} %v{name}, {vector} poison, <{n_columns} x i32> zeroinitializer",
            ]
        for k in (0, 1):
            name = f"{s}_{k}"
            head += [
                f"%q{name} = getelementptr double, ptr %state, i64 {(2 * s + k) * n_columns}",
                f"%start{name} = load {vector}, ptr %q{name}, align 8",
            ]
            first.append(f"%z{name} = phi {vector} [ %start{name}, %entry ], [ %next{name}, %loop ]")
            last.append(f"store {vector} %next{name}, ptr %q{name}, align 8")
        x, y = f"%x{s}", f"%x{s + 1}"
        body += [
            f"%b0x{s} = fmul {vector} %c{s}_0, {x}",
            f"{y} = fadd {vector} %b0x{s}, %z{s}_0",
            f"%b1x{s} = fmul {vector} %c{s}_1, {x}",
            f"%a1y{s} = fmul {vector} %c{s}_4, {y}",
            f"%d1_{s} = fsub {vector} %b1x{s}, %a1y{s}",
            f"%next{s}_0 = fadd {vector} %d1_{s}, %z{s}_1",
            f"%b2x{s} = fmul {vector} %c{s}_2, {x}",
            f"%a2y{s} = fmul {vector} %c{s}_5, {y}",
            f"%next{s}_1 = fsub {vector} %b2x{s}, %a2y{s}",
        ]
    body += [
        "%out = getelementptr double, ptr %filtered, i64 %written",
        f"store {vector} %x{n_sections}, ptr %out, align 8",
        "%next_place = add i64 %place, %step",
        f"%next_written = add i64 %written, {n_columns}",
        "%next_i = add i64 %i, 1",
        "%done = icmp eq i64 %next_i, %m",
        "br i1 %done, label %end, label %loop",
    ]
    counters = [f"%{name} = phi i64 [ 0, %entry ], [ %next_{name}, %loop ]" for name in ("i", "place", "written")]
    return "\n".join(
        (
            "define void @run(i64 %m, i64 %step, ptr %values, ptr %filtered, ptr %sections, ptr %state) {",
            *("entry:", *head, "br label %loop"),
            *("loop:", *counters, *first, *body),
            *("end:", *last, "ret void"),
            "}\n",
        )
    )
