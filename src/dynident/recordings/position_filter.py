"""Zero-phase filter and differentiation of positions, block by block (§12.3.5)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from math import ceil, log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray
from dynident.expressions.recursive_filter import filter_sections
from dynident.recordings.preprocessing import Preprocessing
from dynident.recordings.recording import Recording, SampleBlock, Segment, StoredRows

ComplexArray = NDArray[np.complex128]


def design_butterworth(rate: float, cutoff: float, order: int) -> tuple[FloatArray, ComplexArray]:
    """Design a Butterworth low-pass.

    Parameters
    ----------
    rate, cutoff : float
        Sampling rate and cut-off frequency (half power) in Hz.
    order : int
        Number of poles.

    Returns
    -------
    sections : (s, 6)
        Second-order sections, b0, b1, b2, 1, a1, a2 of each; the poles that are nearest to the unit circle come last.
    poles : (order,) of complex
        The filter's poles.

    Raises
    ------
    ValueError
        For a cut-off frequency that is not between zero and half of the sampling rate.
    """
    if not 0.0 < 2.0 * cutoff < rate:
        raise ValueError(f"cut-off frequency {cutoff:g} Hz; it must be between 0 and {rate / 2:g} Hz")
    # Poles of the analog filter on the left half of a circle. The bilinear transform, at two samples in a second,
    # bends the frequency axis, so that the circle's radius is the bent cut-off frequency.
    k = np.arange(-order + 1, order, 2, dtype=np.float64)
    analog = 4.0 * np.tan(np.pi * (2.0 * cutoff / rate) / 2.0) * -np.exp(1j * np.pi * k / (2 * order))
    poles = (4.0 + analog) / (4.0 - analog)
    gain = (4.0 * np.tan(np.pi * (2.0 * cutoff / rate) / 2.0)) ** order * np.real(1.0 / np.prod(4.0 - analog))
    return _pair_sections(poles, gain), poles


def _pair_sections(poles: ComplexArray, gain: float) -> FloatArray:
    """Return the sections of a low-pass whose zeros are all at -1: each pole with the zeros nearest to it."""
    order = len(poles)
    # Of an odd order one section has a real pole, and a pole and a zero at the origin to fill it up.
    zeros = [-1.0] * order + [0.0] * (order % 2)
    pairs = [pole for pole in poles if pole.imag > 0.0]
    real = [complex(pole) for pole in poles if pole.imag == 0.0]
    sections = np.zeros((len(zeros) // 2, 6))
    # From the last section to the first. Poles near the unit circle are the sharpest and come last.
    for section in sections[::-1]:
        pole = min((*pairs, *real), key=lambda candidate: abs(1.0 - abs(candidate)))
        if pole in pairs:
            pairs.remove(pole)
            both = [pole, np.conj(pole)]
        else:
            real.remove(pole)
            both = [pole, 0.0]
        zeros.sort(key=lambda zero: abs(pole - zero))
        section[:3], section[3:] = np.poly(zeros[:2]), np.poly(both)
        del zeros[:2]
    sections[0, :3] *= gain
    return sections


def compute_steady_state(sections: FloatArray) -> FloatArray:
    """Return the state (s, 2) that a constant input of one leaves in the sections.

    Parameters
    ----------
    sections : (s, 6)
        Second-order sections.
    """
    state, level = np.empty((len(sections), 2)), 1.0
    for index, (b0, b1, b2, _, a1, a2) in enumerate(sections):
        # The state that no longer changes: z = A z + B.
        unchanged = np.linalg.solve([[1.0 + a1, -1.0], [a2, 1.0]], [b1 - a1 * b0, b2 - a2 * b0])
        state[index] = level * unchanged
        # The next section's input is the gain of this one at zero frequency.
        level *= (b0 + b1 + b2) / (1.0 + a1 + a2)
    return state


FORGOTTEN = 1e-16
"""The backward pass starts this far ahead: what it does not know of the future has decayed to rounding error."""

SETTLED = 1e-2
"""A transient of the filter counts as over once it has decayed to this share."""


class ZeroPhase:
    """Forward-backward Butterworth low-pass in second-order sections, applied to blocks of a segment.

    Parameters
    ----------
    rate, cutoff : float
        Sampling rate and cut-off frequency (half power of one pass) in Hz.
    order : int
        Order of one pass.
    """

    def __init__(self, rate: float, cutoff: float, order: int) -> None:
        self._sos, poles = design_butterworth(rate, cutoff, order)
        # The state that a constant input of one leaves behind: times the first sample it starts the filter without a
        # step.
        self._zi = compute_steady_state(self._sos)[:, :, None]
        # A transient decays by this much (as an exponent) with each sample: by the slowest pole.
        self._decay = -log(min(float(np.abs(poles).max()), 1.0 - 1e-15))
        # The same extension at the ends as scipy.signal.sosfiltfilt takes by default.
        sections = len(self._sos)
        at_origin = min(int((self._sos[:, 2] == 0).sum()), int((self._sos[:, 5] == 0).sum()))
        self._pad = 3 * (2 * sections + 1 - at_origin)

    @property
    def lookahead(self) -> int:
        """Samples of the future that an output sample depends on."""
        return ceil(-log(FORGOTTEN) / self._decay) + 1

    @property
    def settling(self) -> int:
        """Samples at either end of a segment that its unknown surroundings spoil."""
        return ceil(-log(SETTLED) / self._decay)

    def stream(
        self, blocks: Iterable[tuple[FloatArray, bool]], least_lookahead: int = 0
    ) -> Iterator[tuple[FloatArray, bool]]:
        """Filter the blocks of one segment.

        Parameters
        ----------
        blocks : iterable of (m, n) and bool
            Samples of one segment, in order, and whether they are the last ones. An empty block says that there are no
            more for now.
        least_lookahead : int
            Look ahead by so many samples at least. Filters that look ahead equally far give parts of equal lengths.

        Yields
        ------
        (k, n) and bool
            Of other lengths than the blocks, the same total; none for an empty block.
        """
        ahead = max(self.lookahead, least_lookahead)
        state: FloatArray | None = None
        tail = np.empty((0, 0))
        waiting: list[FloatArray] = []
        n_waiting = 0
        for block, last in blocks:
            if not len(block):
                yield block, False
                continue
            if state is None:
                if not last and len(block) <= self._pad:
                    raise ValueError(f"the first block holds {len(block)} samples; at least {self._pad + 1} are needed")
                # The odd extension that sosfiltfilt puts before the first sample: point-symmetric about it, so that
                # no step excites the filter.
                start = 2 * block[0] - block[min(self._pad, len(block) - 1) : 0 : -1]
                block_ends = np.concatenate([start, block])
                state = self._zi * block_ends[0]
                if len(start):
                    state = filter_sections(self._sos, start, state)[1]
                tail = block[:0]
            # The extension of the end needs the last samples, which several short blocks may hold together.
            tail = block if len(block) > self._pad else np.concatenate([tail, block])[-(self._pad + 1) :]
            forward, state = filter_sections(self._sos, block, state)
            waiting.append(forward)
            n_waiting += len(forward)
            if last:
                # The same extension behind the last sample. What the filter makes of it is cut off again below.
                end = 2 * tail[-1] - tail[-2 : -(min(self._pad, len(tail) - 1) + 2) : -1]
                if len(end):
                    waiting.append(filter_sections(self._sos, end, state)[0])
                yield self._filter_backward(waiting)[:n_waiting], True
                return
            # The backward pass starts anew for each block, `ahead` samples further on, by which its unknown start has
            # died away: those samples are filtered again with the next block.
            if n_waiting >= 2 * ahead:
                joined = np.concatenate(waiting)
                yield self._filter_backward([joined])[: n_waiting - ahead], False
                waiting = [joined[-ahead:].copy()]
                n_waiting = ahead

    def _filter_backward(self, parts: list[FloatArray]) -> FloatArray:
        """Filter the joined parts backward in time, from a steady state at their last sample."""
        forward = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return filter_sections(self._sos, forward[::-1], self._zi * forward[-1])[0][::-1]


READ_LENGTH = 8192

HELD_BACK = 128
"""Samples that are held back of a recording under way: filters of any order extend its end by fewer."""


class _Rows(NamedTuple):
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    dddq: FloatArray
    ddddq: FloatArray
    measured: StoredRows


_REACH = 2
"""Neighbours on either side that the highest difference needs."""


def filtered_blocks(
    recording: Recording,
    preprocessing: Preprocessing,
    *,
    block_length: int = 4096,
    segments: Sequence[int] | None = None,
    acceleration_cutoff: float | None = None,
) -> Iterator[SampleBlock]:
    """Stream a recording through the position filter and the central differences.

    Positions pass a zero-phase Butterworth filter over the whole segment, also outside the windows, so that the
    windows' rows are filtered with their true surroundings. Velocity and acceleration are central differences of five
    points: those of three points, [12.16] and (q(k+1) - 2 q(k) + q(k-1)) / T², take (ωT)²/6 and (ωT)²/12 off a motion,
    which on exact data is what limits the parameters. The third and fourth derivatives are central differences of the
    second one. Torque and temperature pass unfiltered.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    preprocessing : Preprocessing
        Filters and decimation, of which `position_cutoff` (None: positions are taken as they are) and `filter_order`
        are used here.
    block_length : int
        Longest block to give; memory is bounded by it and by the filter's memory, not by the recording.
    segments : sequence of int or None
        Which segments, by index; None: all. Nothing is ever filtered across their ends.
    acceleration_cutoff : float or None
        Cut-off in Hz of the filter that the acceleration passes, above that of the positions; None: the same filter.

    Yields
    ------
    SampleBlock
        Consecutive, without overlap, each within one segment.
    """
    preprocessing.check_against(recording.sampling_rate)
    for index in range(len(recording.segments)) if segments is None else segments:
        segment = recording.segments[index]
        if segment.length:
            yield from _segment_blocks(recording, index, segment, preprocessing, block_length, acceleration_cutoff)


def compute_edge_margin(preprocessing: Preprocessing, rate: float) -> int:
    """Return the samples at either end of a segment that are not used, because the filter still settles there.

    Parameters
    ----------
    preprocessing : Preprocessing
        Filters and decimation.
    rate : float
        Sampling rate in Hz.

    Returns
    -------
    int
        Number of samples.
    """
    if preprocessing.position_cutoff is None:
        return _REACH
    return _REACH + ZeroPhase(rate, preprocessing.position_cutoff, preprocessing.filter_order).settling


def _segment_blocks(
    recording: Recording,
    index: int,
    segment: Segment,
    preprocessing: Preprocessing,
    block_length: int,
    acceleration_cutoff: float | None,
) -> Iterator[SampleBlock]:
    margin = compute_edge_margin(preprocessing, recording.sampling_rate)
    done = 0
    for rows, last in _differentiate_rows(recording, segment, preprocessing, acceleration_cutoff):
        measured = rows.measured
        # All rows but the last ones of a segment are farther from its end than the margin: the filters look ahead so
        # far. Of a recording under way the end is not known before.
        inside = done + len(rows.q) - margin if last else np.inf
        for start in range(0, max(len(rows.q), 1), block_length):
            part = slice(start, min(start + block_length, len(rows.q)))
            # Times follow from the number of the row: a sum of steps would gather rounding errors.
            numbers = np.arange(done, done + part.stop - part.start, dtype=np.float64)
            t = segment.start_time + numbers * recording.period
            used: BoolArray = (numbers >= margin) & (numbers < inside) & recording.inside_windows(t)
            yield SampleBlock(
                segment=index,
                t=t,
                q=rows.q[part],
                dq=rows.dq[part],
                ddq=rows.ddq[part],
                dddq=rows.dddq[part],
                ddddq=rows.ddddq[part],
                tau=measured.tau[part],
                used=used,
                temperature=None if measured.temperature is None else measured.temperature[part],
                starts_segment=done == 0,
                wrench=None if measured.wrench is None else measured.wrench[part],
                measured_q=measured.q[part],
            )
            done += part.stop - part.start


def _differentiate_rows(
    recording: Recording, segment: Segment, preprocessing: Preprocessing, acceleration_cutoff: float | None
) -> Iterator[tuple[_Rows, bool]]:
    """Yield runs of consecutive rows, positions and derivatives beside the torque of the same samples; the last one."""
    passing: deque[StoredRows] = deque()

    def read_positions() -> Iterator[tuple[FloatArray, bool]]:
        for rows, last in _read_stored_rows(recording, segment, length):
            passing.append(rows)
            yield rows.q, last

    length, cutoff, n = READ_LENGTH, preprocessing.position_cutoff, recording.n
    if cutoff is None:
        filtered = read_positions()
    else:
        zero_phase = ZeroPhase(recording.sampling_rate, cutoff, preprocessing.filter_order)
        # The backward pass repeats its look-ahead with every run: in runs much shorter than that it would do little
        # else.
        length = max(length, 2 * zero_phase.lookahead)
        if acceleration_cutoff is None:
            filtered = zero_phase.stream(read_positions())
        else:
            wide = ZeroPhase(recording.sampling_rate, acceleration_cutoff, preprocessing.filter_order)
            filtered = _filter_side_by_side(read_positions(), (zero_phase, wide))

    # Two samples are held back at each border: their right neighbours come with the next run.
    held: FloatArray | None = None
    first = True
    for q, last in filtered:
        joined = q if held is None else np.concatenate([held, q])
        both = _differentiate(joined, recording.sampling_rate, with_first=first, with_last=last)
        # Behind the positions stand those that the acceleration is made of, if these are others.
        own, dq, ddq, dddq, ddddq = both[0][:, :n], both[1][:, :n], both[2][:, -n:], both[3][:, :n], both[4][:, :n]
        # Of the four rows that stay two are still to be given; the other two were, and are their left neighbours.
        held = joined[-2 * _REACH :] if len(own) else joined
        first = first and not len(own)
        if len(own) or not len(q):
            yield _Rows(own, dq, ddq, dddq, ddddq, _take_rows(passing, len(own))), last


def _filter_side_by_side(
    blocks: Iterable[tuple[FloatArray, bool]], filters: Sequence[ZeroPhase]
) -> Iterator[tuple[FloatArray, bool]]:
    """Yield samples of a segment behind each of two filters, side by side (k, 2 n), and whether they are the last."""
    farthest = max(own.lookahead for own in filters)
    source = iter(blocks)
    queues: list[deque[tuple[FloatArray, bool]]] = [deque() for _ in filters]

    def read(queue: deque[tuple[FloatArray, bool]]) -> Iterator[tuple[FloatArray, bool]]:
        # `itertools.tee` would keep up to 57 blocks that all have read.
        while True:
            if not queue:
                block = next(source, None)
                if block is None:
                    return
                for each in queues:
                    each.append(block)
            yield queue.popleft()

    streams = [own.stream(read(queue), farthest) for own, queue in zip(filters, queues, strict=True)]
    for parts in zip(*streams, strict=True):
        yield np.hstack([q for q, _ in parts]), parts[0][1]


def _differentiate(
    q: FloatArray, rate: float, *, with_first: bool, with_last: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return q and its four derivatives (m, n) of the rows that have two neighbours on both sides.

    The segment's two ends are given if asked for. There the derivatives are those of the nearest inner row (zero in a
    segment of fewer than five rows); such rows are never marked as used.
    """
    part = slice(None if with_first else _REACH, None if with_last else -_REACH)
    if len(q) <= 2 * _REACH:
        if not with_last:
            return q[:0], q[:0], q[:0], q[:0], q[:0]
        still = np.zeros_like(q)
        return q[part], still[part], still[part], still[part], still[part]
    dq, ddq = _central_differences(q, rate)
    dddq, ddddq = _central_differences(ddq, rate)
    # The next term of both series, from derivatives that are there anyway: five points, an error of (ωT)⁴/30.
    inner = slice(_REACH, -_REACH)
    dq[inner] -= dddq[inner] / (6.0 * rate * rate)
    ddq[inner] -= ddddq[inner] / (12.0 * rate * rate)
    for values in (dq, ddq, dddq, ddddq):
        values[:_REACH], values[len(q) - _REACH :] = values[_REACH], values[-_REACH - 1]
    return q[part], dq[part], ddq[part], dddq[part], ddddq[part]


def _central_differences(values: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Return first and second central difference (m, n); the first and last row are zero."""
    first, second = np.empty_like(values), np.empty_like(values)
    np.subtract(values[2:], values[:-2], out=first[1:-1])
    first[1:-1] *= 0.5 * rate
    # As a difference of differences: it rounds less than q(k+1) - 2 q(k) + q(k-1).
    np.subtract(values[2:], values[1:-1], out=second[1:-1])
    second[1:-1] -= values[1:-1] - values[:-2]
    second[1:-1] *= rate * rate
    for derivative in (first, second):
        derivative[0], derivative[-1] = 0.0, 0.0
    return first, second


def _read_stored_rows(recording: Recording, segment: Segment, length: int) -> Iterator[tuple[StoredRows, bool]]:
    """Read a segment in runs of at least `length` rows (but the last), joining the source's own blocks.

    Of every run it is told whether it is the last one. An empty block, by which the source of a recording under way
    says that it has no more rows for now, is passed on behind what was read, but for rows that the end may need.
    """
    parts: list[StoredRows] = []
    count = 0
    run: StoredRows | None = None
    for rows in recording.source.rows(segment.first_row, segment.length, length):
        if not len(rows.q):
            so_far = _join_rows([*([] if run is None else [run]), *parts, rows])
            run, count = None, len(so_far.q)
            parts = [so_far]
            if count > 2 * HELD_BACK:
                yield _cut_rows(so_far, slice(0, -HELD_BACK)), False
                parts, count = [_cut_rows(so_far, slice(-HELD_BACK, None))], HELD_BACK
            yield rows, False
            continue
        # Whether a run is the last one shows by the rows behind it.
        if run is not None:
            yield run, False
            run = None
        parts.append(rows)
        count += len(rows.q)
        if count >= length:
            run = _join_rows(parts)
            parts, count = [], 0
    if run is not None:
        yield run, True
    elif parts:
        yield _join_rows(parts), True


def _join_rows(parts: list[StoredRows]) -> StoredRows:
    if len(parts) == 1:
        return parts[0]
    temperatures = [rows.temperature for rows in parts if rows.temperature is not None]
    wrenches = [rows.wrench for rows in parts if rows.wrench is not None]
    commands = [rows.command for rows in parts if rows.command is not None]
    return StoredRows(
        np.concatenate([rows.q for rows in parts]),
        np.concatenate([rows.tau for rows in parts]),
        np.concatenate(temperatures) if temperatures else None,
        np.concatenate(wrenches) if wrenches else None,
        np.concatenate(commands) if commands else None,
    )


def _take_rows(passing: deque[StoredRows], count: int) -> StoredRows:
    """Take the oldest `count` rows out of `passing`."""
    if not count:
        return _cut_rows(passing[0], slice(0, 0))
    parts: list[StoredRows] = []
    while count:
        rows = passing.popleft()
        # Filtered rows come in other lengths than the blocks that were read.
        if len(rows.q) > count:
            passing.appendleft(_cut_rows(rows, slice(count, None)))
            rows = _cut_rows(rows, slice(0, count))
        parts.append(rows)
        count -= len(rows.q)
    return _join_rows(parts)


def _cut_rows(rows: StoredRows, part: slice) -> StoredRows:
    optional = (None if values is None else values[part] for values in (rows.temperature, rows.wrench, rows.command))
    return StoredRows(rows.q[part], rows.tau[part], *optional)
