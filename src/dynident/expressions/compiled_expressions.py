"""Compile CasADi functions by LLVM and evaluate them at many samples.

CasADi's virtual machine walks its list of instructions once a sample, through memory. Translated, the same list works
in registers on several samples at once: some 25 times faster, and made in tens of milliseconds without a C compiler.
A recurrence steps a state through time, each step from the one before.

The import of this package also makes CasADi's expressions safe in several threads.
"""

from __future__ import annotations

import ctypes
import inspect
import os
import platform
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property, lru_cache, wraps
from hashlib import sha256
from importlib import import_module
from importlib.metadata import version
from types import BuiltinFunctionType
from typing import Any

import casadi as ca
import numpy as np
from llvmlite import binding as llvm

from dynident.array_types import FloatArray
from dynident.expressions import llvm_translation
from dynident.expressions.code_cache import load_or_compute
from dynident.expressions.llvm_translation import LIBRARY_FUNCTIONS, translate_to_llvm

NUMBER = 8
"""Bytes of a number."""
_LANES_AT_ONCE = 4
"""Numbers in a register that the vector functions take."""
# LLVM builds one module at a time.
_BUILD = threading.Lock()
# CasADi's Python functions release Python's lock, but its SX expressions share a cache of constants: a thread that
# drops the last use of a constant destroys it while another may take it from the cache, and the process crashes. This
# lock is held for one CasADi call at a time and nothing else is waited for meanwhile, so it cannot lock up.
_CASADI = threading.RLock()
_NUMERIC_FUNCTIONS = ("DM_", "GenDM_", "FunctionBuffer_", "_function_buffer_eval", "Linsol_", "Opti")
"""Beginnings of the names of CasADi's functions that compute with numbers, possibly for long."""
_BOOKKEEPING = ("_swiginit", "_swigregister")
"""Ends of the names of those that only join a Python object to its expression."""


def _guard_casadi() -> None:
    """Let one thread at a time make, read or destroy CasADi's expressions, in this project's code and in a user's."""
    if "GIL_RELEASE" not in ca.CasadiMeta.swig_flags() or "__del__" in vars(ca.SX):
        return  # Python's own lock does it, or this function has run before
    compiled = import_module("casadi._casadi")  # no part of CasADi's types
    for name, function in list(vars(compiled).items()):
        is_safe = name.startswith(_NUMERIC_FUNCTIONS) or name.endswith(_BOOKKEEPING)
        if isinstance(function, BuiltinFunctionType) and not is_safe:
            setattr(compiled, name, _guard_call(function) if name == "Function_call" else _guard(function))

    # The interpreter takes modules apart at its end, when a thread may have stopped while it held the lock.
    def destroy(self: Any, lock: threading.RLock = _CASADI, is_ending: Callable[[], bool] = sys.is_finalizing) -> None:
        if not is_ending():
            with lock:
                self.__dict__.pop("this", None)

    kinds: tuple[Any, ...] = (ca.SX, ca.MX, ca.Function, ca.CodeGenerator)
    for kind in kinds:
        kind.__del__ = destroy
    if hasattr(os, "register_at_fork"):
        # A child process would wait for ever for a thread that it does not have.
        os.register_at_fork(before=_CASADI.acquire, after_in_parent=_CASADI.release, after_in_child=_CASADI.release)


def _guard(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def call(*arguments: Any) -> Any:
        with _CASADI:
            return function(*arguments)

    return call


def _guard_call(function: Callable[..., Any]) -> Callable[..., Any]:
    """Guard the evaluation of a function, except at numbers, where it may be a solver that takes long."""
    guarded = _guard(function)

    @wraps(function)
    def call(*arguments: Any) -> Any:
        given = next(iter(arguments[1:2]), ())
        values: Iterable[Any] = given.values() if isinstance(given, dict) else given
        return (function if all(map(_is_numeric, values)) else guarded)(*arguments)

    return call


def _is_numeric(value: Any) -> bool:
    return isinstance(value, ca.DM | float | int) or (isinstance(value, np.ndarray) and value.dtype != object)


_guard_casadi()


class Compiled:
    """Machine code of a CasADi function of one vector, evaluated at `lanes` samples at once.

    Parameters
    ----------
    serialised : str
        The function, as CasADi writes it: one input vector, one output vector.
    n_outputs : int
        Number of numbers in the output vector.
    widths : sequence of int
        The widths of the parts of the input vector, each of which `run` takes as an array of its own.
    lanes : int
        Samples in one register.
    """

    def __init__(self, serialised: str, n_outputs: int, widths: Sequence[int], lanes: int) -> None:
        vector_functions = _find_vector_functions(lanes)
        # The function itself says which code it is: it is translated only where none is cached.
        key = f"{_hash_translation()} {tuple(widths)} {lanes} {vector_functions} {serialised}"
        # CasADi has removed common subexpressions; LLVM's own optimisation takes longer than it saves.
        self._engine = build_engine(
            lambda: translate_to_llvm(ca.Function.deserialize(serialised), widths, lanes, vector_functions), key=key
        )
        place, number = ctypes.c_void_p, ctypes.c_int64
        kinds = [number, place, number, place, *(kind for _ in widths for kind in (place, number))]
        self._results_size = n_outputs * lanes
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
        results = np.empty(self._results_size)
        arguments = [results.ctypes.data]
        for item in inputs:
            arguments += (item.ctypes.data, item.strides[0] // NUMBER if item.ndim == 2 else 0)
        self._call(m, out.ctypes.data, out.strides[0] // NUMBER, *arguments)


@lru_cache(maxsize=32)
def _compile(serialised: str, n_outputs: int, widths: tuple[int, ...], lanes: int) -> Compiled:
    """Compile a CasADi function once in a process: every identification of a robot asks for the same ones."""
    return Compiled(serialised, n_outputs, widths, lanes)


def build_engine(write: Callable[[], str], optimisation: int = 0, *, key: str) -> llvm.ExecutionEngine:
    """Compile LLVM assembly, or load its code where it was compiled before.

    Parameters
    ----------
    write : callable
        Writes the assembly; called only where no code is cached.
    optimisation : int
        LLVM's level of optimisation, 0 to 3.
    key : str
        What the assembly is written from.

    Returns
    -------
    llvmlite.binding.ExecutionEngine
        It owns the code, and so has to live as long as the address of a function in it is used.
    """
    with _BUILD:
        machine = _create_machine(optimisation)
        # The same assembly is other code by another compiler, or for another processor.
        head = f"{_read_versions()} {machine.triple} {' '.join(_detect_processor())} -O{optimisation}\n"
        code = load_or_compute(head + key, lambda: machine.emit_object(llvm.parse_assembly(write())))
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
def _hash_translation() -> str:
    """Return a hash of the module that translates: another translation is other code of the same function."""
    return sha256(inspect.getsource(llvm_translation).encode()).hexdigest()


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


class Recurrence:
    """Recurrence x_(k+1), y_k = f(x_k, u_k, p) in machine code.

    Parameters
    ----------
    state, inputs, constants : SX (s, 1), SX (w, 1), SX (c, 1)
        Symbols of the state x, of the inputs u and of the constants p.
    following, sample : SX (s, 1), SX (o, 1)
        Expressions of the next state x_(k+1) and of what a step gives, y.
    """

    def __init__(self, state: ca.SX, inputs: ca.SX, constants: ca.SX, following: ca.SX, sample: ca.SX) -> None:
        self._sizes = (int(state.numel()), int(inputs.numel()), int(constants.numel()))
        outputs = ca.densify(ca.vertcat(following, sample))
        self._width = int(outputs.numel())
        function = ca.Function("step", [ca.vertcat(state, inputs, constants)], [ca.cse(outputs)])
        self._serialised = function.serialize()

    @cached_property
    def _scalar_code(self) -> Compiled:
        # One lane: a step needs the result of the step before, so that none can be taken side by side.
        return _compile(self._serialised, self._width, self._sizes, 1)

    @cached_property
    def _vector_code(self) -> Compiled:
        return _compile(self._serialised, self._width, self._sizes, _LANES)

    def run(self, state: FloatArray, inputs: FloatArray, constants: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Step the state through m samples.

        Parameters
        ----------
        state : (s,)
            The first state x_0.
        inputs : (m, w)
            Inputs u of every step.
        constants : (c,)
            Constants p, the same for all steps.

        Returns
        -------
        state : (s,)
            State after the last step.
        samples : (m, o)
            What every step gives, y.

        Raises
        ------
        ValueError
            For a state, inputs or constants of another size.
        """
        m = len(inputs)
        shapes, n_state = (state.shape, inputs.shape, constants.shape), self._sizes[0]
        needed = ((n_state,), (m, self._sizes[1]), (self._sizes[2],))
        if shapes != needed:
            raise ValueError(f"state, inputs and constants of {shapes}; {needed} are needed")
        # Row k + 1 takes what step k gives and is what step k + 1 reads: one sample at a time, in order.
        table = np.empty((m + 1, self._width))
        table[0, :n_state] = state
        if m:
            others = [np.ascontiguousarray(item, np.float64) for item in (inputs, constants)]
            self._scalar_code.run(m, table[1:], [table[:-1, :n_state], *others])
        return table[-1, :n_state].copy(), table[1:, n_state:]

    def run_many(self, states: FloatArray, inputs: FloatArray, constants: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Step k states through m samples, side by side.

        Parameters
        ----------
        states : (k, s)
            The first states x_0.
        inputs : (m, k, w)
            Inputs u of every step.
        constants : (c,)
            Constants p, the same for all.

        Returns
        -------
        states : (k, s)
            States after the last step.
        samples : (m, k, o)
            What every step gives, y.

        Raises
        ------
        ValueError
            For states, inputs or constants of another size.
        """
        (m, k), n_state = inputs.shape[:2], self._sizes[0]
        shapes = (states.shape, inputs.shape[2:], constants.shape)
        needed = ((k, n_state), (self._sizes[1],), (self._sizes[2],))
        if shapes != needed:
            raise ValueError(f"states, inputs and constants of {shapes}; {needed} are needed")
        table = np.empty((m + 1, k, self._width))
        table[0, :, :n_state] = states
        # Code for several lanes cannot take fewer states than it has lanes.
        compiled = self._vector_code if k >= _LANES else self._scalar_code
        every, same = (np.ascontiguousarray(item, np.float64) for item in (inputs, constants))
        for before, after, given in zip(table[:-1], table[1:], every, strict=True):
            compiled.run(k, after, [before[:, :n_state], given, same])
        return table[-1, :, :n_state].copy(), table[1:, :, n_state:]


# Samples that are evaluated side by side: four numbers fill a register of AVX2.
_LANES = 4


class Program:
    """The structural non-zeros of one expression, to be evaluated at many samples.

    It is compiled when it first runs: models that are solved from reduced data alone never need it. Threads
    may share it, and it goes to another process as its instructions.

    Parameters
    ----------
    inputs : sequence of SX (k, 1)
        Symbols that the expression depends on, one column vector for each argument of `__call__`.
    outputs : SX
        Any shape; its structural non-zeros, column by column, are what `__call__` returns.

    Raises
    ------
    UnsupportedOperationError
        When it first runs, for an expression with an operation that has no translation.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: ca.SX) -> None:
        self.widths = tuple(int(item.numel()) for item in inputs)
        nonzeros = outputs.nz[:] if outputs.nnz() else ca.SX(0, 1)
        self.n_outputs = int(nonzeros.numel())
        self._symbols, self._nonzeros = ca.vertcat(*inputs), nonzeros

    def __getstate__(self) -> dict[str, Any]:
        # CasADi's expressions cannot leave their process, its functions can.
        return {"widths": self.widths, "n_outputs": self.n_outputs, "_function": self._function}

    @property
    def n_instructions(self) -> int:
        """Number of operations a sample, loads and stores included."""
        return int(self._function.n_instructions())

    @cached_property
    def _function(self) -> ca.Function:
        return ca.Function("rows", [self._symbols], [ca.cse(self._nonzeros)])

    @cached_property
    def _vector_code(self) -> Compiled:
        return _compile(self._function.serialize(), self.n_outputs, self.widths, _LANES)

    @cached_property
    def _scalar_code(self) -> Compiled:
        return _compile(self._function.serialize(), self.n_outputs, self.widths, 1)

    def __call__(self, *inputs: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate at samples.

        Parameters
        ----------
        *inputs : (m, width) or (width,)
            One array an input; of shape (width,) where one value holds for all samples.
        out : (m, n_outputs), optional
            Where to put the result; in place where its rows are of contiguous numbers and it is none of the inputs.

        Returns
        -------
        (m, n_outputs)
            The structural non-zeros of the expression, column by column.

        Raises
        ------
        ValueError
            For inputs of different lengths or other widths, or a result of another shape or that is read-only.
        """
        lengths = {item.shape[0] for item in inputs if item.ndim == 2}
        if len(lengths) != 1:
            raise ValueError(f"inputs of {sorted(lengths)} samples; all of them need the same number")
        widths = tuple(item.shape[-1] for item in inputs)
        if widths != self.widths:
            raise ValueError(f"inputs of {widths} numbers a sample; {self.widths} are needed")
        m = lengths.pop()
        if out is None:
            out = np.empty((m, self.n_outputs))
        if out.shape != (m, self.n_outputs) or out.dtype != np.float64:
            raise ValueError(f"a result of {out.shape} {out.dtype}; ({m}, {self.n_outputs}) float64 is needed")
        # Machine code asks nobody before it writes.
        if not out.flags.writeable:
            raise ValueError("a result that is read-only")
        if m == 0 or self.n_outputs == 0:
            return out
        # Some entries are written before all inputs are read, and the last samples may be computed twice: a result that
        # shares memory with an input, or whose rows are not contiguous, is evaluated elsewhere and copied.
        if not _has_contiguous_rows(out) or any(np.may_share_memory(out, item) for item in inputs):
            out[:] = self(*inputs)
            return out
        # Code for several lanes cannot evaluate fewer samples than it has lanes.
        compiled = self._vector_code if m >= _LANES else self._scalar_code
        compiled.run(m, out, [_to_contiguous_rows(item) for item in inputs])
        return out


def _has_contiguous_rows(array: FloatArray) -> bool:
    """Return whether each row is contiguous and rows are a whole number of float64 apart."""
    whole = array.strides[0] % NUMBER == 0
    return bool(array.flags.aligned and whole and (array.shape[-1] <= 1 or array.strides[-1] == NUMBER))


def _to_contiguous_rows(item: FloatArray) -> FloatArray:
    array = np.asarray(item, dtype=np.float64)
    return array if _has_contiguous_rows(array) else np.ascontiguousarray(array)
