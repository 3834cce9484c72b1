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

    `equations` are the rows that the chosen model makes of those that it was identified from; `training` and `held_out`
    the joints' torques in these and in the validation data, one equation a joint, whatever the model (for the dynamic
    model `training` is `equations`); `shaped` the torques of `training` in the model's columns and, behind them, those
    of `shape_columns`, None where no effect has constants or these cannot be looked at. `preprocessing`: how the
    recordings were filtered; `measurement_names` and `validation_names`: what they are called; `copied`: those of
    the validation data that hold samples of the fit, so that the held-out error is not one; `digests` what the samples
    of the fit are known by, one a recording.
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
        """Return the same data in other columns, which are these times `weights` (b, b').

        `shaped` is left out, as its columns would be others.
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
        """
        return Data(self.equations, self.training, recordings, self.preprocessing, reference)
