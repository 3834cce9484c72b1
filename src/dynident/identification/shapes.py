"""Shape constants inside an effect's columns: searched on the effect's grid, then finer (variable projection)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynident.effects import Column, EffectChoice, Signals, columns_of, effect_by_id
from dynident.effects.catalogue import joints_of
from dynident.estimation import Reduction, noise_levels, ordinary, weighted_factor
from dynident.progress import Progress, silent
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
    noise = noise_levels(reduction.select(base), ordinary(reduction.select(base)).values)
    chosen = [_best_alone(reduction, base, group, noise) for group in numbers]
    for _ in range(2):  # each choice again beside the others'
        for k, group in enumerate(numbers):
            if len(group) > 1:
                others = [c for i, picked in enumerate(chosen) if i != k for c in numbers[i][picked]]
                chosen[k] = _best_alone(reduction, base + others, group, noise)
    return tuple(choices[k] for choices, k in zip(options, chosen, strict=True))


def _best_alone(reduction: Reduction, base: list[int], group: list[list[int]], noise: FloatArray) -> int:
    """Index of the option with the smallest weighted squared error beside the columns `base`."""
    if len(group) == 1:
        return 0
    return int(np.argmin([_weighted_error(reduction.select(base + option), noise) for option in group]))


def _weighted_error(reduction: Reduction, noise: FloatArray) -> float:
    """Weighted squared error of the least-squares solution; the columns may depend on one another."""
    r = weighted_factor(reduction, noise)
    c = reduction.n_columns
    scale = np.maximum(np.linalg.norm(r[:, :c], axis=0), np.finfo(float).tiny)
    w, y = r[:, :c] / scale, r[:, c]
    rest = y - w @ np.linalg.lstsq(w, y, rcond=1e-10)[0]
    return float(rest @ rest)
