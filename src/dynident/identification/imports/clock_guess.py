"""Guess the time column of a file, and the columns of files of poses at rest."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.imports import units as of_units
from dynident.identification.imports.facts import CLOCK_FACTORS, Clock, clock_like, clock_of, filled, is_counter
from dynident.identification.imports.fits import Fits, PoseFits
from dynident.identification.imports.groups import Group
from dynident.identification.imports.working_proposal import WorkingProposal
from dynident.recordings.poses import jump_from_row_to_row
from dynident.recordings.stated import EffortKind

_EXPLAINED = 0.5
"""Share of the torque that gravity may leave unexplained where the columns hold what their names say."""

TOGETHER = "give the files as one recording (q.csv+dq.csv+tau.csv)"


def guess_clock(work: WorkingProposal) -> Clock | None:
    """Find the column of the time; ask where no column runs as a clock, or none for sure.

    Parameters
    ----------
    work : WorkingProposal
        Gets the column, its unit, and a question where it is not sure.

    Returns
    -------
    Clock or None
    """
    names, values = work.sample.names, work.sample.values
    running = clock_like(values) if len(values) > 2 else []
    clocks = [clock for column in running if (clock := clock_of(values, column, work.named[column].unit)) is not None]
    by_name = [clock for clock in clocks if work.named[clock.column].signal == "t"]
    by_name.sort(key=lambda clock: is_counter(values, clock.column))
    even = [clock for clock in clocks if not is_counter(values, clock.column) or work.named[clock.column].signal == "t"]
    # A column with the name of a time first; then one that runs evenly; a row counter only where nothing else does.
    choice = next(iter(by_name or even or clocks), None)
    if choice is None:
        detail = (
            "No column runs as a clock does: which one is the time, and in which unit? Where the file has none, "
            f"state the rate of its rows in Hz (rate); where another file has it, {TOGETHER}."
        )
        work.ask("columns/t", detail, names)
        return None
    sure = choice.sure and bool(by_name or even)
    if not by_name and is_counter(values, choice.column):
        sure = False
    name = names[choice.column]
    work.columns["t"] = name
    if choice.unit != "s":
        work.units["t"] = choice.unit
    reason = "its name, and " if by_name else "it runs forward evenly; "
    work.say("columns/t", name, 0.98 if sure else 0.5, f"{reason}{choice.reason}; jitter {choice.jitter:.1%}")
    if not sure:
        work.ask("units/t", f"Is {name} the time, in {choice.unit}? {choice.reason}.", ("s", "ms", "us", "ns"))
    return choice


def are_poses(work: WorkingProposal) -> bool:
    """Tell whether the columns called positions jump from row to row: the robot stands at each."""
    positions = [k for k, name in enumerate(work.named) if name.signal == "q"]
    q = filled(work.sample.values[:, positions])
    return len(positions) >= work.robot.n and jump_from_row_to_row(q)


def guess_clock_of_poses(work: WorkingProposal) -> Clock | None:
    """Return the time column of rows that are poses, whose steps are no sampling period."""
    column = next((k for k, name in enumerate(work.named) if name.signal == "t"), None)
    if column is None:
        work.ask("columns/t", "Which column is the time, or counts the poses?", work.sample.names)
        return None
    unit = work.named[column].unit or "s"
    steps = np.diff(work.sample.values[:, column])
    # A nominal rate, only so that the rows have an order; no filter uses it.
    middle = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    work.columns["t"] = work.sample.names[column]
    if unit != "s":
        work.units["t"] = unit
    reason = f"its name; positions jump from row to row, {middle:.3g} {unit} apart: poses at rest, a row each"
    work.say("columns/t", work.sample.names[column], 0.95, reason)
    return Clock(column, unit, CLOCK_FACTORS.get(unit, 1.0), 1.0 / middle, 0.0, True, reason)


def guess_efforts_at_poses(
    work: WorkingProposal, fits: Fits | PoseFits, tau: FloatArray, effort: Group, q: FloatArray | None, kind: EffortKind
) -> EffortKind:
    """Take the efforts for what their names say, and report what gravity leaves of them."""
    signal = "current" if effort.signal == "current" else "tau"
    if signal == "current" and kind == "unknown":
        kind = "motor_current"
    elif kind == "unknown":
        kind = "joint_torque"
    work.say("effort_kind", kind, 0.8, "by its name; a robot that stands shows no more")
    work.map(signal, effort)
    gains = [drive.gain for drive in work.robot.drives]
    work.effort_unit(signal, tau, effort, gains, of_units.reach_of(work.robot))
    unexplained = None if q is None else fits.left(q, tau)
    if unexplained is not None:
        reason = "what gravity and constant torques of the robot do not explain of poses at rest"
        work.say("check", f"{unexplained:.0%} left", 0.9 if unexplained < _EXPLAINED else 0.4, reason)
    return kind
