"""Unwrap angles that jump by half or whole turns; angles, rotations and quaternions of a frame."""

from __future__ import annotations

from math import pi

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.conditioning.windows_and_changed_rows import ChangedRows, Signals, Window
from dynident.recordings.recording_metadata import Check

TURN = 2.0 * pi

BORDERS = (-pi, 0.0)
"""Where the turns begin that drives count angles in: -pi to pi, or 0 to 2 pi (0 to 360 degrees)."""

ROUNDING = 0.01
"""rad by which a wrapped angle may stand outside its turn: half a degree of a controller that counts in them."""

INSIDE_SHARE = 0.95
"""Share of the values that have to stand inside one turn; the others may be corrupted."""


def fold_angles(difference: FloatArray, period: float = TURN) -> FloatArray:
    """Return differences of angles within half a period; unchanged if the period is 0."""
    return np.asarray(difference - period * np.round(difference / period)) if period else difference


def find_wrapping_columns(window: Window, signals: Signals) -> BoolArray:
    """Return which columns jump by a turn from one end of it to the other, as only wrapped angles do.

    Parameters
    ----------
    window : Window
        The rows to look at.
    signals : Signals
        What the columns of the rows are.

    Returns
    -------
    (c,) of bool
        True for columns that wrap.
    """
    wrapping = np.zeros(len(signals.sources), dtype=bool)
    together = np.diff(window.run) == 0
    for column in np.flatnonzero(signals.turning):
        x = window.values[:, column]
        steps = np.diff(x)
        # No joint goes half a turn between two samples: a larger step is a wrap, or an error.
        jumps = np.flatnonzero((np.abs(steps) > pi) & together)
        if not len(jumps):
            continue
        # A wrap is a jump that is slow without its turn; a joint that really jumps, or a corrupted sample, is not.
        remainder = np.abs(fold_angles(steps[jumps]))
        elapsed = np.maximum(window.t[jumps + 1] - window.t[jumps], signals.step)
        slow = jumps[remainder <= signals.fastest[column] * elapsed]
        finite = x[np.isfinite(x)]
        # A wrap leads from one end of a turn to the other, so that both of its samples lie inside the same turn. Drives
        # count from one of two borders.
        for border in BORDERS:
            low, high = border - ROUNDING, border + TURN + ROUNDING
            ends = np.minimum(x[slow], x[slow + 1]), np.maximum(x[slow], x[slow + 1])
            if ((ends[0] >= low) & (ends[1] <= high)).any():
                # All values lie inside one turn: an angle that is counted on beyond it does not wrap.
                wrapping[column] |= bool(((finite >= low) & (finite <= high)).mean() >= INSIDE_SHARE)
    return wrapping


class WrappedAngles:
    """Makes wrapped angles continuous; over gaps the logged velocity, if any, gives the number of turns."""

    name = "wrapped_angles"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._wrapping = np.zeros(len(signals.sources), dtype=bool)
        self._turns: dict[int, tuple[int, float]] = {}
        self._shift: dict[int, float] | None = None
        self._found = ChangedRows()

    def apply(self, window: Window) -> None:
        """Make the angles of a window continuous with those before it."""
        self._wrapping |= find_wrapping_columns(window, self._signals)
        # Whether a whole turn is missing is decided in the first window alone: all later angles are continued from it.
        if self._shift is None:
            self._shift = self._find_whole_turns(window) if self._wrapping.any() else {}
        for column in np.flatnonzero(self._wrapping | np.isin(np.arange(len(self._wrapping)), list(self._shift))):
            self._unwrap(window, int(column))

    def checks(self) -> list[Check]:
        """Report which angles wrapped."""
        if not self._found.n and not self._shift:
            return [Check(self.name, "ok", "No position wraps around.")]
        sources = self._signals.sources
        parts = (
            [f"Positions that wrap around after a whole turn are unwrapped in {self._found.describe(sources)}."]
            if self._found.n
            else []
        )
        if self._shift:
            shifted = ", ".join(sources[column] for column in self._shift)
            parts.append(
                f"A whole turn is added to or subtracted from {shifted}, so that the joint is inside its limits."
            )
        parts.append("If the recorded positions are right")
        return [self._found.warn_of_correction(self.name, " ".join(parts), sources)]

    def _find_whole_turns(self, window: Window) -> dict[int, float]:
        """Return the columns that are inside their limits one turn farther on, with that turn (±2 pi)."""
        shift = {}
        for column, (low, high) in self._signals.limits.items():
            x = window.values[np.isfinite(window.values[:, column]), column]
            if not self._signals.turning[column] or not len(x) or high - low > 2.0 * TURN:
                continue
            # The median of the first samples: a single one may be corrupted. An angle may wrap among them, and all
            # later ones are counted from the first.
            start = float(np.median(np.unwrap(x[:9])))
            turn = TURN * round((0.5 * (low + high) - start) / TURN)
            if not low - ROUNDING <= start <= high + ROUNDING and abs(turn) == TURN and low <= start + turn <= high:
                shift[column] = turn
        return shift

    def _unwrap(self, window: Window, column: int) -> None:
        rows = np.flatnonzero(np.isfinite(window.values[:, column]))
        if not len(rows):
            return
        x = window.values[rows, column]
        # Over a gap a joint may go farther than half a turn. What its logged velocity explains is taken out first, so
        # that rounding to whole turns leaves the right number of them.
        remainder = np.diff(x) - self._predict_steps(window, column, rows)
        turns = np.concatenate([[0.0], -np.round(remainder / TURN)])
        # Every segment is counted from its own beginning.
        begins = np.concatenate([[False], np.diff(window.segment[rows]) != 0])
        turns[begins] = 0.0
        total = np.cumsum(turns)
        for start in np.flatnonzero(begins):
            total[start:] -= total[start]
        self._continue_turns(window, column, rows, total, begins)
        window.values[rows, column] = x + TURN * total + (self._shift or {}).get(column, 0.0)
        own = window.select_own_rows(rows[1:][np.diff(total) != 0.0])
        self._found.add(column, own, window.t[own - 1 - window.first_row])

    def _continue_turns(
        self, window: Window, column: int, rows: IntArray, total: FloatArray, begins: BoolArray
    ) -> None:
        """Continue the count of turns (m,) from the window before, and remember it for the next one."""
        row, before = self._turns.get(column, (-1, 0.0))
        # Windows overlap: the row at which the window before ended its count is among the margin rows of this one. Only
        # the first segment goes on from there; the others start from zero.
        here = int(np.searchsorted(rows, row - window.first_row))
        first_segment = np.cumsum(begins) == 0
        if here < len(rows) and first_segment[here]:
            total[first_segment] += before - (total[here] if rows[here] == row - window.first_row else 0.0)
        # The count is remembered at the last row that this window decides on. What lies behind it is decided again by
        # the next window, which sees more.
        last = int(np.searchsorted(rows, window.own.stop)) - 1
        if last >= 0:
            self._turns[column] = window.first_row + int(rows[last]), float(total[last])

    def _predict_steps(self, window: Window, column: int, rows: IntArray) -> FloatArray:
        """Return how far an angle goes between known rows by its logged velocity; 0 without one."""
        velocity = self._signals.velocity.get(column)
        if velocity is None:
            return np.zeros(len(rows) - 1)
        speed = window.values[rows, velocity]
        # A logged velocity that no joint has is corrupted, and says nothing.
        speed = np.where(np.abs(speed) < self._signals.fastest[column], speed, 0.0)
        return np.asarray(0.5 * (speed[1:] + speed[:-1]) * np.diff(window.t[rows]))


STEEPEST = 75.0 * pi / 180.0
"""Pitch of the base (rad) from which on rows are left out: the rates of yaw and roll are four times the angular
velocity there, and so is their noise."""


def compute_rotation(quaternion: FloatArray) -> FloatArray:
    """Return the rotations (m, 3, 3) of quaternions (m, 4: x, y, z, w) of any length."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def compute_quaternion(yaw: FloatArray, pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Return the quaternions (m, 4: x, y, z, w) of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (cy, cp, cr), (sy, sp, sr) = (f(0.5 * np.array([yaw, pitch, roll])) for f in (np.cos, np.sin))
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    return np.column_stack([x, y, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy])


def compute_base_angles(quaternion: FloatArray) -> FloatArray:
    """Return the angles of a frame.

    Parameters
    ----------
    quaternion : (m, 4)
        Its orientation, x, y, z, w; of any length.

    Returns
    -------
    (m, 3)
        Yaw, pitch and roll in rad, R = Rz(yaw) Ry(pitch) Rx(roll); NaN where the quaternion is zero or no number, and
        where the pitch is beyond `STEEPEST`.
    """
    x, y, z, w = quaternion.T
    square = x * x + y * y + z * z + w * w
    with np.errstate(invalid="ignore", divide="ignore"):
        pitch = np.arcsin(np.clip(2.0 * (w * y - z * x) / square, -1.0, 1.0))
        yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        roll = np.arctan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
        angles = np.column_stack([yaw, pitch, roll])
        # Logs of a state estimator begin with zeros until it runs.
        angles[~(square > 0) | ~(np.abs(pitch) <= STEEPEST)] = np.nan
    return angles


def unwrap_on(angles: FloatArray, last: FloatArray) -> FloatArray:
    """Return angles (m, k) without jumps of a turn, going on from `last` (k,), which becomes the last angle."""
    out = angles.copy()
    for k in range(angles.shape[1]):
        finite = np.flatnonzero(np.isfinite(angles[:, k]))
        if not len(finite):
            continue
        values = angles[finite, k]
        before = values[:1] if np.isnan(last[k]) else last[k : k + 1]
        out[finite, k] = np.unwrap(np.concatenate([before, values]))[1:]
        last[k] = out[finite[-1], k]
    return out
