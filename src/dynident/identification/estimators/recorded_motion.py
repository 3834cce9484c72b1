"""The recorded motion, as a reference that a simulated robot follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.recordings import Preprocessing, Recording, SampleBlock, filtered_blocks
from dynident.simulation import Reference

_EVERYTHING = slice(None)
# t, q, dq, ddq, tau and temperature of consecutive samples.
_Rows = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Consecutive samples of a recording: the filtered motion, and the torque (m, n) measured along it.

    `sampling_rate` in Hz is the recording's, `label` that of its run.
    """

    reference: Reference
    tau: FloatArray
    sampling_rate: float
    label: str


def read_whole_segments(recording: Recording, preprocessing: Preprocessing) -> tuple[RecordedMotion, ...]:
    """Return the motion of every segment from its first sample to its last, inside the windows or not.

    Parameters
    ----------
    recording : Recording
    preprocessing : Preprocessing

    Returns
    -------
    tuple of RecordedMotion

    Raises
    ------
    DynidentError
        For a cut-off above the Nyquist frequency.
    """
    motions = []
    for segment in range(len(recording.segments)):
        blocks = filtered_blocks(recording, preprocessing, segments=[segment])
        motions.append(_join_pieces(recording, segment, [_take_rows(block) for block in blocks]))
    return tuple(motions)


def read_longest_piece(recording: Recording, preprocessing: Preprocessing, longest: float) -> RecordedMotion:
    """Return the longest unbroken piece of used samples, cut to at most `longest` seconds.

    Parameters
    ----------
    recording : Recording
    preprocessing : Preprocessing
    longest : float
        In s.

    Raises
    ------
    DynidentError
        Where there are not two such samples.
    """
    best: list[_Rows] = []
    run: list[_Rows] = []
    longest_length, length, segment_of_best = 0, 0, 0
    for block in filtered_blocks(recording, preprocessing):
        if block.starts_segment:
            run, length = [], 0
        # Samples come in blocks, and a piece may go on from one block to the next.
        borders = np.flatnonzero(np.diff(block.used)) + 1
        for first, last in zip([0, *borders], [*borders, len(block.t)], strict=True):
            if first == last or not block.used[first]:
                run, length = [], 0
                continue
            run = [*run, _take_rows(block, slice(first, last))]
            length += last - first
            if length > longest_length:
                best, longest_length, segment_of_best = run, length, block.segment
    if longest_length < 2:
        raise DynidentError(
            f"{recording.name} has no unbroken stretch of samples inside its windows",
            pointer="/windows",
            title="No motion to simulate",
        )
    return _join_pieces(recording, segment_of_best, best, longest)


def _take_rows(block: SampleBlock, part: slice = _EVERYTHING) -> _Rows:
    heat = np.zeros_like(block.q) if block.temperature is None else block.temperature
    return block.t[part], block.q[part], block.dq[part], block.ddq[part], block.tau[part], heat[part]


def _join_pieces(recording: Recording, segment: int, pieces: list[_Rows], longest: float = np.inf) -> RecordedMotion:
    """Join consecutive pieces of a segment to one motion, cut to at most `longest` seconds."""
    t, q, dq, ddq, tau, heat = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    inside = t <= t[0] + longest
    temperature = heat[inside] if recording.has_temperature else None
    reference = Reference(t[inside], q[inside], dq[inside], ddq[inside], temperature)
    return RecordedMotion(reference, tau[inside], recording.sampling_rate, recording.name_segment(segment))
