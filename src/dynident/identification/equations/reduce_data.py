"""Recordings reduced to the columns of one model: the data that an identification is solved from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.equations.checks import check_equations
from dynident.identification.equations.model_equations import build_equations
from dynident.identification.problem_options import RowOptions
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model
from dynident.regressors.row_cache import CachedRows, reduce_and_cache


@dataclass(frozen=True, eq=False)
class Data:
    """Recordings reduced to one model's columns, and where they come from.

    Parameters
    ----------
    equations : Reduction
        The rows that the chosen equation type makes of the recordings.
    torque : Reduction
        Rows of the joints' torques, one equation a joint, which errors are reported in whatever the equation type. For
        the dynamic model it is the same object as `equations`.
    recordings : tuple of Recording
        For estimators that go through the samples again.
    preprocessing : Preprocessing
        Filters of the recordings.
    reference : ReferenceParameters
        Parameters that loads and motor torques are predicted with.
    rows : CachedRows or None
        The filtered rows of `torque`, where they are few.
    friction : tuple of Recording
        Tests of single joints' friction, which the strategy separate_friction alone uses.
    """

    equations: Reduction
    torque: Reduction
    recordings: tuple[Recording, ...]
    preprocessing: Preprocessing
    reference: ReferenceParameters
    rows: CachedRows | None = None
    friction: tuple[Recording, ...] = ()

    @property
    def reversal_weights(self) -> FloatArray:
        """Weights (n,) of the rows at reversals; 1 for a joint whose reversals are not told apart."""
        return np.array([1.0 if e.reversal_rows is None else e.reversal_rows.weight for e in self.torque.equations])

    def weighing_turns(self, weights: FloatArray) -> Data:
        """Return the same data with these weights (n,) of the rows at reversals."""
        torque = self.torque.weight_reversals(weights)
        # The dynamic model's equations are the torques, and stay the same object: others test for that.
        return replace(self, torque=torque, equations=torque if self.equations is self.torque else self.equations)


def split_friction_tests(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Split recordings into motions to identify from, and tests of single joints' friction.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of the robot.

    Returns
    -------
    tuple of two tuples of Recording

    Raises
    ------
    DynidentError
        Where there are tests of friction alone.
    """
    # Tests of single joints would count friction twice, and move too little to identify anything else.
    friction = tuple(recording for recording in recordings if recording.role == "friction")
    ordinary = tuple(recording for recording in recordings if recording.role != "friction")
    if friction and not ordinary:
        raise DynidentError(
            "all measurements have the role friction; add at least one motion of the whole robot, or give them another "
            "role",
            pointer="/measurement_ids",
            title="Nothing to identify from",
        )
    return ordinary, friction


def reduce_to_rows(
    model: Model,
    rows: RowOptions,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
) -> Data:
    """Reduce recordings to the rows of the chosen equation type, and to those of the joints' torques.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    rows : RowOptions
        The equation type and its constants.
    recordings : sequence of Recording
        Recordings of the robot.
    preprocessing : Preprocessing
        Filters of the recordings.
    reference : ReferenceParameters
        What torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.
    known : CachedRows, optional
        Rows of a model that this one extends.

    Returns
    -------
    Data
        The data that a model is solved from.

    Raises
    ------
    DynidentError
        Where the model cannot make equations of these columns or recordings.
    """
    ordinary, friction = split_friction_tests(recordings)
    # Other equation types take a second pass over the samples.
    share = 1.0 if rows.model == "dynamic" else 0.5
    # Always reduce the joints' torques as well: errors of all equation types are compared in them.
    data = reduce_torque(model, ordinary, preprocessing, reference, scale_progress(progress, 0.0, share), known)
    data = replace(data, friction=friction)
    if rows.model == "dynamic":
        return data
    equations = build_equations(model, rows, ordinary, preprocessing, reference, scale_progress(progress, share, 1.0))
    # Refused here, where it can still be said that the torques would show what these rows do not.
    check_equations(model, rows.model, equations, data.torque)
    return replace(data, equations=equations)


def reduce_torque(
    model: Model,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
) -> Data:
    """Reduce recordings to the rows of the dynamic model [12.18].

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    recordings : sequence of Recording
        Recordings of the robot.
    preprocessing : Preprocessing
        Filters of the recordings.
    reference : ReferenceParameters
        What torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.
    known : CachedRows, optional
        Rows of a model that this one extends.
    """
    reduction, rows = reduce_and_cache(model, recordings, preprocessing, reference, progress, known)
    return Data(reduction, reduction, tuple(recordings), preprocessing, reference, rows)
