"""Solver of trajectory designs: augmented Lagrangian with L-BFGS from several starts, and its checkpoints.

Holds penalties, iterations and when a start has settled.

A third of a start's iterations bring it most of the way and show what it is worth. Starts are therefore processed in
heats: all of a heat go that far, then they are finished in the order of what they have reached. As many run at a
time as there are processors, in threads: starts are independent, so the number of threads does not change the result.
A checkpoint holds, as bytes, all that a search needs to continue as if it had never been stopped.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from threading import Lock

import numpy as np
import scipy

from dynident.array_types import FloatArray
from dynident.excitation.optimisation.design_problem import (
    Budget,
    Candidate,
    CandidateEvaluator,
    DesignProblem,
    Evaluation,
    Multipliers,
)
from dynident.motion.limits.limit_margins import AmplitudeScaler
from dynident.number_format import format_percent
from dynident.parallel import MIN_PARALLEL_SIZE, count_processors, map_in_threads
from dynident.progress import Checkpoints, NoCheckpoints, Progress
from dynident.version import __version__


@dataclass(frozen=True, eq=False)
class StartState:
    """State of one start, which only the start itself understands.

    Parameters
    ----------
    numbers : mapping of str to float
        Numbers of the state by name.
    arrays : mapping of str to ndarray
        Arrays of the state by name.
    """

    numbers: Mapping[str, float]
    arrays: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class SearchCheckpoint:
    """State of a stopped search.

    Parameters
    ----------
    seconds : float
        Time that it took.
    candidates : (k, m, n)
        Its random trajectories.
    best : (m, n)
        The best coefficients so far.
    first : int
        Number of the first start of the current heat.
    completed : int
        Number of all completed starts.
    starts : sequence of StartState
        States of the starts of the current heat.
    """

    seconds: float
    candidates: FloatArray
    best: FloatArray
    first: int = 0
    completed: int = 0
    starts: Sequence[StartState] = field(default=())

    def to_bytes(self) -> bytes:
        """Return the state as bytes."""
        header = {
            "dynident": __version__,
            "seconds": self.seconds,
            "first": self.first,
            "completed": self.completed,
            "starts": [dict(start.numbers) for start in self.starts],
        }
        arrays = {"candidates": self.candidates, "best": self.best}
        for k, start in enumerate(self.starts):
            # An .npz file is flat, so that the names of arrays carry the number of their start.
            arrays |= {f"start{k}.{name}": value for name, value in start.arrays.items()}
        with io.BytesIO() as file:
            np.savez(file, said=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)  # type: ignore[arg-type]
            return file.getvalue()


def read_checkpoint(content: bytes | None) -> SearchCheckpoint | None:
    """Read a state from bytes; None where there is none, or another version wrote it."""
    if content is None:
        return None
    try:
        # Without pickle a damaged or foreign file cannot run code.
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            header = json.loads(arrays["said"].tobytes())
            # Another version may search differently: continuing would give a result that neither version gives alone.
            if header["dynident"] != __version__:
                return None
            starts = []
            for k, numbers in enumerate(header["starts"]):
                of_start = f"start{k}."
                named = {
                    name.removeprefix(of_start): arrays[name] for name in arrays.files if name.startswith(of_start)
                }
                starts.append(StartState(numbers, named))
            return SearchCheckpoint(
                header["seconds"],
                arrays["candidates"],
                arrays["best"],
                header["first"],
                header["completed"],
                tuple(starts),
            )
    # A checkpoint that cannot be read is no error: the search then begins anew.
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile):
        return None


# First weight of the penalty, and its growth where the excess does not fall by itself.
_PENALTY = 1.0
_PENALTY_GROWTH = 4.0
_ENOUGH_PROGRESS = 0.3
"""The worst excess must fall to this share of the last one, or the penalty grows."""
# Iterations of L-BFGS in each round; the first one has the longest way to go.
_ITERATIONS = (40, 30, 30, 30, 30, 30)
_SKETCH = 2
"""Number of rounds after which a start shows what it is worth."""
# Starts of a heat, which are brought as far as a sketch before any is finished.
_HEAT = 4
_SMALL_EXCESS = 2e-3
"""Excess that is within the margin left between samples: scaling the amplitude removes the rest."""
# Change of the criterion, which is a logarithm, below which a start has settled.
_SETTLED = 2e-3
# Pairs of steps and gradients by which L-BFGS approximates the curvature.
_CORRECTIONS = 20
# Attributes of a start that a checkpoint holds besides its arrays.
_NUMBERS = ("rounds", "iterations", "finished", "counted", "_worst", "_before")


@dataclass(frozen=True)
class Resumption:
    """Checkpoint that a stopped search continues from, and where it keeps new ones.

    Parameters
    ----------
    checkpoints : Checkpoints
        Storage for new checkpoints.
    before : SearchCheckpoint, optional
        Checkpoint to continue from; None to begin anew.
    """

    checkpoints: Checkpoints = field(default_factory=NoCheckpoints)
    before: SearchCheckpoint | None = None


@dataclass(frozen=True, eq=False)
class Optimisation:
    """State of a search: the best candidate, and how much of the budget is used.

    Parameters
    ----------
    best : Candidate
        The best candidate so far.
    starts : int
        Number of starts that were completed.
    out_of_time : bool
        Whether the time ran out.
    """

    best: Candidate
    starts: int
    out_of_time: bool


def optimise_trajectories(
    problem: DesignProblem,
    shrinking: AmplitudeScaler,
    judge: CandidateEvaluator,
    candidates: Sequence[Candidate],
    budget: Budget,
    progress: Progress,
    course: Resumption = Resumption(),
) -> Optimisation:
    """Improve random candidates, best first, until the budget is spent.

    The result keeps the limits on a fine grid and is never worse than the best candidate. A start that the
    budget cuts short still counts with what it has reached; a search that was stopped from outside continues from
    `course`.

    Parameters
    ----------
    problem : DesignProblem
        Criterion and limits over the coefficients.
    shrinking : AmplitudeScaler
        Brings coefficients within the limits.
    judge : CandidateEvaluator
        Gives the true criterion values.
    candidates : sequence of Candidate
        Random candidates, best first.
    budget : Budget
        Time and number of starts.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    course : Resumption
        Where to continue from, and where to keep checkpoints.

    Returns
    -------
    Optimisation
        The best candidate at the end.
    """
    *_, last = search_stepwise(problem, shrinking, judge, candidates, budget, progress, course)
    return last


def search_stepwise(
    problem: DesignProblem,
    shrinking: AmplitudeScaler,
    judge: CandidateEvaluator,
    candidates: Sequence[Candidate],
    budget: Budget,
    progress: Progress,
    course: Resumption = Resumption(),
) -> Iterator[Optimisation]:
    """Do the same as `optimise_trajectories` step by step.

    Yields
    ------
    Optimisation
        At first, after every sketch of a start, and after its end.
    """
    before = course.before
    best_so_far = Optimisation(candidates[0], 0, budget.is_spent)
    if before is not None:
        best_so_far = Optimisation(judge.build_candidate(before.best), before.completed, budget.is_spent)
    yield best_so_far
    # Where time alone is limited, every candidate may become a start.
    start_count = len(candidates) if budget.starts is None else min(budget.starts, len(candidates))
    problems = [problem]
    for first in range(0 if before is None else before.first, start_count, _HEAT):
        heat = [_Start(problem, k, candidates[k].x) for k in range(first, min(first + _HEAT, start_count))]
        worth: dict[int, float] = {}
        if before is not None and before.first == first:
            for start, reached_before in zip(heat, before.starts, strict=False):
                start.resume_from(reached_before)
        for rounds in (_SKETCH, len(_ITERATIONS)):
            # After the sketches the most promising start goes first: time may not suffice for all.
            ordered = sorted(heat, key=lambda start: worth.get(start.number, 0.0))
            waiting = [
                start for start in ordered if not start.counted and start.rounds <= rounds
            ]  # else done before it stopped
            while waiting:
                if budget.is_spent:
                    return
                together, waiting = waiting[: count_processors()], waiting[count_processors() :]
                # Evaluations of a problem share its arrays, hence a copy for every thread, kept for later rounds.
                problems += [problem.copy_for_thread() for _ in together[len(problems) :]]
                for start, own in zip(together, problems, strict=False):
                    start.problem = own
                telling = _ProgressReporter(candidates, best_so_far, first, heat, budget, progress, course.checkpoints)
                _advance_starts(together, rounds, telling)
                for start in together:
                    reached = _fit_within_limits(start.x, shrinking, judge)
                    # A start that cannot be brought within the limits is continued last.
                    worth[start.number] = np.inf if reached is None else reached.rank
                    best_so_far = _update_best(best_so_far, reached, start.finished, budget)
                    start.counted = start.finished
                    yield best_so_far
                if any(start.counted for start in together):
                    course.checkpoints.save(partial(_pack_checkpoint, candidates, best_so_far, first, heat, budget))


def _advance_starts(starts: Sequence[_Start], rounds: int, telling: _ProgressReporter) -> None:
    """Bring starts so many rounds far, in parallel, as far as the time allows."""

    def advance_start(start: _Start, report: Progress) -> None:
        while start.rounds < rounds and not start.finished and not telling.budget.is_spent:
            start.advance(telling.budget, lambda at: report(0.0, telling.build_message(start, at)))
            telling.keep_checkpoint(start)

    map_in_threads(advance_start, starts, [MIN_PARALLEL_SIZE] * len(starts), telling)


@dataclass(eq=False)
class _ProgressReporter:
    """Reports the progress of a heat in the thread that began the search, and keeps a checkpoint after every round."""

    candidates: Sequence[Candidate]
    best_so_far: Optimisation
    first: int
    heat: Sequence[_Start]
    budget: Budget
    progress: Progress
    checkpoints: Checkpoints
    _one: Lock = field(default_factory=Lock)

    def build_message(self, start: _Start, at: Evaluation) -> str:
        """Return the message for an iteration of a start."""
        return (
            f"start {start.number + 1}, iteration {start.iterations}: criterion {np.exp(at.criterion):.4g}, tightest "
            f"limit at {format_percent(1 + at.worst_excess, decimals=0)}; best within the limits "
            f"{self.best_so_far.best.values.criterion:.4g}, best random {self.candidates[0].values.criterion:.4g}"
        )

    def __call__(self, _: float, message: str) -> None:
        """Report a message with the progress of the whole search; raise what stops the search."""
        if message:
            self.progress(self.budget.fraction(self.first + sum(start.share_done for start in self.heat)), message)

    def keep_checkpoint(self, start: _Start) -> None:
        """Keep a checkpoint after a round of a start, in the thread of that start, if it is time."""
        # Starts run in several threads; the state of one must not be recorded while another packs all of them.
        with self._one:
            start.record_state()
            self.checkpoints.save(
                partial(_pack_checkpoint, self.candidates, self.best_so_far, self.first, self.heat, self.budget)
            )


def _pack_checkpoint(
    candidates: Sequence[Candidate], best_so_far: Optimisation, first: int, heat: Sequence[_Start], budget: Budget
) -> bytes:
    drawn = np.array([candidate.x for candidate in candidates])
    starts = tuple(start.get_state() for start in heat)
    return SearchCheckpoint(budget.elapsed, drawn, best_so_far.best.x, first, best_so_far.starts, starts).to_bytes()


def _fit_within_limits(x: FloatArray, shrinking: AmplitudeScaler, judge: CandidateEvaluator) -> Candidate | None:
    fitting = shrinking.scale_down(x)
    return None if fitting is None else judge.build_candidate(fitting)


def _update_best(best_so_far: Optimisation, reached: Candidate | None, finished: bool, budget: Budget) -> Optimisation:
    better = reached is not None and reached.rank < best_so_far.best.rank
    best = reached if reached is not None and better else best_so_far.best
    return Optimisation(best, best_so_far.starts + finished, budget.is_spent)


@dataclass(eq=False)
class _Start:
    """One run of the augmented Lagrangian from coefficients x (m, n), some rounds at a time."""

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
    _reached: StartState = field(init=False)

    def __post_init__(self) -> None:
        self._multipliers = self.problem.create_multipliers(_PENALTY)
        self.record_state()

    @property
    def share_done(self) -> float:
        """Share of the rounds that are done."""
        return 1.0 if self.finished else self.rounds / len(_ITERATIONS)

    def get_state(self) -> StartState:
        """Return the state at the end of the last round; another thread may be in the middle of the next one."""
        return replace(self._reached, numbers={**self._reached.numbers, "counted": float(self.counted)})

    def record_state(self) -> None:
        """Record the state at the end of a round."""
        numbers = {name: float(getattr(self, name)) for name in _NUMBERS}
        multipliers = self._multipliers
        arrays = {"x": self.x, "values": multipliers.values, "crowding": multipliers.crowding}
        self._reached = StartState({**numbers, "penalty": multipliers.penalty}, arrays)

    def resume_from(self, before: StartState) -> None:
        """Continue from a recorded state."""
        for name in _NUMBERS:
            setattr(self, name, type(getattr(self, name))(before.numbers[name]))
        arrays = before.arrays
        self.x = arrays["x"]
        self._multipliers = Multipliers(arrays["values"], arrays["crowding"], before.numbers["penalty"])
        self.record_state()

    def advance(self, budget: Budget, tell: Callable[[Evaluation], None]) -> None:
        """Do one more round, as far as the time allows."""
        descent = _Descent(self.problem, self._multipliers)

        # SciPy calls a function with an argument of this name otherwise than others.
        def after_iteration(intermediate_result: scipy.optimize.OptimizeResult) -> None:  # noqa: ARG001
            self.iterations += 1
            tell(descent.last)
            if budget.is_spent:
                # SciPy takes StopIteration as a request to end, and returns the coefficients reached so far.
                raise StopIteration

        result = scipy.optimize.minimize(
            descent,
            self.x.ravel(),
            jac=True,
            method="L-BFGS-B",
            callback=after_iteration,
            options={"maxiter": _ITERATIONS[self.rounds], "maxcor": _CORRECTIONS, "gtol": 1e-5, "ftol": 1e-10},
        )
        # Also after a round that was cut short: what it reached may be the best candidate.
        self.x = result.x.reshape(self.x.shape)
        at = self.problem.evaluate(result.x, self._multipliers)
        if budget.is_spent:
            return
        # A round that the budget cut short does not count: its multipliers would be those of an unfinished descent.
        self.rounds += 1
        # The criterion is a logarithm: this difference is a relative one.
        settled = abs(self._before - at.criterion) < _SETTLED
        self.finished = bool(self.rounds == len(_ITERATIONS) or (at.worst_excess < _SMALL_EXCESS and settled))
        # The multipliers alone bring the excess down in well-scaled problems. Only where they do not, the penalty
        # grows, as a large one makes the problem ill-conditioned.
        enough = at.worst_excess < _ENOUGH_PROGRESS * self._worst
        self._multipliers = self._multipliers.update(
            at, self._multipliers.penalty * (1.0 if enough else _PENALTY_GROWTH)
        )
        self._worst, self._before = at.worst_excess, at.criterion


class _Descent:
    """The function that L-BFGS minimises; remembers its last evaluation for the progress report."""

    def __init__(self, problem: DesignProblem, multipliers: Multipliers) -> None:
        self._problem, self._multipliers = problem, multipliers
        self.last: Evaluation

    def __call__(self, flat: FloatArray) -> tuple[float, FloatArray]:
        self.last = self._problem.evaluate(flat, self._multipliers)
        return self.last.lagrangian, self.last.gradient
