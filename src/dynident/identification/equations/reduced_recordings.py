"""Recordings reduced to the columns of one model (`ReducedData`), of the fit and held-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.equations.filtered_energy_power_wrench import build_equations
from dynident.identification.equations.model_and_data_checks import check_equations
from dynident.identification.estimation_problem_options import RowOptions
from dynident.parallel import Deferring
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Preprocessing, Recording, filtered_blocks
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import CachedRows, reduce_and_cache
from dynident.simulation.true_effects import has_bent_friction


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
    speeds : (n,), optional
        Largest speed of each joint in the recordings, in rad/s or m/s, where friction bends with the speed.
    """

    equations: Reduction
    torque: Reduction
    recordings: tuple[Recording, ...]
    preprocessing: Preprocessing
    reference: ReferenceParameters
    rows: CachedRows | None = None
    friction: tuple[Recording, ...] = ()
    speeds: FloatArray | None = None

    @property
    def inputs(self) -> RegressorInputs:
        """What the rows were made of, for estimators that make other rows of it."""
        return RegressorInputs(self.recordings, self.preprocessing, self.reference)

    @property
    def reversal_weights(self) -> FloatArray:
        """Weights (n,) of the rows at reversals; 1 for a joint whose reversals are not told apart."""
        return np.array([1.0 if e.weighted_rows is None else e.weighted_rows.weight for e in self.torque.equations])

    def weighing_turns(self, weights: FloatArray) -> Data:
        """Return the same data with these weights (n,) of the rows at reversals."""
        torque = self.torque.weight_groups(weights)
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
            pointer="/recordings",
            title="Nothing to identify from",
        )
    return ordinary, friction


def reduce_to_rows(
    model: Model,
    rows: RowOptions,
    inputs: RegressorInputs,
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
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
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
    ordinary, friction = split_friction_tests(inputs.recordings)
    # Other equation types take a second pass over the samples.
    share = 1.0 if rows.model == "dynamic" else 0.5
    # Always reduce the joints' torques as well: errors of all equation types are compared in them.
    inputs = replace(inputs, recordings=ordinary)
    # Speeds of bent friction take a pass over the positions alone.
    start = 0.1 * share if has_bent_friction(choice.effect for choice in model.effects) else 0.0
    # The joints' fastest motion may be in tests of their friction.
    whole = replace(inputs, recordings=(*ordinary, *friction))
    speeds = find_largest_speeds(model, whole, scale_progress(progress, 0.0, start))
    data = reduce_torque(model, inputs, scale_progress(progress, start, share), known)
    data = replace(data, friction=friction, speeds=speeds)
    if rows.model == "dynamic":
        return data
    equations = build_equations(model, rows, inputs, scale_progress(progress, share, 1.0))
    # Refused here, where it can still be said that the torques would show what these rows do not.
    check_equations(model, rows.model, equations, data.torque)
    return replace(data, equations=equations)


def find_largest_speeds(
    model: Model, inputs: RegressorInputs, progress: Progress = ignore_progress
) -> FloatArray | None:
    """Return the largest filtered speed (n,) of each joint; None for a model whose friction is a straight line."""
    if not has_bent_friction(choice.effect for choice in model.effects):
        return None
    largest = np.zeros(model.robot.n)
    for k, recording in enumerate(inputs.recordings):
        for block in filtered_blocks(recording, inputs.preprocessing):
            progress(k / len(inputs.recordings), "finding the largest speeds")
            largest = np.maximum(largest, np.abs(block.dq[block.used]).max(axis=0, initial=0.0))
    return largest


def reduce_torque(
    model: Model,
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
) -> Data:
    """Reduce recordings to the rows of the dynamic model [12.18].

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.
    known : CachedRows, optional
        Rows of a model that this one extends.
    """
    reduction, rows = reduce_and_cache(model, inputs, progress, known)
    return Data(reduction, reduction, tuple(inputs.recordings), inputs.preprocessing, inputs.reference, rows)


@dataclass(frozen=True, eq=False)
class ReducedData(Deferring):
    """Filtered recordings as factors of W in the columns of an identified model.

    Parameters
    ----------
    equations : Reduction
        The rows that the chosen equation type makes of the recordings that the model was identified from.
    training : Reduction
        The joints' torques in the same recordings, one equation a joint, whatever the equation type. For the dynamic
        model it is the same object as `equations`.
    held_out : Reduction or None
        The joints' torques in the held-out recordings.
    shaped : Reduction or None
        The torques of `training` in the model's columns and, behind them, those of the shape constants
        (`shapes.shape_columns`). None where no effect has constants or these cannot be looked at; may be deferred.
    preprocessing : Preprocessing
        How the recordings were filtered.
    measurement_names : tuple of str
        Names of the recordings of the fit.
    validation_names : tuple of str
        Names of the held-out recordings.
    copied : tuple of str
        Held-out recordings that hold samples of the fit, so that the held-out error is none.
    digests : tuple of str
        Digests of the samples of the fit, one a recording.
    speeds : (n,), optional
        Largest speed of each joint in the recordings of the fit, in rad/s or m/s, where friction bends with the speed;
        None for other models, and those of earlier files.
    from_commands : bool
        Whether torques were computed from the commands of servos.
    """

    equations: Reduction
    training: Reduction
    held_out: Reduction | None
    shaped: Reduction | None
    preprocessing: Preprocessing
    measurement_names: tuple[str, ...] = ()
    validation_names: tuple[str, ...] = ()
    copied: tuple[str, ...] = ()
    digests: tuple[str, ...] = ()
    speeds: FloatArray | None = None
    from_commands: bool = False

    def __repr__(self) -> str:
        held_out = ", ".join(self.validation_names) or "nothing"
        return f"ReducedData({', '.join(self.measurement_names)}; held out {held_out}; {self.training})"

    @property
    def is_fitted_to_torque(self) -> bool:
        """Whether the equations are those of the joints' torques, as those of the dynamic model are."""
        return self.equations is self.training

    def combine_columns(self, weights: FloatArray) -> ReducedData:
        """Return the same data in other columns.

        `shaped` is left out, as its columns would be others.

        Parameters
        ----------
        weights : (b, b')
            The other columns are these times the weights.

        Returns
        -------
        ReducedData
            The data in b' columns.
        """
        # The equations of the dynamic model must stay the same object as the torques: others test for identity.
        training = self.training.combine_columns(weights)
        return replace(
            self,
            equations=training if self.is_fitted_to_torque else self.equations.combine_columns(weights),
            training=training,
            held_out=None if self.held_out is None else self.held_out.combine_columns(weights),
            shaped=None,
        )

    def to_data(self, reference: ReferenceParameters, recordings: tuple[Recording, ...] = ()) -> Data:
        """Return the data that a model is solved from.

        Parameters
        ----------
        reference : ReferenceParameters
            What the torque in the columns was predicted with.
        recordings : tuple of Recording, optional
            For estimators that go through the samples again.

        Returns
        -------
        Data
            The same equations, with what some estimators need beside them.
        """
        return Data(self.equations, self.training, recordings, self.preprocessing, reference, speeds=self.speeds)
