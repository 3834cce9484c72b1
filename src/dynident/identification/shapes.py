"""Shape constants inside an effect's columns: searched on the effect's grid, then finer (variable projection)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynident.effects import Column, EffectChoice, Signals, columns_of, effect_by_id
from dynident.effects.catalogue import joints_of
from dynident.errors import DynidentError
from dynident.estimation import noise_levels, ordinary, weighted_factor
from dynident.progress import Progress, part, silent
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model
from dynident.regressors.observation import Observation
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import FloatArray, Robot

_FINE = (-0.5, -0.25, 0.0, 0.25, 0.5)


def lacks_shape(choice: EffectChoice) -> bool:
    """Whether a choice leaves shape constants open that are to be found from the data."""
    effect = effect_by_id(choice.effect)
    return any(spec.name not in choice.shape_values and spec.proposal == "grid" for spec in effect.shapes)


def check_shapes_given(choices: Sequence[EffectChoice]) -> None:
    """Raise where a choice leaves a shape constant open that no grid of ours can find.

    Raises
    ------
    DynidentError
    """
    for index, choice in enumerate(choices):
        for spec in effect_by_id(choice.effect, f"/effects/{index}/effect").shapes:
            if spec.proposal != "grid" and spec.name not in choice.shape_values:
                raise DynidentError(
                    f"{choice.effect} needs its {spec.description} ({spec.name}, {spec.unit}); a diagnosis finds it in "
                    "the residual, or give it as a shape constant",
                    pointer=f"/effects/{index}/shape/{spec.name}",
                    title="Missing shape constant",
                )


def complete_shapes(
    model: Model,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
    progress: Progress = silent,
) -> tuple[EffectChoice, ...]:
    """Find the shape constants that were left open, on the grid and then between its points; keep those given."""
    if not any(lacks_shape(choice) for choice in added):
        return tuple(added)
    given = tuple(choice for choice in added if not lacks_shape(choice))
    still_open = one_joint_each([choice for choice in added if lacks_shape(choice)], model.robot)
    coarse = find_shapes(model, (*given, *still_open), recordings, preprocessing, reference, part(progress, 0.0, 0.5))
    fine = refine_shapes(model, coarse[len(given) :], recordings, preprocessing, reference, part(progress, 0.5, 1.0))
    return given + fine


def one_joint_each(choices: Sequence[EffectChoice], robot: Robot) -> tuple[EffectChoice, ...]:
    """Split choices that leave their shape open into one a joint, so that every joint finds its own."""
    split: list[EffectChoice] = []
    for choice in choices:
        if lacks_shape(choice) and effect_by_id(choice.effect).scope == "joint":
            split += [replace(choice, joints=(robot.joint_names[j],)) for j in joints_of(choice, robot)]
        else:
            split.append(choice)
    return tuple(split)


def find_shapes(
    model: Model,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
    progress: Progress = silent,
) -> tuple[EffectChoice, ...]:
    """Complete choices by the shape constants with the smallest squared error beside a model.

    Where a choice gives its shape, it is kept. The others are taken from the effect's grid, one after another.
    """
    options = [_options(choice, model.robot) for choice in added]
    return _search(model, options, recordings, preprocessing, reference, progress)


def refine_shapes(
    model: Model,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
    progress: Progress = silent,
) -> tuple[EffectChoice, ...]:
    """Search between the grid points around shape constants that came from a grid of factors of two."""
    options = [_finer(choice) for choice in added]
    if all(len(item) == 1 for item in options):
        return tuple(added)
    return _search(model, options, recordings, preprocessing, reference, progress)


def _options(choice: EffectChoice, robot: Robot) -> list[EffectChoice]:
    if not lacks_shape(choice):
        return [choice]
    joint = joints_of(choice, robot)[0]
    given = choice.shape_values
    return [replace(choice, shape=_key({**shape, **given})) for shape in effect_by_id(choice.effect).grid(robot, joint)]


def _finer(choice: EffectChoice) -> list[EffectChoice]:
    effect = effect_by_id(choice.effect)
    refined = [spec for spec in effect.shapes if spec.proposal == "grid" and spec.unit in ("rad", "rad/s")]
    if not refined or not choice.shape:
        return [choice]
    name = refined[0].name
    value = choice.shape_values[name]
    return [replace(choice, shape=_key({**choice.shape_values, name: value * 2.0**step})) for step in _FINE]


def _key(shape: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((name, float(value)) for name, value in shape.items()))


def _search(
    model: Model,
    options: Sequence[Sequence[EffectChoice]],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
    progress: Progress,
) -> tuple[EffectChoice, ...]:
    signals: Signals = model.signals
    columns: list[Column] = list(model.kept)
    numbers: list[list[list[int]]] = []
    for choices in options:
        numbers.append([])
        for choice in choices:
            made = columns_of([choice], signals)
            numbers[-1].append(list(range(len(columns), len(columns) + len(made))))
            columns += made
    observation = Observation.of(model.robot, columns, signals)
    reduction = reduce_recordings(observation, recordings, preprocessing, reference, progress)
    base = list(range(model.n_parameters))
    alone = reduction.select(base)
    # The factor of all rows together: every option is then a small problem, whatever the length of the data.
    factor = weighted_factor(reduction, noise_levels(alone, ordinary(alone).values))
    chosen = [_best(factor, base, group) for group in numbers]
    for _ in range(2):  # each choice again beside the others'
        for k, group in enumerate(numbers):
            if len(group) > 1:
                others = [c for i, picked in enumerate(chosen) if i != k for c in numbers[i][picked]]
                chosen[k] = _best(factor, base + others, group)
    return tuple(choices[k] for choices, k in zip(options, chosen, strict=True))


def _best(factor: FloatArray, base: list[int], group: list[list[int]]) -> int:
    """Index of the option with the smallest weighted squared error beside the columns `base`."""
    if len(group) == 1:
        return 0
    return int(np.argmin([_squared_error(factor, base + option) for option in group]))


def _squared_error(factor: FloatArray, columns: list[int]) -> float:
    """Squared error of the least-squares solution on these columns, which may depend on one another."""
    w, y = factor[:, columns], factor[:, -1]
    w = w / np.maximum(np.linalg.norm(w, axis=0), np.finfo(float).tiny)
    rest = y - w @ np.linalg.lstsq(w, y, rcond=1e-10)[0]
    return float(rest @ rest)
