"""Rehearsal of a design: its motion without verification, to predict what the design is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.criteria.design_criterion import build_design_criterion
from dynident.excitation.design_model import DesignModel
from dynident.excitation.experiments.periodic import build_family, search_trajectory
from dynident.excitation.experiments.single_joint import Stroke, plan_stroke_moves, plan_strokes
from dynident.excitation.optimising.design_problem import Budget, count_period_samples
from dynident.excitation.request import JOINT_BY_JOINT, DesignRequest
from dynident.motion.joint_trajectories import Motion, PeriodicMotion, concatenate_motions, sample_pieces
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError
from dynident.motion.limits.postures import compute_static_torque
from dynident.motion.move_paths import list_home_candidates

# Random motions of a quick rehearsal, and postures of a joint's strokes whose static torque is checked.
_CANDIDATES = 6
_POSTURES = 30


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """A motion that stands for an experiment.

    Parameters
    ----------
    motion : Motion
        The motion, sampled sparsely.
    n_samples : float
        Number of samples that the experiment would have.
    """

    motion: Motion
    n_samples: float


def rehearse_quickly(request: DesignRequest, model: DesignModel, bounds: Bounds, rate: float) -> Rehearsal:
    """Return a motion of the requested kind, fast enough to tell whether that kind is worth while.

    Of a periodic trajectory it is one period of the best of a few random ones, at every pace: an optimised one is
    better, or at least different. The moves from and to rest are not included.

    Parameters
    ----------
    request : DesignRequest
        The design request.
    model : DesignModel
        Model with the effects in question.
    bounds : Bounds
        Limits of the motion.
    rate : float
        Rate of the samples of strokes, Hz.

    Returns
    -------
    Rehearsal
        The motion, and the number of samples that it stands for.

    Raises
    ------
    ImpossibleLimitsError
        No such motion keeps the limits.
    """
    hasty = replace(request, kind="random", random_trajectories=_CANDIDATES)
    return rehearse_motion(request if request.kind in JOINT_BY_JOINT else hasty, model, bounds, rate)


def rehearse_motion(
    request: DesignRequest, model: DesignModel, bounds: Bounds, rate: float, earlier: FloatArray | None = None
) -> Rehearsal:
    """Return the motion that a design of this request will have, except for what its verification removes.

    Parameters
    ----------
    request : DesignRequest
        The design request.
    model : DesignModel
        Model with the effects in question.
    bounds : Bounds
        Limits of the motion.
    rate : float
        Rate of the samples of strokes, Hz: the design's own where the model has a memory, fewer otherwise.
    earlier : (r, b), optional
        Rows besides W / √N that stand for earlier runs, see `build_earlier_rows`.

    Returns
    -------
    Rehearsal
        The motion, and the number of samples that it stands for.

    Raises
    ------
    ImpossibleLimitsError
        No such motion keeps the limits.
    """
    if request.kind in JOINT_BY_JOINT:
        home = list_home_candidates(request.home, bounds, model)[0]
        strokes = plan_strokes(request, bounds, home)
        _check_holding(strokes, home, bounds, model)
        # One look at all strokes is enough here; every single move is checked when it is designed.
        unloaded = replace(bounds, torque=np.full_like(bounds.torque, np.inf))
        course = plan_stroke_moves(unloaded, model, home, strokes, repeats=request.trajectory.periods, rate=rate)
        motion = sample_pieces(course.pieces, rate)
        return Rehearsal(motion, float(len(motion.t)))
    trajectory = request.trajectory
    # The period need not be a whole number of samples: nothing is recorded.
    family = build_family(trajectory, trajectory.duration)
    design_criterion = build_design_criterion(model, request.criterion, request.noise, earlier=earlier)
    budget = Budget(request.starts_or_default, request.time_budget)
    # The same search with the same seed as the design makes, so that its result foretells the design's.
    best = search_trajectory(request, family, model, bounds, design_criterion, budget).best
    parts, elapsed = [], 0.0
    for pace in trajectory.paces:
        slow = family.with_period(trajectory.duration / pace)
        # The same number of samples at every pace would count the slow ones too little.
        t = np.arange(0.0, slow.period, trajectory.duration / count_period_samples(model, family))
        part = PeriodicMotion(slow, best.x).evaluate(t)
        parts.append(Motion(elapsed + part.t, part.q, part.dq, part.ddq, part.dddq))
        # Paces are recorded one after the other.
        elapsed += slow.period
    return Rehearsal(concatenate_motions(parts), elapsed * trajectory.periods * rate)


def _check_holding(strokes: Sequence[Stroke], home: FloatArray, bounds: Bounds, model: DesignModel) -> None:
    """Raise `ImpossibleLimitsError` where the arm cannot be held along the strokes."""
    if not bounds.has_torque_limits:
        return
    postures = []
    for joint in sorted({stroke.joint for stroke in strokes}):
        own = [stroke for stroke in strokes if stroke.joint == joint]
        along = np.tile(home, (_POSTURES, 1))
        # Static torque depends on the position alone, and so on the range of a joint's strokes, not on their number.
        along[:, joint] = np.linspace(
            min(own_stroke.low for own_stroke in own), max(own_stroke.high for own_stroke in own), _POSTURES
        )
        postures.append(along)
    if (np.abs(compute_static_torque(model, np.concatenate(postures))) > bounds.torque).any():
        raise ImpossibleLimitsError(
            "the torque limits do not allow the arm to be held everywhere along the strokes; choose another home "
            "posture",
            pointer="/home",
        )
