"""Find shape constants that nobody gave: first on the effect's grid, then finer (variable projection)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column, EffectChoice, ShapeSpec, Signals, build_columns, get_effect
from dynident.effects.effect_columns import check_shape_constants, find_joints
from dynident.errors import DynidentError
from dynident.estimation import build_weighted_factor, compute_noise_levels, solve_ordinary
from dynident.identification.shape_refinement import settle_shapes
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import CachedRows, reduce_with_columns
from dynident.robot.robot_model import Robot

# Share of the squared error that a natural value may cost: three times what a free constant gains from noise alone.
_AS_GOOD = 0.002
_DEPENDENT = 1e-10
"""Share of a column below which its part that is independent of the others is rounding."""

DOWN, UP = 6, 8
"""Steps around a coarse value, down and up."""

_ALIKE = 2
"""Steps within which refined constants of two joints are nearly the same: half an octave, of ratios."""

_BETWEEN, _BETWEEN_OF_SEVERAL = (-4, -3, -2, -1, 0, 1, 2, 3, 4), (-4, -2, 0, 2, 4)
"""Steps to half the distance between values of a grid; fewer where several constants have them together."""


def lacks_shape(choice: EffectChoice) -> bool:
    """Tell whether a choice leaves shape constants open that are to be found from the data."""
    effect = get_effect(choice.effect)
    return any(spec.name not in choice.shape_values and spec.proposal == "grid" for spec in effect.shapes)


def check_choices(choices: Sequence[EffectChoice], robot: Robot) -> None:
    """Raise where an effect cannot act on its joints, or lacks a shape constant that is not searched on a grid.

    Parameters
    ----------
    choices : sequence of EffectChoice
        Effects with their joints and shape constants.
    robot : Robot
        The robot.

    Raises
    ------
    DynidentError
        Names the field.
    """
    for index, choice in enumerate(choices):
        pointer = f"/effects/{index}"
        check_shape_constants(choice, pointer)
        find_joints(choice, robot, pointer)
        for spec in get_effect(choice.effect, pointer).shapes:
            if spec.proposal != "grid" and spec.name not in choice.shape_values:
                raise DynidentError(
                    f"{choice.effect} needs its {spec.description} ({spec.name}, {spec.unit}); a diagnosis finds it in "
                    "the residual, or give it as a shape constant",
                    pointer=f"{pointer}/shape/{spec.name}",
                    title="Missing shape constant",
                )


def complete_shapes(
    model: Model,
    added: Sequence[EffectChoice],
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
) -> tuple[EffectChoice, ...]:
    """Find the shape constants that were left open, on the grid and then between its points; keep those given.

    Parameters
    ----------
    model : Model
        That the effects are added to.
    added : sequence of EffectChoice
        Effects that are added to the model.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.
    known : CachedRows, optional
        Rows of the model on these recordings.

    Returns
    -------
    tuple of EffectChoice
        With values for all constants; a choice that left some open becomes one for each joint.
    """
    if not any(lacks_shape(choice) for choice in added):
        return tuple(added)
    with_shape = tuple(choice for choice in added if not lacks_shape(choice))
    # Joints differ in their shape constants, so that one value for all would fit none of them.
    still_open = split_by_joint([choice for choice in added if lacks_shape(choice)], model.robot)
    everything = (*with_shape, *still_open)
    coarse = find_shapes(model, everything, inputs, scale_progress(progress, 0.0, 0.5), known)
    return refine_shapes(
        model,
        coarse,
        inputs,
        scale_progress(progress, 0.5, 1.0),
        kept=[choice.shape_values for choice in everything],
        known=known,
    )


def split_by_joint(choices: Sequence[EffectChoice], robot: Robot) -> tuple[EffectChoice, ...]:
    """Split choices that leave their shape open into one for each joint, so that every joint finds its own."""
    split: list[EffectChoice] = []
    for choice in choices:
        # An effect of the whole robot has one shape, and nothing to split.
        if lacks_shape(choice) and get_effect(choice.effect).scope == "joint":
            split += [replace(choice, joints=(robot.tree.joint_names[j],)) for j in find_joints(choice, robot)]
        else:
            split.append(choice)
    return tuple(split)


def find_shapes(
    model: Model,
    added: Sequence[EffectChoice],
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
) -> tuple[EffectChoice, ...]:
    """Complete choices by the shape constants with the smallest squared error beside a model.

    Where a choice gives its shape, it is kept. The others are taken from the effect's grid, one after another.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    added : sequence of EffectChoice
        Effects that are added to the model.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.
    known : CachedRows, optional
        Rows of the model on these recordings.
    """
    # All options of all choices are evaluated in one pass over the data; the search itself is algebra.
    options = [_list_options(choice, model.robot) for choice in added]
    table = _tabulate(model, options, inputs, progress, known)
    return tuple(choices[k] for choices, k in zip(options, table.search()[0], strict=True))


def refine_shapes(
    model: Model,
    added: Sequence[EffectChoice],
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    *,
    kept: Sequence[Collection[str]] = (),
    known: CachedRows | None = None,
) -> tuple[EffectChoice, ...]:
    """Search around shape constants that came from a coarse grid, one constant of every effect after another.

    The vertex of a parabola through wide steps is only close to the smallest error. So all constants are then settled
    together by Newton steps.

    Constants that are one of a few kinds, an exponent, a law, are chosen anew with the first: a coarse grid may have
    picked one for want of a value between.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    added : sequence of EffectChoice
        With values for all constants.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Called with the fraction done and a message.
    kept : sequence of collections of str
        Names of the constants of every choice that stay as they are; none where it is empty.
    known : CachedRows, optional
        Rows of the model on these recordings.
    """
    refined = tuple(added)
    fixed = kept or [()] * len(refined)
    moving = [_list_refinable(choice, names) for choice, names in zip(refined, fixed, strict=True)]
    # One constant of every effect in each round: a grid over all of them at once would explode.
    rounds = max((len(specs) for specs in moving), default=0)
    for number in range(rounds):
        specs = [of_choice[number] if number < len(of_choice) else None for of_choice in moving]
        kinds = [
            _list_kinds(choice, names, model.robot) if number == 0 and spec is not None else [choice]
            for choice, names, spec in zip(refined, fixed, specs, strict=True)
        ]
        lines = [
            [_list_neighbours(kind, spec) for kind in of_choice] for of_choice, spec in zip(kinds, specs, strict=True)
        ]
        options = [[choice for line in of_choice for choice in line] for of_choice in lines]
        here = scale_progress(progress, number / rounds, (number + 1) / rounds)
        selected, errors = _tabulate(model, options, inputs, here, known).search()
        refined = tuple(_choose_vertex(*arguments) for arguments in zip(lines, selected, errors, specs, strict=True))
    return settle_shapes(model, refined, inputs, kept=fixed)


def list_between(choice: EffectChoice, width: float = 1.0) -> list[EffectChoice]:
    """Return a choice, and the same with shape constants between those of the coarse grid, all of them together.

    The choice alone where its effect has no constants that are searched for.

    Parameters
    ----------
    choice : EffectChoice
        The effect with its shape constants.
    width : float
        How far they go, over half the distance between values of the grid.
    """
    specs = _list_refinable(choice, ())
    steps = _BETWEEN if len(specs) < 2 else _BETWEEN_OF_SEVERAL
    variants = [choice]
    for spec in specs:
        value = choice.shape_values[spec.name]
        moved = [_move_value(spec, value, width * step) for step in steps]
        least = -np.inf if spec.signed else min(spec.least, value)
        allowed = [item for item in moved if spec.admits(item) and item >= least]
        variants = [_replace_shape_value(variant, spec.name, item) for variant in variants for item in allowed]
    return [choice, *(variant for variant in variants if variant != choice)]


def are_nearly_alike(one: EffectChoice, other: EffectChoice) -> bool:
    """Tell whether two choices are the same effect on joints of their own, with constants that are nearly the same.

    Constants that are refined have to be within two steps of their refinement, the others equal.

    Parameters
    ----------
    one, other : EffectChoice
        Two effects with their shape constants.
    """
    if (one.effect, one.runs) != (other.effect, other.runs) or not one.joints or not other.joints:
        return False
    mine, theirs = one.shape_values, other.shape_values
    if not mine or mine.keys() != theirs.keys():
        return False
    return all(
        _is_near(spec, mine[spec.name], theirs[spec.name])
        for spec in get_effect(one.effect).shapes
        if spec.name in mine
    )


def _is_near(spec: ShapeSpec, value: float, other: float) -> bool:
    if not spec.can_be_refined(value):
        return value == other
    return _move_value(spec, value, -_ALIKE) <= other <= _move_value(spec, value, _ALIKE)


def _list_options(choice: EffectChoice, robot: Robot) -> list[EffectChoice]:
    if not lacks_shape(choice):
        return [choice]
    joint = find_joints(choice, robot)[0]
    stated = choice.shape_values
    return [
        replace(choice, shape=_to_key({**shape, **stated}))
        for shape in get_effect(choice.effect).grid(robot.tree, joint)
    ]


def _list_refinable(choice: EffectChoice, fixed: Collection[str]) -> list[ShapeSpec]:
    """Return the shape constants of a choice that are refined."""
    specs = get_effect(choice.effect).shapes
    present = choice.shape_values
    open_ = [spec for spec in specs if spec.name in present and spec.name not in fixed]
    return [spec for spec in open_ if spec.can_be_refined(present[spec.name])]


def _list_kinds(choice: EffectChoice, fixed: Collection[str], robot: Robot) -> list[EffectChoice]:
    """Return the choice with every value that its effect's grid has for constants that are not refined."""
    effect = get_effect(choice.effect)
    open_ = [spec.name for spec in effect.shapes if spec.refined is None and spec.name not in fixed]
    present = [name for name in open_ if name in choice.shape_values]
    if not present or any(spec.proposal != "grid" for spec in effect.shapes):
        return [choice]
    grid = effect.grid(robot.tree, find_joints(choice, robot)[0])
    others = {_to_key({name: shape[name] for name in present if name in shape}) for shape in grid}
    mine = _to_key({name: choice.shape_values[name] for name in present})
    return [
        choice,
        *(replace(choice, shape=_to_key({**choice.shape_values, **dict(o)})) for o in sorted(others - {mine})),
    ]


def _list_neighbours(choice: EffectChoice, spec: ShapeSpec | None) -> list[EffectChoice]:
    """Return neighbours of a choice in even steps of one of its shape constants; the choice alone without a spec."""
    if spec is None:
        return [choice]
    value = choice.shape_values[spec.name]
    moved = [_move_value(spec, value, step) for step in range(-DOWN, UP + 1)]
    least = -np.inf if spec.signed else min(spec.least, value)
    return [_replace_shape_value(choice, spec.name, item) for item in moved if spec.admits(item) and item >= least]


def _move_value(spec: ShapeSpec, value: float, steps: float) -> float:
    return value if spec.refined is None else spec.refined.apply_steps(value, steps)


def _replace_shape_value(choice: EffectChoice, name: str, value: float) -> EffectChoice:
    return replace(choice, shape=_to_key({**choice.shape_values, name: value}))


def _to_key(shape: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((name, float(value)) for name, value in shape.items()))


@dataclass(frozen=True, eq=False)
class _OptionTable:
    """Columns of every option: `factor` is the triangular factor of [model | options | Y], all rows together.

    `numbers[k][i]` are the columns of option i for choice k.
    """

    factor: FloatArray
    n_base: int
    numbers: list[list[list[int]]]

    def compute_errors(self, k: int, others: Sequence[int]) -> FloatArray:
        """Return the squared error of every option of choice k beside the model and the columns `others`."""
        options = self.numbers[k]
        free = [column for option in options for column in option]
        # Variable projection: with the linear parameters eliminated, only what the model cannot explain of Y and of
        # the options counts. The triangular factor has all that in a few hundred rows.
        remainder = _orthogonalise(self.factor[:, [*range(self.n_base), *others]], self.factor[:, [*free, -1]])
        ends = np.cumsum([len(option) for option in options])
        own = (remainder[:, end - len(option) : end] for option, end in zip(options, ends, strict=True))
        return np.array([_compute_squared_error(columns, remainder[:, -1]) for columns in own])

    def search(self) -> tuple[list[int], list[FloatArray]]:
        """Return the best option of every choice, and the errors of all options that it was picked from."""
        chosen: list[int] = []
        errors: list[FloatArray] = []
        for k in range(len(self.numbers)):
            errors.append(self.compute_errors(k, self._list_columns(chosen, range(k))))
            chosen.append(int(np.argmin(errors[k])))
        # The first pass chose each option without those that came after it. Two more rounds let them agree with each
        # other.
        for _ in range(2):
            for k, group in enumerate(self.numbers):
                if len(group) > 1:
                    others = [i for i in range(len(self.numbers)) if i != k]
                    errors[k] = self.compute_errors(k, self._list_columns(chosen, others))
                    chosen[k] = int(np.argmin(errors[k]))
        return chosen, errors

    def _list_columns(self, chosen: Sequence[int], which: Iterable[int]) -> list[int]:
        return [column for i in which for column in self.numbers[i][chosen[i]]]


def _tabulate(
    model: Model,
    options: Sequence[Sequence[EffectChoice]],
    inputs: RegressorInputs,
    progress: Progress,
    known: CachedRows | None,
) -> _OptionTable:
    """Evaluate the columns of all options in one pass over the recordings."""
    signals: Signals = model.signals
    columns: list[Column] = list(model.kept)
    numbers: list[list[list[int]]] = []
    for choices in options:
        numbers.append([])
        for choice in choices:
            added = build_columns([choice], signals)
            numbers[-1].append(list(range(len(columns), len(columns) + len(added))))
            columns += added
    more = columns[model.n_parameters :]
    reduction = reduce_with_columns(model, more, inputs, progress, known, by_time=False)
    alone = reduction.select_columns(list(range(model.n_parameters)))
    # The noise is that of the model without the options, so that all options are compared with the same weights.
    factor = build_weighted_factor(reduction, compute_noise_levels(alone, solve_ordinary(alone).values))
    return _OptionTable(factor, model.n_parameters, numbers)


def _choose_vertex(
    lines: Sequence[Sequence[EffectChoice]], selected: int, errors: FloatArray, spec: ShapeSpec | None
) -> EffectChoice:
    """Return the choice at the minimum of the parabola through the best step and its neighbours, for the best kind."""
    # Every kind has the same steps.
    kind, selected = divmod(selected, len(lines[0]))
    group, errors = lines[kind], errors.reshape(len(lines), -1)[kind]
    choice = group[selected]
    if spec is None or not 0 < selected < len(group) - 1:
        return choice
    before, here, after = errors[selected - 1 : selected + 2]
    # The vertex of the parabola through three equally spaced points.
    curvature = before - 2 * here + after
    shift = float(0.5 * (before - after) / curvature) if curvature > 0 else 0.0
    natural = [k for k, other in enumerate(group) if other.shape_values[spec.name] in spec.natural]
    # A natural value, such as an exponent of 2, is preferred where it costs no more than chance.
    if natural and errors[natural[0]] <= (1 + _AS_GOOD) * here:
        return group[natural[0]]
    return _replace_shape_value(choice, spec.name, _move_value(spec, choice.shape_values[spec.name], shift))


def _orthogonalise(base: FloatArray, columns: FloatArray) -> FloatArray:
    """Return the part of columns (r, c) that is orthogonal to a model's columns (r, b).

    All but the last column are scaled to the size one.
    """
    basis, sizes, _ = np.linalg.svd(_normalise_columns(base), full_matrices=False)
    # Directions that are rounding would take away parts of the options at random.
    basis = basis[:, sizes > _DEPENDENT * sizes[0]]
    remainder = np.column_stack([_normalise_columns(columns[:, :-1]), columns[:, -1]])
    # Orthogonalise twice: the first pass leaves rounding errors along the model.
    for _ in range(2):
        remainder = remainder - basis @ (basis.T @ remainder)
    # A column that the model contains is rounding now, and must not be scaled up to explain the torque.
    nothing = np.linalg.norm(remainder[:, :-1], axis=0) < _DEPENDENT
    remainder[:, :-1][:, nothing] = 0.0
    return np.asarray(remainder)


def _compute_squared_error(w: FloatArray, y: FloatArray) -> float:
    """Return the squared error of the least-squares solution on columns (r, k), which may depend on one another."""
    rest = y - w @ np.linalg.lstsq(w, y, rcond=_DEPENDENT)[0]
    return float(rest @ rest)


def _normalise_columns(columns: FloatArray) -> FloatArray:
    return np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny))
