"""Direct and cross validation: prediction errors on recordings of the fit and on others (§12.7).

They pass by identification/thresholds.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.equations.reduced_recordings import reduce_torque
from dynident.identification.thresholds import LARGEST_ERROR, LARGEST_OF_JOINT, OVERFIT, ValidationOutcome
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording
from dynident.regressors.errors_by_phase import compute_errors_by_phase, select_judged_errors
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.schema.fields import check_value
from dynident.validation.validation_request import LimitedTrial


@dataclass(frozen=True, eq=False)
class RecordingErrors:
    """Errors of a model on one recording, on the joints' filtered torques.

    Parameters
    ----------
    name : str
        Name of the recording.
    errors : Errors
        Errors on all rows.
    moving : Errors
        Errors on the rows where each joint moves.
    """

    name: str
    errors: Errors
    moving: Errors


@dataclass(frozen=True, eq=False)
class TorqueValidation:
    """Errors on every recording and on all together.

    Parameters
    ----------
    recordings : tuple of RecordingErrors
        Errors of each recording.
    total : Errors
        Errors on all rows of all recordings.
    total_moving : Errors
        Errors on the rows of all recordings where each joint moves.
    limit : float
        Largest relative error over all joints that passes.
    judged : ValidationOutcome
        The errors judged against the limit, and the reason.
    """

    recordings: tuple[RecordingErrors, ...]
    total: Errors
    total_moving: Errors
    limit: float
    judged: ValidationOutcome


@single_threaded
def validate_direct(
    identification: Identification,
    recordings: Sequence[Recording],
    limit: float = LARGEST_ERROR,
    progress: Progress = ignore_progress,
) -> TorqueValidation:
    """Compute the torque error on the recordings that the model was identified from.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Those that the model was identified from.
    limit : float
        Largest relative error over all joints that passes.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    TorqueValidation
        The errors, judged against the limit.

    Raises
    ------
    DynidentError
        For a limit that is not above zero, or no recording at all.
    """
    return _validate_torque(identification, recordings, limit, "the identification's own data", progress)


@single_threaded
def validate_cross(
    identification: Identification,
    recordings: Sequence[Recording],
    limit: float = LARGEST_ERROR,
    progress: Progress = ignore_progress,
) -> TorqueValidation:
    """Compute the torque error on recordings that were not used for the identification.

    The validation also fails where the error is much larger than that of the fit: then the data did not determine the
    model.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings that no parameter was fitted to.
    limit : float
        Largest relative error over all joints that passes.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    TorqueValidation
        The errors, judged against the limit and against those of the fit.

    Raises
    ------
    DynidentError
        For a limit that is not above zero, or no recording at all.
    """
    validation = _validate_torque(identification, recordings, limit, "held-out data", progress)
    # A slower motion has less torque, and the same residual is a larger share of it. So the residual itself has to have
    # grown as well.
    errors, fit = select_judged_errors(validation.total_moving, validation.total), identification.fit_judged
    error, own = errors.relative_total, fit.relative_total
    if (
        validation.judged.verdict != "pass"
        or error <= OVERFIT * own
        or not bool(np.any(errors.rms > OVERFIT * fit.rms))
    ):
        return validation
    judged = ValidationOutcome(
        "fail",
        f"The error is {format_percent(error, decimals=1)} on held-out data and {format_percent(own, decimals=1)} in "
        "the fit: the motion of the identification does not determine the model, or this motion shows an effect that "
        "the other did not show.",
    )
    return replace(validation, judged=judged)


def _validate_torque(
    identification: Identification, recordings: Sequence[Recording], limit: float, on_what: str, progress: Progress
) -> TorqueValidation:
    # Squares are added up, not relative errors: long recordings count for more.
    each = _compute_errors_by_recording(identification, recordings, limit, progress)
    total = _add_errors([recording_errors.errors for recording_errors in each])
    moving = _add_errors([recording_errors.moving for recording_errors in each])
    return TorqueValidation(each, total, moving, limit, _judge_errors(identification, total, moving, limit, on_what))


def _compute_errors_by_recording(
    identification: Identification, recordings: Sequence[Recording], limit: float, progress: Progress
) -> tuple[RecordingErrors, ...]:
    # Before the recordings are read, which may take minutes.
    check_value(LimitedTrial, "limit", limit)
    if not recordings:
        raise DynidentError("give at least one recording to validate on", pointer="/recordings")
    recording_errors = []
    for index, recording in enumerate(recordings):
        share = scale_progress(progress, index / len(recordings), (index + 1) / len(recordings))
        data = reduce_torque(
            identification.model,
            RegressorInputs([recording], identification.preprocessing, identification.estimate.reference),
            share,
        )
        values = identification.values
        errors = compute_errors_by_phase(data.torque, values)
        recording_errors.append(RecordingErrors(recording.name, errors.all_rows, errors.moving))
    return tuple(recording_errors)


def _add_errors(each: Sequence[Errors]) -> Errors:
    return Errors(*(np.sum([getattr(summand, name) for summand in each], axis=0) for name in _SUMMED))


_SUMMED = ("squares", "measured", "counts")


def _judge_errors(
    identification: Identification, total: Errors, moving: Errors, limit: float, on_what: str
) -> ValidationOutcome:
    names = identification.model.robot.joint_names
    if not total.counts.any():
        return ValidationOutcome(
            "not_evaluated", "No samples are left inside the windows and away from the ends of the segments."
        )
    error_total = select_judged_errors(moving, total).relative_total
    # A joint that never moves is judged on all its rows: there is nothing else of it.
    relative = np.where(moving.counts > 0, moving.relative, total.relative)
    useless = [
        f"{name} ({format_percent(relative[j], decimals=0)})"
        for j, name in enumerate(names)
        if relative[j] > LARGEST_OF_JOINT
    ]
    worst = int(np.argmax(relative))
    error = f"The torque error on {on_what} is {format_percent(error_total, decimals=1)}"
    largest = f"largest on {names[worst]}, {format_percent(float(relative[worst]), decimals=1)}"
    if error_total > limit:
        return ValidationOutcome(
            "fail",
            f"{error}, above the limit of {format_percent(limit, 2)}; {largest}.",
        )
    if useless:
        most = format_percent(LARGEST_OF_JOINT, decimals=0)
        return ValidationOutcome("fail", f"{error}, but above {most} where it moves on {', '.join(useless)}.")
    return ValidationOutcome(
        "pass",
        f"{error}, within the limit of {format_percent(limit, 2)}; {largest}.",
    )
