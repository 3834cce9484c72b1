"""The order of the repair steps that every recording passes, and the stage that runs them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Protocol

from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.conditioning.angle_wrapping import WrappedAngles
from dynident.recordings.conditioning.corrupted_sample_removal import CorruptedSamples
from dynident.recordings.conditioning.missing_and_held import (
    BridgedGaps,
    FullVoltage,
    HeldSamples,
    IdleDrives,
    MissingValues,
)
from dynident.recordings.conditioning.signed_registers import SignedRegisters
from dynident.recordings.conditioning.windows_and_changed_rows import Signals, Window, cut_into_windows
from dynident.recordings.file_source import RawRows
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


STEPS: dict[str, Callable[[Signals], Step]] = {
    step.name: step
    for step in (
        MissingValues,
        SignedRegisters,
        HeldSamples,
        IdleDrives,
        CorruptedSamples,
        WrappedAngles,
        BridgedGaps,
        FullVoltage,
    )
}
"""The steps in their order: what is missing or corrupted must not be taken for a turn, and what they leave open is
bridged at the end. What servos cannot give is left out after that, so that nothing bridges it."""


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
