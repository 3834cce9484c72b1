"""From a robot and a wish to an experiment that keeps every limit: the room's entry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.errors import DynidentError
from dynident.excitation.a_priori import a_priori_values
from dynident.excitation.baseline import Baseline, Candidate, Judge, baseline_of, random_candidates
from dynident.excitation.constant_velocity import constant_velocity_course, strokes_of
from dynident.excitation.criteria import CriterionValues, criterion_of, true_values
from dynident.excitation.feasible import Shrinking
from dynident.excitation.fourier import FourierFamily, FourierMotion
from dynident.excitation.home import check_home, home_candidates, posture_note, with_moves
from dynident.excitation.limits import Bounds, ImpossibleLimitsError, Margin, bounds_of, keeps, margins_of, tightest
from dynident.excitation.model import DesignModel, design_model
from dynident.excitation.motion import Motion, Piece, in_sequence
from dynident.excitation.optimise import Budget, optimise
from dynident.excitation.problem import DesignProblem
from dynident.excitation.request import Design, DesignRequest, check_request
from dynident.progress import Progress, part, silent
from dynident.robot.model import Robot

_CHECKS_PER_SAMPLE = 10
_CHUNK = 50_000
_VALUED_SAMPLES = 1000
_SHRINK = 0.999
_SHRINKS = 20
# Of the time: optimising gains more than looking for better random trajectories.
_RANDOM_SHARE = 0.3


def design_experiment(robot: Robot, request: DesignRequest, progress: Progress = silent) -> Design:
    """Design an experiment.

    Parameters
    ----------
    robot : Robot
    request : DesignRequest
    progress : Progress
        Told the start, the iteration, the criterion and the tightest limit; may raise to cancel.

    Returns
    -------
    Design
        Verified on a grid ten times as fine as its sampling rate: no limit is broken.

    Raises
    ------
    DynidentError
        What is asked for cannot be designed; `ImpossibleLimitsError` names the limit in the way.
    """
    budget = Budget(request.wanted_starts, request.time_budget)
    check_request(request)
    limits = bounds_of(robot, request.limits)
    if request.home is not None:
        check_home(request.home, limits)
    model = design_model(robot, request.wanted_effects)
    task = _Task(request, model, limits, limits.tightened(), progress)
    progress(0.0, f"{model.n_parameters} base parameters")
    made = _constant_velocity(task) if request.kind == "constant_velocity" else _fourier(task, budget)
    rate = request.trajectory.sampling_rate
    motion = in_sequence(made.pieces, rate)
    progress(1.0, "done")
    return Design(
        joint_names=robot.joint_names,
        request=request,
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        exciting=made.exciting,
        period=made.period,
        parameter_names=model.parameter_names,
        criterion_values=made.values,
        baseline=made.baseline,
        margins=made.margins,
        notes=(*made.notes, *model.notes, *limits.notes),
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """`limits` are those that must hold, `bounds` those that are designed for: a hair inside."""

    request: DesignRequest
    model: DesignModel
    limits: Bounds
    bounds: Bounds
    progress: Progress

    @property
    def rate(self) -> float:
        return self.request.trajectory.sampling_rate

    def verified(self, pieces: Sequence[Piece]) -> tuple[Margin, ...]:
        """Margins against the limits proper, on a grid finer than the sampling."""
        torque = self.model.torque if self.limits.checks_torque else None
        finely = _finely(pieces, self.rate * _CHECKS_PER_SAMPLE, part(self.progress, 0.95, 1.0))
        return margins_of(self.limits, finely, torque)


@dataclass(frozen=True, eq=False)
class _Made:
    """What is left to be put into a `Design`."""

    pieces: tuple[Piece, ...]
    exciting: tuple[float, float]
    period: float | None
    values: CriterionValues
    baseline: Baseline | None
    margins: tuple[Margin, ...]
    notes: tuple[str, ...]


def _fourier(task: _Task, budget: Budget) -> _Made:
    request, model, bounds, rate = task.request, task.model, task.bounds, task.rate
    wanted = request.trajectory
    steps = max(round(wanted.duration * rate), 1)
    family = FourierFamily(wanted.harmonics, steps / rate)
    notes = []
    if abs(family.period - wanted.duration) > 1e-9 * wanted.duration:
        notes.append(f"The period is {family.period:.9g} s: a whole number of sampling periods.")
    a_priori, assumed = a_priori_values(model, request.criterion)
    notes += assumed if request.criterion.name == "weighted" else ()
    judge = Judge(family, model, request.criterion, a_priori)
    count = request.random_trajectories
    candidates = random_candidates(
        family,
        bounds,
        model,
        judge,
        count=count,
        seed=request.seed,
        progress=part(task.progress, 0.0, 0.15),
        enough=lambda: budget.share_spent > _RANDOM_SHARE,
    )
    if not candidates:
        raise _no_room(bounds)
    baseline, best = baseline_of(candidates), candidates[0]
    if request.kind == "optimized":
        problem = DesignProblem(family, model, criterion_of(request.criterion, a_priori), bounds)
        shrinking = Shrinking(family, bounds, model)
        result = optimise(problem, shrinking, judge, candidates, budget, part(task.progress, 0.15, 0.95))
        best = result.best
        completed = f"{result.starts} start{'' if result.starts == 1 else 's'} completed"
        notes.append(f"{completed} before the time was over." if result.out_of_time else f"{completed}.")
    if not np.isfinite(best.values.condition_number):
        notes.append("W has no full rank: this motion cannot tell all base parameters apart.")
    fine = Judge(family, model, request.criterion, a_priori, n_samples=_VALUED_SAMPLES)
    motion, margins = _verified_fourier(task, family, best)
    placed = with_moves(task.request.home, motion, bounds, model, rate)
    moves = (placed.approach, placed.retreat)
    return _Made(
        pieces=(placed.approach, replace(motion, periods=wanted.periods), placed.retreat),
        exciting=(placed.approach.duration, placed.approach.duration + wanted.periods * family.period),
        period=family.period,
        values=fine.values(motion.x),
        baseline=replace(baseline, best=fine.values(candidates[0].x)),
        margins=_wider(margins, task.verified(moves)),
        notes=(*notes, *placed.notes),
    )


def _verified_fourier(task: _Task, family: FourierFamily, best: Candidate) -> tuple[FourierMotion, tuple[Margin, ...]]:
    """One period of the best candidate, shrunk by fractions of a percent until the fine grid agrees."""
    x = best.x.copy()
    for _ in range(_SHRINKS):
        motion = FourierMotion(family, x)
        margins = task.verified([motion])
        if keeps(margins):
            return motion, margins
        x = x.copy()
        x[1:] *= _SHRINK
    worst = tightest(margins)
    raise ImpossibleLimitsError(
        f"The {worst.limit} limit {worst.bound:g} of joint '{worst.joint}' cannot be kept ({worst.value:.4g}).",
        pointer="/limits",
        title="Impossible limits",
    )


def _constant_velocity(task: _Task) -> _Made:
    request, model, bounds = task.request, task.model, task.bounds
    home = home_candidates(request.home, bounds, model)[0]
    strokes = strokes_of(bounds, home, request.trajectory.speeds, request.trajectory.duration)
    course = constant_velocity_course(
        bounds,
        model,
        home,
        strokes,
        repeats=request.trajectory.periods,
        rate=task.rate,
        progress=part(task.progress, 0.0, 0.9),
    )
    margins = task.verified(course.pieces)
    if not keeps(margins):
        worst = tightest(margins)
        raise ImpossibleLimitsError(
            f"The {worst.limit} limit {worst.bound:g} of joint '{worst.joint}' would be broken: {worst.value:.4g}.",
            pointer="/limits",
            title="Impossible limits",
        )
    a_priori, _ = a_priori_values(model, request.criterion)
    motion = in_sequence(course.pieces, task.rate)
    inside = np.flatnonzero((motion.t >= course.first) & (motion.t <= course.last))
    inside = inside[:: max(1, len(inside) // (10 * _VALUED_SAMPLES))]
    w = model.observe(motion.q[inside], motion.dq[inside], motion.ddq[inside])
    values = true_values(request.criterion, w, len(inside), a_priori)
    return _Made(course.pieces, (course.first, course.last), None, values, None, margins, (posture_note(home),))


def _finely(pieces: Sequence[Piece], rate: float, progress: Progress) -> Iterator[Motion]:
    """Pieces on grids of at least `rate`, ends included, in chunks."""
    for number, piece in enumerate(pieces):
        t = np.linspace(0.0, piece.duration, int(np.ceil(piece.duration * rate)) + 1)
        for first in range(0, len(t), _CHUNK):
            progress(number / len(pieces), "verifying")
            yield piece.evaluate(t[first : first + _CHUNK])


def _wider(one: Sequence[Margin], other: Sequence[Margin]) -> tuple[Margin, ...]:
    """Of each limit the margin that is used up more."""
    return tuple(max(pair, key=lambda margin: margin.share) for pair in zip(one, other, strict=True))


def _no_room(bounds: Bounds) -> DynidentError:
    return ImpossibleLimitsError(
        "No trajectory fits: the torque limits leave no room to move around any posture that can be held "
        f"({', '.join(f'{name} {value:.3g}' for name, value in zip(bounds.names, bounds.torque, strict=True))}).",
        pointer="/limits",
        title="Impossible limits",
    )
