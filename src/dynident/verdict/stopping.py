"""Why a model is not to be used at all: the most probable of the gross mistakes, and what would cure it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.diagnosis.comparing.content import Common
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.mistakes import mistakes_in
from dynident.identification.mistakes.checks import revision_of, told_of
from dynident.identification.thresholds import STOP
from dynident.recordings import Recording, Revision
from dynident.robot import Robot

SCALED = 5.0
"""Times the measured torque by which a prediction is off from which on it is a unit or a gain."""


@dataclass(frozen=True)
class Stop:
    """The most probable cause of a gross mistake; `apply` cures the recording of that name, where that is known."""

    cause: str
    recording: str | None = None
    apply: Revision | None = None


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
        cured = _by_columns(robot, recording)
        if cured is not None:
            return cured
    return Stop(_by_joints(robot, error, what))


def _worst(found: Identification) -> tuple[Errors, str]:
    if found.held_out is not None and tells_stop(found.held_out) and not tells_stop(found.fit):
        return found.held_out, "held out"
    return found.fit if tells_stop(found.fit) or found.held_out is None else found.held_out, "fit"


def _by_columns(robot: Robot, recording: Recording) -> Stop | None:
    told = mistakes_in(robot, recording)
    if told is None or not told[0]:
        return None
    first = told[0][0]
    n = recording.n
    words = told_of(first.mistake, recording, [f"q{k + 1}" for k in range(n)], [f"tau{k + 1}" for k in range(n)])
    return Stop(
        f"In {recording.name} it seems that {words}: as it is, {first.left_with:.0%} of an average joint's torque "
        f"cannot be explained by the robot's dynamics, put right {first.left_without:.0%}.",
        recording.name,
        revision_of(first.mistake, n),
    )


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
