"""The order of the repair steps that every recording passes, the stage that runs them, and steps for torques of servos.

Holds how far a servo has to be behind its command for its full voltage (0.35 rad).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from dynident.array_types import FloatArray
from dynident.number_format import format_percent
from dynident.recordings.columns_to_signals import Layout, compute_servo_error
from dynident.recordings.conditioning.angle_wrapping import WrappedAngles
from dynident.recordings.conditioning.corrupted_sample_removal import CorruptedSamples
from dynident.recordings.conditioning.missing_and_held import (
    MOST_MISSING,
    BridgedGaps,
    FrozenSignals,
    HeldSamples,
    IdleDrives,
    MissingValues,
)
from dynident.recordings.conditioning.signed_registers import SignedRegisters
from dynident.recordings.conditioning.windows_and_changed_rows import ChangedRows, Signals, Window, cut_into_windows
from dynident.recordings.file_source import RawRows
from dynident.recordings.position_checks import DEGREE, has_other_unit, is_counted, is_far_without_limits
from dynident.recordings.recording import JointLimits
from dynident.recordings.recording_metadata import Check
from dynident.recordings.sampling_clock import TimeBase


class Step(Protocol):
    """One repair of the rows of a recording, which reports what it has changed."""

    name: str

    def apply(self, window: Window) -> None:
        """Repair the next window, in place."""
        ...

    def checks(self) -> list[Check]:
        """Report what was found, after the last window."""
        ...


class ServoTorques:
    """Computes torques anew from the commands of servos where a step has corrected the position."""

    name = "servo_torques"

    def __init__(self, signals: Signals) -> None:
        self._gains = signals.servo_gains
        self._torques = np.array(sorted(signals.position))
        self._positions = np.array([signals.position[column] for column in self._torques])

    def apply(self, window: Window) -> None:
        """Compute the torques of a window anew, where positions are other ones than those in the file."""
        if self._gains is None:
            return
        q, raw = window.values[:, self._positions], window.raw[:, self._positions]
        torques, gains = window.raw[:, self._torques], self._gains
        ahead = np.divide(torques, gains, out=np.zeros_like(torques), where=gains != 0.0)
        # Of corrupted positions that are too large for it, the sum keeps no digit of the command: their rows are lost.
        commands = np.where(np.abs(raw) < _LARGEST, raw + ahead, np.nan)
        # Other turns of an angle change nothing but the last digits.
        corrected = (np.abs(compute_servo_error(q, raw)) > _ROUNDING) & (gains != 0.0)
        anew = gains * compute_servo_error(commands, q)
        window.values[:, self._torques] = np.where(corrected, anew, window.values[:, self._torques])

    def checks(self) -> list[Check]:
        """Report nothing: the steps before this one say what they have corrected."""
        return []


_LARGEST, _ROUNDING = 1e6, 1e-9
"""rad or m: positions to which commands can still be added, and differences that are none."""

FULL_VOLTAGE = 0.35
"""rad between command and position, from which on a servo has its full voltage: a Feetech STS3215 with the P
coefficient 16, which LeRobot writes, has 0.97 of it at 0.365 rad (BAM's authors measured it with an oscilloscope)."""


class FullVoltage:
    """Leaves out rows in which a position servo is so far behind its command that its torque grows no more."""

    name = "full_duty"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._torques = np.array(sorted(signals.position))
        self._found = ChangedRows()
        self._n_rows = self._n_lost = 0
        self._was_misread = False

    def apply(self, window: Window) -> None:
        """Remove the torques of a window that servos cannot give."""
        gains = self._signals.servo_gains
        if gains is None:
            return
        torques = window.values[:, self._torques]
        beyond = (np.abs(torques) > self._compute_largest(gains)) & (gains != 0.0)
        for joint in np.flatnonzero(beyond.any(axis=0)):
            own = window.select_own_rows(np.flatnonzero(beyond[:, joint]))
            self._found.add(int(self._torques[joint]), own, window.t[own - 1 - window.first_row])
        self._n_rows += window.own.stop - window.own.start
        self._n_lost += int(beyond[window.own].any(axis=1).sum())
        if self._is_misread(window, gains):
            # The check of the positions has to see these rows, and refuses them.
            self._was_misread = True
            return
        window.values[:, self._torques] = np.where(beyond, np.nan, torques)
        window.unused |= beyond.any(axis=1)

    def _compute_largest(self, gains: FloatArray) -> FloatArray:
        """Return the largest torques (n,) that servos give: at full voltage, and by the limits of the joints."""
        joints = self._signals.joints
        turning = np.array([joint.kind == "revolute" for joint in joints])
        # A description with an effort of 0 does not know it.
        efforts = [joint.effort or np.inf for joint in joints]
        return np.minimum(efforts, np.where(turning, FULL_VOLTAGE * np.abs(gains), np.inf))

    def _is_misread(self, window: Window, gains: FloatArray) -> bool:
        """Return whether positions were read in another unit than theirs: torques then say nothing of servos."""
        for torque, joint, gain in zip(self._torques, self._signals.joints, gains, strict=True):
            q = window.values[:, self._signals.position[int(torque)]]
            if gain != 0.0 and np.isfinite(q).any():
                low, high = float(np.nanmin(q)), float(np.nanmax(q))
                small = DEGREE if joint.kind == "revolute" else 1e-3
                is_of_other_unit = has_other_unit(joint, low, high, 0.0, small) or is_counted(joint, low, high)
                if is_of_other_unit or is_far_without_limits(joint, low, high):
                    return True
        return False

    def checks(self) -> list[Check]:
        """Report which rows are left out."""
        rows = self._found
        if not rows.n:
            return []
        share = format_percent(self._n_lost / self._n_rows, 2)
        detail = (
            f"In {share} of the rows a joint is more than {np.degrees(FULL_VOLTAGE):.0f}° behind its command, or so "
            f"far that its torque would exceed its limit: in {rows.describe(self._signals.sources)}. There, servos of "
            "small arms have their full voltage, and the torque no longer grows with the error. These rows are not "
            "used, and no filter runs across them. Command slower motions to lose none; if nearly all rows are lost, "
            "look at units and drive gains first. If these servos give more torque there"
        )
        check = rows.warn_of_correction(self.name, detail, self._signals.sources)
        much = self._was_misread or self._n_lost > MOST_MISSING * self._n_rows
        return [replace(check, status="error") if much else check]


STEPS: dict[str, Callable[[Signals], Step]] = {
    step.name: step
    for step in (
        MissingValues,
        SignedRegisters,
        HeldSamples,
        IdleDrives,
        FrozenSignals,
        CorruptedSamples,
        WrappedAngles,
        BridgedGaps,
        ServoTorques,
        FullVoltage,
    )
}
"""The steps in their order: what is missing or corrupted must not be taken for a turn, and what they leave open is
bridged at the end. After that torques of servos follow the positions as they are now, and what servos cannot give is
left out, so that nothing bridges it."""


class Conditioning:
    """Conditions the rows of a recording, and collects what its steps found.

    Parameters
    ----------
    layout : Layout
        The columns of the file, matched with the joints.
    limits : tuple of JointLimits
        Limits of the n joints, as far as they are known.
    base : TimeBase
        What is known of the time column.
    skip : collection of str
        Names of steps that are not taken.
    """

    def __init__(
        self, layout: Layout, limits: tuple[JointLimits, ...], base: TimeBase, skip: Collection[str] = ()
    ) -> None:
        signals = Signals.from_layout(layout, limits, base)
        self._base = base
        self._steps = [step(signals) for name, step in STEPS.items() if name not in skip]

    def condition(self, blocks: Iterable[RawRows]) -> Iterator[RawRows]:
        """Yield the rows of all blocks, repaired.

        Parameters
        ----------
        blocks : iterable of RawRows
            The rows of the file, in order.

        Yields
        ------
        RawRows
            A needed sample that stays missing is NaN.
        """
        for window in cut_into_windows(blocks, self._base):
            # Each step sees the rows as the steps before it have left them.
            for step in self._steps:
                step.apply(window)
            # A window reaches beyond its own rows, which are repaired with their neighbours in view; only they are
            # given.
            own = window.own
            yield RawRows(window.first_row + own.start, window.t[own], window.segment[own], window.values[own])

    def checks(self) -> tuple[Check, ...]:
        """Return what was found in all rows."""
        return tuple(check for step in self._steps for check in step.checks())
