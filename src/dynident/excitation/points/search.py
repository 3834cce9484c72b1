"""Search of point sequences: random ones, then the best of them improved by accepted variations.

The criterion is not smooth in the points: a move's path changes where another joint or limit becomes the slowest.
A move depends on its two ends alone, so a varied point costs two moves, as in exchange algorithms of optimal design
(Fedorov 1972); the size of the variations follows the share of those that succeed (Rechenberg's one-fifth rule).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.excitation.criteria.deciding import DesignCriterion
from dynident.excitation.criteria.values import CriterionValues
from dynident.excitation.optimising.budget import Budget
from dynident.excitation.points.sequence import MovePlanner, PointSequence, evaluate_moves, stack_rows
from dynident.excitation.points.spaces import PointSpace
from dynident.motion.limits.bounds import ImpossibleLimitsError
from dynident.progress import Progress

_REDRAWN = 20
"""Number of times that a point may be drawn again."""
_FIRST_SIZE, _SMALLEST_SIZE, _LARGEST_SIZE = 0.2, 0.005, 0.5
_GROWTH = 1.3
"""Growth of the variations after a success; four failures undo it."""


@dataclass(frozen=True, eq=False)
class EvaluatedSequence:
    """A sequence that keeps the limits, and its criterion values."""

    sequence: PointSequence
    values: CriterionValues


def draw_sequences(
    space: PointSpace,
    legs: MovePlanner,
    yardstick: DesignCriterion,
    *,
    count: int,
    rng: np.random.Generator,
    progress: Progress,
    enough: Callable[[], bool] = lambda: False,
) -> list[EvaluatedSequence]:
    """Return `count` random sequences that keep the limits, best first; fewer where `enough` says so once there is one.

    Raises
    ------
    ImpossibleLimitsError
        None of many keeps the limits.
    """
    sequences: list[EvaluatedSequence] = []
    for index in range(count):
        if sequences and enough():
            break
        progress(index / count, f"random sequence {index + 1} of {count}")
        sequence = _draw_within_limits(space, legs, rng)
        moves = legs.plan_sequence(sequence)
        if moves is not None:
            sequences.append(EvaluatedSequence(sequence, evaluate_moves(moves, yardstick)))
    if not sequences:
        raise ImpossibleLimitsError(
            f"None of {count} random sequences of moves, each point drawn up to {_REDRAWN} times, keeps the limits of "
            "torque and clearance; raise them, or let fewer points do.",
            pointer="/limits",
            title="Impossible limits",
        )
    return sorted(sequences, key=lambda candidate: candidate.values.criterion)


def _draw_within_limits(space: PointSpace, legs: MovePlanner, rng: np.random.Generator) -> PointSequence:
    """Return a random sequence, point after point drawn again until the moves keep the limits, or many times."""
    sequence = space.draw(rng)
    for _ in range(_REDRAWN * len(sequence.points)):
        k = legs.find_first_broken(sequence)
        if k is None:
            break
        sequence = space.redraw(sequence, k, rng)
    return sequence


def improve_sequence(
    first: PointSequence,
    space: PointSpace,
    legs: MovePlanner,
    yardstick: DesignCriterion,
    *,
    variations: int,
    rng: np.random.Generator,
    budget: Budget,
    progress: Progress,
) -> tuple[PointSequence, bool]:
    """Return the sequence after so many variations, and whether the time allowed all of them."""
    criterion = yardstick.smooth_criterion
    moves = legs.plan_sequence(first)
    assert moves is not None
    best, value, size = first, criterion(stack_rows(moves))[0], _FIRST_SIZE
    for index in range(variations):
        if budget.is_spent:
            return best, False
        progress(index / variations, f"variation {index + 1}: criterion {np.exp(value):.4g}")
        neighbour = space.vary(best, rng, size)
        moves = legs.plan_sequence(neighbour)
        reached = np.inf if moves is None else criterion(stack_rows(moves))[0]
        if reached < value:
            best, value, size = neighbour, reached, min(_GROWTH * size, _LARGEST_SIZE)
        else:
            size = max(size * _GROWTH**-0.25, _SMALLEST_SIZE)
    return best, True
