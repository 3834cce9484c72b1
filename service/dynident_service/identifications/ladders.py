"""Views of ladders: their steps from stored models and from files, in words and as tables, and two of them compared."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import TypeVar

import numpy as np

from dynident.identification import Identification
from dynident.identification.identified_models.held_out_gain import find_best_of_errors, list_confirming_rows
from dynident.presentation.ladder_tables import (
    Step,
    build_ladder_joint_table,
    build_ladder_table,
    build_two_ladders_table,
    describe_last_step,
)
from dynident_service.identifications.wire_types import (
    ErrorFigures,
    ErrorsView,
    IdentificationView,
    LadderStep,
    LadderStepDifference,
    Lineage,
    StepSentence,
)
from dynident_service.shared.field_by_field import from_wire_choices, show_errors, show_tables, to_view
from dynident_service.shared.wire_types import EffectChoice

T = TypeVar("T", int, float)


def build_steps_of_views(views: Sequence[IdentificationView]) -> list[LadderStep]:
    """Build the steps of a ladder of stored models, the first one first, with the intermediate ones of extensions."""
    steps: list[LadderStep] = []
    for view in views:
        # An extension by several effects has made models on its way, which are steps as well.
        steps += _build_intermediate_steps(view, steps[-1] if steps else None)
        steps.append(_build_own_step(view, steps[-1] if steps else None))
    return mark_best_step(steps)


def mark_best_step(steps: Sequence[LadderStep]) -> list[LadderStep]:
    """Return a ladder with its best step marked, and the later steps that increase the validation error."""
    totals = [None if step.validation is None else select_judged(step.validation).relative_total for step in steps]
    known_totals = [total for total in totals if total is not None]
    preferred = [bool(step.confirmed_by or step.removed) for step in steps]
    # Only where every step has a validation error: a step without one could be the best.
    marks = find_best_of_errors(known_totals, preferred) if len(known_totals) == len(steps) else None
    if marks is None:
        return list(steps)
    return [
        step.model_copy(update={"best": k == marks.best, "rises": k in marks.rises}) for k, step in enumerate(steps)
    ]


def select_judged(errors: ErrorsView) -> ErrorFigures:
    """Return the errors that models are compared by: of moving rows; where none are known, of all rows."""
    return errors if errors.moving is None or errors.moving.relative_total is None else errors.moving


def to_step(ladder_step: LadderStep, fit: ErrorsView) -> Step:
    """Convert a stored step of a ladder, whose errors of the fit are known, for its tables."""
    held_out = ladder_step.validation
    return Step(
        from_wire_choices(ladder_step.added),
        from_wire_choices(ladder_step.removed),
        ladder_step.n_parameters,
        select_judged(fit),
        None if held_out is None else select_judged(held_out),
        None if held_out is None else held_out.relative_total,
        ladder_step.confirmed_by or (),
    )


def add_ladder_tables(lineage: Lineage, joints: Sequence[str], parent_id: str | None = None) -> Lineage:
    """Return a ladder, and one that it is compared with, with their steps in words and their tables.

    Parameters
    ----------
    lineage : Lineage
        The ladders.
    joints : sequence of str
        Names of the robot's joints.
    parent_id : str, optional
        Id of the model that the last one was made from; an extension by several effects has a step for each. By
        default the model of the step before.

    Returns
    -------
    Lineage
        The same with words and tables, as far as its models are identified.
    """
    ladders = [
        [(step, to_step(step, step.residual)) for step in items if step.residual is not None]
        for items in (lineage.items, lineage.against or [])
    ]
    for ladder_step, step in (pair for ladder in ladders for pair in ladder):
        ladder_step.change = step.describe_change(joints)
    own, other = ([step for _, step in ladder] for ladder in ladders)
    if not own:
        return lineage
    tables = [build_ladder_table(own, joints), build_ladder_joint_table(own, joints)]
    if other:
        tables.append(build_two_ladders_table(("this ladder", "the other"), (own, other), joints))
    ids = [ladder_step.id for ladder_step, _ in ladders[0]]
    sentence = None
    if len(own) > 1:
        sentence = describe_last_step(own, joints, ids.index(parent_id) if parent_id in ids[:-1] else None)
    last_step = None if sentence is None else to_view(StepSentence, sentence)
    return lineage.model_copy(update={"tables": show_tables(tables), "last_step": last_step})


def _build_intermediate_steps(view: IdentificationView, below: LadderStep | None) -> list[LadderStep]:
    """Build the steps between a model and its parent; an extension by several effects has one for each."""
    steps: list[LadderStep] = []
    for number, step in enumerate(view.result.rungs if view.result is not None else [], start=1):
        under = steps[-1] if steps else below
        ladder_step = LadderStep(
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
            confirmed_by=step.confirmed_by,
        )
        steps.append(ladder_step)
    return steps


def _build_own_step(view: IdentificationView, below: LadderStep | None) -> LadderStep:
    result = view.result
    effects = view.request.effects if result is None else result.effects
    return LadderStep(
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
        confirmed_by=None if result is None else result.confirmed_by,
    )


def _last_added(view: IdentificationView, effects: list[EffectChoice], below: LadderStep | None) -> list[EffectChoice]:
    """Return what the last step added, with the shape constants that were found."""
    # The steps below have the first of the requested effects; the rest of the list is new at this step.
    if not view.added or view.result is None or below is None:
        return view.added
    return effects[len(below.effects) :]


def compare_ladders(own: Sequence[LadderStep], other: Sequence[LadderStep], same_data: bool) -> Lineage:
    """Compare two ladders.

    Parameters
    ----------
    own, other : sequence of LadderStep
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


def _show_difference(number: int, own: LadderStep | None, other: LadderStep | None) -> LadderStepDifference:
    fit = (own.residual if own else None, other.residual if other else None)
    held_out = (own.validation if own else None, other.validation if other else None)
    counts = (own.n_parameters if own else None, other.n_parameters if other else None)
    return LadderStepDifference(
        rung=number,
        id=own.id if own else None,
        against_id=other.id if other else None,
        n_parameters=_subtract(*counts),
        residual=_subtract_per_joint(*fit),
        residual_total=_subtract_totals(*fit),
        validation=_subtract_per_joint(*held_out),
        validation_total=_subtract_totals(*held_out),
        residual_moving=_subtract_per_joint(*map(_get_moving, fit)),
        residual_moving_total=_subtract_totals(*map(_get_moving, fit)),
        validation_moving=_subtract_per_joint(*map(_get_moving, held_out)),
        validation_moving_total=_subtract_totals(*map(_get_moving, held_out)),
    )


def _get_moving(errors: ErrorsView | None) -> ErrorFigures | None:
    return None if errors is None else errors.moving


def _subtract_per_joint(own: ErrorFigures | None, other: ErrorFigures | None) -> list[float | None] | None:
    if own is None or other is None:
        return None
    return [_subtract(a, b) for a, b in zip(own.relative, other.relative, strict=True)]


def _subtract_totals(own: ErrorFigures | None, other: ErrorFigures | None) -> float | None:
    return None if own is None or other is None else _subtract(own.relative_total, other.relative_total)


def _subtract(a: T | None, b: T | None) -> T | None:
    return None if a is None or b is None else a - b


def build_steps(
    identification: Identification, name: str, other_ladder: tuple[Identification, str] | None = None
) -> list[LadderStep]:
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
    list of LadderStep
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
    steps = [
        to_view(
            LadderStep,
            model,
            id=identifier,
            name=identifier,
            parent_id=ids[k - 1] if k else None,
            status="succeeded",
            residual=show_fit(model),
            confirmed_by=list_confirming_rows(model),
        )
        for k, (identifier, model) in enumerate(zip(ids, models, strict=True))
    ]
    return mark_best_step(steps)


def _step_ids(name: str, count: int) -> list[str]:
    return [*(f"{name}/{k}" for k in range(1, count)), name]


def show_fit(identification: Identification) -> ErrorsView:
    """Build the view of the errors on the data that a model was identified from."""
    return show_errors(identification.fit, identification.fit_moving, identification.noise)
