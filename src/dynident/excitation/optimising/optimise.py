"""Optimised periodic trajectories: augmented Lagrangian and L-BFGS with exact gradients, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from dynident.excitation.limits.shrinking import Shrinking
from dynident.excitation.optimising.budget import Budget
from dynident.excitation.optimising.problem import DesignProblem, Evaluation, Multipliers
from dynident.excitation.optimising.random_trajectories import Candidate, Judge
from dynident.progress import Progress
from dynident.robot.model import FloatArray

_PENALTY = 1.0
_PENALTY_GROWTH = 4.0
_ENOUGH_PROGRESS = 0.3
"""The worst excess must fall to this share of the last one, or the penalty grows."""
_ITERATIONS = (40, 30, 30, 30, 30, 30)
_SMALL_EXCESS = 2e-3
"""Within what the margin between samples leaves: shrinking takes the rest."""
_SETTLED = 2e-3
_CORRECTIONS = 20


@dataclass(frozen=True, eq=False)
class Optimisation:
    """The best candidate found, how many starts were completed, and whether the time ran out."""

    best: Candidate
    starts: int
    out_of_time: bool


def optimise(
    problem: DesignProblem,
    shrinking: Shrinking,
    judge: Judge,
    candidates: Sequence[Candidate],
    budget: Budget,
    progress: Progress,
) -> Optimisation:
    """Improve random candidates, best first, one after the other, until the budget is spent.

    What is returned keeps the limits on a fine grid and is never worse than the best candidate. A start that the
    budget cuts short still counts with what it has reached.
    """
    best, completed = candidates[0], 0
    wanted = len(candidates) if budget.starts is None else min(budget.starts, len(candidates))
    for index in range(wanted):
        if budget.spent:
            break

        def tell(iteration: int, done: float, at: Evaluation, start: int = index) -> None:
            progress(
                budget.fraction(start, done),
                f"start {start + 1}, iteration {iteration}: criterion {np.exp(at.criterion):.4g}, "
                f"tightest limit at {100 * (1 + at.worst):.0f} %",
            )

        x, finished = _one_start(problem, candidates[index].x, budget, tell)
        fitting = shrinking.shrink(x)
        completed += finished
        if fitting is not None:
            reached = Candidate(fitting, judge.values(fitting))
            if reached.values.criterion < best.values.criterion:
                best = reached
    return Optimisation(best, completed, budget.spent)


def _one_start(
    problem: DesignProblem, x: FloatArray, budget: Budget, tell: Callable[[int, float, Evaluation], None]
) -> tuple[FloatArray, bool]:
    """Coefficients (m, n) after one run of the augmented Lagrangian, and whether it came to its end."""
    multipliers = problem.no_multipliers(_PENALTY)
    flat, iterations = x.ravel().copy(), 0
    worst, before = np.inf, np.inf
    for number, allowed in enumerate(_ITERATIONS):
        descent = _Descent(problem, multipliers)

        def after_iteration(
            intermediate_result: OptimizeResult, descent: _Descent = descent, number: int = number
        ) -> None:
            nonlocal iterations
            iterations += 1
            tell(iterations, (number + 0.5) / len(_ITERATIONS), descent.last)
            if budget.spent:
                raise StopIteration

        result = minimize(
            descent,
            flat,
            jac=True,
            method="L-BFGS-B",
            callback=after_iteration,
            options={"maxiter": allowed, "maxcor": _CORRECTIONS, "gtol": 1e-5, "ftol": 1e-10},
        )
        flat = result.x
        at = problem.evaluate(flat, multipliers)
        if budget.spent:
            return flat.reshape(x.shape), False
        settled = abs(before - at.criterion) < _SETTLED
        if at.worst < _SMALL_EXCESS and settled:
            break
        penalty = multipliers.penalty * (1.0 if at.worst < _ENOUGH_PROGRESS * worst else _PENALTY_GROWTH)
        multipliers = multipliers.raised(at, penalty)
        worst, before = at.worst, at.criterion
    return flat.reshape(x.shape), True


class _Descent:
    """The function that L-BFGS minimises; remembers its last evaluation for the progress report."""

    def __init__(self, problem: DesignProblem, multipliers: Multipliers) -> None:
        self._problem, self._multipliers = problem, multipliers
        self.last: Evaluation

    def __call__(self, flat: FloatArray) -> tuple[float, FloatArray]:
        self.last = self._problem.evaluate(flat, self._multipliers)
        return self.last.lagrangian, self.last.gradient
