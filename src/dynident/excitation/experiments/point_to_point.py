"""Experiments of moves from point to point, at rest in each (§12.3.4.1): random or with optimised points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.errors import DynidentError
from dynident.excitation.criteria.optimality_criteria import compute_baseline
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.excitation.experiments.design_task import DesignedExperiment, DesignTask
from dynident.excitation.optimisation.design_problem import Budget
from dynident.excitation.point_sequence import (
    EvaluatedSequence,
    FreePoints,
    MovePlanner,
    PointSequence,
    draw_sequences,
    evaluate_moves,
    improve_sequence,
)
from dynident.motion.collision_free_paths import plan_home_moves
from dynident.motion.jerk_limited_moves import move_within_torque
from dynident.motion.joint_trajectories import Piece, Rest
from dynident.motion.limits.bounds import ImpossibleLimitsError
from dynident.motion.limits.limit_margins import Margin, are_limits_kept, build_limit_error, find_tightest
from dynident.motion.limits.postures_within_limits import draw_holdable_postures
from dynident.progress import scale_progress

# Variations that are tried per point of the sequence.
_VARIATIONS_OF_A_POINT = 40
# Share of the time that drawing random sequences may take.
_RANDOM_SHARE = 0.3
# Factor on the speed of moves that break a limit on the fine grid, and how often it is applied.
_SLOWER, _ATTEMPTS = 0.95, 30
# Sequences that are tried on the fine grid: each costs a verification.
_MOST_SETTLED = 10
_HOWEVER_SLOW = ("position_min", "position_max", "clearance", "tool_min", "tool_max", "condition", "balance")
"""Limits that a slower move breaks as well."""


def design_point_to_point(task: DesignTask, budget: Budget) -> DesignedExperiment:
    """Design a sequence of moves through points and back to the first, with the moves there and back.

    Parameters
    ----------
    task : DesignTask
        The design task.
    budget : Budget
        Time and number of starts.
    """
    request, bounds, model = task.request, task.bounds, task.model
    check_no_path(model)
    rng = np.random.default_rng(request.seed)
    space = FreePoints(bounds, draw_holdable_postures(bounds, model, rng), request.trajectory.points)
    legs = MovePlanner(bounds, model, task.rate)
    candidates = draw_sequences(
        space,
        legs,
        task.design_criterion,
        count=request.random_trajectories,
        rng=rng,
        progress=scale_progress(task.progress, 0.0, 0.2),
        enough=budget.start_part(_RANDOM_SHARE),
    )
    best, notes = candidates[0], [*task.design_criterion.notes]
    if request.kind == "optimized":
        best, note = _improve_candidates(task, space, legs, candidates, budget)
        notes.append(note)
    # The search looks at a few samples of each move. Where the closer look disagrees, the next best sequence takes its
    # place.
    chosen, pieces = select_first_fitting(task, [best.sequence, *(candidate.sequence for candidate in candidates)])
    placed = plan_home_moves(request.home, chosen.points[-1], bounds, model, task.rate)
    margins = verify_pieces(task, (placed.approach, *pieces, placed.retreat))
    rounds = _add_dwell(pieces * request.trajectory.periods, chosen, task)
    first = placed.approach.duration
    exciting = (first, first + sum(piece.duration for piece in rounds))
    course = (placed.approach, *rounds, placed.retreat)
    valued = task.evaluate_pieces(course, exciting)
    if not np.isfinite(valued.values.condition_number):
        notes.append("W does not have full rank: this motion does not determine all base parameters.")
    period = sum(piece.duration for piece in rounds) / request.trajectory.periods
    notes.append(f"One round through {len(pieces)} points takes {period:.9g} s.")
    return DesignedExperiment(
        course,
        exciting,
        None if request.trajectory.dwell[1] > 0 else period,
        valued,
        compute_baseline([candidate.values for candidate in candidates]),
        margins,
        (*notes, *placed.notes),
    )


def _add_dwell(moves: Sequence[Piece], sequence: PointSequence, task: DesignTask) -> tuple[Piece, ...]:
    """Return the moves, each of which ends in the next point, with a rest after each where requested."""
    least, most = task.request.trajectory.dwell
    if most <= 0:
        return tuple(moves)
    # A generator of its own, so that rests do not change which points the same seed gives.
    rng = np.random.default_rng((task.request.seed, len(moves)))
    pieces: list[Piece] = []
    for k, move in enumerate(moves):
        # A whole number of samples, as of every piece.
        lasts = round(float(rng.uniform(least, most)) * task.rate) / task.rate
        pieces += (move, Rest(sequence.points[k % len(sequence.points)], lasts))
    return tuple(pieces)


def _improve_candidates(
    task: DesignTask, space: FreePoints, legs: MovePlanner, candidates: list[EvaluatedSequence], budget: Budget
) -> tuple[EvaluatedSequence, str]:
    """Return the best sequence reached from the best random ones, one after the other, and a note."""
    best, completed = candidates[0], 0
    start_count = len(candidates) if budget.starts is None else min(budget.starts, len(candidates))
    for start in range(start_count):
        if budget.is_spent:
            break

        def report(done: float, message: str, start: int = start) -> None:
            share = 0.2 + 0.75 * budget.fraction(start + done)
            task.progress(share, f"start {start + 1}, {message}")

        sequence, finished = improve_sequence(
            candidates[start].sequence,
            space,
            legs,
            task.design_criterion,
            variations=_VARIATIONS_OF_A_POINT * space.count,
            # A generator of its own for every start: its course does not depend on how far the others came.
            rng=np.random.default_rng((task.request.seed, start)),
            budget=budget,
            progress=report,
        )
        completed += finished
        moves = legs.plan_sequence(sequence)
        assert moves is not None
        reached = EvaluatedSequence(sequence, evaluate_moves(moves, task.design_criterion))
        if reached.values.criterion < best.values.criterion:
            best = reached
    ended = f"{completed} start{'' if completed == 1 else 's'} completed"
    return best, f"{ended} before the time limit." if budget.is_spent else f"{ended}."


def select_first_fitting(
    task: DesignTask, sequences: Sequence[PointSequence]
) -> tuple[PointSequence, tuple[Piece, ...]]:
    """Return the first sequence whose moves keep the limits on the fine grid as well, and these moves.

    Parameters
    ----------
    task : DesignTask
        The design task.
    sequences : sequence of PointSequence
        Sequences, the best first.
    """
    for sequence in sequences[:_MOST_SETTLED]:
        try:
            return sequence, slow_until_fitting(task, sequence)
        except ImpossibleLimitsError as error:
            reason = error
    raise reason


def slow_until_fitting(task: DesignTask, sequence: PointSequence) -> tuple[Piece, ...]:
    """Return the moves of one round, slowed down by a few per cent until the fine grid agrees."""
    for _ in range(_ATTEMPTS):
        pieces = _plan_round(task, sequence)
        margins = task.verify_pieces(pieces)
        if are_limits_kept(margins):
            return pieces
        # Slower moves take the same path, so they meet the same obstacles and ends of ranges.
        if find_tightest(margins).limit in _HOWEVER_SLOW:
            break
        sequence = sequence.slow_down(_SLOWER)
    raise build_limit_error(margins)


def _plan_round(task: DesignTask, sequence: PointSequence) -> tuple[Piece, ...]:
    pieces = []
    bounds = task.bounds
    for start, end, share in zip(np.roll(sequence.points, 1, axis=0), sequence.points, sequence.shares, strict=True):
        # The shares of the limits are what is searched besides the points: they decide how much inertia and how much
        # friction a move shows.
        slow = replace(bounds, velocity=share[0] * bounds.velocity, acceleration=share[1] * bounds.acceleration)
        pieces.append(move_within_torque(start, end, slow, task.model, task.rate))
    return tuple(pieces)


def verify_pieces(task: DesignTask, pieces: tuple[Piece, ...]) -> tuple[Margin, ...]:
    """Return the margins of pieces; raise `ImpossibleLimitsError` where a limit is broken.

    Parameters
    ----------
    task : DesignTask
        The design task.
    pieces : tuple of Piece
        Pieces of the motion, one after the other.
    """
    margins = task.verify_pieces(pieces)
    if not are_limits_kept(margins):
        raise build_limit_error(margins)
    return margins


def check_no_path(model: DesignModel) -> None:
    """Raise where a column depends on the path travelled: moves can then not be evaluated one by one.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    """
    if model.needs_path:
        raise DynidentError(
            "an effect depends on the path since the last reversal (presliding, hysteresis): moves from point to "
            'point cannot be designed for it; choose the family "fourier" or "b_spline", or the kind "reversals"',
            pointer="/effects",
        )
