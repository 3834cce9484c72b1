"""Refine all shape constants together by Gauss-Newton steps; their derivatives as columns.

Holds rounds and when a step is small enough.

The columns are the derivatives of torque by shape constants, which other linearised estimates use as well.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import (
    Column,
    EffectChoice,
    Refinement,
    ShapeSpec,
    Signals,
    build_columns,
    get_effect,
)
from dynident.estimation import (
    EstimationError,
    Reduction,
    build_weighted_factor,
    compute_noise_levels,
    linearise_constants,
    solve,
)
from dynident.progress import Progress, ignore_progress
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import CachedRows, reduce_with_columns

ColumnKey = tuple[str, str, tuple[tuple[str, float], ...], tuple[str, ...]]

TINY = 1.0 / 16.0
"""Share of a step of the search to either side of a constant, for its derivative."""

_FAR = 100.0
"""A logarithm of a ratio that is as good as infinite."""


@dataclass(frozen=True)
class ShapeVariable:
    """A shape constant that may take any value.

    Parameters
    ----------
    choice : int
        Number of the model's effect choice that it belongs to.
    spec : ShapeSpec
        Which constant of the effect it is.
    search : Refinement
        How it is searched for.
    """

    choice: int
    spec: ShapeSpec
    search: Refinement

    def get_value(self, effects: Sequence[EffectChoice]) -> float:
        """Return the value in these choices."""
        return effects[self.choice].shape_values[self.spec.name]

    def to_change(self, steps: float) -> float:
        """Return the change that some steps of the search make: of the constant, or of its logarithm."""
        return self.search.step * steps * (np.log(2.0) if self.search.in_octaves else 1.0)

    def compute_change(self, low: float, high: float) -> float:
        """Return the change from one value to another.

        Parameters
        ----------
        low : float
            The value to begin with.
        high : float
            The value to end with.

        Returns
        -------
        float
            The difference, or that of the logarithms.
        """
        return float(np.log(high / low)) if self.search.in_octaves else high - low

    def apply_change(self, value: float, change: float) -> float:
        """Return the value after a change of it, or of its logarithm where it is searched for in equal ratios.

        Parameters
        ----------
        value : float
            The value before.
        change : float
            The change of it, or of its logarithm.
        """
        # Clipped: a step far outside of the linearisation must not overflow.
        return float(value * np.exp(np.clip(change, -_FAR, _FAR))) if self.search.in_octaves else value + change


def list_shape_variables(effects: Sequence[EffectChoice]) -> tuple[ShapeVariable, ...]:
    """Return the shape constants of choices that may take any value, those of one choice after another.

    Parameters
    ----------
    effects : sequence of EffectChoice
        Effects with their joints and shape constants.
    """
    return tuple(
        ShapeVariable(number, spec, spec.refined)
        for number, choice in enumerate(effects)
        for spec in get_effect(choice.effect).shapes
        if spec.refined is not None
        and spec.name in choice.shape_values
        and spec.can_be_refined(choice.shape_values[spec.name])
    )


def replace_shape_value(choice: EffectChoice, name: str, value: float) -> EffectChoice:
    """Return a choice with another value of one of its shape constants.

    Parameters
    ----------
    choice : EffectChoice
        The effect with its shape constants.
    name : str
        Name of the constant.
    value : float
        Its new value.
    """
    return replace(choice, shape=tuple(sorted({**choice.shape_values, name: value}.items())))


def build_shape_columns(model: Model, values: FloatArray, places: Sequence[ShapeVariable]) -> list[Column]:
    """Return ∂(W χ)/∂θ of every constant, one column each, at parameters χ (b,).

    Differences are taken of the expressions before they are filtered, so that what is sampled, filtered and left out
    is the same as for W.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    values : (b,)
        Base parameters χ.
    places : sequence of ShapeVariable
        The constants θ.
    """
    amplitudes = {column.key: float(value) for column, value in zip(model.kept, values, strict=True)}
    return [_differentiate_torque(model.signals, model.effects[place.choice], place, amplitudes) for place in places]


def _differentiate_torque(
    signals: Signals, choice: EffectChoice, place: ShapeVariable, amplitudes: Mapping[ColumnKey, float]
) -> Column:
    """Return the central difference of an effect's torque by one of its shape constants, as a column."""
    value, tiny = choice.shape_values[place.spec.name], place.to_change(TINY)
    # A central difference: the error of a one-sided one would be of the size of the step itself.
    either = [
        build_columns([replace_shape_value(choice, place.spec.name, place.apply_change(value, way * tiny))], signals)
        for way in (1.0, -1.0)
    ]
    here = build_columns([choice], signals)
    torque = ca.SX(signals.robot.n, 1)
    for column, above, below in zip(here, *either, strict=True):
        # A column that dissolves in others has no parameter of its own.
        amplitude = amplitudes.get(column.key, 0.0)
        if amplitude != 0.0:
            torque += amplitude * (above.torque - below.torque) / (2.0 * tiny)
    return replace(
        here[0], parameter=place.spec.name, name=place.spec.name, unit=place.spec.unit, torque=ca.sparsify(torque)
    )


_ROUNDS = 3
"""Newton steps, at most; each is a pass over the data."""
_LEVEL = 0.95
"""Level of the interval that a natural value has to be outside of for the data to contradict it."""
_WIDE = 3.0
"""Standard deviation of a constant, or its logarithm, without any data: that of most ranges that are searched."""
_SETTLED = 0.02
"""Share of a step of the search: a round that moves no constant by more is the last."""


def settle_shapes(
    model: Model,
    choices: Sequence[EffectChoice],
    inputs: RegressorInputs,
    *,
    kept: Sequence[Collection[str]],
) -> tuple[EffectChoice, ...]:
    """Return the choices with the shape constants of the smallest squared error near theirs.

    Constants that `kept` names stay, as do values at the lower end of the search, and natural ones that the data do not
    contradict. No constant moves by more than a step of its search in a round, and none for the worse.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    choices : sequence of EffectChoice
        With values for all shape constants.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    kept : sequence of collections of str
        Constants of every choice that stay as they are.
    """
    here, before, least = tuple(choices), tuple(choices), np.inf
    staying: set[tuple[int, str]] = set()
    noise: FloatArray | None = None
    # Gauss and Newton: linear parameters and constants together, linearised anew in each round.
    for number in range(_ROUNDS):
        places = [
            p for p in list_shape_variables(here) if p.spec.name not in kept[p.choice] and _is_above_least(p, here)
        ]
        places = [p for p in places if (p.choice, p.spec.name) not in staying]
        if not places:
            return here
        # Intervals take what each block of time says; a step needs sums alone.
        data = _ShapeDerivatives.from_recordings(model, here, places, inputs, noise, by_time=number == 0)
        noise = data.noise
        # Natural values, such as an exponent of 2, are preferred: they only move where the data contradict them.
        if number == 0:
            against = data.find_contradicted()
            free = [k for k, p in enumerate(places) if against[k] or p.get_value(here) not in p.spec.natural]
            staying = {(p.choice, p.spec.name) for k, p in enumerate(places) if k not in free}
            places, data = [places[k] for k in free], data.select_constants(free)
            if not places:
                return here
        error, changes = data.compute_step()
        # The last step made the error larger, so the one before it is the result.
        if error > least:
            return before
        before, least = here, error
        # Further than one step of the search the linearisation does not hold.
        steps = [float(np.clip(change / p.to_change(1.0), -1, 1)) for p, change in zip(places, changes, strict=True)]
        for place, step in zip(places, steps, strict=True):
            here = _move_constant(here, place, step)
        if max(map(abs, steps)) < _SETTLED:
            break
    return here


def _is_above_least(place: ShapeVariable, choices: Sequence[EffectChoice]) -> bool:
    return place.spec.signed or place.get_value(choices) > place.spec.least


def _move_constant(choices: tuple[EffectChoice, ...], place: ShapeVariable, step: float) -> tuple[EffectChoice, ...]:
    value = place.apply_change(place.get_value(choices), place.to_change(step))
    if not place.spec.signed:
        value = max(value, place.spec.least)
    # A value that the effect cannot have leaves the constant where it is.
    if not place.spec.admits(value):
        return choices
    changed = replace_shape_value(choices[place.choice], place.spec.name, value)
    return (*choices[: place.choice], changed, *choices[place.choice + 1 :])


@dataclass(frozen=True, eq=False)
class _ShapeDerivatives:
    """Rows of [model | choices | choices with a constant a little larger, then smaller | Y], and their noise (n,).

    `n_columns` are those of the model and the choices; `pairs` (k) the numbers of three columns each, here, above and
    below, for every constant, and `widths` (k,) the distance from below to above.
    """

    reduction: Reduction
    noise: FloatArray
    n_columns: int
    pairs: list[list[tuple[int, int, int]]]
    widths: list[float]

    @classmethod
    def from_recordings(
        cls,
        model: Model,
        choices: Sequence[EffectChoice],
        places: Sequence[ShapeVariable],
        inputs: RegressorInputs,
        noise: FloatArray | None,
        *,
        by_time: bool,
    ) -> _ShapeDerivatives:
        columns: list[Column] = list(model.kept)
        numbers: list[range] = []
        for choice in choices:
            added = build_columns([choice], model.signals)
            numbers.append(range(len(columns), len(columns) + len(added)))
            columns += added
        n_columns = len(columns)
        pairs = []
        for place in places:
            own, value = numbers[place.choice], place.get_value(choices)
            ends = [place.apply_change(value, way * place.to_change(TINY)) for way in (1.0, -1.0)]
            first = len(columns)
            for end in ends:
                columns += build_columns(
                    [replace_shape_value(choices[place.choice], place.spec.name, end)], model.signals
                )
            pairs.append([(k, first + i, first + len(own) + i) for i, k in enumerate(own)])
        # One pass over the data for all derivatives: the shifted columns are sampled and filtered beside the others.
        observation = model.observation.extend(columns[model.n_parameters :], model.signals)
        reduction = reduce_recordings(observation, inputs, by_time=by_time)
        if noise is None:
            # Of the model with the choices: without them, a joint that lacks much would hardly count.
            here = reduction.select_columns(list(range(n_columns)))
            levels = compute_noise_levels(here, _solve_values(here, np.ones(len(here.equations))))
            noise = compute_noise_levels(here, _solve_values(here, levels))
        return cls(reduction, noise, n_columns, pairs, [2.0 * place.to_change(TINY) for place in places])

    def select_constants(self, numbers: Sequence[int]) -> _ShapeDerivatives:
        """Return the same for some of the constants."""
        return replace(self, pairs=[self.pairs[k] for k in numbers], widths=[self.widths[k] for k in numbers])

    def find_contradicted(self) -> BoolArray:
        """Tell which constants (k,) have a value outside of the interval that the data give.

        None where the data do not determine all columns.
        """
        none = np.zeros(len(self.pairs), dtype=bool)
        try:
            solution = solve(self.reduction.select_columns(list(range(self.n_columns))), self.noise)
            linearisation = linearise_constants(
                self.reduction.combine_columns(self._combine_slopes(solution.values)),
                solution,
                np.full(len(none), _WIDE),
                "by_time_and_joints",
            )
        except EstimationError:
            return none
        return np.asarray(np.abs(linearisation.steps) > linearisation.statistics.half_widths(_LEVEL)[self.n_columns :])

    def _combine_slopes(self, values: FloatArray) -> FloatArray:
        """Return the columns, and the derivatives by the constants, as combinations (c, n_columns + k)."""
        whole = np.zeros((self.reduction.n_columns, self.n_columns + len(self.pairs)))
        whole[: self.n_columns, : self.n_columns] = np.eye(self.n_columns)
        for number, (own, width) in enumerate(zip(self.pairs, self.widths, strict=True)):
            for k, above, below in own:
                whole[above, self.n_columns + number] += values[k] / width
                whole[below, self.n_columns + number] -= values[k] / width
        return whole

    def compute_step(self) -> tuple[float, FloatArray]:
        """Return the squared error here, and the changes (k,) of the constants that would make it smallest."""
        factor = build_weighted_factor(self.reduction, self.noise)
        columns, y = factor[:, :-1], factor[:, -1]
        # First the linear parameters alone: the derivatives by the constants are theirs times the slopes of the
        # columns.
        values, error = _solve_least_squares(columns[:, : self.n_columns], y)
        together, _ = _solve_least_squares(columns @ self._combine_slopes(values), y)
        return error, together[self.n_columns :]


def _solve_values(reduction: Reduction, noise: FloatArray) -> FloatArray:
    factor = build_weighted_factor(reduction, noise)
    return _solve_least_squares(factor[:, :-1], factor[:, -1])[0]


def _solve_least_squares(w: FloatArray, y: FloatArray) -> tuple[FloatArray, float]:
    """Return the least-squares solution for columns that may depend on one another, and its squared error."""
    sizes = np.linalg.norm(w, axis=0)
    scaled = w / np.where(sizes > 0, sizes, 1.0)
    scaled_values = np.linalg.lstsq(scaled, y, rcond=1e-10)[0]
    rest = y - scaled @ scaled_values
    return scaled_values / np.where(sizes > 0, sizes, 1.0), float(rest @ rest)


def reduce_with_shapes(
    model: Model,
    values: FloatArray,
    inputs: RegressorInputs,
    known: CachedRows | None,
    progress: Progress = ignore_progress,
) -> Reduction | None:
    """Reduce recordings to a model's columns and, behind them, the derivatives of its torque by its shape constants.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    values : (b,)
        Parameters that the derivatives are taken at.
    inputs : RegressorInputs
        Recordings of the fit, their filters, and what torque is predicted with.
    known : CachedRows or None
        Rows of the model or of one that it extends, where they are in memory.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    Reduction or None
        None for a model without shape constants.
    """
    places = list_shape_variables(model.effects)
    if not places:
        return None
    return reduce_with_columns(model, build_shape_columns(model, values, places), inputs, progress, known)
