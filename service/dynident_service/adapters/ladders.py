"""Ladders of models as views, and the comparison of two ladders step by step."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import TypeVar

import numpy as np

from dynident.identification import Identification
from dynident.identification.study.model_selection import find_best_of_errors
from dynident_service.adapters.identifications import show_fit
from dynident_service.adapters.serialise import to_view
from dynident_service.models.common import EffectChoice
from dynident_service.models.identifications import ErrorsView, IdentificationView, Lineage, Rung, RungDifference

T = TypeVar("T", int, float)


def build_steps_of_views(views: Sequence[IdentificationView]) -> list[Rung]:
    """Build the steps of a ladder of stored models, the first one first, with the intermediate ones of extensions."""
    rungs: list[Rung] = []
    for view in views:
        # An extension by several effects has made models on its way, which are steps as well.
        rungs += _build_intermediate_steps(view, rungs[-1] if rungs else None)
        rungs.append(_build_own_step(view, rungs[-1] if rungs else None))
    return mark_best_step(rungs)


def mark_best_step(rungs: Sequence[Rung]) -> list[Rung]:
    """Return a ladder with its best step marked, and the later steps that increase the validation error."""
    totals = [rung.validation.relative_total for rung in rungs if rung.validation is not None]
    known_totals = [total for total in totals if total is not None]
    # Only where every step has a validation error: a step without one could be the best.
    marks = find_best_of_errors(known_totals) if len(known_totals) == len(rungs) else None
    if marks is None:
        return list(rungs)
    return [
        rung.model_copy(update={"best": k == marks.best, "rises": k in marks.rises}) for k, rung in enumerate(rungs)
    ]


def _build_intermediate_steps(view: IdentificationView, below: Rung | None) -> list[Rung]:
    """Build the steps between a model and its parent; an extension by several effects has one for each."""
    rungs: list[Rung] = []
    for number, step in enumerate(view.result.rungs if view.result is not None else [], start=1):
        under = rungs[-1] if rungs else below
        rung = Rung(
            id=f"{view.id}/{number}",
            part_of=view.id,
            name=view.name,
            parent_id=None if under is None else under.id,
            status=view.status,
            added=step.added,
            removed=[],
            effects=[*([] if under is None else under.effects), *step.added],
            n_parameters=step.n_parameters,
            residual=step.residual,
            validation=step.validation,
        )
        rungs.append(rung)
    return rungs


def _build_own_step(view: IdentificationView, below: Rung | None) -> Rung:
    result = view.result
    effects = view.request.effects if result is None else result.effects
    return Rung(
        id=view.id,
        name=view.name,
        parent_id=view.parent_id if below is None else below.id,
        status=view.status,
        added=_last_added(view, effects, below),
        removed=view.removed,
        effects=effects,
        n_parameters=None if result is None else len(result.parameters),
        residual=None if result is None else result.residual,
        validation=None if result is None else result.validation,
    )


def _last_added(view: IdentificationView, effects: list[EffectChoice], below: Rung | None) -> list[EffectChoice]:
    """Return what the last step added, with the shape constants that were found."""
    # The steps below have the first of the requested effects; the rest of the list is new at this step.
    if not view.added or view.result is None or below is None:
        return view.added
    return effects[len(below.effects) :]


def compare_ladders(own: Sequence[Rung], other: Sequence[Rung], same_data: bool) -> Lineage:
    """Compare two ladders.

    Parameters
    ----------
    own, other : sequence of Rung
        The ladders, their first models first.
    same_data : bool
        Whether all their models rest on the same recordings.

    Returns
    -------
    Lineage
        Both ladders, their last common model, and the differences of errors step by step.
    """
    # Ladders of one robot may begin with the same models: the last pair of equal ids is where they part.
    shared = [a.id for a, b in zip(own, other, strict=False) if a.id == b.id]
    return Lineage(
        items=list(own),
        against=list(other),
        common_ancestor=shared[-1] if shared else None,
        differences=[_show_difference(k, a, b) for k, (a, b) in enumerate(zip_longest(own, other), start=1)],
        same_data=same_data,
    )


def _show_difference(number: int, own: Rung | None, other: Rung | None) -> RungDifference:
    fit = (own.residual if own else None, other.residual if other else None)
    held_out = (own.validation if own else None, other.validation if other else None)
    counts = (own.n_parameters if own else None, other.n_parameters if other else None)
    return RungDifference(
        rung=number,
        id=own.id if own else None,
        against_id=other.id if other else None,
        n_parameters=_subtract(*counts),
        residual=_subtract_per_joint(*fit),
        residual_total=_subtract_totals(*fit),
        validation=_subtract_per_joint(*held_out),
        validation_total=_subtract_totals(*held_out),
    )


def _subtract_per_joint(own: ErrorsView | None, other: ErrorsView | None) -> list[float | None] | None:
    if own is None or other is None:
        return None
    return [_subtract(a, b) for a, b in zip(own.relative, other.relative, strict=True)]


def _subtract_totals(own: ErrorsView | None, other: ErrorsView | None) -> float | None:
    return None if own is None or other is None else _subtract(own.relative_total, other.relative_total)


def _subtract(a: T | None, b: T | None) -> T | None:
    return None if a is None or b is None else a - b


def build_steps(
    identification: Identification, name: str, other_ladder: tuple[Identification, str] | None = None
) -> list[Rung]:
    """Build the steps of a ladder from a model in a file.

    Parameters
    ----------
    identification : Identification
        The last model of the ladder.
    name : str
        Its name; the models before it are called name/1, name/2, ….
    other_ladder : tuple of Identification and str, optional
        Another ladder and its name. Steps at which both have the same model take the other ladder's ids, so that
        `compare_ladders` sees what they share.

    Returns
    -------
    list of Rung
        The steps, the first model first.
    """
    models = list(identification.ladder())
    ids = _step_ids(name, len(models))
    if other_ladder is not None:
        others = list(other_ladder[0].ladder())
        for k, (model, other) in enumerate(zip(models, others, strict=False)):
            # Models in files have no ids: they are the same if their choices and all their values are.
            if model.choices != other.choices or not np.array_equal(model.values, other.values):
                break
            ids[k] = _step_ids(other_ladder[1], len(others))[k]
    rungs = [
        to_view(
            Rung,
            model,
            id=identifier,
            name=identifier,
            parent_id=ids[k - 1] if k else None,
            status="succeeded",
            residual=show_fit(model),
        )
        for k, (identifier, model) in enumerate(zip(ids, models, strict=True))
    ]
    return mark_best_step(rungs)


def _step_ids(name: str, count: int) -> list[str]:
    return [*(f"{name}/{k}" for k in range(1, count)), name]
