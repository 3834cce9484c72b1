"""Experiments with all joints at once: Fourier or spline trajectories, random or optimised, at one or several paces.

Holds the share of the time for random trajectories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.errors import DynidentError
from dynident.excitation.criteria.optimality_criteria import compute_baseline
from dynident.excitation.design_request import TrajectoryRequest, compute_planned_seconds
from dynident.excitation.experiments.design_task import DesignedExperiment, DesignTask, MotionValues
from dynident.excitation.optimisation.augmented_lagrangian import Resumption, optimise_trajectories, read_checkpoint
from dynident.excitation.optimisation.design_problem import (
    Budget,
    Candidate,
    CandidateEvaluator,
    DesignProblem,
    draw_candidates,
)
from dynident.motion.collision_free_paths import MoveCost, list_home_candidates, plan_home_moves
from dynident.motion.joint_trajectories import BSplineFamily, Family, FourierFamily, PeriodicMotion
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError
from dynident.motion.limits.limit_margins import AmplitudeScaler, Margin, are_limits_kept, build_limit_error
from dynident.progress import scale_progress

# Samples of a period that the reported values are computed from.
_VALUED_SAMPLES = 1000
_SHRINKS = (0.999,) * 20 + (0.95,) * 30
"""Factors on the amplitude: small ones for excursions between the samples, larger ones for exact shapes.

Exact shapes may come nearer to each other than the capsules that the search uses.
"""
# Of the time: optimising gains more than looking for better random trajectories.
_RANDOM_SHARE = 0.3


def build_family(trajectory: TrajectoryRequest, period: float) -> Family:
    """Return the family of Fourier series or B-splines of one period.

    Parameters
    ----------
    trajectory : TrajectoryRequest
        The requested trajectory.
    period : float
        Period, s.

    Returns
    -------
    Family
        The family.

    Raises
    ------
    DynidentError
        For a family without a period.
    """
    if trajectory.family == "b_spline":
        return BSplineFamily(trajectory.intervals, period)
    if trajectory.family == "fourier":
        return FourierFamily(trajectory.harmonics, period)
    raise DynidentError(f"a trajectory of the family {trajectory.family} has no period", pointer="/trajectory/family")


def design_periodic(task: DesignTask, budget: Budget) -> DesignedExperiment:
    """Design a trajectory of a linear family, with the moves there and back.

    Parameters
    ----------
    task : DesignTask
        The design task.
    budget : Budget
        Time and number of starts.
    """
    request, model, bounds, rate = task.request, task.model, task.bounds, task.rate
    trajectory = request.trajectory
    # A period that is a whole number of samples: repeated periods then have the same samples, and can be averaged.
    steps = max(round(trajectory.duration * rate), 1)
    family = build_family(trajectory, steps / rate)
    requested_period = trajectory.duration
    if len(trajectory.paces) == 1:
        family, requested_period = (
            _change_pace(family, trajectory.paces[0], rate),
            requested_period / trajectory.paces[0],
        )
    notes = []
    if abs(family.period - requested_period) > 1e-9 * requested_period:
        notes.append(f"The period is {family.period:.9g} s: a whole number of sampling periods.")
    notes += task.design_criterion.notes
    search = search_trajectory(task, family, budget)
    candidates, best = search.candidates, search.best
    baseline = compute_baseline([candidate.values for candidate in candidates])
    notes += search.notes
    if not np.isfinite(best.values.condition_number):
        notes.append("W does not have full rank: this motion does not determine all base parameters.")
    # The baseline and the result are reported on the same samples, more than the search could afford.
    finer = 0 if request.criterion.is_sample_dependent else _VALUED_SAMPLES
    fine = CandidateEvaluator(family, model, task.design_criterion, n_samples=finer, rows=request.model)
    # The search looks at the samples of a period; between them a motion may swing out a little further.
    motions, margins = fit_within_limits(task, family, best)
    placed = plan_home_moves(request.home, motions[0].start, bounds, model, rate)
    # The moves from and to home are verified by themselves, as they do not depend on the search.
    margins = _merge_margins(margins, task.verify_pieces((placed.approach, placed.retreat)))
    if not are_limits_kept(margins):
        raise build_limit_error(margins)
    pieces = (placed.approach, *(replace(motion, periods=trajectory.periods) for motion in motions), placed.retreat)
    exciting = (placed.approach.duration, sum(piece.duration for piece in pieces[:-1]))
    one_pace = len(motions) == 1
    return DesignedExperiment(
        pieces=pieces,
        exciting=exciting,
        period=motions[0].family.period if one_pace else None,
        valued=_evaluate_motion(task, fine, motions[0]) if one_pace else task.evaluate_pieces(pieces, exciting),
        baseline=replace(baseline, best=fine.evaluate(candidates[0].x)),
        margins=margins,
        notes=(*notes, *placed.notes),
    )


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search for the coefficients of a periodic trajectory.

    Parameters
    ----------
    candidates : tuple of Candidate
        Random trajectories within the limits, best first.
    best : Candidate
        The best trajectory, optimised where requested.
    notes : tuple of str
        Notes for the user.
    """

    candidates: tuple[Candidate, ...]
    best: Candidate
    notes: tuple[str, ...] = ()


def search_trajectory(task: DesignTask, family: Family, budget: Budget) -> SearchResult:
    """Search for coefficients that keep the limits and have a good criterion value.

    Without a time budget the same request gives the same answer, here and wherever it is repeated.

    Parameters
    ----------
    task : DesignTask
        The design task.
    family : Family
        Family of trajectories.
    budget : Budget
        Time and number of starts.

    Returns
    -------
    SearchResult
        The random trajectories and the best one.

    Raises
    ------
    ImpossibleLimitsError
        No trajectory fits into the limits.
    """
    request, model, bounds, progress = task.request, task.model, task.bounds, task.progress
    moves = _build_move_cost(task, family) if task.counts_moves else None
    judge = CandidateEvaluator(family, model, task.design_criterion, rows=request.model, moves=moves)
    before = read_checkpoint(task.checkpoints.load_last())
    # The random trajectories of the stopped search are used again, since drawing them may have been cut short by time.
    if before is not None:
        budget.add_elapsed(before.seconds)
        candidates = [judge.build_candidate(x) for x in before.candidates]
    else:
        candidates = draw_candidates(
            family,
            bounds,
            model,
            judge,
            count=request.random_trajectories,
            seed=request.seed,
            progress=scale_progress(progress, 0.0, 0.15),
            enough=budget.start_part(_RANDOM_SHARE),
        )
    if not candidates:
        raise _build_no_room_error(bounds)
    # The best random motion is the result where none is optimised.
    if request.kind != "optimized":
        return SearchResult(tuple(candidates), candidates[0])
    problem = DesignProblem(family, model, task.design_criterion.smooth_criterion, bounds, request.model, moves)
    shrinking = AmplitudeScaler(family, bounds, model)
    course = Resumption(task.checkpoints, before)
    result = optimise_trajectories(
        problem, shrinking, judge, candidates, budget, scale_progress(progress, 0.15, 0.95), course
    )
    completed = f"{result.starts} start{'' if result.starts == 1 else 's'} completed"
    note = f"{completed} before the time limit." if result.out_of_time else f"{completed}."
    return SearchResult(tuple(candidates), result.best, (note,))


def _build_move_cost(task: DesignTask, family: Family) -> MoveCost | None:
    """Return what the moves from and to home cost; None where no posture can be a home."""
    try:
        home = list_home_candidates(task.request.home, task.bounds, task.model)[0]
    except ImpossibleLimitsError:
        return None
    return MoveCost(family.basis(np.zeros(1))[0, 0], home, task.bounds.velocity, compute_planned_seconds(task.request))


def _evaluate_motion(task: DesignTask, judge: CandidateEvaluator, motion: PeriodicMotion) -> MotionValues:
    n_samples = task.request.trajectory.periods * motion.family.period * task.rate
    w, dq = judge.observe(motion.x), judge.compute_velocity(motion.x)
    return MotionValues(
        judge.evaluate(motion.x),
        task.predict_uncertainties(w, dq, judge.row_model, n_samples, task.design_criterion.earlier),
    )


def fit_within_limits(
    task: DesignTask, family: Family, best: Candidate
) -> tuple[tuple[PeriodicMotion, ...], tuple[Margin, ...]]:
    """Return one period of the best candidate at every pace, its amplitude reduced until the fine grid agrees.

    Parameters
    ----------
    task : DesignTask
        The design task.
    family : Family
        Family of trajectories.
    best : Candidate
        The best trajectory of the search.
    """
    x = best.x.copy()
    paces = task.request.trajectory.paces
    families = [family] if len(paces) == 1 else [_change_pace(family, pace, task.rate) for pace in paces]
    for shrink in _SHRINKS:
        motions = tuple(PeriodicMotion(each, x) for each in families)
        margins = task.verify_pieces(motions)
        if are_limits_kept(margins):
            return motions, margins
        x = x.copy()
        # The first coefficient is the middle posture, which stays; the others are the amplitude.
        x[1:, _list_shrunk_joints(task, margins)] *= shrink
    raise build_limit_error(margins)


def _list_shrunk_joints(task: DesignTask, margins: Sequence[Margin]) -> tuple[int, ...]:
    """Return the joints whose amplitude has to become smaller: where bodies come too near, those that move them."""
    broken = [margin for margin in margins if margin.share > 1.0]
    contacts = None if task.bounds.space is None else task.bounds.space.contacts
    if contacts is None or any(margin.limit != "clearance" for margin in broken):
        return tuple(range(task.model.robot.n))
    return tuple(sorted({joint for margin in broken for joint in contacts.list_moving_joints(margin.joint)}))


def _change_pace(family: Family, pace: float, rate: float) -> Family:
    """Return the family whose trajectories take the same paths at a share `pace` of the speed."""
    # Rounded up to a whole number of samples, so that no speed becomes larger than requested. The small number absorbs
    # rounding errors of the quotient.
    return family.with_period(float(np.ceil(family.period / pace * rate - 1e-6)) / rate)


def _merge_margins(first: Sequence[Margin], second: Sequence[Margin]) -> tuple[Margin, ...]:
    """Return of each limit the margin that is used up more."""
    return tuple(max(pair, key=lambda margin: margin.share) for pair in zip(first, second, strict=True))


def _build_no_room_error(bounds: Bounds) -> DynidentError:
    return ImpossibleLimitsError(
        "No trajectory is possible: the torque limits allow no motion around any posture that the arm can hold "
        f"({', '.join(f'{name} {value:.3g}' for name, value in zip(bounds.names, bounds.torque, strict=True))}).",
        pointer="/limits",
        title="Impossible limits",
    )
