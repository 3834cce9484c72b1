"""Sets of special test motions (§12.3.4.2), run one after the other and combined in one global system."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.excitation.baseline import Baseline
from dynident.excitation.home import home_candidates, posture_note
from dynident.excitation.limits import ImpossibleLimitsError
from dynident.excitation.motion import Motion, Piece, in_sequence
from dynident.excitation.optimise import Budget
from dynident.excitation.request import Run
from dynident.excitation.row_models import EVERY_JOINT
from dynident.excitation.run_search import FoundRun, RunSearch
from dynident.excitation.sequences import check_no_path, verified
from dynident.excitation.special_sets import BetweenTwoPoints, PlannedRun, planned_runs
from dynident.excitation.task import Made, Task, Valued
from dynident.excitation.ways import way_between
from dynident.progress import Progress, part
from dynident.robot.model import FloatArray
from dynident.robot.pointers import listed

_TRIES = 4
_MOST_VALUED = 10_000
_NOT_SHOWN = 1e-6


@dataclass(frozen=True, eq=False)
class _RunMade:
    """A run, the way to its start, its samples, and W (m, n, b) at them without the equations of locked joints."""

    planned: PlannedRun
    found: FoundRun
    approach: Piece
    motion: Motion
    w: FloatArray


def sequential(task: Task, budget: Budget) -> Made:
    """Design the runs of a set one after the other, each to complement those before, with the ways between them."""
    request, bounds, model = task.request, task.bounds, task.model
    runs = planned_runs(request.trajectory.sets, model.robot.joint_names)
    if any(isinstance(run.how, BetweenTwoPoints) for run in runs):
        check_no_path(model)
    search = RunSearch(task, np.random.default_rng(request.seed))
    told = search.nothing_told()
    home = home_candidates(request.home, bounds, model)[0]
    placed: list[_RunMade] = []
    at, seconds = home, None if budget.seconds is None else budget.seconds / len(runs)
    for index, run in enumerate(runs):
        progress = part(task.progress, 0.9 * index / len(runs), 0.9 * (index + 1) / len(runs))
        one = _placed(task, search, run, at, told, Budget(1, seconds), _labelled(progress, run, index, len(runs)))
        rows = one.w.reshape(-1, one.w.shape[-1])
        told = told + rows.T @ rows / task.rate
        at = one.found.start
        placed.append(one)
    retreat = way_between(at, home, bounds, model, task.rate)
    return _made(task, placed, retreat, home)


def _labelled(progress: Progress, run: PlannedRun, index: int, count: int) -> Progress:
    return lambda fraction, message: progress(fraction, f"run {index + 1} of {count} ({run.label}): {message}")


def _placed(
    task: Task, search: RunSearch, run: PlannedRun, at: FloatArray, told: FloatArray, budget: Budget, progress: Progress
) -> _RunMade:
    """A run whose start can be reached from a posture (n,)."""
    for attempt in range(_TRIES):
        try:
            found = search.find(run, told, budget, progress)
            approach = way_between(at, found.start, task.bounds, task.model, task.rate)
        except ImpossibleLimitsError:
            if attempt == _TRIES - 1:
                raise
        else:
            break
    motion = in_sequence(found.pieces, task.rate)
    moving = np.isin(np.arange(task.model.robot.n), run.moving)
    observed = replace(task.model, counted=moving).observe_along(motion, np.arange(len(motion.t)))
    return _RunMade(run, found, approach, motion, observed.reshape(len(motion.t), task.model.robot.n, -1))


def _made(task: Task, placed: list[_RunMade], retreat: Piece, home: FloatArray) -> Made:
    pieces: list[Piece] = []
    spans: list[Run] = []
    clock = 0.0
    names = task.model.robot.joint_names
    for one in placed:
        first = clock + one.approach.duration
        clock = first + sum(piece.duration for piece in one.found.pieces)
        spans.append(Run(one.planned.label, tuple(names[j] for j in one.planned.moving), first, clock))
        pieces += [one.approach, *one.found.pieces]
    margins = verified(task, tuple(dict.fromkeys([*pieces, retreat])))
    valued = _valued(task, placed)
    notes = [*task.yardstick.notes, *_not_shown(task, valued), posture_note(home)]
    notes.append(
        f"{len(placed)} runs, {sum(run.end - run.start for run in spans):.4g} s together; in each, only the equations "
        "of the joints that move count. Each was chosen to add the most to log det M of those before it."
    )
    return Made(
        pieces=(*pieces, retreat),
        exciting=(spans[0].start, spans[-1].end),
        period=None,
        valued=valued,
        baseline=_baseline(task, placed),
        margins=margins,
        notes=tuple(notes),
        runs=tuple(spans),
    )


def _valued(task: Task, placed: list[_RunMade]) -> Valued:
    """What all runs together are worth: samples evenly from all of them."""
    total = sum(len(one.motion.t) for one in placed)
    every = max(1, total // _MOST_VALUED)
    w = np.concatenate([one.w[::every] for one in placed])
    dq = np.concatenate([one.motion.dq[::every] for one in placed])
    values = task.yardstick.values(w.reshape(-1, w.shape[-1]), len(w))
    return Valued(values, task.expected(w, dq, EVERY_JOINT, total))


def _not_shown(task: Task, valued: Valued) -> list[str]:
    missing = [one.name for one in valued.expected if one.share < _NOT_SHOWN]
    if not missing:
        return []
    return [f"W has no full rank: the runs do not show {listed(missing)}."]


def _baseline(task: Task, placed: list[_RunMade]) -> Baseline:
    """The same set with random motions of the same kind and length in every run."""
    count = min(len(one.found.random) for one in placed)
    seconds = sum(len(one.motion.t) for one in placed) / task.rate
    values = []
    for k in range(count):
        information = sum(one.found.random[k] for one in placed) / seconds
        sizes = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        eigenvalues, vectors = np.linalg.eigh(information / np.outer(sizes, sizes))
        rows = (np.sqrt(np.maximum(eigenvalues, 0.0)) * vectors).T * sizes
        values.append(task.yardstick.values(rows, 1))
    best = min(values, key=lambda one: one.criterion)
    return Baseline(count, best, float(np.median([one.condition_number for one in values])))
