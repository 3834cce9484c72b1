"""Design a whole set of test motions, run after run, and combine their information (§12.3.4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.criteria.optimality_criteria import Baseline, CriterionValues, compute_baseline
from dynident.excitation.design_result import Run
from dynident.excitation.equation_type_rows import DYNAMIC_ROWS
from dynident.excitation.experiments.design_task import DesignedExperiment, DesignTask, MotionValues
from dynident.excitation.experiments.point_to_point import check_no_path, verify_pieces
from dynident.excitation.experiments.run_search import (
    BetweenTwoPoints,
    PlannedRun,
    RunMotion,
    RunSearch,
    factor_information,
    plan_runs,
)
from dynident.excitation.optimisation.design_problem import Budget
from dynident.motion.collision_free_paths import list_home_candidates, note_home, plan_path
from dynident.motion.joint_trajectories import Motion, Piece, sample_pieces
from dynident.motion.limits.bounds import ImpossibleLimitsError
from dynident.progress import Progress, scale_progress
from dynident.robot.json_fields import join_names

# Motions that are searched for a run until one can be reached from the run before.
_TRIES = 4
_MOST_VALUED = 10_000
# Share of a column that is left beside the others, below which a parameter counts as not shown.
_NOT_SHOWN = 1e-6
_ABOUT_PARAMETERS = ("parameters", "separation")
"""Criteria that weigh the equations of each joint, which an information matrix no longer tells apart."""


@dataclass(frozen=True, eq=False)
class _PlacedRun:
    """A run, the move to its start, its samples, and W (m, n, b) at them without the equations of locked joints.

    `information` (b, b) is ∫ WᵀW dt.
    """

    planned: PlannedRun
    run_motion: RunMotion
    approach: Piece
    motion: Motion
    w: FloatArray
    information: FloatArray


def design_sequential(task: DesignTask, budget: Budget) -> DesignedExperiment:
    """Design the runs of a set one after the other, each to complement those before, with the moves between them.

    Parameters
    ----------
    task : DesignTask
        The design task.
    budget : Budget
        Time and number of starts.
    """
    request, bounds, model = task.request, task.bounds, task.model
    runs = plan_runs(request.trajectory.sets, model.robot.joint_names)
    if any(isinstance(run.how, BetweenTwoPoints) for run in runs):
        check_no_path(model)
    search = RunSearch(task, np.random.default_rng(request.seed))
    home = list_home_candidates(request.home, bounds, model)[0]
    # Searching the first time is looking for what shows at all: it takes as long as looking again for the best.
    seconds = None if budget.seconds is None else budget.seconds / len(runs) / 2
    first = _search_first(replace(task, progress=scale_progress(task.progress, 0.0, 0.45)), search, runs, home, seconds)
    placed_runs = _search_again(
        replace(task, progress=scale_progress(task.progress, 0.45, 0.9)), search, first, home, budget
    )
    in_time = not budget.is_spent
    retreat = plan_path(placed_runs[-1].run_motion.start, home, bounds, model, task.rate)
    experiment = _assemble(task, placed_runs, retreat, home)
    if in_time:
        return experiment
    note = (
        "The time limit ended the search before all runs were optimised by the criterion: the others were chosen by "
        "log det M. More time may improve them much."
    )
    return replace(experiment, notes=(*experiment.notes, note))


def _search_first(
    task: DesignTask, search: RunSearch, runs: Sequence[PlannedRun], home: FloatArray, seconds: float | None
) -> list[_PlacedRun]:
    """Return all runs, each of which adds the most to those before."""
    information, at = search.create_initial_information(), home
    placed_runs: list[_PlacedRun] = []
    for index, run in enumerate(runs):
        progress = _label_progress(task.progress, run, index, len(runs))
        placed = _search_reachable(task, search, run, at, information, Budget(1, seconds), progress)
        # Each run complements those before, so its information counts for all that follow.
        information = information + placed.information
        at = placed.run_motion.start
        placed_runs.append(placed)
    return placed_runs


def _search_again(
    task: DesignTask, search: RunSearch, first: list[_PlacedRun], home: FloatArray, budget: Budget
) -> list[_PlacedRun]:
    """Return the runs after one more search of each by the requested criterion; the better motion is kept.

    Runs for which the time is not enough stay as they are.
    """
    seconds = None if budget.seconds is None else budget.seconds / len(first) / 2
    best_runs = list(first)
    if task.request.criterion.name in _ABOUT_PARAMETERS:
        return best_runs
    # An exchange of one run is judged by the criterion of all runs together.
    value = _evaluate_runs(task, best_runs).criterion
    # Without full rank no exchange of one run has a finite value, so that none could be compared.
    if not np.isfinite(value):
        return best_runs
    for index, placed in enumerate(first):
        if budget.is_spent:
            break
        others = sum(
            (each.information for each in best_runs if each is not best_runs[index]), start=0.0 * placed.information
        )
        progress = _label_progress(task.progress, placed.planned, index, len(first))
        try:
            motion = search.search_again(placed.planned, others, Budget(1, seconds), progress)
            changed = list(best_runs)
            changed[index] = _sample_run(task, placed.planned, motion, placed.approach)
            reached = _evaluate_runs(task, changed).criterion
            if reached >= value:
                continue
            # Another motion starts elsewhere, so that the ways to it and from it have to be planned again.
            ends = [home, *(each.run_motion.start for each in changed)]
            for k in (index, index + 1):
                if k < len(changed):
                    way = plan_path(ends[k], ends[k + 1], task.bounds, task.model, task.rate)
                    changed[k] = replace(changed[k], approach=way)
        # The run stays as it is where no other motion keeps the limits or can be reached.
        except ImpossibleLimitsError:
            continue
        best_runs, value = changed, reached
    return best_runs


def _label_progress(progress: Progress, run: PlannedRun, index: int, count: int) -> Progress:
    inner = scale_progress(progress, index / count, (index + 1) / count)
    return lambda fraction, message: inner(fraction, f"run {index + 1} of {count} ({run.label}): {message}")


def _search_reachable(
    task: DesignTask,
    search: RunSearch,
    run: PlannedRun,
    at: FloatArray,
    information: FloatArray,
    budget: Budget,
    progress: Progress,
) -> _PlacedRun:
    """Return a run whose start can be reached from a posture (n,)."""
    for attempt in range(_TRIES):
        try:
            motion = search.search_first(run, information, budget, progress)
            approach = plan_path(at, motion.start, task.bounds, task.model, task.rate)
        except ImpossibleLimitsError:
            if attempt == _TRIES - 1:
                raise
        else:
            break
    return _sample_run(task, run, motion, approach)


def _sample_run(task: DesignTask, run: PlannedRun, found_run: RunMotion, approach: Piece) -> _PlacedRun:
    motion = sample_pieces(found_run.pieces, task.rate)
    moving = np.isin(np.arange(task.model.robot.n), run.moving)
    observed = replace(task.model, counted=moving).observe_along(motion, np.arange(len(motion.t)))
    w = observed.reshape(len(motion.t), task.model.robot.n, -1)
    return _PlacedRun(run, found_run, approach, motion, w, observed.T @ observed / task.rate)


def _evaluate_runs(task: DesignTask, placed_runs: Sequence[_PlacedRun]) -> CriterionValues:
    """Return the values of all runs together by the requested criterion, from their information matrices."""
    seconds = sum(len(placed.motion.t) for placed in placed_runs) / task.rate
    information = sum((placed.information for placed in placed_runs), start=0.0 * placed_runs[0].information)
    return task.design_criterion.evaluate(factor_information(information / seconds), 1)


def _assemble(task: DesignTask, runs: list[_PlacedRun], retreat: Piece, home: FloatArray) -> DesignedExperiment:
    pieces: list[Piece] = []
    spans: list[Run] = []
    clock = 0.0
    names = task.model.robot.joint_names
    for placed in runs:
        first = clock + placed.approach.duration
        clock = first + sum(piece.duration for piece in placed.run_motion.pieces)
        spans.append(Run(placed.planned.label, tuple(names[j] for j in placed.planned.moving), first, clock))
        pieces += [placed.approach, *placed.run_motion.pieces]
    # Rounds repeat the same pieces, which need to be verified once.
    margins = verify_pieces(task, tuple(dict.fromkeys([*pieces, retreat])))
    valued = _evaluate_samples(task, runs)
    notes = [*task.design_criterion.notes, *_note_not_shown(task, valued), note_home(home)]
    notes.append(
        f"{len(runs)} runs, {sum(run.end - run.start for run in spans):.4g} s together; in each run, only the "
        "equations of the moving joints count."
    )
    return DesignedExperiment(
        pieces=(*pieces, retreat),
        exciting=(spans[0].start, spans[-1].end),
        period=None,
        valued=valued,
        baseline=_compute_baseline(task, runs),
        margins=margins,
        notes=tuple(notes),
        runs=tuple(spans),
    )


def _evaluate_samples(task: DesignTask, placed_runs: list[_PlacedRun]) -> MotionValues:
    """Return the values of all runs together, from evenly taken samples."""
    total = sum(len(placed.motion.t) for placed in placed_runs)
    every = max(1, total // _MOST_VALUED)
    w = np.concatenate([placed.w[::every] for placed in placed_runs])
    dq = np.concatenate([placed.motion.dq[::every] for placed in placed_runs])
    values = task.design_criterion.evaluate(w.reshape(-1, w.shape[-1]), len(w))
    return MotionValues(values, task.predict_uncertainties(w, dq, DYNAMIC_ROWS, total, None))


def _note_not_shown(task: DesignTask, valued: MotionValues) -> list[str]:
    missing = [parameter.name for parameter in valued.expected if parameter.share < _NOT_SHOWN]
    if not missing:
        return []
    note = f"W does not have full rank: the runs do not determine {join_names(missing)}."
    if task.request.trajectory.sets != "vandanjon":
        note += (
            " Their joints never move together with the joints that would determine them; choose the set "
            "'vandanjon', or give a run of all joints as an earlier recording."
        )
    return [note]


def _compute_baseline(task: DesignTask, placed_runs: list[_PlacedRun]) -> Baseline | None:
    """Return the baseline of the same set with random motions in every run; None where rows have weights."""
    if task.request.criterion.name in _ABOUT_PARAMETERS:
        return None
    # Runs may have different numbers of random motions; the shorter lists are gone through again.
    count = max(len(placed.run_motion.random) for placed in placed_runs)
    seconds = sum(len(placed.motion.t) for placed in placed_runs) / task.rate
    values = []
    for k in range(count):
        information = sum(
            (placed.run_motion.random[k % len(placed.run_motion.random)] for placed in placed_runs),
            start=0.0 * placed_runs[0].information,
        )
        values.append(task.design_criterion.evaluate(factor_information(information / seconds), 1))
    return compute_baseline(values)
