"""Two ladders of models beside each other, rung by rung."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from dynident.identification import Identification
from dynident_service.adapters.effects import show_choice
from dynident_service.adapters.identifications import show_errors
from dynident_service.models.identifications import ErrorsView, Lineage, Rung, RungDifference


def beside(own: Sequence[Rung], other: Sequence[Rung], same_data: bool) -> Lineage:
    """Compare two ladders, the first models first."""
    shared = [a.id for a, b in zip(own, other, strict=False) if a.id == b.id]
    return Lineage(
        items=list(own),
        against=list(other),
        common_ancestor=shared[-1] if shared else None,
        differences=[_difference(k, a, b) for k, (a, b) in enumerate(zip_longest(own, other), start=1)],
        same_data=same_data,
    )


def _difference(number: int, own: Rung | None, other: Rung | None) -> RungDifference:
    fit = (own.residual if own else None, other.residual if other else None)
    tried = (own.validation if own else None, other.validation if other else None)
    more = None
    if own is not None and other is not None and own.n_parameters is not None and other.n_parameters is not None:
        more = own.n_parameters - other.n_parameters
    return RungDifference(
        rung=number,
        id=own.id if own else None,
        against_id=other.id if other else None,
        n_parameters=more,
        residual=_per_joint(*fit),
        residual_total=_total(*fit),
        validation=_per_joint(*tried),
        validation_total=_total(*tried),
    )


def _per_joint(own: ErrorsView | None, other: ErrorsView | None) -> list[float | None] | None:
    if own is None or other is None:
        return None
    return [_minus(a, b) for a, b in zip(own.relative, other.relative, strict=True)]


def _total(own: ErrorsView | None, other: ErrorsView | None) -> float | None:
    return None if own is None or other is None else _minus(own.relative_total, other.relative_total)


def _minus(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b


def rungs_of(found: Identification, name: str, beside: tuple[Identification, str] | None = None) -> list[Rung]:
    """Show the ladder of a model in a file, each rung under a name of its own, or that of the same model `beside`."""
    models = list(found.ladder())
    ids = _ids(name, len(models))
    if beside is not None:
        others = list(beside[0].ladder())
        for k, (model, other) in enumerate(zip(models, others, strict=False)):
            if model.choices != other.choices or not np.array_equal(model.values, other.values):
                break
            ids[k] = _ids(beside[1], len(others))[k]
    return [
        Rung(
            id=identifier,
            name=identifier,
            parent_id=ids[k - 1] if k else None,
            status="succeeded",
            added=[show_choice(one) for one in model.added],
            removed=[show_choice(one) for one in model.removed],
            effects=[show_choice(one) for one in model.choices.effects],
            n_parameters=model.model.n_parameters,
            residual=show_errors(model.fit, model.noise),
            validation=None if model.held_out is None else show_errors(model.held_out),
        )
        for k, (identifier, model) in enumerate(zip(ids, models, strict=True))
    ]


def _ids(name: str, count: int) -> list[str]:
    return [*(f"{name}/{k}" for k in range(1, count)), name]
