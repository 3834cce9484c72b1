"""W of chosen columns [12.4]: its inputs, its compiled expression, its evaluation in blocks."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Column, MemorySignal, ReferenceParameters, RunSignal, Signals, get_effect
from dynident.estimation import PriorInformation
from dynident.expressions import Program
from dynident.recordings import Preprocessing, Recording
from dynident.robot.contacts import Mixing, find_mixed_joints, yield_mixing_matrices
from dynident.robot.robot_model import Robot


@dataclass(frozen=True, eq=False)
class FurtherSignals:
    """Values at m samples; what is left out counts as zero.

    Parameters
    ----------
    dddq, ddddq : (m, n), optional
        Third and fourth derivative of q in rad/s³ and rad/s⁴, or m/s³ and m/s⁴.
    time : (m,), optional
        Time of the session, s.
    temperature : (m, n), optional
        Temperature of every joint, °C.
    runs : (number of run signals,) or (m, number of run signals), optional
        1 where the samples' run is one of the signal's.
    period : float
        Sampling period in s, for columns that jump.
    """

    dddq: FloatArray | None = None
    ddddq: FloatArray | None = None
    time: FloatArray | None = None
    temperature: FloatArray | None = None
    runs: FloatArray | None = None
    period: float = 1e-3


NOTHING_FURTHER = FurtherSignals()
"""For columns that depend on the motion alone, to its second derivative."""


@dataclass(frozen=True, eq=False)
class RegressorInputs:
    """Recordings, and what makes rows of W and Y of them.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of the robot.
    preprocessing : Preprocessing
        Their filters, differentiation and decimation.
    reference : ReferenceParameters
        Parameters that loads and motor torques are predicted with.
    known : PriorInformation, optional
        What is known of the model's parameters beside the data.
    kept_rows : dict, optional
        Filtered rows that one pass over the recordings leaves to the next; without, each filters all columns anew.
    """

    recordings: Sequence[Recording]
    preprocessing: Preprocessing
    reference: ReferenceParameters
    known: PriorInformation | None = None
    kept_rows: dict[tuple[Hashable, ...], FloatArray] | None = None


AnyProgram: TypeAlias = "Program | ConcatenatedPrograms | ProjectedProgram"


class ConcatenatedPrograms:
    """Two programs evaluated together: the entries of the first, then those of the second.

    Parameters
    ----------
    first, second : Program, ConcatenatedPrograms or ProjectedProgram
        What is evaluated.
    widths : sequence of int
        Widths of the inputs of both together.
    selections : sequence of (k,) or slice
        For every input: which of its columns the second program reads, in its order; the first reads the leading ones.
    """

    def __init__(
        self,
        first: AnyProgram,
        second: AnyProgram,
        widths: Sequence[int],
        selections: Sequence[NDArray[np.intp] | slice],
    ) -> None:
        self._first, self._second = first, second
        self.widths: tuple[int, ...] = tuple(widths)
        self._selections = tuple(selections)
        self.n_outputs: int = first.n_outputs + second.n_outputs

    @property
    def n_instructions(self) -> int:
        """Number of operations a sample."""
        return self._first.n_instructions + self._second.n_instructions

    def __call__(self, *inputs: FloatArray, out: FloatArray, mixing: FloatArray) -> None:
        """Evaluate on samples into `out` (m, n_outputs), as a `Program` or a `ProjectedProgram` does."""
        border = self._first.n_outputs
        # Inputs only ever grow at their ends, so that the first program reads the leading columns.
        leading = [item[..., :width] for item, width in zip(inputs, self._first.widths, strict=True)]
        _run(self._first, leading, out[:, :border], mixing)
        selected = [item[..., selection] for item, selection in zip(inputs, self._selections, strict=True)]
        _run(self._second, selected, out[:, border:], mixing)


def _run(program: AnyProgram, inputs: Sequence[FloatArray], out: FloatArray, mixing: FloatArray) -> None:
    """Evaluate a program; equations of a robot without contacts are not mixed."""
    if isinstance(program, Program):
        program(*inputs, out=out)
    else:
        program(*inputs, out=out, mixing=mixing)


class ProjectedProgram:
    """A program of W whose rows are projected so that contact forces do not appear in them: the entries of P(q) W.

    P mixes the equations of the joints that move a contact, and leaves those of the others as they are.

    Parameters
    ----------
    program : Program
        Evaluates the entries of W; the positions are its first input.
    robot : Robot
        Robot with contacts.
    places : (rows, columns)
        Where the entries stand in W.
    n_columns : int
        Number of columns of W.
    """

    def __init__(
        self, program: AnyProgram, robot: Robot, places: tuple[IndexArray, IndexArray], n_columns: int
    ) -> None:
        self._program = program
        is_mixed = find_mixed_joints(robot)
        filled = np.zeros((robot.n, n_columns), dtype=bool)
        filled[places] = True
        columns = np.flatnonzero(filled[is_mixed].any(axis=0))
        filled[is_mixed] = False
        self._mixed = np.flatnonzero(is_mixed)
        self._block_shape = len(self._mixed), len(columns)
        # The mixed block is dense: it stands first, so that products are written to their places at once.
        others = np.nonzero(filled)
        rows = np.concatenate([np.repeat(self._mixed, len(columns)), others[0]])
        cols = np.concatenate([np.tile(columns, len(self._mixed)), others[1]])
        self.places: tuple[IndexArray, IndexArray] = (rows, cols)
        self.widths: tuple[int, ...] = tuple(program.widths)
        self.n_outputs: int = len(rows)
        # Where entries of the program go in the mixed block, and where the others go in the answer.
        own = is_mixed[places[0]]
        self._from_program, self._others = np.flatnonzero(own), np.flatnonzero(~own)
        block_row, block_column = np.cumsum(is_mixed) - 1, np.searchsorted(columns, places[1][own])
        self._into_block = block_row[places[0][own]], block_column
        number = np.full(filled.shape, -1, dtype=np.intp)
        number[rows, cols] = np.arange(len(rows))
        self._other_places = number[places[0][~own], places[1][~own]]

    @property
    def n_instructions(self) -> int:
        """Number of operations a sample."""
        return self._program.n_instructions + len(self._mixed) * math.prod(self._block_shape)

    def __call__(self, *inputs: FloatArray, out: FloatArray, mixing: FloatArray) -> None:
        """Evaluate on samples, as a `Program` does.

        Parameters
        ----------
        inputs : (m, width) or (width,)
        out : (m, n_outputs)
            Where the entries are put.
        mixing : (m, k, k)
            From `yield_mixing_matrices`.
        """
        entries = np.empty((len(out), self._program.n_outputs))
        _run(self._program, inputs, entries, mixing)
        size = math.prod(self._block_shape)
        block = np.zeros((len(entries), *self._block_shape))
        block[:, self._into_block[0], self._into_block[1]] = entries[:, self._from_program]
        # One axis is split in two, so that this is no copy.
        np.matmul(mixing, block, out=out[:, :size].reshape(block.shape))
        out[:, self._other_places] = entries[:, self._others]


# Places of these inputs in a program.
_MEMORY, _RUNS = 8, 9
FAR = 1e6
"""Number of slip distances after which any hysteresis slides steadily: its start has faded by exp(-FAR)."""


@dataclass(frozen=True, eq=False)
class Observation:
    """W of one robot for `columns`, as the list of its structural non-zeros.

    Parameters
    ----------
    robot : Robot
        Robot that the columns belong to.
    columns : tuple of Column
        One for every parameter.
    memory : tuple of MemorySignal
        Hysteresis states that must be supplied, in this order.
    runs : tuple of RunSignal
        Run signals that must be supplied, in this order.
    entry_rows, entry_columns : (e,)
        Row (of W: joint) and column of each of the e entries of an evaluation.
    n_rows : int
        Number of rows for one sample.
    program : Program, ConcatenatedPrograms or ProjectedProgram
        Evaluates the entries.
    parts : tuple of two Observation, optional
        Where it extends another one: that one, and what was put behind it.
    """

    robot: Robot
    columns: tuple[Column, ...]
    memory: tuple[MemorySignal, ...]
    runs: tuple[RunSignal, ...]
    entry_rows: IndexArray
    entry_columns: IndexArray
    n_rows: int
    program: AnyProgram
    parts: tuple[Observation, Observation] | None = None

    @classmethod
    def from_columns(cls, robot: Robot, columns: Sequence[Column], signals: Signals) -> Observation:
        """Build the observation matrix of columns.

        Parameters
        ----------
        robot : Robot
            Robot that the columns belong to.
        columns : sequence of Column
            One for every parameter.
        signals : Signals
            The symbols that the columns are made of.

        Returns
        -------
        Observation
            With one row a joint.
        """
        sparse = cls.from_matrix(robot, columns, _build_matrix(robot, columns), signals)
        if not robot.contacts or not columns:
            return sparse
        program = ProjectedProgram(sparse.program, robot, (sparse.entry_rows, sparse.entry_columns), len(columns))
        return replace(sparse, entry_rows=program.places[0], entry_columns=program.places[1], program=program)

    @classmethod
    def from_matrix(cls, robot: Robot, columns: Sequence[Column], matrix: ca.SX, signals: Signals) -> Observation:
        """Build another matrix of the same columns.

        Parameters
        ----------
        robot : Robot
            Robot that the columns belong to.
        columns : sequence of Column
            One for every column of the matrix; their names and units.
        matrix : SX (k, c)
            Expressions in the signals; k need not be n.
        signals : Signals
            The symbols that the columns are made of.

        Returns
        -------
        Observation
            With k rows.
        """
        memory, runs = signals.find_memory_signals(matrix), signals.find_run_signals(matrix)
        # Only structural non-zeros are evaluated and stored: most parameters do not act on most joints.
        rows, cols = matrix.sparsity().get_triplet()
        return cls(
            robot=robot,
            columns=tuple(columns),
            memory=memory,
            runs=runs,
            entry_rows=np.array(rows, dtype=np.intp),
            entry_columns=np.array(cols, dtype=np.intp),
            n_rows=int(matrix.shape[0]),
            program=Program(_collect_inputs(signals, memory, runs), matrix),
        )

    def extend(self, columns: Sequence[Column], signals: Signals) -> Observation:
        """Return the observation matrix with more columns behind the present ones.

        Parameters
        ----------
        columns : sequence of Column
            The columns to add.
        signals : Signals
            The symbols that the columns are made of.

        Returns
        -------
        Observation
            It shares the compiled programs of this one.
        """
        if not columns:
            return self
        tail = _build_tail(self.robot, columns, signals)
        memory = self.memory + tuple(item for item in tail.memory if item not in self.memory)
        runs = self.runs + tuple(item for item in tail.runs if item not in self.runs)
        widths = list(tail.program.widths)
        selections: list[IndexArray | slice] = [slice(None)] * len(widths)
        for place, together, own in ((_MEMORY, memory, tail.memory), (_RUNS, runs, tail.runs)):
            # The tail knows only its own hysteresis states and runs: it selects them from those of the whole.
            widths[place] = len(together)
            selections[place] = np.array([together.index(item) for item in own], dtype=np.intp)
        return Observation(
            robot=self.robot,
            columns=self.columns + tail.columns,
            memory=memory,
            runs=runs,
            entry_rows=np.concatenate([self.entry_rows, tail.entry_rows]),
            entry_columns=np.concatenate([self.entry_columns, self.n_columns + tail.entry_columns]),
            n_rows=self.n_rows,
            program=ConcatenatedPrograms(self.program, tail.program, widths, selections),
            parts=(self, tail),
        )

    @property
    def n_columns(self) -> int:
        """Number of parameters c."""
        return len(self.columns)

    @property
    def n_memory(self) -> int:
        """Number of hysteresis states to be supplied."""
        return len(self.memory)

    def evaluate(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        *,
        reference: ReferenceParameters,
        memory: FloatArray,
        further: FurtherSignals = NOTHING_FURTHER,
        out: FloatArray | None = None,
        mixing: Iterable[Mixing] | None = None,
    ) -> FloatArray:
        """Evaluate the entries of W at m samples.

        Parameters
        ----------
        q, dq, ddq : (m, n)
            rad or m, and their derivatives.
        reference : ReferenceParameters
            What the torque of the load and of the motors is predicted with.
        memory : (m, number of memory signals)
            Hysteresis states in [-1, 1].
        further : FurtherSignals, optional
            What the columns depend on besides q, dq and ddq.
        out : (m, number of entries), optional
            Where to put the result.
        mixing : iterable, optional
            How contacts mix the equations, from `yield_mixing_matrices`; by the positions `q` where left out.

        Returns
        -------
        (m, number of entries)
            The structural non-zeros of W at every sample.
        """
        n = self.robot.n
        # One row of zeros holds for all samples.
        nothing = np.zeros(n)
        inputs = (
            q,
            dq,
            ddq,
            nothing if further.dddq is None else further.dddq,
            nothing if further.ddddq is None else further.ddddq,
            np.zeros(1) if further.time is None else further.time[:, None],
            np.array([further.period]),
            nothing if further.temperature is None else further.temperature,
            memory,
            np.zeros(len(self.runs)) if further.runs is None else further.runs,
            reference.to_vector(self.robot),
        )
        if out is None:
            out = np.empty((len(q), len(self.entry_rows)))
        if not self.robot.contacts or isinstance(self.program, Program):
            _run(self.program, inputs, out, np.empty(0))
            return out
        # All programs share the matrices of a sample, which take longer than they.
        for part, matrices, _ in yield_mixing_matrices(self.robot, q, None) if mixing is None else mixing:
            _run(self.program, [item[part] if item.ndim == 2 else item for item in inputs], out[part], matrices)
        return out

    def compute_sliding_states(self, dq: FloatArray) -> FloatArray:
        """Return the steady states (m, number of hysteresis signals) of joints that keep on moving at dq (m, n)."""
        states = np.zeros((len(dq), self.n_memory))
        for k, signal in enumerate(self.memory):
            moved = FAR * np.sign(dq[:, signal.joint])
            # Only the sign of the velocity counts: after such a way every operator slides in its direction.
            states[:, k] = [signal.operator.stroke(np.zeros(1), np.array([[way]]))[0, 0] for way in moved]
        return states

    def joint_entries(self, joint: int) -> tuple[IndexArray, IndexArray]:
        """Return the positions among the entries, and the columns (ascending), of one joint's row."""
        # An extended matrix has the entries of its parts one behind the other, so that they have to be sorted again.
        positions = np.flatnonzero(self.entry_rows == joint)
        order = np.argsort(self.entry_columns[positions], kind="stable")
        return positions[order], self.entry_columns[positions[order]]

    def compute_torque(self, entries: FloatArray, values: FloatArray) -> FloatArray:
        """Return W χ from entries of W.

        Parameters
        ----------
        entries : (m, number of entries)
            From `evaluate`.
        values : (c,)
            Parameters χ.

        Returns
        -------
        (m, n_rows) array
            N m or N.
        """
        weighted = entries * values[self.entry_columns]
        out = np.zeros((len(entries), self.n_rows))
        for row in range(self.n_rows):
            # Summed row by row: W is sparse, and a dense W would need memory for its zeros.
            out[:, row] = weighted[:, self.entry_rows == row].sum(axis=1)
        return out


def _build_tail(robot: Robot, columns: Sequence[Column], signals: Signals) -> Observation:
    """Build the matrix of columns that are put behind others, each kind of them in a program of its own.

    First-order effects are derivatives of the whole torque, so that compiling them takes longest: they are built once.
    Which shape constants are tried of some others depends on the data. Mostly one kind changes from one matrix to the
    next: then the machine code of the others is at hand.
    """
    kinds = np.array([_find_kind(column) for column in columns])
    if len(columns) and (kinds == 2).all():
        key, matrix = (robot, *columns), _build_matrix(robot, columns)
        return signals.build_once(key, lambda: (Observation.from_columns(robot, columns, signals), matrix))
    if not len(columns) or (kinds == kinds[0]).all():
        return Observation.from_columns(robot, columns, signals)
    order = np.argsort(kinds, kind="stable")
    first, *others = ([columns[k] for k in order if kinds[k] == kind] for kind in np.unique(kinds))
    whole = Observation.from_columns(robot, first, signals)
    for same in others:
        whole = whole.extend(same, signals)
    return replace(whole, columns=tuple(columns), entry_columns=order[whole.entry_columns], parts=None)


def _find_kind(column: Column) -> int:
    """Return 2 for a first-order effect, 1 for one whose constants are tried as the data are, 0 for all others."""
    if not column.effect:
        return 0
    effect = get_effect(column.effect)
    depends = effect.proposal != "grid" or any(spec.resolved_by for spec in effect.shapes)
    return 2 if effect.first_order else int(depends)


def _build_matrix(robot: Robot, columns: Sequence[Column]) -> ca.SX:
    return ca.horzcat(*(column.torque for column in columns)) if columns else ca.SX(robot.n, 0)


def _collect_inputs(signals: Signals, memory: Sequence[MemorySignal], runs: Sequence[RunSignal]) -> list[ca.SX]:
    return [
        signals.q,
        signals.dq,
        signals.ddq,
        signals.dddq,
        signals.ddddq,
        signals.time,
        signals.period,
        signals.temperature,
        ca.vertcat(*(signals.memory(item) for item in memory)) if memory else ca.SX(0, 1),
        ca.vertcat(*(signals.in_runs(item) for item in runs)) if runs else ca.SX(0, 1),
        signals.reference,
    ]
