"""Why a model is not to be used at all: the most probable of the gross mistakes, and what would cure it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.diagnosis.comparing.content import Common
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.mistakes import CAUSES, examine
from dynident.identification.thresholds import OVERFIT, STOP
from dynident.recordings import Check, Recording, Revision
from dynident.robot import Robot

SCALED = 5.0
"""Times the measured torque by which a prediction is off from which on it is a unit or a gain."""


@dataclass(frozen=True)
class Stop:
    """The most probable cause of a gross mistake; `apply` cures the recording of that name, where that is known.

    `records_more` says that nothing is wrong but that the data determine too little.
    """

    cause: str
    recording: str | None = None
    apply: Revision | None = None
    records_more: bool = False


def tells_stop(found: Errors | None) -> bool:
    """Whether an error is so large that the model is not to be used."""
    return found is not None and bool(found.counts.any()) and not found.relative_total <= STOP


def stop_of(
    found: Identification, fitted: Sequence[Recording], held_out: Sequence[Recording], common: Sequence[Common]
) -> Stop | None:
    """Why a model has to be stopped; None where it has not.

    Causes are looked for in the order of what they usually cost: content, columns, then what only a person can see.
    """
    copied = next((one for one in common if one.kind == "copied"), None)
    if copied is not None:
        return Stop(str(copied), copied.held_out)
    if not tells_stop(found.held_out) and not tells_stop(found.fit):
        return None
    error, what = _worst(found)
    robot = found.model.robot
    for recording in (*held_out, *fitted) if what == "held out" else fitted:
        cause = _by_checks(robot, recording)
        if cause is not None:
            return cause
    moving = found.held_out_moving if what == "held out" else found.fit_moving
    if moving is not None and moving.counts.any() and moving.relative_total <= STOP:
        return Stop(
            f"Of the torque {error.relative_total:.0%} cannot be explained on all rows, {moving.relative_total:.0%} "
            "where the joints move: what is wrong is in the rows at rest. Brakes that are engaged and drives that are "
            "off hold any torque, or none: leave these seconds out."
        )
    if what == "held out" and found.fit.relative_total * OVERFIT < error.relative_total and _all_bad(error):
        return Stop(
            f"The fit leaves {found.fit.relative_total:.0%} of the torque, held-out data {error.relative_total:.0%}: "
            "columns and units explain the one, so the motion does not determine the parameters that the other needs, "
            "or that has another load. Record more: a designed motion.",
            records_more=True,
        )
    return Stop(_by_joints(robot, moving if moving is not None and moving.counts.any() else error, what))


def _all_bad(error: Errors) -> bool:
    """Whether no joint alone makes the error: that would be its column."""
    told = error.relative[error.counts > 0]
    return bool((told > STOP).mean() > 0.5)


def _worst(found: Identification) -> tuple[Errors, str]:
    if found.held_out is not None and tells_stop(found.held_out) and not tells_stop(found.fit):
        return found.held_out, "held out"
    return found.fit if tells_stop(found.fit) or found.held_out is None else found.held_out, "fit"


def _by_checks(robot: Robot, recording: Recording) -> Stop | None:
    """What the robot's dynamics say of a recording, the gravest finding of it."""
    n = recording.n
    checks = examine(robot, recording, [f"q{k + 1}" for k in range(n)], [f"tau{k + 1}" for k in range(n)]).checks
    found = sorted((one for one in checks if one.name in CAUSES and one.status != "ok"), key=_rank)
    return Stop(f"In {recording.name}: {found[0].detail}", recording.name, found[0].apply) if found else None


def _rank(check: Check) -> bool:
    return check.status != "error"


def _by_joints(robot: Robot, error: Errors, what: str) -> str:
    names = robot.joint_names
    relative = np.where(error.counts > 0, error.relative, 0.0)
    worst = int(np.argmax(relative))
    bad = [j for j in range(len(names)) if relative[j] > STOP]
    of = "the data of the fit" if what == "fit" else "held-out data"
    if len(bad) < len(names) and relative[worst] > STOP:
        return (
            f"On {of} {', '.join(f'{names[j]} ({relative[j]:.0%})' for j in bad)} cannot be explained, the other "
            "joints can: look at the unit, the drive gain and the zero of these, and at their axes in the description."
        )
    both = "The fit itself fails" if what == "fit" else "The fit holds, and the held-out data are not explained"
    return (
        f"{both}, on nearly all joints: it may be another robot, another load, a unit of all columns, or gravity in "
        "another direction."
    )
