"""Information of earlier runs about the parameters, which the next experiment is to complement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.excitation.observation.design_model import DesignModel
from dynident.excitation.request import DesignRequest
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording, choose_preprocessing
from dynident.regressors.filtered_rows import reduce_recordings
from dynident.regressors.qr_accumulation import compute_used_duration


def build_earlier_rows(
    model: DesignModel, recordings: Sequence[Recording], request: DesignRequest, progress: Progress = ignore_progress
) -> FloatArray:
    """Return rows that stand for earlier recordings besides the rows W / √N of one period of a design.

    They have the same WᵀW as all rows of the recordings, in proportion to the length of the new experiment: a minute
    recorded counts as much as a minute designed. Row j of every sample is joint j's.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    recordings : sequence of Recording
        The earlier runs.
    request : DesignRequest
        The design request, which gives the length of the new experiment.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    (m n, b)
        Rows in the units of W / √N.

    Raises
    ------
    DynidentError
        A recording is another robot's, or the experiment is of a kind that earlier runs cannot be added to.
    """
    _check_addable(model, request)
    for recording in recordings:
        if recording.joint_names != model.robot.joint_names:
            raise DynidentError(
                f"{recording.name} has the joints {', '.join(recording.joint_names)}; the robot has "
                f"{', '.join(model.robot.joint_names)}",
                pointer="/earlier_ids",
                title="Another robot's measurement",
            )
    # Filtered as an identification would filter them, so that their rows are worth as much as it will make of them.
    preprocessing = choose_preprocessing(recordings)
    reduction = reduce_recordings(model.observation, recordings, preprocessing, model.reference, progress)
    n, b = model.robot.n, model.n_parameters
    # The triangular factors have the inner products of all rows: a few rows stand for whole recordings.
    rows = np.zeros((max(equation.factors.shape[-1] for equation in reduction.equations), n, b))
    for joint, equation in enumerate(reduction.equations):
        k = len(equation.columns)
        # A joint's equation has some of the columns only. The last column of its factor is the torque, which a design
        # does not use.
        rows[: k + 1, joint, equation.columns] = equation.joint_factor[:, :k]
    seconds = sum(compute_used_duration(recording) for recording in recordings)
    per_second = reduction.n_rows / n / seconds
    equivalent_rows: FloatArray = rows.reshape(-1, b) / np.sqrt(compute_planned_seconds(request) * per_second)
    return equivalent_rows


def _check_addable(model: DesignModel, request: DesignRequest) -> None:
    """Raise `DynidentError` where the rows of earlier runs cannot be added to those of the design."""
    if request.kind == "sequential":
        raise DynidentError(
            "a set of test motions complements itself, not earlier runs; leave the earlier runs out, or choose the "
            'kind "optimized"',
            pointer="/earlier_ids",
        )
    if not model.counted.all():
        raise DynidentError(
            "with locked joints, the parameters are grouped in another way than in earlier runs of all joints; leave "
            "the earlier runs out, or let all joints move",
            pointer="/earlier_ids",
        )
    if request.model != "dynamic":
        raise DynidentError(
            f"earlier runs count beside the rows of the dynamic model; a design for the {request.model} model cannot "
            "take them into account",
            pointer="/earlier_ids",
        )


def compute_planned_seconds(request: DesignRequest) -> float:
    """Return the requested duration of the exciting part, s; the design may last longer or shorter."""
    trajectory = request.trajectory
    return float(trajectory.duration * trajectory.periods * sum(1.0 / pace for pace in trajectory.paces))
