"""The runs of a set of test motions (§12.3.4.2), and the search for each: what adds most information (D-optimality).

A plan says which joints move in each run, which are locked, and how.

With locked joints a run shows only some parameters, and no criterion of its W alone would be finite. What counts at
first is log det of the information of all runs up to this one, D-optimality, beginning with a little information about
every parameter: a direction that the run cannot show then neither helps nor hurts it. Once all runs exist, each can
be searched again in the presence of all others by the requested criterion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.excitation.criteria.criterion_choice import CriterionChoice
from dynident.excitation.criteria.design_criterion import DesignCriterion
from dynident.excitation.criteria.parameter_variances import ParameterSelection
from dynident.excitation.design_request import SET_KINDS
from dynident.excitation.experiments.design_task import DesignTask
from dynident.excitation.experiments.periodic_trajectories import build_family, fit_within_limits
from dynident.excitation.experiments.point_to_point import select_first_fitting
from dynident.excitation.optimisation.augmented_lagrangian import optimise_trajectories
from dynident.excitation.optimisation.design_problem import Budget, CandidateEvaluator, DesignProblem, draw_candidates
from dynident.excitation.point_sequence import (
    FreePoints,
    MovePlanner,
    PointSequence,
    PointSpace,
    TwoPoints,
    draw_sequences,
    improve_sequence,
    stack_rows,
)
from dynident.motion.joint_trajectories import Piece
from dynident.motion.limits.bounds import ImpossibleLimitsError, lock_bounds
from dynident.motion.limits.limit_margins import AmplitudeScaler
from dynident.motion.limits.postures_within_limits import draw_holdable_postures
from dynident.progress import Progress, scale_progress

SETS = SET_KINDS.names

_WRIST = 3
_POSTURES_OF_A_GROUP = 3
"""Number of runs of a group of joints, each with the others locked elsewhere, which shows the links from new sides."""


@dataclass(frozen=True)
class FreeMotion:
    """The moving joints follow a trajectory of the requested family."""


@dataclass(frozen=True)
class BetweenTwoPoints:
    """The moving joints go back and forth between two points.

    Parameters
    ----------
    short : tuple of int
        Joints that only speed up and slow down again.
    long : tuple of int
        Joints that cruise at full speed. The other moving joints go a little way meanwhile, so that their friction
        has a sign.
    """

    short: tuple[int, ...] = ()
    long: tuple[int, ...] = ()


@dataclass(frozen=True)
class SlowMotion:
    """The moving joints go slowly through many postures."""


@dataclass(frozen=True)
class PlannedRun:
    """One test motion of a set, before its motion is known.

    Parameters
    ----------
    label : str
        Purpose of the run, in words.
    moving : tuple of int
        Indices of the joints that move.
    how : FreeMotion or BetweenTwoPoints or SlowMotion
        How they move.
    """

    label: str
    moving: tuple[int, ...]
    how: FreeMotion | BetweenTwoPoints | SlowMotion


def plan_runs(name: str, joint_names: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return the runs of a set, in the order in which they are made.

    Parameters
    ----------
    name : str
        Name of the set, one of `SETS`.
    joint_names : tuple of str
        Names of the joints from the base to the terminal link.

    Returns
    -------
    tuple of PlannedRun
        The runs.

    Raises
    ------
    DynidentError
        The robot has too few joints for the set.
    """
    if name == "link_by_link":
        return _plan_link_by_link(joint_names)
    if name == "wrist_then_shoulder":
        return _plan_wrist_then_shoulder(joint_names)
    return _plan_vandanjon(joint_names)


def _plan_link_by_link(joints: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return runs from the terminal link inwards [12.22]-[12.24], each of its joint and the two before it.

    These two carry the link about other axes. The joints beyond are locked: their links are known by then, and move as
    one with this link.
    """
    return tuple(
        PlannedRun(f"link {j + 1} ({joints[j]})", tuple(range(max(0, j - 2), j + 1)), FreeMotion())
        for j in reversed(range(len(joints)))
    )


def _plan_wrist_then_shoulder(joints: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return runs of the last three joints with the arm locked, then of the arm with the wrist locked (§12.7)."""
    n = len(joints)
    if n <= _WRIST:
        raise DynidentError(
            f"the robot has {n} joints; a wrist of {_WRIST} and a shoulder need at least {_WRIST + 1}",
            pointer="/trajectory/sets",
        )
    groups = (("wrist", tuple(range(n - _WRIST, n))), ("shoulder", tuple(range(n - _WRIST))))
    return tuple(
        PlannedRun(f"{name}, posture {k + 1}", moving, FreeMotion())
        for name, moving in groups
        for k in range(_POSTURES_OF_A_GROUP)
    )


def _plan_vandanjon(joints: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return runs for four phenomena, one after the other [Vandanjon 95]; together they make one global system."""
    n = len(joints)
    inertia = [PlannedRun(f"inertia, {joints[j]}", (j,), BetweenTwoPoints(short=(j,))) for j in range(n)]
    pairs = [(i, j) for j in range(1, n) for i in (j - 1, j - 2) if i >= 0]
    centrifugal = [
        PlannedRun(f"centrifugal coupling, {joints[i]} on {joints[j]}", (i, j), BetweenTwoPoints(long=(i,)))
        for i, j in pairs
    ]
    coupling = [
        PlannedRun(f"inertial coupling, {joints[i]} and {joints[j]}", (i, j), BetweenTwoPoints(short=(i, j)))
        for i, j in pairs
    ]
    return (*inertia, *centrifugal, *coupling, PlannedRun("gravity", tuple(range(n)), SlowMotion()))


_KNOWN_BEFORE = 0.02
"""Information about each parameter at the beginning, as a share of its column: too little to matter."""
# Random states that give the size of each column, and candidates and locked postures of each run.
_STATES = 200
_CANDIDATES, _LOCKED_POSTURES = 12, 2
# Variations tried of a motion between two points, and of each point of a longer sequence.
_VARIATIONS_OF_TWO_POINTS, _VARIATIONS_OF_A_POINT = 60, 20
_SLOW = 0.25
"""Share of the limits in the run that shows gravity."""
_MOST_OF_A_RANGE, _HALF_A_RANGE = 0.8, 0.5
_SHORTEST, _LONG, _LONGEST = 0.3, 2.0, 6.0
"""Strokes, as shares of the way that speeding up to the limit and slowing down again takes."""
# Ways of joints that only have to keep moving, as shares of their range.
_LITTLE_WAY = (0.02, 0.1)


@dataclass(frozen=True, eq=False)
class RunMotion:
    """Rounds of a motion that starts and ends at rest in one posture.

    Parameters
    ----------
    round : tuple of Piece
        Pieces of one round.
    rounds : int
        Number of rounds.
    start : (n,)
        Posture at which the motion starts and ends at rest, rad or m.
    random : tuple of (b, b)
        Information ∫ WᵀW dt that random motions of its kind would have given.
    """

    round: tuple[Piece, ...]
    rounds: int
    start: FloatArray
    random: tuple[FloatArray, ...]

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """All rounds."""
        return self.round * self.rounds


class RunSearch:
    """Searches the motions of runs one after the other.

    Parameters
    ----------
    task : DesignTask
        The design task; `duration` of its trajectory is about how long each run lasts.
    rng : Generator
        Generator of all that is drawn.
    """

    def __init__(self, task: DesignTask, rng: np.random.Generator) -> None:
        self._task, self._rng = task, rng
        self._postures = draw_holdable_postures(task.bounds, task.model, rng)
        self._legs: MovePlanner | None = None

    def create_initial_information(self) -> FloatArray:
        """Return the information (b, b) to begin with: a little about every parameter."""
        bounds, n = self._task.bounds, len(self._task.bounds.names)
        q = self._postures[self._rng.integers(len(self._postures), size=_STATES)]
        dq = bounds.velocity * self._rng.uniform(-1, 1, (_STATES, n))
        ddq = bounds.acceleration * self._rng.uniform(-1, 1, (_STATES, n))
        w = self._task.model.observe(q, dq, ddq, dddq=np.zeros_like(q), ddddq=np.zeros_like(q))
        # Mean square of each column over random states: a parameter's share of information is then independent of its
        # unit.
        squares = np.einsum("ij,ij->j", w, w) / _STATES
        return np.diag(_KNOWN_BEFORE**2 * np.where(squares > 0, squares, 1.0))

    def search_first(self, run: PlannedRun, information: FloatArray, budget: Budget, progress: Progress) -> RunMotion:
        """Return the motion of a run that adds the most to the information (b, b) of those before.

        Parameters
        ----------
        run : PlannedRun
            The run, whose motion is not known yet.
        information : (b, b)
            Information ∫ WᵀW dt of the runs before.
        budget : Budget
            Time and number of starts.
        progress : Progress
            Called with the fraction done and a message; may raise to cancel.

        Raises
        ------
        ImpossibleLimitsError
            No motion of the kind was found that keeps the limits.
        """
        b = len(information)
        design_criterion = DesignCriterion(CriterionChoice("d_optimal"), np.ones(b), ParameterSelection.select_all(b))
        return self._search_motion(run, design_criterion, information, budget, progress)

    def search_again(self, run: PlannedRun, information: FloatArray, budget: Budget, progress: Progress) -> RunMotion:
        """Return the motion of a run that is the best by the requested criterion.

        `information` (b, b) is that of all other runs.

        Parameters
        ----------
        run : PlannedRun
            The run.
        information : (b, b)
            Information ∫ WᵀW dt of all other runs.
        budget : Budget
            Time and number of starts.
        progress : Progress
            Called with the fraction done and a message; may raise to cancel.

        Raises
        ------
        ImpossibleLimitsError
            No motion of the kind was found that keeps the limits.
        """
        return self._search_motion(run, self._task.design_criterion, information, budget, progress)

    def _search_motion(
        self, run: PlannedRun, by: DesignCriterion, information: FloatArray, budget: Budget, progress: Progress
    ) -> RunMotion:
        task = self._task
        moving = np.isin(np.arange(len(task.bounds.names)), run.moving)
        # Only the equations of moving joints count: a locked one may be held by its brake.
        within = replace(task, model=replace(task.model, counted=moving), progress=progress)
        # Information is an integral over time; divided by the duration of a run it stands beside W / √N of that run.
        design_criterion = replace(by, earlier=factor_information(information / task.request.trajectory.duration))
        if isinstance(run.how, FreeMotion) and task.request.trajectory.family != "point_to_point":
            return self._search_periodic(within, moving, design_criterion, budget)
        return self._search_points(within, run, moving, design_criterion, budget)

    def _search_periodic(
        self, task: DesignTask, moving: BoolArray, design_criterion: DesignCriterion, budget: Budget
    ) -> RunMotion:
        """Return a periodic trajectory with the other joints locked in the best of some postures."""
        trajectory, model = task.request.trajectory, task.model
        family = build_family(trajectory, max(round(trajectory.duration * task.rate), 1) / task.rate)
        judge = CandidateEvaluator(family, model, design_criterion)
        candidates_of_postures = []
        # Where the other joints are locked decides which parameters show, so that several postures are tried.
        for _ in range(_LOCKED_POSTURES):
            posture = self._postures[self._rng.integers(len(self._postures))]
            bounds = lock_bounds(task.bounds, posture, moving)
            seed = int(self._rng.integers(2**31))
            candidates = draw_candidates(
                family,
                bounds,
                model,
                judge,
                count=_CANDIDATES,
                seed=seed,
                progress=scale_progress(task.progress, 0.0, 0.2),
            )
            candidates_of_postures += [(candidate, bounds) for candidate in candidates]
        if not candidates_of_postures:
            raise ImpossibleLimitsError("no motion with locked joints was found within the limits", pointer="/limits")
        # The bounds are those of the posture in which this candidate has the other joints locked.
        best, bounds = min(candidates_of_postures, key=lambda pair: pair[0].values.criterion)
        problem = DesignProblem(family, model, design_criterion.smooth_criterion, bounds)
        shrinking = AmplitudeScaler(family, bounds, model)
        best = optimise_trajectories(
            problem, shrinking, judge, [best], budget, scale_progress(task.progress, 0.2, 0.9)
        ).best
        (motion, *_), _ = fit_within_limits(task, family, best)
        random = tuple(
            _compute_information(judge, candidate.x, family.period) for candidate, _ in candidates_of_postures
        )
        return RunMotion((motion,), trajectory.periods, motion.start, random)

    def _search_points(
        self, task: DesignTask, run: PlannedRun, moving: BoolArray, design_criterion: DesignCriterion, budget: Budget
    ) -> RunMotion:
        """Return moves between points, the best of some random ones improved."""
        trajectory, rng = task.request.trajectory, self._rng
        if self._legs is None:
            self._legs = MovePlanner(task.bounds, task.model, task.rate)
        legs = self._legs.restrict_to_joints(moving)
        space = self._build_space(task, run, moving)
        candidates = draw_sequences(
            space, legs, design_criterion, count=_CANDIDATES, rng=rng, progress=scale_progress(task.progress, 0.0, 0.2)
        )
        of_points = (
            _VARIATIONS_OF_TWO_POINTS if isinstance(space, TwoPoints) else _VARIATIONS_OF_A_POINT * trajectory.points
        )
        best, _ = improve_sequence(
            candidates[0].sequence,
            space,
            legs,
            design_criterion,
            variations=of_points,
            rng=rng,
            budget=budget,
            progress=scale_progress(task.progress, 0.2, 0.9),
        )
        sequence, pieces = select_first_fitting(task, [best, *(candidate.sequence for candidate in candidates)])
        length = sum(piece.duration for piece in pieces)
        # Rounds of short moves are repeated until the run lasts about as long as requested.
        rounds = trajectory.periods * max(1, round(trajectory.duration / length))
        random = tuple(
            _compute_sequence_information(legs, candidate.sequence, length * rounds) for candidate in candidates
        )
        return RunMotion(pieces, rounds, sequence.points[-1], random)

    def _build_space(self, task: DesignTask, run: PlannedRun, moving: BoolArray) -> PointSpace:
        bounds, trajectory = task.bounds, task.request.trajectory
        if isinstance(run.how, BetweenTwoPoints):
            shortest, longest = _compute_stroke_ranges(task, run.how, moving)
            return TwoPoints(bounds, self._postures, shortest, longest)
        if isinstance(run.how, FreeMotion):
            posture = self._postures[self._rng.integers(len(self._postures))]
            bounds = lock_bounds(bounds, posture, moving)
            postures = draw_holdable_postures(bounds, task.model, self._rng)
            return FreePoints(bounds, postures, trajectory.points)
        return FreePoints(bounds, self._postures, trajectory.points, fastest=_SLOW)


def factor_information(information: FloatArray) -> FloatArray:
    """Return rows (b, b) that have the WᵀW of an information matrix (b, b)."""
    sizes = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    # Scaled to a unit diagonal first: units of parameters must not cost digits.
    eigenvalues, vectors = np.linalg.eigh(information / np.outer(sizes, sizes))
    rows: FloatArray = (np.sqrt(np.maximum(eigenvalues, 0.0)) * vectors).T * sizes
    return rows


def _compute_stroke_ranges(task: DesignTask, how: BetweenTwoPoints, moving: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the shortest and the longest way (n,) of every joint between two points."""
    bounds = task.bounds
    span = 2 * bounds.half_range
    shortest, longest = (np.where(moving, share * span, 0.0) for share in _LITTLE_WAY)
    # As far as the joint gets while it speeds up to its limit and slows down at once.
    corner = np.minimum(bounds.velocity**2 / bounds.acceleration, _MOST_OF_A_RANGE * span)
    for j in how.short:
        shortest[j], longest[j] = _SHORTEST * corner[j], corner[j]
    for j in how.long:
        shortest[j] = min(_LONG * corner[j], _HALF_A_RANGE * span[j])
        longest[j] = max(shortest[j], min(_LONGEST * corner[j], _MOST_OF_A_RANGE * span[j]))
    return shortest, longest


def _compute_information(judge: CandidateEvaluator, x: FloatArray, period: float) -> FloatArray:
    w = judge.observe(x)
    rows = w.reshape(-1, w.shape[-1])
    information: FloatArray = rows.T @ rows * (period / judge.n_samples)
    return information


def _compute_sequence_information(legs: MovePlanner, sequence: PointSequence, seconds: float) -> FloatArray:
    moves = legs.plan_sequence(sequence)
    assert moves is not None
    rows = stack_rows(moves)
    information: FloatArray = seconds * rows.T @ rows
    return information
