"""The recordings of an identification reduced to factors: all that later steps need instead of the recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import Reduction
from dynident.identification.equations.reduce_data import Data
from dynident.recordings import Preprocessing, Recording


@dataclass(frozen=True, eq=False)
class ReducedData:
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
        (`shapes.shape_columns`). None where no effect has constants or these cannot be looked at.
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

    def __repr__(self) -> str:
        held_out = ", ".join(self.validation_names) or "nothing"
        return f"ReducedData({', '.join(self.measurement_names)}; held out {held_out}; {self.training})"

    @property
    def is_fitted_to_torque(self) -> bool:
        """Whether the equations are those of the joints' torques, as those of the dynamic model are."""
        return self.equations is self.training

    @property
    def has_equal_weights(self) -> bool:
        """Whether the equations are rows of the joints' torques, of which none counts for less than others."""
        reversals = [
            equation.reversal_rows for equation in self.training.equations if equation.reversal_rows is not None
        ]
        return self.is_fitted_to_torque and all(rows.weight == 1.0 for rows in reversals)

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
        return Data(self.equations, self.training, recordings, self.preprocessing, reference)
