"""Decide whether what was added to a model helps on data that no parameter saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import get_effect
from dynident.estimation import Reduction
from dynident.identification.study.result import Identification

SURE_T, _CHANCE = 2.0, 1.0
"""t of the gain over the stretches: surely above zero from the first on; below the second, less than its own spread."""

# Ratio of held-out errors from which on a joint is said to be worse.
_WORSE = 1.02
# Blocks from which a spread can be told.
_FEWEST = 4
_ROUNDING = 1.0 + 1e-6
"""Errors that differ by less are the same: what is added and removed again leaves so much."""


def list_addition_warnings(grown: Identification) -> tuple[str, ...]:
    """Return warnings where an addition does not help on held-out data, or not surely, or where a joint got worse.

    Parameters
    ----------
    grown : Identification
        With the step from the model that was added to.

    Returns
    -------
    tuple of str
        Sentences for the user.
    """
    parent = grown.step.parent
    if parent is None or grown.held_out is None or parent.held_out is None:
        return ()
    titles = " and ".join(dict.fromkeys(get_effect(choice.effect).title for choice in grown.step.added))
    before, after = parent.held_out.relative_total, grown.held_out.relative_total
    sentences = []
    t = _compute_t_of_gain(parent, grown)
    errors = f"on held-out recordings the error changes from {before:.2%} to {after:.2%}"
    # t compares in the parent's noise and by blocks; the total error has to fall as well.
    if t < _CHANCE or after >= before:
        by_chance = ", no more than by chance" if t > -_CHANCE else ""
        sentences.append(
            f"Held-out data do not confirm {titles}: {errors} (t = {t:.1f}){by_chance}. Remove it unless you know "
            "that it exists."
        )
    elif t < SURE_T:
        sentences.append(
            f"{titles} helps, but this is not certain: {errors}, unevenly over the motion (t = {t:.2f}; certain from "
            f"{SURE_T:g}). Hold out another motion before you rely on it."
        )
    names = grown.model.robot.joint_names
    old, new = parent.held_out.relative, grown.held_out.relative
    # An addition may help on the whole and hurt a joint, which a total hides.
    worse = [f"{name} ({old[j]:.2%} to {new[j]:.2%})" for j, name in enumerate(names) if new[j] > _WORSE * old[j]]
    if worse:
        sentences.append(f"With {titles} the held-out error is larger on {', '.join(worse)}.")
    return tuple(sentences)


@dataclass(frozen=True)
class BestStep:
    """The step of a ladder with the smallest held-out error, and those after it that raise that error.

    Parameters
    ----------
    best : int
        Number of the best step, from the first model of the ladder on.
    rises : tuple of int
        Steps above the best one whose held-out error is larger than the best one's.
    """

    best: int
    rises: tuple[int, ...]


def find_best_step(models: Sequence[Identification]) -> BestStep | None:
    """Return the model of a ladder that predicts held-out data best; None where one of them has no held-out error.

    Parameters
    ----------
    models : sequence of Identification
        The ladder, first model first.

    Returns
    -------
    BestStep or None
        The best step, and those after it that raise the error.
    """
    totals = [model.held_out.relative_total for model in models if model.held_out is not None]
    return find_best_of_errors(totals) if len(totals) == len(models) else None


def find_best_of_errors(totals: Sequence[float]) -> BestStep | None:
    """Return the best step by the held-out errors of a ladder's models, over all joints; None where there are none.

    Parameters
    ----------
    totals : sequence of float
        Held-out errors, the first model's first.

    Returns
    -------
    BestStep or None
        The best step, and those after it that raise the error.
    """
    if not totals:
        return None
    best = int(np.argmin(totals))
    return BestStep(best, tuple(k for k in range(best + 1, len(totals)) if totals[k] > _ROUNDING * totals[best]))


def _compute_t_of_gain(parent: Identification, grown: Identification) -> float:
    """Return t of the drop of the squared held-out error over blocks of time, all joints in units of their noise."""
    # Both models are measured in the parent's noise: in its own, the better model would be judged by the stricter
    # rule.
    before, after = _compute_block_errors(parent, parent.noise), _compute_block_errors(grown, parent.noise)
    if len(before) != len(after) or len(before) < _FEWEST:
        # Held-out data of another kind: nothing to compare stretch by stretch.
        return SURE_T
    return compute_t(before - after)


def compute_t(gains: FloatArray) -> float:
    """Return t of the gains (s,) in blocks of time; 0 where all gain the same, or there is one alone.

    Parameters
    ----------
    gains : (s,)
        Drop of the squared error in every block.

    Returns
    -------
    float
        The mean gain over its standard error.
    """
    # Blocks, not samples: residuals are correlated within a block.
    spread = float(gains.std(ddof=1)) if len(gains) > 1 else 0.0
    return float(gains.mean() / spread * np.sqrt(len(gains))) if spread > 0 else 0.0


def _compute_block_errors(model: Identification, noise: FloatArray) -> FloatArray:
    """Return the squared held-out error of every block (s,), each joint in units of its noise (n,)."""
    held_out = model.data.held_out
    return np.zeros(0) if held_out is None else compute_block_squares(held_out, model.values, noise)


def compute_block_squares(data: Reduction, values: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the squared error of every block of time (s,) for parameters (b,), each joint in units of its noise (n,).

    Parameters
    ----------
    data : Reduction
        The joints' torques in blocks of time.
    values : (b,)
        Base parameters.
    noise : (n,)
        Standard deviation of each joint's residual; 0 counts as 1.
    """
    parts: Sequence[FloatArray] = [
        equation.sum_squares(values) / sigma**2
        for equation, sigma in zip(data.equations, np.where(noise > 0, noise, 1.0), strict=True)
    ]
    return np.asarray(np.sum(parts, axis=0))
