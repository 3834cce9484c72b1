"""Columns of the derivatives of torque by shape constants, for linearised estimates of these constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column, EffectChoice, Refinement, ShapeSpec, Signals, build_columns, get_effect
from dynident.regressors.model import Model

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
