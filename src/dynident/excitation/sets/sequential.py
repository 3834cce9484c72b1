"""Design of sets of special test motions (§12.3.4.2), run one after the other and combined in one global system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.excitation.criteria.baseline import Baseline, baseline_of
from dynident.excitation.criteria.values import CriterionValues
from dynident.excitation.experiments.point_to_point import check_no_path, verified
from dynident.excitation.experiments.task import Made, Task, Valued
from dynident.excitation.observation.row_models import EVERY_JOINT
from dynident.excitation.optimising.budget import Budget
from dynident.excitation.result import Run
from dynident.excitation.sets.planned import BetweenTwoPoints, PlannedRun, planned_runs
from dynident.excitation.sets.run_search import FoundRun, RunSearch, rows_like
from dynident.motion.limits.bounds import ImpossibleLimitsError
from dynident.motion.moves.home import home_candidates, posture_note
from dynident.motion.moves.ways import way_between
from dynident.motion.trajectories.motion import Motion, Piece, in_sequence
from dynident.progress import Progress, part
from dynident.robot.pointers import listed

_TRIES = 4
_MOST_VALUED = 10_000
_NOT_SHOWN = 1e-6
_ABOUT_PARAMETERS = ("parameters", "separation")
"""Criteria that weigh the equations of each joint, which an information matrix no longer tells apart."""


@dataclass(frozen=True, eq=False)
class _RunMade:
    """A run, the move to its start, its samples, and W (m, n, b) at them without the equations of locked joints.

    `information` (b, b) is ∫ WᵀW dt.
    """

    planned: PlannedRun
    found: FoundRun
    approach: Piece
    motion: Motion
    w: FloatArray
    information: FloatArray


def sequential(task: Task, budget: Budget) -> Made:
    """Design the runs of a set one after the other, each to complement those before, with the moves between them."""
    request, bounds, model = task.request, task.bounds, task.model
    runs = planned_runs(request.trajectory.sets, model.robot.joint_names)
    if any(isinstance(run.how, BetweenTwoPoints) for run in runs):
        check_no_path(model)
    search = RunSearch(task, np.random.default_rng(request.seed))
    home = home_candidates(request.home, bounds, model)[0]
    # Searching the first time is looking for what shows at all: it takes as long as looking again for the best.
    seconds = None if budget.seconds is None else budget.seconds / len(runs) / 2
    first = _first(replace(task, progress=part(task.progress, 0.0, 0.45)), search, runs, home, seconds)
    placed_runs = _again(replace(task, progress=part(task.progress, 0.45, 0.9)), search, first, home, budget)
    in_time = not budget.spent
    retreat = way_between(placed_runs[-1].found.start, home, bounds, model, task.rate)
    experiment = _made(task, placed_runs, retreat, home)
    if in_time:
        return experiment
    note = (
        "The time was over before all runs were searched by the criterion: until then, they are chosen by log det M; "
        "more time may make them much better."
    )
    return replace(experiment, notes=(*experiment.notes, note))


def _first(
    task: Task, search: RunSearch, runs: Sequence[PlannedRun], home: FloatArray, seconds: float | None
) -> list[_RunMade]:
    """Return all runs, each of which adds the most to those before."""
    information, at = search.nothing_told(), home
    placed_runs: list[_RunMade] = []
    for index, run in enumerate(runs):
        progress = _labelled(task.progress, run, index, len(runs))
        placed = _reachable(task, search, run, at, information, Budget(1, seconds), progress)
        information = information + placed.information
        at = placed.found.start
        placed_runs.append(placed)
    return placed_runs


def _again(task: Task, search: RunSearch, first: list[_RunMade], home: FloatArray, budget: Budget) -> list[_RunMade]:
    """Return the runs after one more search of each by the requested criterion; the better motion is kept.

    Runs for which the time is not enough stay as they are.
    """
    seconds = None if budget.seconds is None else budget.seconds / len(first) / 2
    best_runs = list(first)
    if task.request.criterion.name in _ABOUT_PARAMETERS:
        return best_runs
    value = _worth(task, best_runs).criterion
    # Without full rank no exchange of one run has a finite value, so that none could be compared.
    if not np.isfinite(value):
        return best_runs
    for index, placed in enumerate(first):
        if budget.spent:
            break
        others = sum(
            (each.information for each in best_runs if each is not best_runs[index]), start=0.0 * placed.information
        )
        progress = _labelled(task.progress, placed.planned, index, len(first))
        try:
            motion = search.again(placed.planned, others, Budget(1, seconds), progress)
            changed = list(best_runs)
            changed[index] = _with_samples(task, placed.planned, motion, placed.approach)
            reached = _worth(task, changed).criterion
            if reached >= value:
                continue
            ends = [home, *(each.found.start for each in changed)]
            for k in (index, index + 1):
                if k < len(changed):
                    way = way_between(ends[k], ends[k + 1], task.bounds, task.model, task.rate)
                    changed[k] = replace(changed[k], approach=way)
        except ImpossibleLimitsError:
            continue
        best_runs, value = changed, reached
    return best_runs


def _labelled(progress: Progress, run: PlannedRun, index: int, count: int) -> Progress:
    inner = part(progress, index / count, (index + 1) / count)
    return lambda fraction, message: inner(fraction, f"run {index + 1} of {count} ({run.label}): {message}")


def _reachable(
    task: Task,
    search: RunSearch,
    run: PlannedRun,
    at: FloatArray,
    information: FloatArray,
    budget: Budget,
    progress: Progress,
) -> _RunMade:
    """Return a run whose start can be reached from a posture (n,)."""
    for attempt in range(_TRIES):
        try:
            motion = search.first(run, information, budget, progress)
            approach = way_between(at, motion.start, task.bounds, task.model, task.rate)
        except ImpossibleLimitsError:
            if attempt == _TRIES - 1:
                raise
        else:
            break
    return _with_samples(task, run, motion, approach)


def _with_samples(task: Task, run: PlannedRun, found_run: FoundRun, approach: Piece) -> _RunMade:
    motion = in_sequence(found_run.pieces, task.rate)
    moving = np.isin(np.arange(task.model.robot.n), run.moving)
    observed = replace(task.model, counted=moving).observe_along(motion, np.arange(len(motion.t)))
    w = observed.reshape(len(motion.t), task.model.robot.n, -1)
    return _RunMade(run, found_run, approach, motion, w, observed.T @ observed / task.rate)


def _worth(task: Task, placed_runs: Sequence[_RunMade]) -> CriterionValues:
    """Return the values of all runs together by the requested criterion, from their information matrices."""
    seconds = sum(len(placed.motion.t) for placed in placed_runs) / task.rate
    information = sum((placed.information for placed in placed_runs), start=0.0 * placed_runs[0].information)
    return task.yardstick.values(rows_like(information / seconds), 1)


def _made(task: Task, runs: list[_RunMade], retreat: Piece, home: FloatArray) -> Made:
    pieces: list[Piece] = []
    spans: list[Run] = []
    clock = 0.0
    names = task.model.robot.joint_names
    for placed in runs:
        first = clock + placed.approach.duration
        clock = first + sum(piece.duration for piece in placed.found.pieces)
        spans.append(Run(placed.planned.label, tuple(names[j] for j in placed.planned.moving), first, clock))
        pieces += [placed.approach, *placed.found.pieces]
    margins = verified(task, tuple(dict.fromkeys([*pieces, retreat])))
    valued = _valued(task, runs)
    notes = [*task.yardstick.notes, *_not_shown(task, valued), posture_note(home)]
    notes.append(
        f"{len(runs)} runs, {sum(run.end - run.start for run in spans):.4g} s together; in each, only the equations "
        "of the joints that move count."
    )
    return Made(
        pieces=(*pieces, retreat),
        exciting=(spans[0].start, spans[-1].end),
        period=None,
        valued=valued,
        baseline=_baseline(task, runs),
        margins=margins,
        notes=tuple(notes),
        runs=tuple(spans),
    )


def _valued(task: Task, placed_runs: list[_RunMade]) -> Valued:
    """Return the values of all runs together, from evenly taken samples."""
    total = sum(len(placed.motion.t) for placed in placed_runs)
    every = max(1, total // _MOST_VALUED)
    w = np.concatenate([placed.w[::every] for placed in placed_runs])
    dq = np.concatenate([placed.motion.dq[::every] for placed in placed_runs])
    values = task.yardstick.values(w.reshape(-1, w.shape[-1]), len(w))
    return Valued(values, task.expected(w, dq, EVERY_JOINT, total, None))


def _not_shown(task: Task, valued: Valued) -> list[str]:
    missing = [parameter.name for parameter in valued.expected if parameter.share < _NOT_SHOWN]
    if not missing:
        return []
    note = f"W has no full rank: the runs do not show {listed(missing)}."
    if task.request.trajectory.sets != "vandanjon":
        note += (
            " Their joints never move together with those that would tell; choose the set 'vandanjon', or state a run "
            "of all joints as an earlier measurement."
        )
    return [note]


def _baseline(task: Task, placed_runs: list[_RunMade]) -> Baseline | None:
    """Return the baseline of the same set with random motions in every run; None where rows have weights."""
    if task.request.criterion.name in _ABOUT_PARAMETERS:
        return None
    count = max(len(placed.found.random) for placed in placed_runs)
    seconds = sum(len(placed.motion.t) for placed in placed_runs) / task.rate
    values = []
    for k in range(count):
        information = sum(
            (placed.found.random[k % len(placed.found.random)] for placed in placed_runs),
            start=0.0 * placed_runs[0].information,
        )
        values.append(task.yardstick.values(rows_like(information / seconds), 1))
    return baseline_of(values)
