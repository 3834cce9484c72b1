"""Check the columns of a sample against the robot's dynamics, and report the results as guesses and questions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.identification.column_inference.dynamics_fits import DynamicsFits
from dynident.identification.column_inference.proposal import Guess, Question
from dynident.identification.recording_faults import check_recording_faults
from dynident.identification.recording_faults.fault_checks import DESCRIPTION_UNITS, GRAVITY, SCALE
from dynident.recordings.columns import NOT_RECORDED
from dynident.recordings.metadata import COMMANDED, Check
from dynident.robot import Robot

_UNEXPLAINED_LIMIT = 0.5
"""Unexplained share of an average joint's torque above which the columns are taken for wrong."""

_ASKED_WARNINGS = (GRAVITY, SCALE)
"""Checks that are asked about although they only warn: what they find makes a model useless."""

_FIELDS = {GRAVITY: "gravity", SCALE: "units/tau", COMMANDED: "effort_kind"}
"""Fields of the metadata, or of the robot, that checks are about; all other checks are about the columns."""


def check_against_dynamics(
    robot: Robot,
    fits: DynamicsFits,
    q: FloatArray,
    tau: FloatArray,
    names: tuple[Sequence[str], Sequence[str]],
    *,
    in_si: bool,
    silent: Sequence[int] = (),
) -> tuple[list[Guess], list[Question]]:
    """Check columns against a robot's dynamics as the import of the whole file will.

    What that would refuse is asked now.

    Parameters
    ----------
    robot : Robot
        As it was given.
    fits : DynamicsFits
        Of the sample.
    q, tau : (m, n)
        Positions in rad or m; torques, in N m or N where that is known, which `in_si` says.
    names : pair of names
        Of the columns of positions, and of torques.
    in_si : bool
        Whether the torques are in N m or N.
    silent : sequence of int
        Joints whose torque was not recorded, which is said elsewhere.

    Returns
    -------
    tuple of guesses and questions
    """
    recording = fits.to_recording(q, tau)
    examined = None if recording is None else check_recording_faults(robot, recording, *names)
    # Where the unit is not known yet, the size of the torques says nothing: that is asked together with the unit.
    wrong = [] if examined is None else [check for check in examined.checks if _is_finding(check, in_si=in_si)]
    questions = [
        Question(_FIELDS.get(check.name, "columns"), check.detail, check=check.name)
        for check in wrong
        if _is_question(check)
    ]
    guesses = [
        Guess("check", check.name.replace("_", " "), 0.5, check.detail) for check in wrong if not _is_question(check)
    ]
    is_commanded = any(check.name == COMMANDED for check in wrong)
    # A torque that never changes while its joint moves was not recorded, or another column holds it.
    still = np.setdiff1d(np.flatnonzero((np.ptp(tau, axis=0) == 0) & (np.ptp(q, axis=0) > 0)), silent)
    if len(still) and not is_commanded:
        never = ", ".join(names[1][int(joint)] for joint in still)
        questions.append(
            Question(
                "columns/tau",
                f"{never} never change while the joints move: where is the measured torque? If it was not recorded, "
                f'say "columns": {{"tau{int(still[0]) + 1}": "{NOT_RECORDED}"}}, or lock the joint.',
            )
        )
    if examined is None or examined.unexplained is None:
        nothing = (
            "the sample has too little motion, or its times are not in order, so that it cannot be checked with the "
            "robot's dynamics"
        )
        return [*guesses, *([] if is_commanded else [Guess("check", "none", 0.5, nothing)])], questions
    unexplained = examined.unexplained
    worst = robot.joint_names[int(np.argmax(unexplained.joints))]
    reason = (
        f"share of the torque that the robot's dynamics do not explain, as the mean over the joints; for {worst} "
        f"{unexplained.worst_share:.0%}"
    )
    # The masses of the description explain no residual: identification does not use them.
    causes = [check for check in wrong if check.name != DESCRIPTION_UNITS]
    if unexplained.average_share < _UNEXPLAINED_LIMIT and not causes:
        return [*guesses, Guess("check", f"{unexplained.average_share:.0%} left", 0.9, reason)], questions
    # The most probable cause comes first, before all other guesses.
    cause = f"; most probably: {causes[0].detail}" if causes else ""
    return [Guess("check", f"{unexplained.average_share:.0%} left", 0.4, f"{reason}{cause}"), *guesses], questions


def _is_finding(check: Check, *, in_si: bool) -> bool:
    return check.status != "ok" and (in_si or check.name != SCALE)


def _is_question(check: Check) -> bool:
    return check.status == "error" or check.name in _ASKED_WARNINGS
