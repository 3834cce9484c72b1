"""Gross mistakes as findings of a recording's checks, each with its cure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dynident.identification.mistakes.bands import thinned
from dynident.identification.mistakes.described_units import DescribedUnits, find_units
from dynident.identification.mistakes.gravity import Mounting, compensated, other_mounting
from dynident.identification.mistakes.judge import Left
from dynident.identification.mistakes.scales import scales_of
from dynident.identification.mistakes.search import (
    ALIKE,
    MOST_JOINTS,
    SOUND,
    WORST_EXPLAINED,
    Finding,
    Judges,
    delay_among,
    excess_in,
    find_mistakes,
    motion_to_judge,
)
from dynident.identification.mistakes.static_torque import StaticTorque, find_static_torque
from dynident.identification.mistakes.swaps import Kind, Mistake, Motion
from dynident.recordings.stated import COMMANDED, DELAY, NO_MEASUREMENT, Axis, Revision
from dynident.recordings.types import Check, ModelChecks, Recording
from dynident.robot.model import Robot
from dynident.threads import single_threaded

_CHECK: dict[Kind, str] = {
    "torques swapped": "torque_order",
    "positions swapped": "joint_order",
    "joints swapped": "joint_order",
    "torque turned": "torque_sign",
    "position turned": "joint_sign",
    "joint turned": "joint_sign",
    "torque scaled": "torque_scale",
    "joint coupled": "joint_coupling",
}
_SILENT = {"torque_scale", "joint_coupling"}
"""Checks that say nothing where they find nothing, or by themselves."""

GRAVITY, SCALE = "gravity_direction", "torque_scale"

VETOES = (COMMANDED, GRAVITY, SCALE, "gravity_load", "torque_sign", "joint_sign")
"""Checks whose findings leave a model without use, however well it fits: its masses are not the robot's."""

CAUSES = (*VETOES, "torque_order", "joint_order", "joint_coupling")
"""Checks that say what may be wrong where a model fails."""

_HARDLY = 1.1
"""Times what is left without a mistake below which it is friction that tells of it."""

_MASSES = "Torques are far from what the masses of the description need: "
_FRICTION = "Friction is far larger than the other joints', or what its drive can give, allow: "

_ELSE = (
    " If columns and signs are right, something else about this robot is not: gravity in the description, the zero of "
    "a joint, a drive gain."
)


class Examined(NamedTuple):
    """The checks of a recording against its robot's dynamics, and what these leave of the torque as it is."""

    checks: tuple[Check, ...]
    left: Left | None


def checks_against(robot: Robot) -> ModelChecks:
    """What a robot's own dynamics say of order and signs of the columns, for `import_recording`.

    The function that is given back takes a recording and the user's names of its position and torque columns; it gives
    None where they say nothing.
    """

    def looked_at(recording: Recording, q: Sequence[str], tau: Sequence[str]) -> tuple[Check, ...] | None:
        return examine(robot, recording, q, tau).checks or None

    return looked_at


@single_threaded
def examine(robot: Robot, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> Examined:
    """Hold a recording against its robot's dynamics: causes about the whole robot first, then single columns.

    Parameters
    ----------
    robot : Robot
    recording : Recording
    q, tau : names
        What the user calls the columns of positions and torques.
    """
    units = find_units(robot)
    machine = robot if units is None else units.of(robot)
    described = () if units is None else (_description(units),)
    judges = Judges(machine)
    # Once for all of them: it is read from the whole recording.
    whole = motion_to_judge(recording, judges) if robot.n <= MOST_JOINTS else None
    if whole is None:
        return Examined(described, None)
    motion = thinned(whole[0])
    static = find_static_torque(machine, motion, judges.plain)
    if static is not None:
        return Examined((_commanded(static, tau), *described), None)
    found = find_mistakes(machine, motion, judges)
    if found is None:
        return Examined(described, None)
    mistakes, now = found
    as_is = judges.plain.left(motion)
    mounted = None if _is_enough(mistakes, now) else other_mounting(machine, motion, as_is)
    # One cause for the whole robot goes before several for some joints.
    if mounted is not None and (len(mistakes) > 1 or mounted.explains.score <= now.score + ALIKE):
        mistakes = ()
    elif mistakes:
        mounted = None
    wrong = {_CHECK[one.mistake.kind] for one in mistakes}
    fine = f"No other order or sign of the columns explains the torque clearly better: {now.usual:.0%} are left of it."
    passed = [Check(name, "ok", fine) for name in dict.fromkeys(_CHECK.values()) if name not in wrong | _SILENT]
    if mounted is not None:
        findings: tuple[Check, ...] = (_mounting(mounted, machine),)
    elif mistakes:
        findings = tuple(_check(one, recording, q, tau) for one in mistakes)
    else:
        findings = _scales(machine, motion, recording, tau, judges)
        if all(one.status == "ok" for one in findings):
            # Torques in different units have no delay that could be told.
            findings = (*_delay(machine, *whole, tau, judges), *findings)
        findings = (*_gravity(machine, motion, tau), *findings)
    return Examined((*passed, *findings, *described), as_is)


def _is_enough(mistakes: Sequence[Finding], now: Left) -> bool:
    """Whether one mistake in the columns explains all that was left: nothing else is looked for."""
    return len(mistakes) == 1 and mistakes[0].certain and now.worst < WORST_EXPLAINED


def _description(units: DescribedUnits) -> Check:
    return Check(
        "description_units",
        "warning",
        f"The robot's description is not in SI units: its {units}. The torques are not what is wrong. An "
        "identification does not need these numbers; a prior, a completed export and checks against them do: write "
        "them in kg, m and kg m² into the description.",
    )


def _commanded(found: StaticTorque, tau: Sequence[str]) -> Check:
    columns = ", ".join(tau[joint] for joint in found.joints)
    left, moving = (f"{max(share, 1e-4):.2%}" for share in (found.left, found.moving_share))
    return Check(
        COMMANDED,
        "error",
        f"There is neither friction nor inertia in the torque ({columns}): the load of gravity alone explains all but "
        f"{left} of it, and motion has {moving}. It seems to be the command of a gravity compensation, while something "
        f"else moved the joints, such as a hand. {NO_MEASUREMENT['commanded'].capitalize()}: give the torque, or "
        "current, that was measured while the drives moved the robot.",
        tau[found.joints[0]],
    )


def _check(one: Finding, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> Check:
    told = told_of(one.mistake, recording, q, tau)
    twins = "; or ".join(told_of(twin, recording, q, tau) for twin in one.alike[:2])
    doubt = f" (Or, which this data cannot tell from it, {twins}.)" if twins else ""
    known, otherwise = ("It seems that", "") if one.certain else ("It may be that", _ELSE)
    why = (
        f"{one.left_with:.0%} of an average joint's torque cannot be explained by the robot's dynamics, put right "
        f"{one.left_without:.0%}"
    )
    if one.left_with < _HARDLY * one.left_without:
        why = "friction would drive the joint, which there is not"
    columns, is_scaled = tau if "torque" in one.mistake.kind else q, one.mistake.kind == "torque scaled"
    return Check(
        _CHECK[one.mistake.kind],
        "error" if one.certain else "warning",
        f"{known} {told}: as the columns are, {why}. {_cure(one.mistake, q, tau)}{doubt}{otherwise}",
        columns[one.mistake.joints[0]],
        # Of cures that leave alike the user has to choose, and a ratio is as good as the masses of the description.
        apply=None if one.certain and (_is_ambiguous(one) or is_scaled) else revision_of(one.mistake, recording.n),
    )


def _is_ambiguous(one: Finding) -> bool:
    """Tell whether there is another cure of other signals.

    Two legs may exchange their torques as well as their positions, which gives the same robot with other names.
    """
    return any(len(one.mistake.pairs) < 2 or twin.joints != one.mistake.joints for twin in one.alike)


def _gravity(robot: Robot, motion: Motion, tau: Sequence[str]) -> tuple[Check, ...]:
    found = compensated(robot, motion)
    if found is None:
        return ()
    return (
        Check(
            "gravity_load",
            "error",
            f"The torque seems to be gravity-compensated ({tau[0]} … {tau[-1]}): of the load of gravity that the "
            f"masses of the description need {found.gravity:.0%} is in it, of what motion needs {found.motion:.0%}. "
            f"{NO_MEASUREMENT['gravity_compensated'].capitalize()}: give the torque, or current, that was measured.",
            tau[0],
        ),
    )


def _mounting(found: Mounting, robot: Robot) -> Check:
    told = ",".join(f"{value:.3g}" for value in found.gravity + 0.0)
    worst = robot.joint_names[int(np.argmax(found.as_stated.joints))]
    return Check(
        GRAVITY,
        "warning",
        f"Gravity seems to pull along ({told}) m/s² of the base, as on a wall, a slope or a ceiling: with the stated "
        f"one {found.left_as_stated:.0%} of the torque of {worst} cannot be explained by the robot's dynamics, with "
        f'that at most {found.left:.0%} of any joint\'s. State it with the robot: "gravity": [{told}].',
    )


def _delay(robot: Robot, motion: Motion, period: float, tau: Sequence[str], judges: Judges) -> tuple[Check, ...]:
    found = delay_among(robot, motion, period, judges)
    if found is None:
        return ()
    word = "late" if found.seconds > 0 else "early"
    if found.is_at_the_end or found.left_without > SOUND:
        # An elastic arm looks late or early, too, and by more than any log is.
        nothing = "How torque and position are aligned cannot be told: too little is explained with any delay."
        return (Check(DELAY, "ok", nothing),)
    if not found.is_mistake:
        fine = f"By the robot's dynamics the torque is {1e3 * abs(found.seconds):.1f} ms {word}, as in a right log."
        return (Check(DELAY, "ok", fine),)
    seconds = float(f"{found.seconds:.2g}")
    told = Check(
        DELAY,
        "warning",
        f"Torque comes about {1e3 * abs(found.seconds):.0f} ms {word} against position: {found.left_with:.1%} of an "
        f"average joint's torque cannot be explained by the robot's dynamics, with that taken out "
        f'{found.left_without:.1%}. Log both at the same instant, or mend it by "torque_delay": {seconds} (in s).',
        tau[0],
        apply=Revision(torque_delay=seconds),
    )
    return (told,)


def _scales(
    robot: Robot, motion: Motion, recording: Recording, tau: Sequence[str], judges: Judges
) -> tuple[Check, ...]:
    found = scales_of(robot, motion, excess_in(robot, motion, judges))
    if found is None:
        return ()
    if not found:
        return (Check("torque_scale", "ok", "No torque is many times what the masses of the description need."),)
    reasons = []
    for by_friction, what in ((False, _MASSES), (True, _FRICTION)):
        names = [
            f"{tau[one.joint]} ({recording.joint_names[one.joint]}) {one.times:.3g} times"
            for one in found
            if one.by_friction == by_friction
        ]
        if len(names) == robot.n > 1 and not by_friction:
            # By the masses of them all, they are told by one factor.
            reasons.append(f"{what}all of them ({tau[0]} … {tau[-1]}) {found[0].times:.3g} times")
        elif names:
            reasons.append(what + ", ".join(names))
    return (
        Check(
            "torque_scale",
            "warning",
            f"{'. '.join(reasons)}. It may be another unit (permille, N mm), a gear ratio or a drive gain: mend it by "
            "units, by the robot's drives or by scale. Or it is no torque: a current, a register, or the error of a "
            "controller, which drive gains make one of.",
            tau[found[0].joint],
            apply=Revision(scale={f"tau{one.joint + 1}": 1.0 / one.power for one in found}),
        ),
    )


def revision_of(one: Mistake, n: int) -> Revision | None:
    """What has to be said of a file in which a mistake was made; None where nothing that can be said mends it."""
    if one.kind == "joint coupled":
        return None
    sides: tuple[tuple[Axis, bool], ...] = (("q", one.is_of_positions), ("tau", one.is_of_torques))
    kinds = [kind for kind, told in sides if told]
    if one.kind == "torque scaled":
        return Revision(scale={f"tau{joint + 1}": one.factor for joint in one.joints})
    if not one.is_swap:
        return Revision(signs={f"{kind}{joint + 1}": -1.0 for kind in kinds for joint in one.joints})
    order = list(range(1, n + 1))
    for first, second in one.pairs:
        order[first], order[second] = order[second], order[first]
    return Revision(permutation=dict.fromkeys(kinds, tuple(order)))


def told_of(one: Mistake, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> str:
    """A mistake in words, with the user's names of position and torque columns."""
    names = [recording.joint_names[j] for j in one.joints]
    if one.is_swap:
        first, second = (", ".join(side) for side in (names[::2], names[1::2]))
        torques, positions = ("; ".join(f"{kind[a]}, {kind[b]}" for a, b in one.pairs) for kind in (tau, q))
        if len(one.pairs) > 1:
            second = f"those of {second}"
        what = {
            "torques swapped": f"the torques of {first} and {second} ({torques})",
            "positions swapped": f"the positions of {first} and {second} ({positions})",
            "joints swapped": f"{first} and {second}, positions and torques alike,",
        }
        return f"{what[one.kind]} stand in each other's place"
    if one.kind == "joint coupled":
        own, other = (q[joint] for joint in one.joints)
        sign, counted = ("-", "plus") if one.factor > 0 else ("+", "minus")
        return (
            f"the position of {names[0]} ({own}) is counted from the base, or the horizon, and not from {names[1]}: it "
            f"is its angle {counted} that of {names[1]}, and {own} {sign} {other} is what the description means"
        )
    if len(names) == recording.n:
        whole = {
            "torque turned": f"all torques ({tau[0]} … {tau[-1]}) have the opposite sign, as the reaction that "
            "a sensor or a driver may report",
            "position turned": f"all positions ({q[0]} … {q[-1]}) have the opposite sign",
        }
        return whole[one.kind]
    of = " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
    columns = tuple(", ".join(kind[joint] for joint in one.joints) for kind in (q, tau))
    verb = ("has", "is") if len(names) == 1 else ("have", "are")
    plural = "" if len(names) == 1 else "s"
    what = {
        "torque turned": f"the torque{plural} of {of} ({columns[1]}) {verb[0]} the opposite sign",
        "position turned": f"the position{plural} of {of} ({columns[0]}) {verb[0]} the opposite sign",
        "joint turned": f"position and torque of {of} ({columns[0]}, {columns[1]}) have the opposite sign",
        "torque scaled": f"the torque{plural} of {of} ({columns[1]}) {verb[1]} {1.0 / one.factor:.3g} times what the "
        "others need",
    }
    return what[one.kind]


def _cure(one: Mistake, q: Sequence[str], tau: Sequence[str]) -> str:
    if one.kind == "joint coupled":
        own, other = (q[joint] for joint in one.joints)
        word = "Subtract" if one.factor > 0 else "Add"
        return (
            f"{word} {other} {'from' if one.factor > 0 else 'to'} {own}, and their velocities, before the file is read."
        )
    if one.kind == "torque scaled":
        which = (
            "its unit and its drive gain, or take it" if len(one.joints) == 1 else "their units and gains, or take them"
        )
        scale = ", ".join(f'"tau{joint + 1}": {one.factor:.3g}' for joint in one.joints)
        return f'Look at {which} times {one.factor:.3g}: "scale": {{{scale}}}.'
    if not one.is_swap:
        side = "tau" if one.kind == "torque turned" else "q"
        signs = ", ".join(f'"{side}{joint + 1}": -1' for joint in one.joints)
        kept = "the joint's axis in the description" if one.kind != "torque turned" else "the sign of its drive gain"
        return f'Turn the column{"" if len(one.joints) == 1 else "s"} round ("signs": {{{signs}}}), or {kept}.'
    pairs = []
    for first, second in one.pairs:
        if one.is_of_positions:
            pairs += [(f"q{first + 1}", q[second]), (f"q{second + 1}", q[first])]
        if one.is_of_torques:
            pairs += [(f"tau{first + 1}", tau[second]), (f"tau{second + 1}", tau[first])]
    told = ", ".join(f'"{key}": "{source}"' for key, source in pairs)
    return f'Map them: "columns": {{{told}}}.'
