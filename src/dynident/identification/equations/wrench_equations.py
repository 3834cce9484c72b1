"""Reduce the base's reaction wrench to equations of the dynamic model's base parameters."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.effects import ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, Reduction
from dynident.estimation.nuisance import marginalise_parameters
from dynident.identification.asked import RowOptions
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.types import WRENCH_NAMES
from dynident.regressors.base_wrench import build_wrench_model
from dynident.regressors.equations import reduce_form, stream_equations
from dynident.regressors.model import Model


def build_wrench_equations(
    model: Model,
    rows: RowOptions,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    progress: Progress = ignore_progress,
) -> Reduction:
    """Reduce recordings to six equations in the model's base parameters.

    Parameters that only the wrench shows are fitted to whatever the others are, and eliminated.

    Parameters
    ----------
    model : Model
    rows : RowsAsked
    recordings : sequence of Recording
        With the columns of the wrench.
    preprocessing : Preprocessing
    progress : Progress

    Raises
    ------
    DynidentError
        For an effect that does not show in the base's wrench, a recording without one, or a base parameter that the
        wrench does not determine.
    """
    check_wrench_effects(model)
    check_wrenches(recordings)
    wrench = build_wrench_model(model, tolerance=rows.tolerance)
    if wrench.unseen:
        raise EstimationError(
            f"the base's wrench does not determine {', '.join(wrench.unseen)} of this robot; choose another model",
            pointer="/model",
            title="Not identifiable with this model",
        )
    # The columns of the links need no predicted load, so any reference parameters will do.
    nothing = ReferenceParameters.massless(model.robot)
    reduction = reduce_form(wrench.form, stream_equations, recordings, preprocessing, nothing, progress)
    if reduction.n_rows == 0:
        return reduction.combine_columns(wrench.coordinates[:, wrench.n_extra :])
    # Columns that only the wrench shows come first; they are eliminated so that the rest is in the model's
    # parameters.
    return marginalise_parameters(reduction.combine_columns(wrench.coordinates), wrench.n_extra, weighted=rows.weighted)


def check_wrench_effects(model: Model) -> None:
    """Raise where an effect does not show in the base's wrench."""
    silent_ones = {column.effect for column in model.columns if column.wrench is None}
    for index, choice in enumerate(model.effects):
        if choice.effect in silent_ones:
            raise DynidentError(
                f"{', '.join(sorted(silent_ones))}: not in the base's wrench, which holds the weight and the motion of "
                "the links; what acts between two links, like friction, a motor or a spring, cancels in it. Choose the "
                "effect rigid_body, and payload where some runs carry one, or another model",
                pointer=f"/effects/{index}",
                title="Effects that the base's wrench does not show",
            )


def check_wrenches(recordings: Sequence[Recording]) -> None:
    """Raise where a recording has no wrench of the base."""
    for index, recording in enumerate(recordings):
        if not recording.has_wrench:
            raise DynidentError(
                f"{recording.name} has no wrench of the base: record the columns {', '.join(WRENCH_NAMES)} (force and "
                "moment of the base on the robot, along the base frame's axes, about its origin), or choose another "
                "model",
                pointer=f"/measurement_ids/{index}",
                title="Wrench of the base needed",
            )
