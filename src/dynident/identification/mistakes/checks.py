"""Gross mistakes as findings of a recording's checks, each with its cure."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification.mistakes.gravity import Mounting, compensated, other_mounting
from dynident.identification.mistakes.scales import scales_of
from dynident.identification.mistakes.search import (
    MOST_JOINTS,
    Finding,
    Judges,
    delay_among,
    excess_in,
    mistakes_of,
    thinned,
    whole_motion_of,
)
from dynident.identification.mistakes.swaps import Kind, Mistake, Motion
from dynident.recordings.stated import DELAY, NO_MEASUREMENT, Axis, Revision
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
}
_AMOUNTS = {"torque_scale"}

_HARDLY = 1.1
"""Times what is left without a mistake below which it is friction that tells of it."""

_MASSES = "Torques are far from what the masses of the description need: "
_FRICTION = "Friction is far larger than the other joints', or what its drive can give, allow: "

_ELSE = (
    " If columns and signs are right, something else about this robot is not: gravity in the description, the zero of "
    "a joint, a drive gain."
)


def checks_against(robot: Robot) -> ModelChecks:
    """What a robot's own dynamics say of order and signs of the columns, for `import_recording`.

    The function that is given back takes a recording and the user's names of its position and torque columns; it gives
    None where they say nothing.
    """

    @single_threaded
    def looked_at(recording: Recording, q: Sequence[str], tau: Sequence[str]) -> tuple[Check, ...] | None:
        # Once for all of them: it is read from the whole recording.
        whole = whole_motion_of(recording) if robot.n <= MOST_JOINTS else None
        if whole is None:
            return None
        motion, judges = thinned(whole[0]), Judges(robot)
        found = mistakes_of(robot, motion, judges)
        if found is None:
            return None
        mistakes, left = found
        wrong = {_CHECK[one.mistake.kind] for one in mistakes}
        fine = f"No other order or sign of the columns explains the torque clearly better: {left:.0%} are left of it."
        amounts = () if mistakes else _scales(robot, motion, recording, tau, judges)
        if not mistakes and all(one.status == "ok" for one in amounts):
            # Torques in different units have no delay that could be told.
            amounts = (*_delay(robot, *whole, tau, judges), *amounts)
        passed = [Check(name, "ok", fine) for name in dict.fromkeys(_CHECK.values()) if name not in wrong | _AMOUNTS]
        if not mistakes:
            amounts = (*_gravity(robot, motion, tau, left), *amounts)
        return (*passed, *(_check(one, recording, q, tau) for one in mistakes), *amounts)

    return looked_at


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
    columns = tau if "torque" in one.mistake.kind else q
    return Check(
        _CHECK[one.mistake.kind],
        "error" if one.certain else "warning",
        f"{known} {told}: as the columns are, {why}. {_cure(one.mistake, q, tau)}{doubt}{otherwise}",
        columns[one.mistake.joints[0]],
        apply=revision_of(one.mistake, recording.n),
    )


def _gravity(robot: Robot, motion: Motion, tau: Sequence[str], left: float) -> tuple[Check, ...]:
    found = compensated(robot, motion)
    if found is None:
        mounted = other_mounting(robot, motion, left)
        return () if mounted is None else (_mounting(mounted),)
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


def _mounting(found: Mounting) -> Check:
    told = ",".join(f"{value:g}" for value in found.gravity + 0.0)
    return Check(
        "gravity_direction",
        "warning",
        f"Gravity seems to pull along ({told}) m/s² of the base, as on a wall or a ceiling: with the stated one "
        f"{found.left_as_stated:.0%} of an average joint's torque cannot be explained by the robot's dynamics, with "
        f'that {found.left:.0%}. State "gravity": [{told}] with the robot.',
    )


def _delay(robot: Robot, motion: Motion, period: float, tau: Sequence[str], judges: Judges) -> tuple[Check, ...]:
    found = delay_among(robot, motion, period, judges)
    if found is None:
        return ()
    word = "late" if found.seconds > 0 else "early"
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
        if names:
            reasons.append(what + ", ".join(names))
    return (
        Check(
            "torque_scale",
            "warning",
            f"{'. '.join(reasons)}. It may be another unit (permille, N mm), a gear ratio or a drive gain: mend it by "
            "units, by the robot's drives or by scale.",
            tau[found[0].joint],
            apply=Revision(scale={f"tau{one.joint + 1}": 1.0 / one.power for one in found}),
        ),
    )


def revision_of(one: Mistake, n: int) -> Revision:
    """What has to be said of a file in which a mistake was made."""
    sides: tuple[tuple[Axis, bool], ...] = (("q", one.is_of_positions), ("tau", one.is_of_torques))
    kinds = [kind for kind, told in sides if told]
    if one.kind == "torque scaled":
        return Revision(scale={f"tau{one.joints[0] + 1}": one.factor})
    if len(one.joints) == 1:
        return Revision(signs={f"{kind}{one.joints[0] + 1}": -1.0 for kind in kinds})
    order = list(range(1, n + 1))
    first, second = one.joints
    order[first], order[second] = order[second], order[first]
    return Revision(permutation=dict.fromkeys(kinds, tuple(order)))


def told_of(one: Mistake, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> str:
    """A mistake in words, with the user's names of position and torque columns."""
    names = [recording.joint_names[j] for j in one.joints]
    if len(names) == 2:
        first, second = names
        what = {
            "torques swapped": f"the torques of {first} and {second} ({tau[one.joints[0]]}, {tau[one.joints[1]]})",
            "positions swapped": f"the positions of {first} and {second} ({q[one.joints[0]]}, {q[one.joints[1]]})",
            "joints swapped": f"{first} and {second}, positions and torques alike,",
        }
        return f"{what[one.kind]} stand in each other's place"
    joint = one.joints[0]
    what = {
        "torque turned": f"the torque of {names[0]} ({tau[joint]}) has the opposite sign",
        "position turned": f"the position of {names[0]} ({q[joint]}) has the opposite sign",
        "joint turned": f"position and torque of {names[0]} ({q[joint]}, {tau[joint]}) have the opposite sign",
        "torque scaled": f"the torque of {names[0]} ({tau[joint]}) is {1.0 / one.factor:g} times what the others need",
    }
    return what[one.kind]


def _cure(one: Mistake, q: Sequence[str], tau: Sequence[str]) -> str:
    if one.kind == "torque scaled":
        return f"Look at its unit and its drive gain, or take it times {one.factor:g}."
    if len(one.joints) == 1:
        kept = "the joint's axis in the description" if one.kind != "torque turned" else "the sign of its drive gain"
        return f"Turn the column round, or {kept}."
    first, second = (joint + 1 for joint in one.joints)
    pairs = []
    if one.kind != "torques swapped":
        pairs += [(f"q{first}", q[second - 1]), (f"q{second}", q[first - 1])]
    if one.kind != "positions swapped":
        pairs += [(f"tau{first}", tau[second - 1]), (f"tau{second}", tau[first - 1])]
    told = ", ".join(f'"{key}": "{source}"' for key, source in pairs)
    return f'Map them: "columns": {{{told}}}.'
