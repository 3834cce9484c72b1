"""Decide whether a column of effort is torque or current, measured or commanded, and ask for drive gains.

Holds the plausible ranges of currents, torques and gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.identification.column_inference.dynamics_fits import DynamicsFits, has_wrong_columns
from dynident.identification.column_inference.metadata_proposal import SURE, Question, UnitGuess
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.description_fit import FAIR, TorqueScales, compare_with_description
from dynident.identification.recording_faults.fault_search import (
    CLEARLY_AGREES,
)
from dynident.identification.recording_faults.gravity_in_torque import detect_compensated_gravity, find_mounting
from dynident.identification.recording_faults.torque_scale import compute_median_scale
from dynident.identification.recording_faults.unexplained_torque import (
    measure_gain_by_other_scales,
    measure_unexplained_share,
)
from dynident.number_format import format_percent
from dynident.recordings.recording_metadata import EffortKind
from dynident.recordings.units import MOMENTS
from dynident.robot import Robot
from dynident.robot.pinocchio_conversion import compute_described_torque

NO_MEASUREMENT: dict[EffortKind, str] = {
    "external": "external torques: the torque of the robot's own dynamics was subtracted from them",
    "gravity_compensated": "gravity-compensated: the gravity torque was subtracted from them",
    "commanded": "commanded, not measured",
}

_BY_THE_CONTROLLER = ("MACur",)
"""Names of currents that makers' handbooks give in per cent of the largest one, and much software takes for A."""


def ask_for_gains(
    names: str,
    unit: str | None,
    gains: Sequence[float | None],
    fits: DynamicsFits,
    columns: tuple[FloatArray, FloatArray],
) -> Question | None:
    """Ask for drive gains, or whether they are per unit of these currents; None where neither is needed.

    Parameters
    ----------
    names : str
        Of the columns.
    unit : str, optional
        What the names state.
    gains : sequence of float or None
        The robot's drive gains.
    fits : DynamicsFits
        Of the sample.
    columns : pair of (m, n)
        Positions in SI, and currents.
    """
    known = all(gain is not None for gain in gains)
    if any(word in names for word in _BY_THE_CONTROLLER):
        per = "A (or per cent of the largest current, if the manual of the controller says so)"
        if not known:
            return Question("drives", f"{names} are currents: give the drive gains of the joints in N m/{per}.")
        # With gains that fit the description, the unit of the gains is that of the currents, whatever it is called.
        if is_as_described(fits, *columns, gains):
            return None
        return Question(
            "drives",
            f"{names} are in {per}: are the drive gains of the robot in N m per that unit? With these gains the "
            "torque does not match the inertias of the description.",
        )
    if known:
        return None
    if unit in ("permille", "percent"):
        return Question("drives", f"{names} are in {unit}: give the drive gains in N m per {unit}.")
    return Question("drives", f"{names} are currents: give the drive gains of the joints in N m/A.")


COMPUTED_NOISE, PREDICTABLE_NOISE = 1e-3, 0.03
"""Share of a torque's noise that earlier positions leave unexplained, below which it was computed from them; and share
that the torque's own past has to leave, or it is no noise. Measured torques of the open recordings also hold what the
controller makes of the position's noise, and leave 0.012 and more (`benchmarks/effort_kinds.py`)."""

_ORDER = 3
"""Order of the difference from row to row that removes the motion and leaves the noise."""
_NOISY = 1.5
"""Variance of such a difference over that of the one before: 3.5 of noise alone, 0 of a smooth motion."""
_POSITIONS, _TORQUES = 8, 3
"""Earlier rows that a controller may use: of positions, and of its own output, which it may filter."""
_FEWEST, _MOST = 400, 16_384
"""Rows that are needed, and rows that are used at most, as somebody waits for the answer."""


def is_commanded(q: FloatArray, tau: FloatArray) -> bool | None:
    """Tell whether torques hold no noise but what a controller makes of the noise in the measured positions.

    A measured torque has noise of its own sensor, however well the drive follows the controller.

    Parameters
    ----------
    q, tau : (m, n)
        Consecutive rows, as they were recorded, in any unit.

    Returns
    -------
    bool or None
        The answer of most joints that move. None where they give none: positions or torques are smooth, as if
        filtered or simulated, or there are too few rows.
    """
    if len(q) < _FEWEST:
        return None
    q, tau = q[:_MOST], tau[:_MOST]
    joints = np.flatnonzero((np.ptp(q, axis=0) > 0) & (np.ptp(tau, axis=0) > 0))
    verdicts = [_is_computed(q[:, joint], tau[:, joint]) for joint in joints]
    for answer in (True, False):
        if verdicts and verdicts.count(answer) >= 0.5 * len(verdicts):
            return answer
    return None


def _is_computed(q: FloatArray, tau: FloatArray) -> bool | None:
    """Tell whether one joint's torque was computed from its positions; None where the noise does not tell."""
    if _compute_roughness(q) < _NOISY:
        return None
    before, noise = np.diff(q, n=_ORDER), np.diff(tau, n=_ORDER)
    first = _POSITIONS
    # A controller computes the torque linearly from the last few positions. Regress its noise on theirs.
    positions = [before[first - k : len(before) - k] for k in range(_POSITIONS + 1)]
    torques = [noise[first - k : len(noise) - k] for k in range(1, _TORQUES + 1)]
    target = noise[first:]
    # A torque that its own past predicts is smooth, so there is no noise to decide by.
    if _compute_unexplained(np.column_stack(torques), target) < PREDICTABLE_NOISE:
        return None
    return _compute_unexplained(np.column_stack([*positions, *torques]), target) < COMPUTED_NOISE


def _compute_unexplained(rows: FloatArray, target: FloatArray) -> float:
    """Return the share of the second half's variance that a fit to the first half leaves."""
    # Fitted to the first half and judged by the second: many columns explain noise that they were fitted to.
    half = len(target) // 2
    size = np.sqrt((rows**2).mean(axis=0)) + np.finfo(float).tiny
    solution, *_ = np.linalg.lstsq(rows[:half] / size, target[:half], rcond=1e-12)
    rest = target[half:] - rows[half:] / size @ solution
    return float((rest**2).mean() / max(float((target[half:] ** 2).mean()), np.finfo(float).tiny))


def _compute_roughness(values: FloatArray) -> float:
    size = float(np.diff(values, n=_ORDER).var())
    return float(np.diff(values, n=_ORDER + 1).var()) / size if size > 0 else 0.0


CANNOT_TELL = "the data do not show whether it was measured or commanded, because they contain no noise of their own"

_LOST = 0.75
"""Ratio of the residuals without and with gravity, below which a torque counts as gravity-compensated."""
_CURRENTS = (0.2, 100.0)
"""A: the largest current of an arm is between these; of a motor of a few watts, and of a robot for 300 kg."""
_LEAST_OF_MOTORS = 0.01
"""A or N m: the largest current and the largest torque of an arm's motors, those of a few watts, are larger."""
_LARGEST_GAIN = 500.0
"""N m/A: a gear of 250 behind a large motor."""
_APART = 1.25
"""Times what is left with gravity, below which the motion does not show whether there is any: at least 1.7 in torques
of the open recordings, up to 1.6 without it (`benchmarks/effort_kinds.py`)."""
_LOADED = 0.02
"""Share of a joint's largest torque that gravity has to have for the joint to count as loaded."""
_NOTHING = 0.9
"""Unexplained share above which the motion explains nothing of a torque."""


@dataclass(frozen=True)
class EffortGuess:
    """A guess of what an effort is.

    Parameters
    ----------
    kind : str
        The kind, "unknown" where nothing tells.
    confidence : float
        From 0 to 1.
    reason : str
        The reason, as a clause.
    scales : TorqueScales or None
        Numbers over the torques of the description; None where they were not compared.
    """

    kind: EffortKind
    confidence: float
    reason: str
    scales: TorqueScales | None = None


def classify_effort(
    fits: DynamicsFits,
    q: FloatArray,
    tau: FloatArray,
    signal: str | None,
    unit: str | None,
    torque_factor: float = 1.0,
    current_factor: float | None = None,
) -> EffortGuess:
    """Classify torques by their name and by the data; "unknown" where these do not tell.

    Parameters
    ----------
    fits : DynamicsFits
        Of the sample.
    q, tau : (m, n)
        Positions in rad or m, and efforts in any unit.
    signal, unit : str, optional
        What their names say.
    torque_factor, current_factor : float
        Make N m and A of the numbers; None where the currents' unit is not known.

    Returns
    -------
    EffortGuess
        The kind, how sure it is, and the reason.
    """
    commanded = is_commanded(q, tau)
    # A command explains itself, so it has to be told before the dynamics are asked.
    if commanded:
        reason = "its noise follows from the noise of earlier positions, within 0.1 %, as in the output of a controller"
        return EffortGuess("commanded", 0.9, reason)
    guess = _classify_measured(fits, q, tau, signal, unit, torque_factor, current_factor)
    return guess if commanded is False else replace(guess, reason=f"{guess.reason}; {CANNOT_TELL}")


def _classify_measured(
    fits: DynamicsFits,
    q: FloatArray,
    tau: FloatArray,
    signal: str | None,
    unit: str | None,
    torque_factor: float,
    current_factor: float | None,
) -> EffortGuess:
    """Classify torques that no controller computed from the positions."""
    motion = fits.to_motion(q, tau)
    if motion is None or not len(motion.q) or not np.isfinite(motion.tau).all():
        return _classify_by_name(signal, unit, 0.6, "by its name; it could not be compared with the robot's dynamics")
    # External torques are what remains without the robot's own dynamics, so the motion cannot explain them.
    with_gravity = measure_unexplained_share(fits.robot, motion)
    if with_gravity > _NOTHING:
        if has_wrong_columns(fits, q, tau):
            return _classify_by_name(signal, unit, 0.6, "by its name; its columns, which are asked for, are wrong")
        return EffortGuess(
            "external",
            0.6,
            f"motion and gravity explain almost nothing of it ({format_percent(with_gravity, decimals=0)} unexplained)",
        )
    # Without gravity in the robot nothing tells whether it is in the torque.
    told_apart = 1.0
    if _has_gravity(fits.robot):
        without = measure_unexplained_share(_remove_gravity(fits.robot), motion)
        told_apart = without / max(with_gravity, 1e-9)
        # On a robot that is mounted otherwise than stated, gravity along another axis explains the torque just as well.
        if without < _LOST * with_gravity and find_mounting(fits.robot, motion).unexplained > without / _LOST:
            reason = (
                f"the robot's dynamics leave {format_percent(without, decimals=0)} of it unexplained without gravity, "
                f"and {format_percent(with_gravity, decimals=0)} with gravity"
            )
            return EffortGuess("gravity_compensated", 0.9, reason)
    taken_out = detect_compensated_gravity(fits.robot, motion, torque_factor)
    if taken_out is not None:
        reason = (
            f"it contains {format_percent(taken_out.gravity, decimals=0)} of the gravity torque of the description, "
            f"and {format_percent(taken_out.motion, decimals=0)} of the torque for the motion"
        )
        return EffortGuess("gravity_compensated", 0.85, reason)
    if signal == "tau":
        return _classify_torque(fits.robot, motion, unit, torque_factor)
    if signal == "current" or unit is not None:
        return _classify_by_name(signal, unit, 0.9, "by its name; gravity and motion explain it")
    if told_apart < _APART and _has_load(fits.robot, motion):
        return EffortGuess("unknown", 0.3, "the motion does not show whether it contains the gravity torque")
    return classify_by_size(fits.robot, motion, torque_factor, current_factor)


def _classify_torque(robot: Robot, motion: Motion, unit: str | None, factor: float) -> EffortGuess:
    """Classify what is called a torque: before the gears, or in a drive's unit, if drive gains make it plausible."""
    scales = compare_with_description(robot, motion)
    gains = np.array([np.nan if drive.gain is None else drive.gain for drive in robot.drives])
    is_torque = scales is None or scales.is_near_one(np.full(robot.n, factor))
    if scales is not None and not is_torque and np.isfinite(gains).all() and scales.is_near_one(gains):
        reason = "with the drive gains its size matches the inertias of the description; without, it does not"
        return EffortGuess("motor_torque", 0.9, reason, scales)
    if scales is None or scales.is_plausible(factor):
        by_name = _classify_by_name("tau", unit, 0.9, "by its name; gravity and motion explain it")
        return replace(by_name, scales=scales)
    size = f"it is {scales.median * factor:.2g} times the torque that the inertias of the description need"
    return EffortGuess("unknown", 0.3, size, scales)


def fit_torque_unit(guess: UnitGuess, effort: EffortGuess) -> tuple[UnitGuess, EffortGuess]:
    """Correct the unit of what is called a torque, and what it is, by the inertias of the description.

    Parameters
    ----------
    guess : UnitGuess
        The unit by the size of the numbers, where none is stated.
    effort : EffortGuess
        What the numbers are, with that unit.

    Returns
    -------
    pair of UnitGuess and EffortGuess
    """
    scales = effort.scales
    if scales is None or effort.kind == "motor_torque":
        return guess, effort
    unit = _match_description(guess, scales)
    if unit != guess and effort.kind == "unknown":
        # The size is that of a torque in another unit, which is what is asked.
        effort = replace(effort, kind="joint_torque", reason="by its name; gravity and motion explain it")
    return unit, effort


_NO_ALIAS = ("N m", "mN m", "kN m", "N cm", "kgf m", "kgf cm", "lbf ft", "lbf in", "ozf in")
"""Units of torque that are tried, each size once."""
_MIXED = ("N m", "mN m")
"""Units that one file has side by side, where small joints have drives of their own."""


def _match_description(guess: UnitGuess, scales: TorqueScales) -> UnitGuess:
    """Return the unit of torques, corrected or confirmed by what the inertias of the description need."""
    size = scales.median
    near = [unit for unit in _NO_ALIAS if scales.is_in_unit(MOMENTS[unit])]
    near.sort(key=lambda unit: abs(np.log(size * MOMENTS[unit])))
    if guess.unit in near:
        reason = f"in {guess.unit} its size matches the inertias of the description"
        return guess if guess.confidence >= SURE else UnitGuess(guess.unit, 0.85, reason)
    if near[:1] == ["N m"]:
        return UnitGuess("N m", 0.85, "in N m its size matches the inertias of the description")
    counts = {unit: scales.count_near(MOMENTS[unit]) for unit in _MIXED}
    if not near and min(counts.values()) > 0 and sum(counts.values()) == np.count_nonzero(scales.trusted):
        # Some joints are in each of these; the check of scales names those in the rarer one.
        most = max(_MIXED, key=lambda unit: counts[unit])
        return UnitGuess(most, 0.85, f"in {most} the torques of most joints match the inertias of the description")
    if not near and guess.unit == "N m":
        return guess
    # An unusual unit has to be borne out by the masses.
    units = tuple(near[:3]) or (guess.unit, "N m")
    sizes = ", ".join(f"{size * MOMENTS[unit]:.2g} times in {unit}" for unit in dict.fromkeys((*units, "N m")))
    reason = (
        f"they are these times the torque that the inertias of the description need: {sizes}; if they are torques of "
        "motors, or shares of rated ones, give drive gains"
    )
    return UnitGuess(units[0], 0.5, reason, units)


def classify_by_size(robot: Robot, motion: Motion, torque_factor: float, current_factor: float | None) -> EffortGuess:
    """Tell torque from current by the inertias of the description, and by drive gains where there are any.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    torque_factor, current_factor : float
        Make N m and A of the numbers; None where the currents' unit is not known.
    """
    scales = compare_with_description(robot, motion)
    if scales is None:
        return _classify_by_elimination(robot, motion, torque_factor) or EffortGuess(
            "unknown", 0.3, "neither the name nor the description shows whether it is torque or current"
        )
    is_torque = scales.is_near_one(np.full(robot.n, torque_factor))
    gains = np.array([np.nan if drive.gain is None else drive.gain for drive in robot.drives])
    known = current_factor is not None and bool(np.isfinite(gains).all())
    is_current = known and scales.is_near_one(gains * (current_factor or 1.0))
    # The masses of a description may be guesses. So currents that are somewhat off are still possible.
    may_be_current = known and scales.is_fair(gains * (current_factor or 1.0))
    # All joints have to agree on one unit: currents look like torques on single joints, but not on all with the same
    # factor.
    agrees = is_torque and not may_be_current and measure_gain_by_other_scales(robot, motion, 2.0) < CLEARLY_AGREES
    if agrees:
        return EffortGuess("joint_torque", 0.9, "its size matches the inertias of the description")
    if is_current and not is_torque:
        return EffortGuess(
            "motor_current", 0.9, "with the drive gains its size matches the inertias of the description"
        )
    if is_torque and may_be_current:
        return EffortGuess("unknown", 0.3, "its size matches the description both with and without the drive gains")
    return _classify_by_elimination(robot, motion, torque_factor) or EffortGuess(
        "unknown",
        0.3,
        f"as torque it is {scales.median * torque_factor:.2g} times the value that the description needs",
    )


def _classify_by_elimination(robot: Robot, motion: Motion, torque_factor: float) -> EffortGuess | None:
    """Return torque where it cannot be currents: those would be too large or too small for an arm."""
    # Currents of an arm lie in a known range, so values outside of it can only be torques.
    peak, usual = float(np.abs(motion.tau).max()), compute_median_scale(robot, motion)
    if usual is None:
        # Without masses, only values that are too small for a motor in any unit decide: joint torques in kN m.
        if peak < _LEAST_OF_MOTORS and measure_gain_by_other_scales(robot, motion, 2.0) < CLEARLY_AGREES:
            return EffortGuess("joint_torque", 0.85, "it is too small for a current or a torque of an arm's motors")
        return None
    if not FAIR[0] < usual * torque_factor < FAIR[1]:
        return None
    possible = [
        unit
        for unit, factor in (("A", 1.0), ("mA", 1e-3))
        if _CURRENTS[0] <= peak * factor <= _CURRENTS[1] and 1.0 / (usual * factor) <= _LARGEST_GAIN
    ]
    size = f"it is {usual * torque_factor:.2g} times the value that the description needs"
    if not possible and measure_gain_by_other_scales(robot, motion, 2.0) < CLEARLY_AGREES:
        return EffortGuess("joint_torque", 0.85, f"{size}, and this is not the range of an arm's currents")
    return None


def is_as_described(fits: DynamicsFits, q: FloatArray, currents: FloatArray, gains: Sequence[float | None]) -> bool:
    """Tell whether drive gains make of currents the torque that the inertias of the description need.

    False where the description has none, or a gain is missing.

    Parameters
    ----------
    fits : DynamicsFits
        Fits of the robot to the sample.
    q, currents : (m, n)
        Positions in rad or m, and currents.
    gains : sequence of float or None
        Drive gains of the joints; None where one is not known.
    """
    known = np.array([np.nan if gain is None else gain for gain in gains])
    motion = fits.to_motion(q, currents) if np.isfinite(known).all() else None
    scales = compare_with_description(fits.robot, motion) if motion is not None and len(motion.q) else None
    return scales is not None and scales.is_sure(known)


def _classify_by_name(signal: str | None, unit: str | None, confidence: float, reason: str) -> EffortGuess:
    if signal == "current" or unit in ("A", "mA"):
        return EffortGuess("motor_current", confidence, reason)
    if unit in ("permille", "percent"):
        return EffortGuess("motor_torque", confidence, reason)
    if signal == "tau" or unit in MOMENTS:
        return EffortGuess("joint_torque", confidence, reason)
    return EffortGuess("unknown", 0.3, "neither the name nor the data show whether it is torque or current")


def _has_gravity(robot: Robot) -> bool:
    return bool(np.linalg.norm(robot.gravity) > 1.0)


def _has_load(robot: Robot, motion: Motion) -> bool:
    """Tell whether gravity loads a joint, as far as the description says."""
    if robot.inertias is None:
        return True
    q = motion.q[:: max(1, len(motion.q) // 50)]
    loads = compute_described_torque(robot, q, np.zeros_like(q), np.zeros_like(q))
    return bool((np.abs(loads).max(axis=0) > _LOADED * np.abs(motion.tau).max(axis=0)).any())


def _remove_gravity(robot: Robot) -> Robot:
    return replace(robot, gravity=np.zeros(3))


def ask_for_servo_gains(fits: DynamicsFits, names: str, q: FloatArray, error: FloatArray) -> Question:
    """Ask for the gains of position servos, with those that the masses of the description need.

    Parameters
    ----------
    fits : DynamicsFits
        Of the sample.
    names : str
        What the file calls the columns of the commands.
    q, error : (m, n)
        Positions, and how far the commands are ahead of them, in rad or m.
    """
    motion = fits.to_motion(q, error)
    scales = None if motion is None or not len(motion.q) else compare_with_description(fits.robot, motion)
    described = "" if scales is None else f" {_describe_servo_gains(scales)}"
    return Question(
        "drives",
        f"{names} are commands, and no torque was recorded. If position servos follow them, the torque is gain x "
        "(command - position): give the drive gains of the joints in N m/rad, a servo's stall torque times the duty "
        f"that its P coefficient makes of 1 rad.{described} A Feetech STS3215 with the P coefficient 16, which LeRobot "
        "writes, has about 7.8 at 12 V and 5.1 at 7.4 V. If all gains are wrong by one factor, all masses and all "
        "friction are wrong by it, and no error shows it.",
    )


def _describe_servo_gains(scales: TorqueScales) -> str:
    """Say with which gains the description's masses explain the position errors."""
    gains = np.sort(1.0 / np.abs(scales.values[scales.trusted]))
    span = f" ({gains[0]:.2g} to {gains[-1]:.2g} by joint)" if len(gains) > 1 else ""
    return f"The masses of the description need gains of {float(np.median(gains)):.2g}{span}."
