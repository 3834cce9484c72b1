"""Find the number of encoder counts a turn, by the robot's limits and its own dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.imports.fits import DynamicsFits
from dynident.identification.imports.unit_guess import CLEARLY, LEAST_MOTION, MOST_MOTION, UnitGuess
from dynident.recordings.units import find_conversion
from dynident.robot import Robot

WELL_KNOWN = (
    *(float(2**k) for k in range(8, 27)),
    *(float(m * 10**k) for k in range(3, 8) for m in (1, 2, 4)),
    *(3.6 * 10.0**k for k in range(3, 7)),
)
"""Counts a turn of encoders: powers of two; lines of incremental ones; tenths to thousandths of degrees and finer."""

_NEAR = 1.6
"""Ratio to the best power of two up to which other numbers are tried: half way to the next power."""

_EXPLAINED_BY_COUNTS = 0.5
"""Share of the torque that the right counts may leave unexplained."""

_MOST_ASKED = 4


def guess_counts_unit(
    robot: Robot, turning: Sequence[int], q: FloatArray, tau: FloatArray | None, fits: DynamicsFits
) -> UnitGuess | None:
    """Guess the unit of positions that cannot be angles of the joints; None where they are no counts either.

    Parameters
    ----------
    robot : Robot
    turning : sequence of int
        Its revolute joints.
    q, tau : (m, n)
        As the file has them; without torques only limits decide.
    fits : Fits
        Of the sample.

    Returns
    -------
    UnitGuess or None
    """
    low, high = np.nanmin(q[:, turning], axis=0), np.nanmax(q[:, turning], axis=0)
    units = [
        unit
        for counts in WELL_KNOWN
        for unit in _write_units(counts, low, high)
        if _is_possible_count(robot, turning, low, high, unit)
    ]
    if not units:
        return None
    reason = "no unit of angles makes a joint's of them, and they look like the counts of an encoder"
    unexplained: dict[str, float] = {}
    if tau is not None:
        unexplained = _compute_unexplained_counts(
            robot, turning, q, tau, fits, [unit for unit in units if np.log2(_parse_counts(unit)) % 1.0 == 0.0]
        )
        # Powers of two first, as most encoders have them; other numbers only near the best of these, since each trial
        # is a fit.
        best = _parse_counts(min(unexplained, key=lambda unit: unexplained[unit], default=units[0]))
        others = [
            unit for unit in units if unit not in unexplained and 1.0 / _NEAR < _parse_counts(unit) / best < _NEAR
        ]
        unexplained |= _compute_unexplained_counts(robot, turning, q, tau, fits, others)
    ranked = sorted(unexplained, key=lambda unit: unexplained[unit]) or units
    unit = ranked[0]
    alike = [other for other in ranked if not unexplained or unexplained[other] < CLEARLY * unexplained[unit]]
    if unexplained:
        shares = [f"{unexplained[other]:.1%} of the torque with {_name_unit(other)}" for other in ranked[:3]]
        reason += f"; the robot's dynamics leave {', '.join(shares)}"
    sure = len(alike) == 1 and unexplained.get(unit, 1.0) < _EXPLAINED_BY_COUNTS
    return UnitGuess(unit, 0.9 if sure else 0.5, reason, tuple(alike[:_MOST_ASKED]))


def _write_units(counts: float, low: FloatArray, high: FloatArray) -> list[str]:
    """Return the unit with zero at 0; and at half a turn, where all counts are within one turn."""
    unit = f"counts:{counts:.0f}"
    within_a_turn = low.min() >= 0.0 and high.max() <= counts
    return [unit, f"{unit}@{0.5 * counts:.0f}"] if within_a_turn else [unit]


def _name_unit(unit: str) -> str:
    counts, _, zero = unit.removeprefix("counts:").partition("@")
    return f"{counts} counts a turn" + (f" and zero at {zero}" if zero else "")


def _parse_counts(unit: str) -> float:
    return float(unit.removeprefix("counts:").partition("@")[0])


def _is_possible_count(robot: Robot, turning: Sequence[int], low: FloatArray, high: FloatArray, unit: str) -> bool:
    """Tell whether all joints are inside their limits, and at least one moves as far as one does in a recording."""
    factor, offset = find_conversion("q", "revolute", unit, "q")
    span = factor * (high - low)
    if span.max() < LEAST_MOTION or span.max() > MOST_MOTION:
        return False
    for place, joint in enumerate(turning):
        limits = robot.joints[joint].reach
        if limits is None or not limits[1] > limits[0]:
            continue
        slack = 0.05 * (limits[1] - limits[0]) + 0.1
        if factor * low[place] + offset < limits[0] - slack or factor * high[place] + offset > limits[1] + slack:
            return False
    return True


def _compute_unexplained_counts(
    robot: Robot, turning: Sequence[int], q: FloatArray, tau: FloatArray, fits: DynamicsFits, units: Sequence[str]
) -> dict[str, float]:
    """Return the unexplained share of the torque with each of the units."""
    unexplained = {}
    for unit in units:
        factor, offset = find_conversion("q", "revolute", unit, "q")
        scaled = np.array(q)
        scaled[:, turning] = scaled[:, turning] * factor + offset
        share = fits.measure_unexplained(scaled, tau)
        if share is not None:
            unexplained[unit] = share
    return unexplained
