"""LLVM: compile CasADi's list of instructions to machine code that reads and writes numpy's arrays in place."""

from __future__ import annotations

import ctypes
import platform
import threading
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from typing import Any

import casadi as ca
import numpy as np
from llvmlite import binding as llvm

from dynident.array_types import FloatArray
from dynident.expressions.code_cache import load_or_compile
from dynident.expressions.llvm_translation import LIBRARY_FUNCTIONS, translate_to_llvm

NUMBER = 8
"""Bytes of a number."""
_LANES_AT_ONCE = 4
"""Numbers in a register that the vector functions take."""
# LLVM builds one module at a time.
_BUILD = threading.Lock()


class Compiled:
    """Machine code of a CasADi function of one vector, evaluated at `lanes` samples at once.

    Parameters
    ----------
    function : casadi.Function
        One input vector, one output vector.
    widths : sequence of int
        The widths of the parts of the input vector, each of which `run` takes as an array of its own.
    lanes : int
        Samples in one register.
    """

    def __init__(self, function: ca.Function, widths: Sequence[int], lanes: int) -> None:
        # CasADi has removed common subexpressions; LLVM's own optimisation takes longer than it saves.
        self._engine = build_engine(translate_to_llvm(function, widths, lanes, _find_vector_functions(lanes)))
        place, number = ctypes.c_void_p, ctypes.c_int64
        kinds = [number, place, number, place, *(kind for _ in widths for kind in (place, number))]
        self._room = int(function.numel_out(0)) * lanes
        self._call: Any = ctypes.CFUNCTYPE(None, *kinds)(self._engine.get_function_address("run"))

    def run(self, m: int, out: FloatArray, inputs: Sequence[FloatArray]) -> None:
        """Evaluate m samples.

        Parameters
        ----------
        m : int
            At least `lanes`.
        out : (m, number of outputs)
            Where to put the result.
        inputs : sequence of (m, width) or (width,)
            One array for each part of the input vector, its rows contiguous; one of shape (width,) holds for all
            samples.
        """
        # Of each call its own, so that threads may share the code.
        # Machine code has no bounds checks: the callers, `Program` and `Recurrence`, have checked all shapes.
        results = np.empty(self._room)
        arguments = [results.ctypes.data]
        for item in inputs:
            arguments += (item.ctypes.data, item.strides[0] // NUMBER if item.ndim == 2 else 0)
        self._call(m, out.ctypes.data, out.strides[0] // NUMBER, *arguments)


def build_engine(text: str, optimisation: int = 0) -> llvm.ExecutionEngine:
    """Compile LLVM assembly.

    Parameters
    ----------
    text : str
        The assembly.
    optimisation : int
        LLVM's level of optimisation, 0 to 3.

    Returns
    -------
    llvmlite.binding.ExecutionEngine
        It owns the code, and so has to live as long as the address of a function in it is used.
    """
    with _BUILD:
        machine = _create_machine(optimisation)
        # The same text is other code by another compiler, or for another processor.
        head = f"; {_read_versions()} {machine.triple} {' '.join(_detect_processor())}\n"
        level = f"; -O{optimisation}\n" if optimisation else ""
        code = load_or_compile(head + level + text, lambda: machine.emit_object(llvm.parse_assembly(text)))
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
    return engine


@cache
def _create_target() -> llvm.Target:
    """Return the target for this computer, with the C library's functions registered."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = ctypes.CDLL(None)
    # LLVM ends the process over a symbol that it cannot find.
    for name in LIBRARY_FUNCTIONS:
        llvm.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
    return llvm.Target.from_default_triple()


@cache
def _find_vector_functions(lanes: int) -> dict[str, str]:
    """Return the vector functions of the C library (glibc, AVX2) by the names of those for one number.

    They are accurate to 4 ulp, mostly 1. A sine takes as long as 130 products by itself, and as 30 in such a call.
    """
    _create_target()
    if lanes != _LANES_AT_ONCE or "+avx2" not in _detect_processor()[1].split(",") or platform.machine() != "x86_64":
        return {}
    try:
        library = ctypes.CDLL("libmvec.so.1")
    except OSError:
        return {}
    vector_functions = {}
    for name in sorted(LIBRARY_FUNCTIONS):
        for arguments in ("v", "vv"):
            # The name by x86's vector ABI: "d" is AVX2, "N" without a mask, a "v" for every argument.
            full = f"_ZGVdN{lanes}{arguments}_{name}"
            if hasattr(library, full):
                llvm.add_symbol(full, ctypes.cast(getattr(library, full), ctypes.c_void_p).value)
                vector_functions[name] = full
    return vector_functions


def _create_machine(optimisation: int) -> llvm.TargetMachine:
    """Return the compiler of this computer."""
    name, features = _detect_processor()
    return _create_target().create_target_machine(cpu=name, features=features, opt=optimisation, jit=True)


@cache
def _read_versions() -> str:
    return f"llvmlite {version('llvmlite')}, LLVM {'.'.join(map(str, llvm.llvm_version_info))}"


@cache
def _detect_processor() -> tuple[str, str]:
    """Return the processor's name and features; two empty texts (the common base) if LLVM does not know it."""
    try:
        return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    except RuntimeError:
        return "", ""
