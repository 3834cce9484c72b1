"""The recorded and the commanded motion, as references that a simulated robot follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.recordings import Preprocessing, Recording, SampleBlock, filtered_blocks
from dynident.recordings.sources import replace_by_command
from dynident.simulation import Reference

# Share of the motion by which it may differ from the delayed command; above it the robot did not follow.
_FOLLOWED = 0.05
# Gauss-Newton steps for the delay: it is small, so that few are enough.
_DELAY_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class CommandedMotion:
    """The command of every segment, as late as the robot was.

    Parameters
    ----------
    segments : tuple of RecordedMotion
        The delayed command of each segment.
    delay : (n,)
        Delay of each joint in s, which brings the command nearest to the measured motion.
    rest : float
        The rms difference between the two over the size of the motion, for the joint where that is largest.
    """

    segments: tuple[RecordedMotion, ...]
    delay: FloatArray
    rest: float

    @property
    def is_followed(self) -> bool:
        """Whether the robot followed the command but for the delay."""
        return self.rest <= _FOLLOWED


def align_commanded_motion(recording: Recording, smooth: Preprocessing) -> CommandedMotion:
    """Return the commanded motion behind a zero-phase filter, as late as the measured one behind the same filter.

    Parameters
    ----------
    recording : Recording
        With commanded positions.
    smooth : Preprocessing
        Its position filter is used.

    Returns
    -------
    CommandedMotion
        The delayed command, and how well the robot followed it.
    """
    # Both behind the same filter, so that its delay and band cancel in the comparison.
    measured = read_whole_segments(recording, smooth)
    ahead = read_whole_segments(replace_by_command(recording), smooth)
    delay = np.zeros(recording.n)
    for _ in range(_DELAY_ROUNDS):
        late = tuple(_delay_motion(motion, delay) for motion in ahead)
        gap = np.concatenate([m.reference.q - c.reference.q for m, c in zip(measured, late, strict=True)])
        slope = np.concatenate([c.reference.dq for c in late])
        squares = np.sum(slope**2, axis=0)
        # Least squares for a shift in time: to first order the gap between both motions is the velocity times the
        # missing delay.
        delay = delay - np.sum(gap * slope, axis=0) / np.where(squares > 0, squares, np.inf)
    # Commands that are no numbers give no delay: they are reported as not followed.
    if not np.isfinite(delay).all():
        return CommandedMotion(measured, np.zeros(recording.n), np.inf)
    late = tuple(_delay_motion(motion, delay) for motion in ahead)
    gap = np.concatenate([m.reference.q - c.reference.q for m, c in zip(measured, late, strict=True)])
    size = np.std(np.concatenate([m.reference.q for m in measured]), axis=0)
    # A joint that hardly moves has no motion that the difference could be compared with.
    moving = size > 1e-3 * size.max()
    rest = np.sqrt(np.mean(gap**2, axis=0))[moving] / size[moving]
    return CommandedMotion(late, delay, float(rest.max(initial=0.0)))


def _delay_motion(motion: RecordedMotion, delay: FloatArray) -> RecordedMotion:
    """Return the motion with every joint delayed by so many seconds."""
    reference = motion.reference
    q, dq, ddq = (
        np.column_stack(
            [np.interp(reference.t - late, reference.t, part[:, joint]) for joint, late in enumerate(delay)]
        )
        for part in (reference.q, reference.dq, reference.ddq)
    )
    return replace(motion, reference=replace(reference, q=q, dq=dq, ddq=ddq))


_EVERYTHING = slice(None)
# t, q, dq, ddq, tau and temperature of consecutive samples.
_Rows = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Consecutive samples of a recording.

    Parameters
    ----------
    reference : Reference
        The filtered motion.
    tau : (m, n)
        Torque that was measured along it, in N m or N.
    sampling_rate : float
        Rate of the recording in Hz.
    label : str
        Label of its run.
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
        The recording.
    preprocessing : Preprocessing
        Filters of the recordings.

    Returns
    -------
    tuple of RecordedMotion
        One motion for each segment.

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
        The recording.
    preprocessing : Preprocessing
        Filters of the recordings.
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
        # A new segment is a new motion: time and positions jump.
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
