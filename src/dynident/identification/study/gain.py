"""Whether what was added to a model helps on data that no parameter saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import effect_by_id
from dynident.estimation import Reduction
from dynident.identification.study.result import Identification

SURE, _CHANCE = 2.0, 1.0
"""t of the gain over the stretches: surely above zero from the first on; below the second, less than its own spread."""

_WORSE = 1.02
_FEWEST = 4
_ROUNDING = 1.0 + 1e-6
"""Errors that differ by less are the same: what is added and removed again leaves so much."""


def warnings_of_addition(grown: Identification) -> tuple[str, ...]:
    """Where an addition does not survive held-out data, or not surely, or where a joint got worse by it.

    Parameters
    ----------
    grown : Identification
        With the step from the model that was added to.
    """
    parent = grown.step.parent
    if parent is None or grown.held_out is None or parent.held_out is None:
        return ()
    what = " and ".join(dict.fromkeys(effect_by_id(choice.effect).title for choice in grown.step.added))
    before, after = parent.held_out.relative_total, grown.held_out.relative_total
    found = []
    t = _t_of_gain(parent, grown)
    errors = f"on recordings that no parameter saw the error goes from {before:.2%} to {after:.2%}"
    if t < _CHANCE or after >= before:
        by_chance = ", no more than chance would do" if t > -_CHANCE else ""
        found.append(
            f"{what} does not survive held-out data: {errors} (t = {t:.1f}){by_chance}. Remove it unless you know that "
            "it is there."
        )
    elif t < SURE:
        found.append(
            f"{what} helps, but not surely: {errors}, unevenly over the motion (t = {t:.2f}, where {SURE:g} would be "
            "sure). Hold out another motion before you rely on it."
        )
    names = grown.model.robot.joint_names
    old, new = parent.held_out.relative, grown.held_out.relative
    worse = [f"{name} ({old[j]:.2%} to {new[j]:.2%})" for j, name in enumerate(names) if new[j] > _WORSE * old[j]]
    if worse:
        found.append(f"With {what} the held-out error is larger on {', '.join(worse)}.")
    return tuple(found)


@dataclass(frozen=True)
class BestRung:
    """The rung of a ladder with the smallest held-out error, and those after it that raise that error.

    Indices count from the first model of the ladder; `rises` names each rung above the best one whose held-out error is
    larger than the best one's.
    """

    best: int
    rises: tuple[int, ...]


def best_rung(models: Sequence[Identification]) -> BestRung | None:
    """Which model of a ladder predicts held-out data best; None where one of them was not tried on any."""
    totals = [model.held_out.relative_total for model in models if model.held_out is not None]
    return best_of(totals) if len(totals) == len(models) else None


def best_of(totals: Sequence[float]) -> BestRung | None:
    """The same from the held-out errors of a ladder's models, over all joints; None where there are none."""
    if not totals:
        return None
    best = int(np.argmin(totals))
    return BestRung(best, tuple(k for k in range(best + 1, len(totals)) if totals[k] > _ROUNDING * totals[best]))


def _t_of_gain(parent: Identification, grown: Identification) -> float:
    """t of the drop of the held-out squared error over stretches of time, all joints in units of their noise."""
    before, after = _stretch_errors(parent, parent.noise), _stretch_errors(grown, parent.noise)
    if len(before) != len(after) or len(before) < _FEWEST:
        # Held-out data of another kind: nothing to compare stretch by stretch.
        return SURE
    return t_of(before - after)


def t_of(gains: FloatArray) -> float:
    """t of what was gained in every stretch (s,) of time; 0 where all gain the same, or there is one alone."""
    spread = float(gains.std(ddof=1)) if len(gains) > 1 else 0.0
    return float(gains.mean() / spread * np.sqrt(len(gains))) if spread > 0 else 0.0


def _stretch_errors(model: Identification, noise: FloatArray) -> FloatArray:
    """(s,): squared held-out error of every stretch, each joint in units of its noise (n,)."""
    held_out = model.data.held_out
    return np.zeros(0) if held_out is None else stretch_squares(held_out, model.values, noise)


def stretch_squares(data: Reduction, values: FloatArray, noise: FloatArray) -> FloatArray:
    """(s,): squared error of every stretch for parameters (b,), each joint in units of its noise (n,)."""
    parts: Sequence[FloatArray] = [
        equation.squares(values) / sigma**2
        for equation, sigma in zip(data.equations, np.where(noise > 0, noise, 1.0), strict=True)
    ]
    return np.asarray(np.sum(parts, axis=0))
