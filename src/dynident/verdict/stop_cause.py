"""Find the most probable cause where a model is not to be used at all (wrong columns, signs, units, …)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.diagnosis.comparison.data_leakage import DataOverlap
from dynident.errors import Remedy
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.recording_faults import CAUSES, check_recording_faults
from dynident.identification.thresholds import LARGEST_CONDITION_NUMBER, OVERFIT, STOP
from dynident.number_format import format_percent
from dynident.recordings import Check, Recording, Revision
from dynident.robot import Robot


@dataclass(frozen=True)
class Stop:
    """The most probable cause of a gross fault.

    Parameters
    ----------
    cause : str
        The cause, in a sentence or two.
    recording : str or None
        Name of the recording that shows it; None where it is no single one.
    apply : Revision or None
        Change of the metadata that cures that recording, where it is known.
    records_more : bool
        Whether nothing is wrong but that the data determine too little.
    remedies : tuple of Remedy
        Those that the cause quotes.
    """

    cause: str
    recording: str | None = None
    apply: Revision | None = None
    records_more: bool = False
    remedies: tuple[Remedy, ...] = ()


def is_hopeless(errors: Errors | None) -> bool:
    """Tell whether an error is so large that the model is not to be used.

    Parameters
    ----------
    errors : Errors or None
        Errors of the fit or on held-out data.

    Returns
    -------
    bool
        False where there are no errors to judge by.
    """
    # Written with `not`, so that an error that is no number counts as too large.
    return errors is not None and bool(errors.counts.any()) and not errors.relative_total <= STOP


def find_stop_cause(
    identification: Identification,
    fitted: Sequence[Recording],
    held_out: Sequence[Recording],
    common: Sequence[DataOverlap],
) -> Stop | None:
    """Find the most probable cause for which a model is not to be used; None where it may be used.

    Causes are looked for in the order of what they usually cost: content, columns, then what only a person can see.

    Parameters
    ----------
    identification : Identification
        The identified model.
    fitted : sequence of Recording
        Data of the fit.
    held_out : sequence of Recording
        Held-out data.
    common : sequence of DataOverlap
        What the two share.

    Returns
    -------
    Stop or None
        The cause; None where the model may be used.
    """
    copied = next((overlap for overlap in common if overlap.kind == "copied"), None)
    if copied is not None:
        return Stop(str(copied), copied.held_out)
    if not is_hopeless(identification.held_out) and not is_hopeless(identification.fit):
        return None
    error, data_name = _select_worst_errors(identification)
    robot = identification.model.robot
    # Where only held-out data fail, the fault is most probably in one of them.
    for recording in (*held_out, *fitted) if data_name == "held out" else fitted:
        cause = _find_failed_check(robot, recording)
        if cause is not None:
            return cause
    # If the joints are explained while they move, columns and units are right, and the rows at rest are to blame.
    moving = identification.held_out_moving if data_name == "held out" else identification.fit_moving
    if moving is not None and moving.counts.any() and moving.relative_total <= STOP:
        return Stop(
            f"The model does not explain {format_percent(error.relative_total, decimals=0)} of the torque on all rows, "
            f"but only {format_percent(moving.relative_total, decimals=0)} where the joints move: the fault is in the "
            "rows at standstill. Engaged brakes or drives that are off make the torque there meaningless: leave these "
            "seconds out."
        )
    if (
        data_name == "held out"
        and identification.fit.relative_total * OVERFIT < error.relative_total
        and (_are_most_joints_bad(error) or identification.equilibrated_condition_number > LARGEST_CONDITION_NUMBER)
    ):
        return Stop(
            f"The model leaves {format_percent(identification.fit.relative_total, decimals=0)} of the torque "
            f"unexplained in the fit, but {format_percent(error.relative_total, decimals=0)} on the held-out data. "
            "Columns and units are right, because the fit is good: either its motion does not determine the "
            "parameters that the held-out data need, or the held-out data have another load. Record a designed "
            "motion.",
            records_more=True,
        )
    return Stop(_word_by_joints(robot, moving if moving is not None and moving.counts.any() else error, data_name))


def _are_most_joints_bad(error: Errors) -> bool:
    """Return whether most joints are bad: a single bad joint would point at its own column, if its motion is enough."""
    relative = error.relative[error.counts > 0]
    return bool((relative > STOP).mean() > 0.5)


def _select_worst_errors(identification: Identification) -> tuple[Errors, str]:
    fit, held_out = identification.fit, identification.held_out
    if held_out is not None and is_hopeless(held_out) and not is_hopeless(fit):
        return held_out, "held out"
    return fit if is_hopeless(fit) or held_out is None else held_out, "fit"


def _find_failed_check(robot: Robot, recording: Recording) -> Stop | None:
    """Return the gravest finding of the checks that hold a recording against the robot's dynamics."""
    n = recording.n
    # The names of the columns do not matter here, they only appear in the words of the checks.
    checks = check_recording_faults(
        robot, recording, [f"q{k + 1}" for k in range(n)], [f"tau{k + 1}" for k in range(n)]
    ).checks
    failed_checks = sorted(
        (check for check in checks if check.name in CAUSES and check.status != "ok"), key=_get_severity
    )
    if not failed_checks:
        return None
    gravest = failed_checks[0]
    return Stop(f"In {recording.name}: {gravest.detail}", recording.name, gravest.apply, remedies=gravest.remedies)


def _get_severity(check: Check) -> bool:
    # Errors sort before warnings; among equals the order of the checks stays.
    return check.status != "error"


def _word_by_joints(robot: Robot, error: Errors, data_name: str) -> str:
    names = robot.joint_names
    relative = np.where(error.counts > 0, error.relative, 0.0)
    worst = int(np.argmax(relative))
    bad = [j for j in range(len(names)) if relative[j] > STOP]
    data_words = "the data of the fit" if data_name == "fit" else "held-out data"
    if len(bad) < len(names) and relative[worst] > STOP:
        return (
            f"On {data_words} the model does not explain "
            f"{', '.join(f'{names[j]} ({format_percent(relative[j], decimals=0)})' for j in bad)}, but it explains the "
            "other joints: check the unit, the drive gain and the zero position of these joints, and their axes in "
            "the description."
        )
    both = (
        "The model does not explain the data of the fit"
        if data_name == "fit"
        else "The model explains the data of the fit but not the held-out data"
    )
    return (
        f"{both}, on nearly all joints: the cause may be another robot, another load, a wrong unit of all columns, "
        "or a wrong direction of gravity."
    )
