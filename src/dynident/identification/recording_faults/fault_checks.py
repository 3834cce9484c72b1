"""Turn found faults into checks of a recording, with cures as revisions; which forbid its use (vetoes)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from dynident.errors import Remedy
from dynident.identification.recording_faults.column_faults import (
    SCALED,
    ColumnFault,
    FaultKind,
    Motion,
    build_revision,
    is_possible_delay,
)
from dynident.identification.recording_faults.description_fit import check_description, describe_weightlessness
from dynident.identification.recording_faults.fault_search import (
    ALIKE,
    CURED,
    MOST_JOINTS,
    WORST_EXPLAINED,
    DetectedFault,
    find_excess_of_motion,
    search_bands,
)
from dynident.identification.recording_faults.gravity_in_torque import (
    Mounting,
    StaticTorque,
    detect_compensated_gravity,
    find_other_mounting,
    find_static_torque,
)
from dynident.identification.recording_faults.joint_angle_faults import (
    ZERO,
    describe_mixing,
    describe_mixing_cure,
    describe_zeros,
    describe_zeros_cure,
    report_zeros_from_start,
)
from dynident.identification.recording_faults.rows_for_fault_search import (
    HeldOutFits,
    drop_scales_of_loads,
    filter_for_search,
    find_delay,
    report_clocks,
    report_torque_steps,
    thin_out,
)
from dynident.identification.recording_faults.torque_scale import TorqueScale, find_torque_scales
from dynident.identification.recording_faults.tree_fit import BLOCKS
from dynident.identification.recording_faults.unexplained_torque import UnexplainedTorque
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.recordings.recording import ModelChecks, Recording
from dynident.recordings.recording_metadata import COMMANDED, DELAY, NO_MEASUREMENT, Check, Revision
from dynident.robot.pseudo_inertia import find_description_units
from dynident.robot.robot_model import Robot

_CHECK: dict[FaultKind, str] = {
    "torques swapped": "torque_order",
    "positions swapped": "joint_order",
    "joints swapped": "joint_order",
    "torque turned": "torque_sign",
    "position turned": "joint_sign",
    "joint turned": "joint_sign",
    "torque scaled": "torque_scale",
    "joint coupled": "joint_coupling",
    "joints mixed": "joint_coupling",
    "joint zero": "joint_zero",
    "position scaled": "position_scale",
}
_SILENT = {"torque_scale", "joint_coupling", "joint_zero", "position_scale"}
"""Checks that are not listed as passed: another check reports for them, or they have nothing to say."""

GRAVITY, SCALE = "gravity_direction", "torque_scale"
VETOES = (COMMANDED, GRAVITY, SCALE, "gravity_load", "torque_sign", "joint_sign")
"""Checks whose findings make a model useless, however well it fits: its masses are not the robot's."""

CAUSES = (*VETOES, "torque_order", "joint_order", "joint_coupling", ZERO)
"""Checks that name possible causes where a model fails."""

_CLEARLY_LESS = 0.95
"""Share of what half a recording leaves unexplained with the delay of the whole that its own delay may leave, so that
the delay is said to change. On a UR10e and on drawn arms: 0.99 and more; 0.72 to 0.91 if it grows by 1 ms a second."""

_HARDLY_BETTER = 1.1
"""Ratio of the unexplained shares with and without a fault, below which negative friction is why it is reported."""

_MASSES = "Torques do not match the masses of the description: "
_FRICTION = "Friction is far larger than on the other joints, or than the drive can overcome: "
_OTHER_CAUSES = " If columns and signs are right, check gravity, the zeros of the joints and the drive gains."


class DynamicsCheck(NamedTuple):
    """The checks of a recording against its robot's dynamics.

    Parameters
    ----------
    checks : tuple of Check
        The checks, those that passed included.
    unexplained : UnexplainedTorque or None
        Unexplained shares of the torque as it is; None where nothing was fitted.
    """

    checks: tuple[Check, ...]
    unexplained: UnexplainedTorque | None


def build_dynamics_checks(robot: Robot) -> ModelChecks:
    """Return a function that checks a recording against a robot's dynamics, for `import_recording`.

    The function takes a recording and the user's names of its position and torque columns. It returns None where the
    dynamics say nothing about them.
    """

    def check(recording: Recording, q: Sequence[str], tau: Sequence[str]) -> tuple[Check, ...] | None:
        return check_recording_faults(robot, recording, q, tau).checks or None

    return check


@single_threaded
def check_recording_faults(robot: Robot, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> DynamicsCheck:
    """Check a recording against its robot's dynamics: causes about the whole robot first, then single columns.

    Parameters
    ----------
    robot : Robot
        The robot.
    recording : Recording
        The recording.
    q, tau : names
        What the user calls the columns of positions and torques.

    Returns
    -------
    DynamicsCheck
        Without checks where the recording is too short, or the robot has too many joints.
    """
    units = find_description_units(robot)
    # Masses in grams make every torque look a thousand times too small: the description is brought to SI first.
    machine = robot if units is None else units.to_si(robot)
    described = check_description(robot, units)
    judges = HeldOutFits(machine)
    # All checks share these rows, as reading and filtering the whole recording takes most of the time.
    bands = filter_for_search(recording, judges) if robot.n <= MOST_JOINTS else []
    if not bands:
        return DynamicsCheck(described, None)
    motion = thin_out(bands[0][0])
    # A commanded gravity torque explains itself perfectly: it is refused before any fit is compared.
    static = find_static_torque(machine, motion, judges.plain_fit)
    if static is not None:
        return DynamicsCheck((_report_commanded(static, tau), *described), None)
    if not recording.torque_from_commands and (clocks := report_clocks(machine, *bands[0], tau, judges)) is not None:
        # Every other search is for what only looks like this, in rows that do not belong together.
        return DynamicsCheck((clocks, *described), judges.plain_fit.measure_unexplained(motion))
    search_result = search_bands(machine, bands, judges)
    if search_result is None:
        # A fit has too many parameters for so few rows; the masses of the description have few.
        scales = _report_scales(find_torque_scales(machine, motion, {}), recording, tau)
        return DynamicsCheck((*(check for check in scales if check.status != "ok"), *described), None)
    band, faults, now = search_result
    motion = thin_out(bands[band][0])
    as_is = judges.plain_fit.measure_unexplained(motion)
    # A zero for each joint fits many faults half-way, so that it has to explain more than a single one of the columns.
    # Several are several causes where this is one.
    otherwise = (as_is, now) if len(faults) == 1 else (as_is,)
    from_start = report_zeros_from_start(machine, recording, motion, judges.plain_fit, otherwise, q)
    if from_start is not None:
        return DynamicsCheck((from_start, *described), as_is)
    excess = {} if faults else find_excess_of_motion(machine, motion, judges.plain_fit)
    # Friction tells a torque that is too large whatever gravity does, and such a torque may look like other gravity.
    sizes = np.array([10.0 ** np.rint(np.log10(excess.get(joint, 1.0))) for joint in range(machine.n)])
    of_one_unit = [(replace(rows, tau=rows.tau / sizes), period) for rows, period in bands[band:]]
    is_known = _is_explained_by_one(faults, now)
    mounted = None if is_known else find_other_mounting(machine, of_one_unit, judges.plain_fit)
    # One cause for the whole robot is more likely than several for some joints, unless they surely explain more.
    several = len(faults) > 1 and mounted is not None and not mounted.explains.is_surely_above(now)
    if mounted is not None and (several or mounted.explains.score <= now.score + ALIKE):
        faults = ()
    elif faults:
        mounted = None
    wrong = {_CHECK[finding.fault.kind] for finding in faults}
    fine = (
        "No other order or sign of the columns explains the torque clearly better: "
        f"{format_percent(now.average_share, decimals=0)} of it is unexplained."
    )
    passed = [Check(name, "ok", fine) for name in dict.fromkeys(_CHECK.values()) if name not in wrong | _SILENT]
    if mounted is not None:
        findings: tuple[Check, ...] = (_report_mounting(mounted, machine),)
    elif faults:
        findings = tuple(_report_fault(finding, recording, q, tau) for finding in faults)
    elif steps := report_torque_steps(motion, recording, tau, judges):
        findings = (*_report_compensated(machine, motion, tau), *steps)
    else:
        # Sizes are looked at only where order and signs are right: a wrong column has any size, and so has a step.
        frictions = judges.plain_fit.measure_frictions(motion)
        wrong_sizes = find_torque_scales(machine, motion, excess, frictions)
        findings = _report_scales(drop_scales_of_loads(wrong_sizes, motion, judges.plain_fit), recording, tau)
        if all(check.status == "ok" for check in findings) and not recording.torque_from_commands:
            # A delay can only be estimated once all torques are in the same unit; of servos, play looks like one.
            findings = (*_check_delay(machine, *bands[band], tau, judges), *findings)
        # Gravity that was taken out would make masses look wrong, so it is reported first.
        findings = (*_report_compensated(machine, motion, tau), *findings)
    return DynamicsCheck((*passed, *findings, *described), as_is)


def _is_explained_by_one(faults: Sequence[DetectedFault], now: UnexplainedTorque) -> bool:
    """Tell whether one fault of the columns explains all that was unexplained, so that no other cause is looked for."""
    return len(faults) == 1 and faults[0].certain and now.worst_share < WORST_EXPLAINED


def _report_commanded(static: StaticTorque, tau: Sequence[str]) -> Check:
    columns = ", ".join(tau[joint] for joint in static.joints)
    unexplained, moving = (format_percent(max(share, 1e-4)) for share in (static.unexplained, static.moving_share))
    return Check(
        COMMANDED,
        "error",
        f"The torque ({columns}) contains neither friction nor inertia: gravity alone explains all but {unexplained} "
        f"of it, and friction and inertia together at most {moving}. It seems to be the command of a gravity "
        f"compensation, while something else moved the joints, such as a hand. "
        f"{NO_MEASUREMENT['commanded'].capitalize()}: give the "
        "torque, or current, that was measured while the drives moved the robot.",
        tau[static.joints[0]],
    )


def _report_fault(finding: DetectedFault, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> Check:
    description = describe_fault(finding.fault, recording, q, tau)
    twins = "; or ".join(describe_fault(twin, recording, q, tau) for twin in finding.alike[:2])
    doubt = f" (These data fit equally well: {twins}.)" if twins else ""
    known, otherwise = ("It seems that", "") if finding.certain else ("Possibly", _OTHER_CAUSES)
    by_masses = finding.left_by_masses
    who = "the robot's dynamics" if by_masses is None else "the masses of the description"
    left = [format_percent(share, decimals=0) for share in by_masses or (finding.left_with, finding.left_without)]
    why = f"{who} leave {left[0]} of an average joint's torque unexplained, and {left[1]} after the correction"
    if by_masses is None and finding.left_with < _HARDLY_BETTER * finding.left_without:
        why = "friction would drive the joint, which is impossible"
    columns, is_scaled = tau if "torque" in finding.fault.kind else q, finding.fault.kind in SCALED
    cure, remedies = _describe_cure(finding.fault, q, tau)
    return Check(
        _CHECK[finding.fault.kind],
        "error" if finding.certain else "warning",
        f"{known} {description}: with the columns as they are, {why}. {cure}{doubt}{otherwise}",
        columns[finding.fault.joints[0]],
        # A cure is applied without asking only where it is the only one. Between cures that explain alike the user
        # has to choose, and a ratio is only as good as the masses of the description.
        apply=None
        if finding.certain and (_is_ambiguous(finding) or is_scaled)
        else build_revision(finding.fault, recording.n),
        remedies=remedies,
    )


def _is_ambiguous(finding: DetectedFault) -> bool:
    """Tell whether another cure, of other signals, explains as much.

    Two legs may exchange their torques as well as their positions, which gives the same robot with other names.
    """
    fault = finding.fault
    is_of_legs = fault.is_swap and len(fault.joints) > 2
    return any(not is_of_legs or set(twin.joints) != set(fault.joints) for twin in finding.alike)


def _report_compensated(robot: Robot, motion: Motion, tau: Sequence[str]) -> tuple[Check, ...]:
    shares = detect_compensated_gravity(robot, motion)
    if shares is None:
        return ()
    cure, remedies = describe_weightlessness(robot)
    detail = (
        f"The torque seems to be gravity-compensated ({tau[0]} … {tau[-1]}): it contains "
        f"{format_percent(shares.gravity, decimals=0)} of the gravity torque that the masses of the description "
        f"need, and {format_percent(shares.motion, decimals=0)} of the torque for the motion. "
        f"{NO_MEASUREMENT['gravity_compensated'].capitalize()}: give the torque, or current, that was measured.{cure}"
    )
    return (Check("gravity_load", "error", detail, tau[0], remedies=remedies),)


def _report_mounting(mounting: Mounting, robot: Robot) -> Check:
    rounded = tuple(float(f"{value:.3g}") for value in mounting.gravity + 0.0)
    direction, remedy = ",".join(f"{value:g}" for value in rounded), Remedy("gravity", rounded)
    worst = robot.joint_names[int(np.argmax(mounting.as_stated.joints))]
    why = (
        "With the given gravity the robot's dynamics leave "
        f"{format_percent(mounting.unexplained_as_stated, decimals=0)} of the torque of {worst} unexplained, with this "
        f"one at most {format_percent(mounting.unexplained, decimals=0)} for any joint."
    )
    if mounting.is_of_masses:
        why = (
            "With the given gravity the masses of the description leave "
            f"{format_percent(mounting.unexplained_as_stated, decimals=0)} of an average joint's torque unexplained, "
            f"with this one {format_percent(mounting.unexplained, decimals=0)}. (Zeros of the joints that are "
            "elsewhere look the same.)"
        )
    return Check(
        GRAVITY,
        "warning",
        f"Gravity seems to act along ({direction}) m/s² in the base frame, as on a wall, a slope or a ceiling. {why} "
        f"State {remedy} with the robot.",
        remedies=(remedy,),
    )


def _check_delay(
    robot: Robot, motion: Motion, period: float, tau: Sequence[str], judges: HeldOutFits
) -> tuple[Check, ...]:
    if (delay := find_delay(robot, motion, period, judges)) is None:
        return ()
    word = "late" if delay.seconds > 0 else "early"
    if delay.is_at_the_end or delay.left_without > CURED:  # as of an elastic arm, by more than the delay of any log
        nothing = "The delay between torque and position cannot be determined: no delay explains the torque well."
        return (Check(DELAY, "ok", nothing),)
    if not delay.is_fault:
        shown = f"By the robot's dynamics the torque is {1e3 * abs(delay.seconds):.1f} ms {word}"
        usual = "which is usual" if is_possible_delay(delay.seconds) else "but the recording does not show this surely"
        return (Check(DELAY, "ok", f"{shown}, {usual}."),)
    seconds = float(f"{delay.seconds:.2g}")
    remedy = Remedy(DELAY, seconds)
    without = format_percent(delay.left_without, decimals=1)
    left = (
        f"the robot's dynamics leave {format_percent(delay.left_with, decimals=1)} of an average joint's torque "
        f"unexplained, and {without} without this delay"
    )
    about = f"The torque is about {1e3 * abs(delay.seconds):.0f} ms {word} against the position: {left}."
    if (halves := _find_unlike_halves(robot, motion, period, judges, seconds)) is not None:
        first, second = (f"{1e3 * half:.0f} ms" for half in halves)
        unlike = f"In the first half it is {first}, and in the second {second}: a clock drifts, or has jumped"
        return (Check(DELAY, "warning", f"{about} {unlike}, and no one delay corrects it. Use one clock.", tau[0]),)
    cure = f"Log both at the same instant, or correct the delay by {remedy} (in s)."
    apply = Revision(torque_delay=seconds)
    return (Check(DELAY, "warning", f"{about} {cure}", tau[0], apply=apply, remedies=(remedy,)),)


def _find_unlike_halves(
    robot: Robot, motion: Motion, period: float, judges: HeldOutFits, seconds: float
) -> tuple[float, float] | None:
    """Return the delays of both halves of a motion where these show that it is another one; None otherwise."""
    times, m, rests = np.arange(len(motion.q)), len(motion.q) // 2, []
    undone = scipy.interpolate.make_interp_spline(times, motion.tau)(np.clip(times + seconds / period, 0, times[-1]))
    for rows in (slice(0, m), slice(m, 2 * m)):
        q, dq, ddq, tau = (signal[rows] for signal in (motion.q, motion.dq, motion.ddq, undone))
        rest = find_delay(robot, Motion(q, dq, ddq, tau, np.arange(m) * BLOCKS // m, motion.t[rows]), period, judges)
        # A half in which the robot is slow tells little of a delay.
        if rest is None or rest.is_at_the_end or rest.left_without > _CLEARLY_LESS * rest.left_with:
            return None
        rests.append(rest.seconds)
    return (seconds + rests[0], seconds + rests[1]) if rests[0] * rests[1] < 0.0 else None


def _report_scales(
    scales: tuple[TorqueScale, ...] | None, recording: Recording, tau: Sequence[str]
) -> tuple[Check, ...]:
    if scales is None:
        return ()
    if not scales:
        return (Check("torque_scale", "ok", "The size of every torque matches the masses of the description."),)
    reasons = []
    for by_friction, intro in ((False, _MASSES), (True, _FRICTION)):
        names = [
            f"{tau[scale.joint]} ({recording.joint_names[scale.joint]}) {scale.times:.3g} times the expected torque"
            for scale in scales
            if scale.by_friction == by_friction
        ]
        if len(names) == recording.n > 1 and not by_friction:
            # The masses of all joints give one common factor.
            reasons.append(f"{intro}all of them ({tau[0]} … {tau[-1]}) {scales[0].times:.3g} times the expected torque")
        elif names:
            reasons.append(intro + ", ".join(names))
    return (
        Check(
            "torque_scale",
            "warning",
            f"{'. '.join(reasons)}. The cause may be another unit (permille, N mm), a gear ratio or a drive gain: "
            "correct it by units, by the robot's drives or by scale. Or the column is not a torque but a current, a "
            "register, or the error of a controller, scaled by drive gains.",
            tau[scales[0].joint],
            apply=Revision(scale={f"tau{scale.joint + 1}": 1.0 / scale.power for scale in scales}),
        ),
    )


def describe_fault(fault: ColumnFault, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> str:
    """Describe a fault in words, with the user's names of position and torque columns.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    recording : Recording
        The recording.
    q, tau : sequence of str
        What the user calls the columns.
    """
    names = [recording.joint_names[j] for j in fault.joints]
    if fault.mixing is not None:
        return describe_mixing(fault, names, q)
    if fault.kind == "joint zero":
        return describe_zeros(fault, names, q)
    if fault.is_swap:
        return _describe_exchange(fault, recording, q, tau)
    if fault.kind == "joint coupled":
        own, other = (q[joint] for joint in fault.joints)
        sign, counted = ("-", "plus") if fault.factor > 0 else ("+", "minus")
        return (
            f"the position of {names[0]} ({own}) is measured from the base, or the horizon, not from {names[1]}: it "
            f"is the joint angle {counted} the angle of {names[1]}, and the description needs {own} {sign} {other}"
        )
    if len(names) == recording.n:
        whole = {
            "torque turned": (
                f"all torques ({tau[0]} … {tau[-1]}) have the opposite sign, as when a sensor or a driver reports the "
                "reaction torque"
            ),
            "position turned": f"all positions ({q[0]} … {q[-1]}) have the opposite sign",
            "position scaled": f"all positions ({q[0]} … {q[-1]}) are in degrees",
        }
        return whole[fault.kind]
    of = " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
    columns = tuple(", ".join(kind[joint] for joint in fault.joints) for kind in (q, tau))
    verb = ("has", "is") if len(names) == 1 else ("have", "are")
    plural = "" if len(names) == 1 else "s"
    descriptions = {
        "torque turned": f"the torque{plural} of {of} ({columns[1]}) {verb[0]} the opposite sign",
        "position turned": f"the position{plural} of {of} ({columns[0]}) {verb[0]} the opposite sign",
        "joint turned": f"position and torque of {of} ({columns[0]}, {columns[1]}) have the opposite sign",
        "torque scaled": (
            f"the torque{plural} of {of} ({columns[1]}) {verb[1]} {1.0 / fault.factor:.3g} times the value that "
            "fits the other joints"
        ),
        "position scaled": (
            f"the position{plural} of {of} ({columns[0]}) {verb[1]} {1.0 / fault.factor:.3g} times the angle or "
            "distance that moved, as with another gear ratio or number of counts"
        ),
    }
    return descriptions[fault.kind]


def _describe_cure(fault: ColumnFault, q: Sequence[str], tau: Sequence[str]) -> tuple[str, tuple[Remedy, ...]]:
    if fault.mixing is not None:
        return describe_mixing_cure(fault, q, tau), ()
    if fault.kind == "joint coupled":
        own, other = (q[joint] for joint in fault.joints)
        word = "Subtract" if fault.factor > 0 else "Add"
        preposition = "from" if fault.factor > 0 else "to"
        return f"{word} {other} {preposition} {own}, and their velocities, before the file is read.", ()
    if fault.kind in SCALED:
        side, cause = ("tau", "drive gain") if fault.kind == "torque scaled" else ("q", "gear ratio")
        which = (
            f"its unit and its {cause}, or multiply it"
            if len(fault.joints) == 1
            else f"their units and {cause}s, or multiply them"
        )
        remedy = Remedy("scale", {f"{side}{joint + 1}": float(f"{fault.factor:.3g}") for joint in fault.joints})
        return f"Check {which} by {fault.factor:.3g}: {remedy}.", (remedy,)
    if fault.kind == "joint zero":
        return describe_zeros_cure(fault)
    if not fault.is_swap:
        sides = [side for side, is_wrong in (("q", fault.is_of_positions), ("tau", fault.is_of_torques)) if is_wrong]
        remedy = Remedy("signs", {f"{side}{joint + 1}": -1 for side in sides for joint in fault.joints})
        alternative = (
            "the joint's axis in the description" if fault.kind != "torque turned" else "the sign of its drive gain"
        )
        plural = "" if len(fault.joints) * len(sides) == 1 else "s"
        return f"Change the sign of the column{plural} ({remedy}), or {alternative}.", (remedy,)
    pairs = []
    for joint, source in fault.places:
        if fault.is_of_positions:
            pairs.append((f"q{joint + 1}", q[source]))
        if fault.is_of_torques:
            pairs.append((f"tau{joint + 1}", tau[source]))
    remedy = Remedy("columns", dict(pairs))
    return f"Map the columns: {remedy}.", (remedy,)


def _describe_exchange(fault: ColumnFault, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> str:
    names = [recording.joint_names[joint] for joint in fault.joints]
    if fault.sources:
        kind = {"torques swapped": "torques", "positions swapped": "positions"}.get(fault.kind, "positions and torques")
        columns = tau if fault.kind == "torques swapped" else q
        elsewhere = ", ".join(f"{name} in {columns[source]}" for name, source in zip(names, fault.sources, strict=True))
        return f"the {kind} of several joints are in another order ({elsewhere})"
    first, second = (", ".join(side) for side in (names[::2], names[1::2]))
    pairs = list(zip(fault.joints[::2], fault.joints[1::2], strict=True))
    torques, positions = ("; ".join(f"{kind[a]}, {kind[b]}" for a, b in pairs) for kind in (tau, q))
    if len(pairs) > 1:
        second = f"those of {second}"
    descriptions = {
        "torques swapped": f"the torques of {first} and {second} ({torques})",
        "positions swapped": f"the positions of {first} and {second} ({positions})",
        "joints swapped": f"{first} and {second} (both positions and torques)",
    }
    return f"{descriptions[fault.kind]} are exchanged"
