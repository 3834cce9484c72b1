"""Optimised periodic trajectories: augmented Lagrangian and L-BFGS with exact gradients, from several starts.

A third of a start's iterations bring it most of the way and tell what it is worth. Starts are therefore tried in heats:
all of a heat go that far, then they are finished in the order of what they have reached. As many are worked on at a
time as there are processors, by threads: a start knows nothing of the others, so it reaches the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from threading import Lock

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from dynident.arrays import FloatArray
from dynident.checkpoints import Checkpoints, NoCheckpoints
from dynident.excitation.optimising.budget import Budget
from dynident.excitation.optimising.problem import DesignProblem, Evaluation, Multipliers
from dynident.excitation.optimising.random_trajectories import Candidate, Judge
from dynident.excitation.optimising.reached import Reached, StartReached
from dynident.motion.limits.shrinking import Shrinking
from dynident.progress import Progress
from dynident.side_by_side import WORTH, processors, side_by_side

_PENALTY = 1.0
_PENALTY_GROWTH = 4.0
_ENOUGH_PROGRESS = 0.3
"""The worst excess must fall to this share of the last one, or the penalty grows."""
_ITERATIONS = (40, 30, 30, 30, 30, 30)
_SKETCH = 2
"""Rounds after which a start shows what it is worth."""
_HEAT = 4
_SMALL_EXCESS = 2e-3
"""Within what the margin between samples leaves: shrinking takes the rest."""
_SETTLED = 2e-3
_CORRECTIONS = 20
_NUMBERS = ("rounds", "iterations", "finished", "counted", "_worst", "_before")


@dataclass(frozen=True)
class Course:
    """Where a search comes from, if it was stopped, and where it keeps how far it is."""

    checkpoints: Checkpoints = field(default_factory=NoCheckpoints)
    before: Reached | None = None


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
    course: Course = Course(),
) -> Optimisation:
    """Improve random candidates, best first, until the budget is spent.

    What is returned keeps the limits on a fine grid and is never worse than the best candidate. A start that the
    budget cuts short still counts with what it has reached; one that was stopped from outside goes on from `course`.
    """
    *_, last = search(problem, shrinking, judge, candidates, budget, progress, course)
    return last


def search(
    problem: DesignProblem,
    shrinking: Shrinking,
    judge: Judge,
    candidates: Sequence[Candidate],
    budget: Budget,
    progress: Progress,
    course: Course = Course(),
) -> Iterator[Optimisation]:
    """The same step by step: what there is at first, after every sketch of a start and after its end."""
    before = course.before
    found = Optimisation(candidates[0], 0, budget.spent)
    if before is not None:
        found = Optimisation(Candidate(before.best, judge.values(before.best)), before.completed, budget.spent)
    yield found
    wanted = len(candidates) if budget.starts is None else min(budget.starts, len(candidates))
    problems = [problem]
    for first in range(0 if before is None else before.first, wanted, _HEAT):
        heat = [_Start(problem, k, candidates[k].x) for k in range(first, min(first + _HEAT, wanted))]
        worth: dict[int, float] = {}
        if before is not None and before.first == first:
            for start, reached_before in zip(heat, before.starts, strict=False):
                start.go_on_from(reached_before)
        for rounds in (_SKETCH, len(_ITERATIONS)):
            ordered = sorted(heat, key=lambda one: worth.get(one.number, 0.0))
            left = [one for one in ordered if not one.counted and one.rounds <= rounds]  # else done before it stopped
            while left:
                if budget.spent:
                    return
                together, left = left[: processors()], left[processors() :]
                problems += [problem.apart() for _ in together[len(problems) :]]
                for start, own in zip(together, problems, strict=False):
                    start.problem = own
                telling = _Telling(candidates, found, first, heat, budget, progress, course.checkpoints)
                _advance(together, rounds, telling)
                for start in together:
                    reached = _within_limits(start.x, shrinking, judge)
                    worth[start.number] = np.inf if reached is None else reached.values.criterion
                    found = _with(found, reached, start.finished, budget)
                    start.counted = start.finished
                    yield found
                if any(start.counted for start in together):
                    course.checkpoints.keep(partial(_reached, candidates, found, first, heat, budget))


def _advance(starts: Sequence[_Start], rounds: int, telling: _Telling) -> None:
    """Bring starts so many rounds far, side by side, as far as the time allows."""

    def advance(start: _Start, told: Progress) -> None:
        while start.rounds < rounds and not start.finished and not telling.budget.spent:
            start.advance(telling.budget, lambda at: told(0.0, telling.message(start, at)))
            telling.keep(start)

    side_by_side(advance, starts, [WORTH] * len(starts), telling)


@dataclass(eq=False)
class _Telling:
    """Says how far a heat is, in the thread that began the search, and keeps it after every round of a start."""

    candidates: Sequence[Candidate]
    found: Optimisation
    first: int
    heat: Sequence[_Start]
    budget: Budget
    progress: Progress
    checkpoints: Checkpoints
    _one: Lock = field(default_factory=Lock)

    def message(self, start: _Start, at: Evaluation) -> str:
        """What is said of an iteration of a start."""
        return (
            f"start {start.number + 1}, iteration {start.iterations}: criterion {np.exp(at.criterion):.4g}, "
            f"tightest limit at {100 * (1 + at.worst):.0f} %; best within the limits "
            f"{self.found.best.values.criterion:.4g}, best random {self.candidates[0].values.criterion:.4g}"
        )

    def __call__(self, _: float, message: str) -> None:
        """Tell it, with how far the whole search is; raises what stops the search."""
        if message:
            self.progress(self.budget.fraction(self.first + sum(one.share_done for one in self.heat)), message)

    def keep(self, start: _Start) -> None:
        """Keep a checkpoint after a round of a start, whose thread this is, if it is time."""
        with self._one:
            start.settle()
            self.checkpoints.keep(partial(_reached, self.candidates, self.found, self.first, self.heat, self.budget))


def _reached(
    candidates: Sequence[Candidate], found: Optimisation, first: int, heat: Sequence[_Start], budget: Budget
) -> bytes:
    drawn = np.array([one.x for one in candidates])
    starts = tuple(start.reached() for start in heat)
    return Reached(budget.taken, drawn, found.best.x, first, found.starts, starts).to_bytes()


def _within_limits(x: FloatArray, shrinking: Shrinking, judge: Judge) -> Candidate | None:
    fitting = shrinking.shrink(x)
    return None if fitting is None else Candidate(fitting, judge.values(fitting))


def _with(found: Optimisation, reached: Candidate | None, finished: bool, budget: Budget) -> Optimisation:
    better = reached is not None and reached.values.criterion < found.best.values.criterion
    best = reached if reached is not None and better else found.best
    return Optimisation(best, found.starts + finished, budget.spent)


@dataclass(eq=False)
class _Start:
    """One run of the augmented Lagrangian, from coefficients x (m, n) on, some rounds at a time."""

    problem: DesignProblem
    number: int
    x: FloatArray
    iterations: int = 0
    finished: bool = False
    counted: bool = False
    rounds: int = 0
    _worst: float = np.inf
    _before: float = np.inf
    _multipliers: Multipliers = field(init=False)
    _reached: StartReached = field(init=False)

    def __post_init__(self) -> None:
        self._multipliers = self.problem.no_multipliers(_PENALTY)
        self.settle()

    @property
    def share_done(self) -> float:
        """Rounds that are done, of those that it may take."""
        return 1.0 if self.finished else self.rounds / len(_ITERATIONS)

    def reached(self) -> StartReached:
        """How far it had come when its last round was over; another thread may be in the midst of the next."""
        return replace(self._reached, numbers={**self._reached.numbers, "counted": float(self.counted)})

    def settle(self) -> None:
        """A round is over: this is how far it has come, until the next one is."""
        numbers = {name: float(getattr(self, name)) for name in _NUMBERS}
        multipliers = self._multipliers
        arrays = {"x": self.x, "values": multipliers.values, "crowding": multipliers.crowding}
        self._reached = StartReached({**numbers, "penalty": multipliers.penalty}, arrays)

    def go_on_from(self, before: StartReached) -> None:
        """Go on from where it was."""
        for name in _NUMBERS:
            setattr(self, name, type(getattr(self, name))(before.numbers[name]))
        arrays = before.arrays
        self.x = arrays["x"]
        self._multipliers = Multipliers(arrays["values"], arrays["crowding"], before.numbers["penalty"])
        self.settle()

    def advance(self, budget: Budget, tell: Callable[[Evaluation], None]) -> None:
        """Do one more round, as far as the time allows."""
        descent = _Descent(self.problem, self._multipliers)

        def after_iteration(intermediate_result: OptimizeResult) -> None:
            self.iterations += 1
            tell(descent.last)
            if budget.spent:
                raise StopIteration

        result = minimize(
            descent,
            self.x.ravel(),
            jac=True,
            method="L-BFGS-B",
            callback=after_iteration,
            options={"maxiter": _ITERATIONS[self.rounds], "maxcor": _CORRECTIONS, "gtol": 1e-5, "ftol": 1e-10},
        )
        self.x = result.x.reshape(self.x.shape)
        at = self.problem.evaluate(result.x, self._multipliers)
        if budget.spent:
            return
        self.rounds += 1
        settled = abs(self._before - at.criterion) < _SETTLED
        self.finished = bool(self.rounds == len(_ITERATIONS) or (at.worst < _SMALL_EXCESS and settled))
        enough = at.worst < _ENOUGH_PROGRESS * self._worst
        self._multipliers = self._multipliers.raised(
            at, self._multipliers.penalty * (1.0 if enough else _PENALTY_GROWTH)
        )
        self._worst, self._before = at.worst, at.criterion


class _Descent:
    """The function that L-BFGS minimises; remembers its last evaluation for the progress report."""

    def __init__(self, problem: DesignProblem, multipliers: Multipliers) -> None:
        self._problem, self._multipliers = problem, multipliers
        self.last: Evaluation

    def __call__(self, flat: FloatArray) -> tuple[float, FloatArray]:
        self.last = self._problem.evaluate(flat, self._multipliers)
        return self.last.lagrangian, self.last.gradient
