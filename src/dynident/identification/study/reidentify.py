"""Solve an identified model again with other choices, from its reduced data: no recording is read again."""

from __future__ import annotations

from dataclasses import replace

from dynident.blas_threads import single_threaded
from dynident.errors import DynidentError
from dynident.identification.choices import IdentificationChoices
from dynident.identification.methods.bases import ESTIMATORS, STRATEGIES
from dynident.identification.study.fit_model import SubmodelRelation, finalise_identification
from dynident.identification.study.removing import build_submodel, combine_shapes
from dynident.identification.study.result import NONE_IN_MEMORY, Identification

_TITLE = "Recordings needed"


@single_threaded
def reidentify(identification: Identification, choices: IdentificationChoices) -> Identification:
    """Solve an identified model again with another strategy, estimator, prior or fewer effects.

    Predicted loads stay those that the data were reduced with.

    Parameters
    ----------
    identification : Identification
        The model to solve again, with its reduced data.
    choices : IdentificationChoices
        The model's rows and their constants must be the same, and its effects a part of the old ones.

    Returns
    -------
    Identification
        Solved from the same reduced data.

    Raises
    ------
    DynidentError
        Where the choices need more than the reduced data: other rows or filters, effects that are not in them, or an
        estimator or strategy that goes through the samples again.
    """
    check_reduced_data(identification, choices)
    known = identification.model
    model, part, data = known, None, identification.data
    if choices.effects != known.effects:
        model, weights = build_submodel(known, choices.effects, choices.tolerance)
        part, data = SubmodelRelation(known, weights), data.combine_columns(weights)
    # Fewer effects need no new rows: the smaller model's columns are linear combinations of those that the reduced
    # data hold.
    shaped = combine_shapes(identification, model.effects, None if part is None else part.weights)
    # The filters are those that the reduced data went through, whatever the choices leave open.
    chosen = replace(choices, preprocessing=identification.choices.preprocessing)
    identified = finalise_identification(
        model, chosen, data.to_data(identification.estimate.reference), data, part, lambda _: shaped
    )
    # Rows in memory belong to the columns of the larger model, so a smaller one starts without any.
    return replace(identified, in_memory=identification.in_memory if part is None else NONE_IN_MEMORY)


def check_reduced_data(identification: Identification, choices: IdentificationChoices) -> None:
    """Raise where choices need more than the reduced data of an identification.

    Parameters
    ----------
    identification : Identification
        The identified model.
    choices : IdentificationChoices
        The choices to solve it again with.

    Raises
    ------
    DynidentError
        Names the choice that needs the recordings, and what is possible without them.
    """
    old = identification.choices
    if (choices.model, choices.pole, choices.interval) != (old.model, old.pole, old.interval):
        raise _recordings_needed_error("/model", f"the reduced data are rows of the {old.model} model")
    if old.model == "base_wrench" and choices.solver.weighted != old.solver.weighted:
        raise _recordings_needed_error(
            "/estimator", "what the wrench alone shows was taken out with the other estimator's weights"
        )
    if not choices.solver.from_reduced:
        able = ", ".join(ESTIMATORS.names_with("from_reduced"))
        reason = f"{choices.solver.name} goes through the samples again; from reduced data there are {able}"
        raise _recordings_needed_error("/estimator", reason)
    if not choices.plan.from_reduced:
        able = ", ".join(STRATEGIES.names_with("from_reduced"))
        reason = f"{choices.strategy} needs runs of single joints; from reduced data there are {able}"
        raise _recordings_needed_error("/strategy", reason)
    if choices.preprocessing not in (None, old.preprocessing, identification.preprocessing):
        raise _recordings_needed_error("/preprocessing", "the reduced data were filtered otherwise")


def _recordings_needed_error(pointer: str, why: str) -> DynidentError:
    return DynidentError(f"{why}; identify from the recordings for that", pointer=pointer, title=_TITLE)
