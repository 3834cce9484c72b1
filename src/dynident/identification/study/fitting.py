"""Identify the parameters of a model that is built already, with everything decided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters
from dynident.estimation import Reduction
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.data import reduce_to_rows, reduce_torque
from dynident.identification.shapes.shape_columns import build_shape_columns, list_shape_variables
from dynident.identification.study.concluding import finalise_identification
from dynident.identification.study.in_memory import NONE_IN_MEMORY, RowsInMemory
from dynident.identification.study.reduced_data import ReducedData
from dynident.identification.study.result import Identification
from dynident.progress import Progress, scale_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model
from dynident.regressors.rows import reduce_with_columns


def identify_model(
    model: Model,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    choices: IdentificationChoices,
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    progress: Progress,
    known: RowsInMemory = NONE_IN_MEMORY,
) -> Identification:
    """Identify the parameters of a model that is built already, with everything decided.

    Parameters
    ----------
    model : Model
    recordings, validation : sequence of Recording
        Data that parameters are fitted to, and data that no parameter sees.
    choices : IdentificationChoices
    preprocessing : Preprocessing
        Filters for all recordings.
    reference : ReferenceParameters
        What torque is predicted with; any where no effect needs the load.
    progress : Progress
    known : RowsInMemory, optional
        Of a model that this one extends, for the same recordings and validation data.

    Returns
    -------
    Identification

    Raises
    ------
    DynidentError
        Where the data do not determine the parameters.
    """
    # Progress by the number of recordings: reducing them takes nearly all of the time.
    share = 0.9 * len(recordings) / (len(recordings) + len(validation))
    training = reduce_to_rows(
        model,
        choices.row_options,
        recordings,
        preprocessing,
        reference,
        scale_progress(progress, 0.0, share),
        known.training,
    )
    held_out = None
    if validation:
        held_out = reduce_torque(
            model, validation, preprocessing, reference, scale_progress(progress, share, 0.9), known.held_out
        )
    progress(0.9, "solving")
    solve_progress = scale_progress(progress, 0.9, 1.0)

    def reduce_shapes(values: FloatArray) -> Reduction | None:
        places = list_shape_variables(model.effects)
        if not places:
            return None
        columns = build_shape_columns(model, values, places)
        ordinary = training.recordings
        return reduce_with_columns(model, columns, ordinary, preprocessing, reference, solve_progress, training.rows)

    data = ReducedData(
        training.equations,
        training.torque,
        # Held-out errors count every row alike, so that they can be compared between models with other weights.
        None if held_out is None else held_out.torque.with_fixed_weights,
        None,
        preprocessing,
        tuple(recording.name for recording in recordings),
        tuple(recording.name for recording in validation),
    )
    identified = finalise_identification(model, choices, training, data, shaped=reduce_shapes)
    return replace(identified, in_memory=RowsInMemory(training.rows, None if held_out is None else held_out.rows))
