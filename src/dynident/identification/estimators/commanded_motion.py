"""The commanded motion of a recording, delayed like the robot: a reference without the noise of encoders."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.estimators.recorded_motion import RecordedMotion, read_whole_segments
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.commanded import replace_by_command

# Share of the motion by which it may differ from the delayed command; above it the robot did not follow.
_FOLLOWED = 0.05
# Gauss-Newton steps for the delay: it is small, so that few are enough.
_DELAY_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class CommandedMotion:
    """The command of every segment, delayed by `delay` (n,) in s, which brings it nearest to the measured motion.

    `rest`: the rms difference between the two over the size of the motion, for the joint where that is largest.
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
    """
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
