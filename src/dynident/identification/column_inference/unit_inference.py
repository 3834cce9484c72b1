"""Guess the unit of each signal, encoder counts included, from names, a robot's range, slopes and a dynamics fit.

Holds the counts a turn that are tried, and when a unit is ruled out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.identification.column_inference.dynamics_fits import BORNE_OUT, DynamicsFits
from dynident.identification.column_inference.metadata_proposal import SURE, UnitGuess
from dynident.number_format import format_percent
from dynident.recordings.position_checks import has_other_unit
from dynident.recordings.recording import JointKind, JointLimits
from dynident.recordings.units import FACTORS, find_conversion
from dynident.robot import Robot
from dynident.robot.pseudo_inertia import measure_reach

LEAST_MOTION = np.deg2rad(6.0)
"""rad: in every recording at least one joint moves that far."""

HARDLY_MOVES = np.deg2rad(10.0)
"""rad: angles said to be degrees that stay within this may be radians."""

MOST_MOTION, CLEARLY = 4.0 * np.pi * 1.05, 1.25
"""rad: no joint with limits moves further; two turns, and a little. And the ratio of the unexplained shares above which
another unit is ruled out."""

WELL_KNOWN = (
    *(float(2**k) for k in range(8, 27)),
    *(float(m * 10**k) for k in range(3, 8) for m in (1, 2, 4)),
    *(3.6 * 10.0**k for k in range(3, 7)),
    *(2.0 * np.pi * 10.0**k for k in range(3, 7)),
)
"""Counts a turn of encoders: powers of two; lines of incremental ones; tenths to thousandths of degrees and
finer; thousandths of rad and finer."""

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
        The robot.
    turning : sequence of int
        Its revolute joints.
    q, tau : (m, n)
        As the file has them; without torques only limits decide.
    fits : DynamicsFits
        Of the sample.

    Returns
    -------
    UnitGuess or None
        The unit with its confidence; None where no count is possible.
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
    reason = "in no unit of angles are they the range of a joint, and they look like encoder counts"
    unexplained: dict[str, float] = {}
    if tau is not None:
        unexplained = _compute_unexplained_counts(
            turning, q, tau, fits, [unit for unit in units if np.log2(_parse_counts(unit)) % 1.0 == 0.0]
        )
        # Powers of two first, as most encoders have them; other numbers only near the best of these, since each trial
        # is a fit.
        best = _parse_counts(min(unexplained, key=lambda unit: unexplained[unit], default=units[0]))
        others = [
            unit for unit in units if unit not in unexplained and 1.0 / _NEAR < _parse_counts(unit) / best < _NEAR
        ]
        unexplained |= _compute_unexplained_counts(turning, q, tau, fits, others)
    ranked = sorted(unexplained, key=lambda unit: unexplained[unit]) or units
    unit = ranked[0]
    alike = [other for other in ranked if not unexplained or unexplained[other] < CLEARLY * unexplained[unit]]
    if unexplained:
        shares = [
            f"{format_percent(unexplained[other], decimals=1)} of the torque with {_name_unit(other)}"
            for other in ranked[:3]
        ]
        reason += f"; the robot's dynamics leave {', '.join(shares)}"
    sure = len(alike) == 1 and unexplained.get(unit, 1.0) < _EXPLAINED_BY_COUNTS
    if not sure:
        reason += "; where gears or encoders differ, each joint has its own, q1=counts:N and so on, of the controller"
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
    turning: Sequence[int], q: FloatArray, tau: FloatArray, fits: DynamicsFits, units: Sequence[str]
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


__all__ = ["SURE", "UnitGuess", "compute_reach", "convert_mixed_torques", "get_factor", "guess_current_unit",
           "guess_position_unit", "guess_rate_unit", "guess_stroke_unit", "guess_torque_unit"]  # fmt: skip

_MORE = 1.05
"""Share of a joint's range that its motion may exceed: limits of descriptions are rounded."""
_PLACEHOLDER = 5000.0
"""N m, and more than a hundred times what the robot's size needs: such limits of effort say nothing."""
_STROKE = (0.008, 4.0)
"""m: shortest and longest stroke of a sliding joint."""


def get_factor(signal: str, kind: str, unit: str) -> float:
    """Return the factor from a unit to SI.

    Parameters
    ----------
    signal, kind, unit : str
        Such as "q", "revolute" and "deg".
    """
    return FACTORS[signal, kind][unit]  # type: ignore[index]


def guess_position_unit(
    robot: Robot, q: FloatArray, stated: str | None, tau: FloatArray | None, fits: DynamicsFits
) -> UnitGuess | None:
    """Guess the unit of the revolute joints' positions; None where there is no such joint.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, tau : (m, n)
        As the file has them.
    stated : str, optional
        What the names say.
    fits : DynamicsFits
        Of the sample.
    """
    turning = [index for index, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    wrapped = _find_wrapped_unit(q[:, turning]) if turning else None
    if not turning or (wrapped is not None and stated in (None, wrapped.unit)):
        return wrapped
    low, high = np.nanmin(q[:, turning], axis=0), np.nanmax(q[:, turning], axis=0)
    reach = float((high - low).max())
    whole = bool((q[:, turning] == np.rint(q[:, turning])).all())
    # Joints without limits turn as often as they like, where they are not counted in steps of an encoder.
    speed = None if whole else fits.measure_speed(q[:, turning])
    # First what the joints' limits allow; then, where several units are left, what the dynamics explain best.
    possible = [
        unit for unit in ("rad", "deg", "mrad", "rev") if _is_possible_unit(robot, turning, low, high, unit, speed)
    ]
    likely = [unit for unit in possible if get_factor("q", "revolute", unit) * reach >= LEAST_MOTION]
    if stated is not None and stated in FACTORS["q", "revolute"]:
        if stated in possible or _is_possible_unit(robot, turning, low, high, stated, speed):
            fitting = UnitGuess(stated, 0.99, f"its name says {stated}, and the range of motion fits it")
            return (_doubt_degrees(robot, q, tau, fits) if stated == "deg" and "rad" in likely else None) or fitting
        beyond = f"its name says {stated}, but that goes beyond the robot's limits"
        if stated == "rev":
            # One unit for all joints, or one for each where their gears differ.
            of_motors = (
                "these are probably turns of the motors: say how many of them make one turn of the joint, "
                "q=counts:RATIO, or q1=counts:RATIO and so on"
            )
            return UnitGuess(stated, 0.5, f"{beyond}; {of_motors}", ("counts:RATIO",))
        return UnitGuess(stated, 0.5, beyond)
    # Hardly anyone logs mrad or revolutions, so these need the fit to be taken.
    usual = [unit for unit in likely if unit in ("rad", "deg")]
    if not {"rad", "deg"} & set(possible) and (whole or not possible):
        counted = guess_counts_unit(robot, turning, q, tau, fits)
        if counted is not None:
            return counted
    unexplained = _compute_unexplained(robot, q, tau, fits, likely) if len(likely) > 1 else {}
    if unexplained:
        ranked = sorted(unexplained, key=lambda unit: unexplained[unit])
        best = ranked[0]
        clear = len(ranked) == 1 or unexplained[ranked[1]] > CLEARLY * unexplained[best]
        if clear and len(unexplained) == len(likely) and best in usual:
            others = ", ".join(f"{format_percent(unexplained[unit], decimals=0)} as {unit}" for unit in ranked[1:])
            return UnitGuess(
                best,
                0.97,
                f"as {best} the robot's dynamics leave {format_percent(unexplained[best], decimals=0)} of the torque "
                f"unexplained, {others}",
            )
        if clear and len(unexplained) == len(likely):
            # Angles of motors are many times those of the joints, and look like a small unit.
            motors = "; if they are angles of the motors, in front of the gears, divide them by the gear ratios"
            reason = (
                f"as {best} the robot's dynamics leave least of the torque unexplained, "
                f"{format_percent(unexplained[best], decimals=0)}{motors if best == 'mrad' else ''}"
            )
            # Angles of motors with another gear on each leave much; turns of the joints are borne out, or are not.
            sure = best == "rev" and unexplained[best] < BORNE_OUT
            return UnitGuess(best, 0.9 if sure else 0.6, reason, (best, *usual))
    if len(usual) == 1:
        ranges = (
            f"the largest range of motion is then {np.rad2deg(reach * get_factor('q', 'revolute', usual[0])):.0f} deg"
        )
        return UnitGuess(usual[0], 0.9, f"{ranges}; the other usual unit is not plausible")
    still = f"no joint moves by more than {reach:.2g}, which is too little in any unit"
    is_still = bool(possible) and reach < LEAST_MOTION
    return UnitGuess(usual[0] if usual else "rad", 0.4, still if is_still else "several units are possible")


def _doubt_degrees(robot: Robot, q: FloatArray, tau: FloatArray | None, fits: DynamicsFits) -> UnitGuess | None:
    """Return radians for angles that are called degrees, hardly move as such, and explain the torque as radians."""
    turning = [index for index, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    reach = float(np.nanmax(np.nanmax(q[:, turning], axis=0) - np.nanmin(q[:, turning], axis=0)))
    left = _compute_unexplained(robot, q, tau, fits, ("rad", "deg")) if np.deg2rad(reach) < HARDLY_MOVES else {}
    if len(left) < 2 or left["deg"] <= CLEARLY * left["rad"]:
        return None
    shares = " and ".join(f"{format_percent(left[unit], decimals=0)} as {unit}" for unit in left)
    reason = (
        f"its name says deg, but then no joint moves by more than {reach:.2g} deg, and the robot's dynamics leave "
        f"{shares} of the torque unexplained"
    )
    return UnitGuess("rad", 0.5, reason)


def _find_wrapped_unit(q: FloatArray) -> UnitGuess | None:
    """Return the unit in which angles (m, n) jump by a turn, and stay within one; None where none does."""
    steps = np.abs(np.diff(q, axis=0))
    for unit, turn in (("deg", 360.0), ("rad", 2.0 * np.pi)):
        jumps = steps > _JUMP * turn
        # A motion has no steps between its own, which are small, and those of whole turns.
        small = np.nanmax(np.where(jumps, 0.0, steps)) < _STEP * turn
        if jumps.any() and small and np.nanmax(np.ptp(q, axis=0)) <= 1.001 * turn:
            return UnitGuess(unit, 0.95, f"they jump by a turn in {unit}, where angles wrap")
    return None


_JUMP, _STEP = 0.9, 0.1
"""Shares of a turn: of the steps by which angles wrap at least, and of those of a motion at most."""


def _is_possible_unit(
    robot: Robot, turning: Sequence[int], low: FloatArray, high: FloatArray, unit: str, speed: FloatArray | None
) -> bool:
    factor = get_factor("q", "revolute", unit)
    for place, joint in enumerate(turning):
        limits = robot.joints[joint].reach
        if limits is not None and limits[1] > limits[0]:
            tolerance = 0.05 * (limits[1] - limits[0]) + 0.1
            # Only the width of the motion is compared with the limits: the zero may be another, and a turn more or
            # less is the same place.
            if factor * (high[place] - low[place]) > _MORE * (limits[1] - limits[0]) + tolerance:
                return False
        elif speed is not None and unit in ("rad", "deg"):
            unlimited = JointLimits(velocity=robot.joints[joint].limits.velocity)
            if has_other_unit(unlimited, 0.0, 0.0, factor * float(speed[place]), 1.0):
                return False
            continue
        if abs(factor) * max(high[place] - low[place], abs(low[place]), abs(high[place])) > MOST_MOTION:
            return False
    return True


def _compute_unexplained(
    robot: Robot, q: FloatArray, tau: FloatArray | None, fits: DynamicsFits, units: Sequence[str]
) -> dict[str, float]:
    if tau is None:
        return {}
    unexplained = {}
    for unit in units:
        scaled = np.array(q)
        for index, joint in enumerate(robot.joints):
            if joint.kind == "revolute":
                scaled[:, index] *= get_factor("q", "revolute", unit)
            else:
                scaled[:, index] *= _guess_sliding_factor(q[:, index])
        share = fits.measure_unexplained(scaled, tau)
        if share is not None:
            unexplained[unit] = share
    return unexplained


def _guess_sliding_factor(q: FloatArray) -> float:
    return 1.0 if float(np.nanmax(q) - np.nanmin(q)) < _STROKE[1] else 1e-3


def guess_stroke_unit(q: FloatArray, limits: tuple[float, float] | None, stated: str | None) -> UnitGuess:
    """Guess the unit of a prismatic joint's positions (m,).

    Parameters
    ----------
    q : (m,)
        Positions as the file has them.
    limits : pair of float, optional
        In m.
    stated : str, optional
        What its name says.
    """
    if stated in FACTORS["q", "prismatic"]:
        assert stated is not None
        return UnitGuess(stated, 0.99, f"its name says {stated}")
    reach = float(np.nanmax(q) - np.nanmin(q))
    most = float(np.nanmax(np.abs(q)))
    if limits is not None and limits[1] > limits[0]:
        # The stroke has to fit into the limits in one unit, and be more than nothing of them.
        span = limits[1] - limits[0]
        factors = FACTORS["q", "prismatic"]
        fits = [unit for unit in ("m", "mm", "um") if 1e-3 * span < factors[unit] * reach <= 1.1 * span]
        if len(fits) == 1:
            return UnitGuess(fits[0], 0.95, f"its stroke is {reach:.3g}, and the joint limits allow this in {fits[0]}")
    if most < _STROKE[1] and reach < 2.0:
        return UnitGuess("m", 0.9, f"its stroke is {reach:.3g}: in mm this would be almost no motion")
    if reach > 8.0:
        return UnitGuess("mm", 0.9, f"its stroke is {reach:.3g}: in m this would be too long for a robot")
    return UnitGuess("m", 0.5, f"its stroke is {reach:.3g}")


def guess_rate_unit(signal: str, kind: str, factor: float, stated: str | None) -> UnitGuess | None:
    """Guess the unit of a velocity or acceleration by the slope of the positions; None where no unit fits.

    Parameters
    ----------
    signal, kind : str
        Signal ("dq" or "ddq") and kind of the joint.
    factor : float
        Slope of the positions in SI over the column.
    stated : str, optional
        What its name says.
    """
    known: dict[str, float] = FACTORS[signal, kind]  # type: ignore[index]
    # In logarithms: a factor of two too large is as far off as one of two too small.
    near = {unit: abs(np.log(value / factor)) for unit, value in known.items()} if factor > 0 else {}
    best = min(near, key=lambda unit: near[unit], default=None)
    if best is None or near[best] > 0.12:
        return None
    if stated in near and near[stated] <= 0.12:
        best = stated
    assert best is not None
    return UnitGuess(best, 0.97, "it is the derivative of the position")


def compute_reach(robot: Robot) -> float:
    """Return the length in m of the robot from its base, all links stretched; 0.3 where the tree says nothing."""
    return max(0.3, measure_reach(robot))


def guess_torque_unit(robot: Robot, tau: FloatArray, stated: str | None, reach: float) -> UnitGuess:
    """Guess the unit of torques by what a robot of this reach needs, and by its limits of effort.

    Parameters
    ----------
    robot : Robot
        The robot.
    tau : (m, n)
        Torques as the file has them.
    stated : str, optional
        What the names say.
    reach : float
        In m.
    """
    kind: JointKind = "revolute" if any(joint.kind == "revolute" for joint in robot.joints) else "prismatic"
    known: dict[str, float] = FACTORS["tau", kind]
    of_kind = [index for index, joint in enumerate(robot.joints) if joint.kind == kind]
    most = float(np.nanmax(np.abs(tau[:, of_kind])))
    allowed = [robot.joints[index].limits.effort for index in of_kind]
    # The mass of arms grows with the cube of their reach, and the torque of gravity is mass times reach.
    usual = 9.81 * reach**4 if kind == "revolute" else 9.81 * 10 * reach**3
    base = "N m" if kind == "revolute" else "N"
    small, large = ("mN m", "kN m") if kind == "revolute" else ("mN", "kN")

    def is_fitting(unit: str) -> bool:
        # Limits of effort bound each joint's torque. Placeholders say nothing, and some are only those that a drive
        # gives all day; the next unit is a thousand times as large.
        in_si, largest = known[unit] * most, max(_PLACEHOLDER, 100 * usual)
        own = (known[unit] * float(np.nanmax(np.abs(tau[:, index]))) for index in of_kind)
        shares = [value / limit for value, limit in zip(own, allowed, strict=True) if limit and limit < largest]
        if shares and np.median(shares) > 5.0:
            return False
        limits = [limit for limit in allowed if limit and limit < _PLACEHOLDER]
        if limits:
            return in_si > 4e-3 * max(limits)
        return 0.2 * usual <= in_si <= 200 * usual

    if stated is not None and stated in known:
        if is_fitting(stated):
            return UnitGuess(stated, 0.99, f"its name says {stated}")
        return UnitGuess(stated, 0.82, f"its name says {stated}, though {most:.3g} {stated} is unusual for this robot")
    possible = [unit for unit in (base, small, large) if is_fitting(unit)]
    if len(possible) == 1:
        return UnitGuess(
            possible[0], 0.92, f"its largest value, {most:.4g}, is plausible for a robot of this size in {possible[0]}"
        )
    return UnitGuess(base, 0.4, f"its largest value is {most:.4g}; {' or '.join(possible) or 'no unit'} is possible")


def convert_mixed_torques(tau: FloatArray, units: Sequence[str | None]) -> tuple[FloatArray, str | None]:
    """Return torques in N m where their names state several units, else as they are; and their unit, if it is known.

    Parameters
    ----------
    tau : (m, n)
        Torques of revolute joints as the file has them.
    units : sequence of str or None
        What the name of each column says.
    """
    known: dict[str, float] = FACTORS["tau", "revolute"]
    if len(set(units)) == 1 or not all(unit in known for unit in units):
        return tau, units[0] if len(set(units)) == 1 else None
    return tau * [known[unit] for unit in units if unit is not None], "N m"


def guess_current_unit(i: FloatArray, gains: Sequence[float | None], robot: Robot, stated: str | None) -> UnitGuess:
    """Guess the unit of currents by the torque that they make with the drive gains, or by their size.

    Parameters
    ----------
    i : (m, n)
        Currents as the file has them.
    gains : sequence of float or None
        Drive gains of the joints; None where one is not known.
    robot : Robot
        The robot.
    stated : str, optional
        What the names say.
    """
    if stated in ("A", "mA"):
        return UnitGuess(stated, 0.99, f"its name says {stated}")
    most = np.nanmax(np.abs(i), axis=0)
    # With gains and limits known, the currents must make a sensible share of the torque that the joint can give.
    shares = [
        abs(gain) * most[index] / limit
        for index, (gain, joint) in enumerate(zip(gains, robot.joints, strict=True))
        if gain is not None and (limit := joint.limits.effort) and limit < _PLACEHOLDER
    ]
    if shares:
        # The joint that comes nearest to its limit tells most.
        share = max(shares)
        if 0.01 <= share <= 2.0:
            return UnitGuess(
                "A",
                0.95,
                f"with the drive gains they reach at most {format_percent(share, decimals=0)} of the torque limits",
            )
        if 10.0 <= share <= 2000.0:
            return UnitGuess("mA", 0.95, f"in A they would give {share:.0f} times the torque limits")
    peak = float(most.max())
    # Without gains the size alone decides: drives of arms take up to some tens of A.
    if peak > 150.0:
        return UnitGuess("mA", 0.9, f"the largest is {peak:.4g}, too large for a robot joint in A")
    if peak < 60.0:
        return UnitGuess("A", 0.9 if peak > 0.1 else 0.6, f"the largest is {peak:.4g}")
    return UnitGuess("A", 0.5, f"the largest is {peak:.4g}")
