"""Shape constants brought from near the smallest squared error to it, all of them together (Gauss and Newton)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.effects import Column, EffectChoice, columns_of
from dynident.estimation import noise_levels, ordinary, weighted_factor
from dynident.identification.shape_columns import TINY, ShapePlace, changed_choice, shape_places
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model
from dynident.regressors.observation import Observation
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import FloatArray

_ROUNDS = 3
_SETTLED = 0.02
"""Share of a step of the search that a last round moves a constant by, at most."""


def settled_shapes(
    model: Model,
    choices: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
    *,
    kept: Sequence[Collection[str]],
) -> tuple[EffectChoice, ...]:
    """The choices with the shape constants of the smallest squared error near theirs.

    What `kept` names stays, as do natural values and those at the lower end of what is searched. No constant moves by
    more than a step of its search in a round, and none for the worse.
    """
    here, before, least = tuple(choices), tuple(choices), np.inf
    for _ in range(_ROUNDS):
        places = [p for p in shape_places(here) if p.spec.name not in kept[p.choice] and _loose(p, here)]
        if not places:
            return here
        data = _Derivatives.of(model, here, places, recordings, preprocessing, reference)
        error, changes = data.step()
        if error > least:
            return before
        before, least = here, error
        steps = [float(np.clip(change / p.change(1.0), -1, 1)) for p, change in zip(places, changes, strict=True)]
        for place, step in zip(places, steps, strict=True):
            here = _moved(here, place, step)
        if max(map(abs, steps)) < _SETTLED:
            break
    return here


def _loose(place: ShapePlace, choices: Sequence[EffectChoice]) -> bool:
    value = place.value(choices)
    return value not in place.spec.natural and (place.spec.signed or value > place.spec.least)


def _moved(choices: tuple[EffectChoice, ...], place: ShapePlace, step: float) -> tuple[EffectChoice, ...]:
    value = place.moved(place.value(choices), place.change(step))
    if not place.spec.signed:
        value = max(value, place.spec.least)
    if not place.spec.admits(value):
        return choices
    changed = changed_choice(choices[place.choice], place.spec.name, value)
    return (*choices[: place.choice], changed, *choices[place.choice + 1 :])


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Factor of [model | choices | the choices with a constant a little larger, then smaller | Y], all rows together.

    `n_columns` are those of the model and the choices; `pairs` (k) the numbers of three columns each, here, above and
    below, for every constant, and `widths` (k,) how far above and below are apart.
    """

    factor: FloatArray
    n_columns: int
    pairs: list[list[tuple[int, int, int]]]
    widths: list[float]

    @classmethod
    def of(
        cls,
        model: Model,
        choices: Sequence[EffectChoice],
        places: Sequence[ShapePlace],
        recordings: Sequence[Recording],
        preprocessing: Preprocessing,
        reference: FloatArray,
    ) -> _Derivatives:
        columns: list[Column] = list(model.kept)
        numbers: list[range] = []
        for choice in choices:
            made = columns_of([choice], model.signals)
            numbers.append(range(len(columns), len(columns) + len(made)))
            columns += made
        n_columns = len(columns)
        pairs = []
        for place in places:
            own, value = numbers[place.choice], place.value(choices)
            ends = [place.moved(value, way * place.change(TINY)) for way in (1.0, -1.0)]
            first = len(columns)
            for end in ends:
                columns += columns_of([changed_choice(choices[place.choice], place.spec.name, end)], model.signals)
            pairs.append([(k, first + i, first + len(own) + i) for i, k in enumerate(own)])
        observation = Observation.of(model.robot, columns, model.signals)
        reduction = reduce_recordings(observation, recordings, preprocessing, reference)
        alone = reduction.select(list(range(model.n_parameters)))
        factor = weighted_factor(reduction, noise_levels(alone, ordinary(alone).values))
        return cls(factor, n_columns, pairs, [2.0 * place.change(TINY) for place in places])

    def step(self) -> tuple[float, FloatArray]:
        """The squared error here, and the changes (k,) of the constants that would make it smallest."""
        w, y = self.factor[:, : self.n_columns], self.factor[:, -1]
        values, error = _solved(w, y)
        slopes = [
            sum((values[k] * (self.factor[:, a] - self.factor[:, b]) for k, a, b in own), np.zeros(len(y))) / width
            for own, width in zip(self.pairs, self.widths, strict=True)
        ]
        together, _ = _solved(np.column_stack([w, *slopes]), y)
        return error, together[self.n_columns :]


def _solved(w: FloatArray, y: FloatArray) -> tuple[FloatArray, float]:
    """Least squares of columns that may depend on one another, and the squared error that is left."""
    sizes = np.linalg.norm(w, axis=0)
    scaled = w / np.where(sizes > 0, sizes, 1.0)
    found = np.linalg.lstsq(scaled, y, rcond=1e-10)[0]
    rest = y - scaled @ found
    return found / np.where(sizes > 0, sizes, 1.0), float(rest @ rest)
