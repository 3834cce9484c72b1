"""A trajectory design as an optimisation problem: criterion and limits as functions of coefficients, with gradients.

Holds the time budget, samples of a period, and the random trajectories that a search starts from.

The budget of the search, the sampling of a period during the design, and the random trajectories that the search starts
from belong to it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import get_effect
from dynident.excitation.criteria.design_criterion import DesignCriterion
from dynident.excitation.criteria.optimality_criteria import Criterion, CriterionValues
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.excitation.equation_type_rows import RowModelName, build_row_model
from dynident.excitation.expected_torque import ExpectedTorqueGradient
from dynident.excitation.swaying_trunk import build_observation_gradient
from dynident.motion.collision.constraint_slack import METRES_OF_A_SHARE
from dynident.motion.collision_free_paths import MoveCost
from dynident.motion.joint_trajectories import Family
from dynident.motion.limits.bounds import Bounds
from dynident.motion.limits.limit_margins import AmplitudeScaler
from dynident.motion.limits.postures_within_limits import draw_holdable_postures
from dynident.progress import Progress, ignore_progress


class Budget:
    """Limits of an optimisation's time and number of starts.

    Parameters
    ----------
    starts : int, optional
        Largest number of starts.
    seconds : float, optional
        Longest time, counted from now.
    """

    def __init__(self, starts: int | None, seconds: float | None) -> None:
        self.starts, self.seconds = starts, seconds
        self._began = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds that have passed, those before an interruption included."""
        return time.monotonic() - self._began

    def add_elapsed(self, seconds: float) -> None:
        """Count the time that passed before the search was interrupted."""
        self._began -= seconds

    @property
    def share_spent(self) -> float:
        """Share of the time that has passed; 0 where time is not limited."""
        return 0.0 if self.seconds is None else (time.monotonic() - self._began) / self.seconds

    @property
    def is_spent(self) -> bool:
        """Whether the time is over."""
        return self.share_spent >= 1.0

    def start_part(self, share: float) -> Callable[[], bool]:
        """Return a function that says whether a share of the time that is left now has passed by then."""
        # What was spent before, on a robot with many joints much of it, is no time of this part.
        end = self.share_spent + share * (1.0 - self.share_spent)
        return lambda: self.share_spent > end

    def fraction(self, starts: float) -> float:
        """Return the share of the budget used when so many starts are done, parts of them included."""
        shares = [] if self.starts is None else [starts / self.starts]
        if self.seconds is not None:
            shares.append(self.share_spent)
        return min(1.0, max(shares))


# Samples of a period, and samples of each wave of the highest frequency.
_N_SAMPLES = 100
_SAMPLES_PER_WAVE = 16
# Hysteresis and low-speed friction happen within a few per cent of a period.
_N_CLOSE_SAMPLES = 600
# Share of the velocity limit over which sign(q̇) is rounded while optimising, and at most so much of a shape constant.
_SMOOTH_SIGN = 0.01
_SHARE_OF_SHAPE = 0.25


def count_period_samples(model: DesignModel, family: Family) -> int:
    """Return the number of samples N of one period that the criterion is computed from.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    family : Family
        Family of trajectories.
    """
    close = model.needs_path or bool(_find_narrow_speeds(model))
    # The fastest wave of the family must be sampled well, or the motion could break limits between the samples.
    return max(_N_CLOSE_SAMPLES if close else _N_SAMPLES, _SAMPLES_PER_WAVE * family.waves)


def choose_sign_rounding(model: DesignModel, bounds: Bounds) -> float:
    """Return the velocity (rad/s, m/s) over which sign(q̇) is rounded, small compared to limits and friction peaks.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    bounds : Bounds
        Limits of the motion.
    """
    narrow = [_SHARE_OF_SHAPE * speed for speed in _find_narrow_speeds(model)]
    return min([_SMOOTH_SIGN * float(bounds.velocity.min()), *narrow])


def _find_narrow_speeds(model: DesignModel) -> list[float]:
    """Return the shape constants of the model that are a speed near rest."""
    return [
        dict(column.shape)[spec.name]
        for column in model.base_columns[: model.n_parameters]
        for spec in get_effect(column.effect).shapes
        if spec.resolved_by == "speed" and spec.name in dict(column.shape)
    ]


# Between the samples a motion swings out a little further than on them.
_SHARE_OF_LIMITS = 0.99


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the augmented Lagrangian, and the penalty's weight.

    Parameters
    ----------
    values : (6, N, n)
        One for each limit and sample.
    crowding : (N, K)
        One for each distance that is kept, and for the balance of a robot on its feet.
    penalty : float
        Weight μ of the penalty.
    """

    values: FloatArray
    crowding: FloatArray
    penalty: float

    def update(self, at: Evaluation, penalty: float) -> Multipliers:
        """Return those of the next round, after an evaluation at the end of this one.

        Parameters
        ----------
        at : Evaluation
            Evaluation at the end of this round.
        penalty : float
            Weight μ of the next round.
        """
        return Multipliers(
            np.maximum(0.0, self.values + self.penalty * at.excess),
            np.maximum(0.0, self.crowding + self.penalty * at.crowding),
            penalty,
        )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The augmented Lagrangian at one x, and its parts.

    An excess of 0 touches a limit, above 0 breaks it: |value| / bound - 1.

    Parameters
    ----------
    lagrangian : float
        Value of the augmented Lagrangian.
    gradient : (m n,)
        Its gradient over the coefficients.
    criterion : float
        Value of the smooth criterion.
    excess : (6, N, n)
        Of the limits.
    crowding : (N, K)
        Excess of the distances that are kept, in units of `METRES_OF_A_SHARE`.
    """

    lagrangian: float
    gradient: FloatArray
    criterion: float
    excess: FloatArray
    crowding: FloatArray

    @property
    def worst_excess(self) -> float:
        """The largest excess."""
        return max(float(self.excess.max()), float(self.crowding.max(initial=-np.inf)))


class DesignProblem:
    """Criterion and limits over the coefficients x (m, n) of a family; those of joints without range stay as they are.

    For one thread at a time; see `copy_for_thread`.

    Parameters
    ----------
    family : Family
        Family of trajectories.
    model : DesignModel
        Model of the design.
    criterion : Criterion
        The smooth criterion.
    bounds : Bounds
        Limits of the motion.
    rows : str
        The identification model whose rows the criterion is computed from.
    moves : MoveCost, optional
        What the moves from and to home cost; nothing where left out.
    """

    def __init__(
        self,
        family: Family,
        model: DesignModel,
        criterion: Criterion,
        bounds: Bounds,
        rows: RowModelName = "dynamic",
        moves: MoveCost | None = None,
    ) -> None:
        self.family, self.bounds, self._moves = family, bounds, moves
        self.n = model.robot.n
        self.n_samples = count_period_samples(model, family)
        self._model = model
        self._criterion = criterion
        # The families are linear in their coefficients: one matrix gives positions and derivatives at all samples.
        self._basis = family.basis(np.arange(self.n_samples) * family.period / self.n_samples)
        self._rows_of = rows
        self._row_model = build_row_model(rows, self.n_samples, family.period, family.highest_frequency)
        rounding = choose_sign_rounding(model, bounds)
        self._rows = build_observation_gradient(model, self.n_samples, rounding)
        self._expected = None if model.expected is None else ExpectedTorqueGradient(model.expected, rounding)
        b = model.n_parameters
        self._n_parameters = b
        self._nominal = model.nominal_values
        self._counted = None if model.counted.all() else model.counted[:, None].astype(np.float64)
        self._middle = np.zeros((6, 1, self.n))
        self._middle[0, 0] = bounds.middle
        self._constraints = None if bounds.space is None else bounds.space.constraints
        self._balance = bounds.balance
        of_rates = (bounds.velocity, bounds.acceleration, bounds.jerk, bounds.torque, bounds.power)
        half_ranges = np.stack([bounds.half_range, *of_rates])
        self._moving = bounds.half_range > 0
        # A locked joint has no range, and a distance from its middle must not be divided by zero.
        half_ranges[0, ~self._moving] = np.inf
        # An absent limit has an infinite range: its share is zero, and it never acts.
        self._per_half_range = 1.0 / (_SHARE_OF_LIMITS * half_ranges[:, None, :])

    def copy_for_thread(self) -> DesignProblem:
        """Return a copy for another thread: evaluations of one problem use the same memory."""
        return DesignProblem(self.family, self._model, self._criterion, self.bounds, self._rows_of, self._moves)

    def create_multipliers(self, penalty: float) -> Multipliers:
        """Return zero multipliers, where the augmented Lagrangian begins."""
        count = sum(part.count for part in (self._constraints, self._balance) if part is not None)
        return Multipliers(np.zeros((6, self.n_samples, self.n)), np.zeros((self.n_samples, count)), penalty)

    def evaluate(self, flat: FloatArray, multipliers: Multipliers) -> Evaluation:
        """Return the augmented Lagrangian at coefficients (m n,), exact gradient included.

        F(W(x)) + 1/(2 μ) Σ max(0, λ + μ c(x))² - λ² with c the excess (Rockafellar 1973).

        Parameters
        ----------
        flat : (m n,)
            Coefficients of the family.
        multipliers : Multipliers
            Multipliers of this round.
        """
        x = flat.reshape(self.family.n_coefficients, self.n)
        q, dq, ddq, dddq, ddddq = self._basis @ x
        w = self._rows.evaluate(q, dq, ddq, dddq, ddddq)
        # The description's torque is linear in the same base parameters, so that one evaluation of W serves criterion
        # and torque limits.
        torque = w @ self._nominal if self._expected is None else self._expected.evaluate(q, dq, ddq)
        b = self._n_parameters
        scale = 1.0 / np.sqrt(self.n_samples)
        chosen = self._mask_uncounted(w[:, :, :b])
        criterion, of_rows = self._criterion(scale * self._row_model.build_rows(chosen, dq))
        of_chosen, of_velocity = self._row_model.pull_back(chosen, dq, scale * of_rows)
        # Everything as a share of its limit: one penalty then weighs all kinds of limits alike.
        shares = (np.stack([q, dq, ddq, dddq, torque, torque * dq]) - self._middle) * self._per_half_range
        excess = np.abs(shares) - 1.0
        active = np.maximum(0.0, multipliers.values + multipliers.penalty * excess)
        crowding, of_crowding, of_motion = self._evaluate_crowding((q, dq, ddq), multipliers)
        penalty = float(np.sum(active**2) - np.sum(multipliers.values**2)) / (2 * multipliers.penalty) + of_crowding
        of_signals = active * np.sign(shares) * self._per_half_range
        # Power is torque times velocity: its share of the gradient goes to both by the product rule.
        of_torque = of_signals[4] + of_signals[5] * dq
        of_w = of_torque[:, :, None] * self._nominal if self._expected is None else np.zeros_like(w)
        of_w[:, :, :b] += self._mask_uncounted(of_chosen)
        gradient = self._basis[1].T @ (of_velocity + of_signals[5] * torque)
        for basis, of_derivative in zip(self._basis, of_motion, strict=False):
            gradient += basis.T @ of_derivative
        for basis, of_derivative in zip(self._basis, of_signals[:4], strict=False):
            gradient += basis.T @ of_derivative
        for basis, of_derivative in zip(self._basis, self._rows.pull_back(of_w), strict=False):
            gradient += basis.T @ of_derivative
        if self._expected is not None:
            for basis, of_derivative in zip(self._basis, self._expected.pull_back(of_torque), strict=False):
                gradient += basis.T @ of_derivative
        if self._moves is not None:
            cost, of_cost = self._moves.evaluate(x)
            criterion, gradient = criterion + cost, gradient + of_cost
        # Without a gradient the optimiser leaves locked joints where they are.
        gradient[:, ~self._moving] = 0.0
        return Evaluation(criterion + penalty, gradient.ravel(), criterion, excess, crowding)

    def _mask_uncounted(self, rows: FloatArray) -> FloatArray:
        """Return the rows (N, n, b) with those of joints that do not count set to zero."""
        return rows if self._counted is None else rows * self._counted

    def _evaluate_crowding(
        self, motion: tuple[FloatArray, FloatArray, FloatArray], multipliers: Multipliers
    ) -> tuple[FloatArray, float, list[FloatArray]]:
        """Return the crowding (N, K), its part of the augmented Lagrangian, and the gradient of that.

        The gradient is that over q, or over q, q̇, q̈ (N, n); none where nothing is near.
        """
        at_rest = None if self._constraints is None else self._constraints.evaluate(motion[0])
        moving = None if self._balance is None else self._balance.evaluate_motion(*motion)
        parts = [part.values for part in (at_rest, moving) if part is not None]
        if not parts:
            return multipliers.crowding, 0.0, []
        # Slack is positive where there is clearance to spare, an excess where a limit is broken: hence the sign.
        crowding = np.concatenate(parts, axis=1) / -METRES_OF_A_SHARE
        active = np.maximum(0.0, multipliers.crowding + multipliers.penalty * crowding)
        penalty = float(np.sum(active**2) - np.sum(multipliers.crowding**2)) / (2 * multipliers.penalty)
        if not active.any():
            return crowding, penalty, []
        of_slack = active / -METRES_OF_A_SHARE
        gradient = [] if moving is None else moving.pull_back_motion(of_slack[:, -moving.values.shape[1] :])
        if at_rest is not None:
            of_posture = at_rest.pull_back(of_slack[:, : at_rest.values.shape[1]])
            gradient = [of_posture + gradient[0], *gradient[1:]] if gradient else [of_posture]
        return crowding, penalty, gradient


@dataclass(frozen=True, eq=False)
class Candidate:
    """A trajectory that keeps the limits, and its criterion values.

    Parameters
    ----------
    x : (m, n)
        Coefficients of the family, a column a joint.
    values : CriterionValues
        Criterion values of the trajectory.
    rank : float
        What candidates are compared by, the smaller the better: a logarithm of the criterion, with what moves cost.
    """

    x: FloatArray
    values: CriterionValues
    rank: float


class CandidateEvaluator:
    """Criterion values of coefficients, without smoothing, on samples of one period."""

    def __init__(
        self,
        family: Family,
        model: DesignModel,
        design_criterion: DesignCriterion,
        *,
        n_samples: int = 0,
        rows: RowModelName = "dynamic",
        moves: MoveCost | None = None,
    ) -> None:
        self._model, self._design_criterion, self.moves = model, design_criterion, moves
        self.n_samples = max(n_samples, count_period_samples(model, family))
        self._basis = family.basis(np.arange(self.n_samples) * family.period / self.n_samples)
        self.row_model = build_row_model(rows, self.n_samples, family.period, family.highest_frequency)

    def build_candidate(self, x: FloatArray) -> Candidate:
        """Return the candidate of coefficients (m, n)."""
        values, cost = self.evaluate(x), 0.0 if self.moves is None else self.moves.evaluate(x)[0]
        return Candidate(x, values, self._design_criterion.compute_logarithm(values) + cost)

    def evaluate(self, x: FloatArray) -> CriterionValues:
        """Return the criterion values of coefficients (m, n)."""
        return self._design_criterion.evaluate(
            self.row_model.build_rows(self.observe(x), self.compute_velocity(x)), self.n_samples
        )

    def observe(self, x: FloatArray) -> FloatArray:
        """Return W (N, n, b) of the dynamic model for coefficients (m, n)."""
        q, dq, ddq, dddq, ddddq = self._basis @ x
        memory = self._model.compute_memory(q, periodic=True)
        w = self._model.observe(q, dq, ddq, dddq=dddq, ddddq=ddddq, memory=memory)
        return w.reshape(*q.shape, -1)

    def compute_velocity(self, x: FloatArray) -> FloatArray:
        """Return q̇ (N, n) for coefficients (m, n)."""
        velocity: FloatArray = self._basis[1] @ x
        return velocity


def draw_candidates(
    family: Family,
    bounds: Bounds,
    model: DesignModel,
    judge: CandidateEvaluator,
    *,
    count: int,
    seed: int,
    progress: Progress = ignore_progress,
    enough: Callable[[], bool] = lambda: False,
) -> list[Candidate]:
    """Return random trajectories of the family, each joint scaled into its limits, best first.

    `count` of them, or fewer where `enough` says so once there is one.

    Parameters
    ----------
    family : Family
        Family of trajectories.
    bounds : Bounds
        Limits of the motion.
    model : DesignModel
        Model that predicts the torque.
    judge : CandidateEvaluator
        Gives the criterion values.
    count : int
        Largest number of trajectories to draw.
    seed : int
        Seed of the generator.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    enough : callable
        Asked before each draw; True ends the drawing once there is a trajectory.

    Returns
    -------
    list of Candidate
        Trajectories within the limits, best first; none where every one had to be given up.

    Raises
    ------
    ImpossibleLimitsError
        No posture can be held within the torque limits.
    """
    rng = np.random.default_rng(seed)
    postures = draw_holdable_postures(bounds, model, rng)
    # Coarsely: of many random motions only the best are looked at closely later.
    shrinking = AmplitudeScaler(family, bounds, model, fine=False)
    # Position to jerk, without the offset, which no scale changes.
    basis = family.basis(np.arange(judge.n_samples) * family.period / judge.n_samples)[:4, :, 1:]
    candidates: list[Candidate] = []
    for index in range(count):
        if candidates and enough():
            break
        progress(index / count, f"random trajectory {index + 1} of {count}")
        x = np.empty((family.n_coefficients, model.robot.n))
        # The first coefficient is the posture about which the motion swings; the others are random.
        x[0] = postures[rng.integers(len(postures))]
        x[1:] = rng.standard_normal((family.n_coefficients - 1, model.robot.n))
        # Each joint fills its own limits first; then one factor for all brings torque and clearances within theirs.
        x[1:] *= _find_largest_scale(basis @ x[1:], x[0], bounds)
        if judge.moves is not None:
            # As near to home as the range allows: from a start far away a search does not come back.
            q = basis[0] @ x[1:]
            low, high = bounds.position_low - q.min(axis=0), bounds.position_high - q.max(axis=0)
            x[0] = np.clip(judge.moves.home - q[0], low, np.maximum(low, high))
        fitting = shrinking.scale_down(x)
        if fitting is not None:
            candidates.append(judge.build_candidate(fitting))
    return sorted(candidates, key=lambda candidate: candidate.rank)


def _find_largest_scale(motion: FloatArray, centre: FloatArray, bounds: Bounds) -> FloatArray:
    """Return the amplitude per joint (n,) of motion (4, N, n) about its centre that fills the limits on q … jerk."""
    q, dq, ddq, dddq = motion
    scale: FloatArray = np.min(
        [
            (bounds.position_high - centre) / q.max(axis=0),
            (centre - bounds.position_low) / -q.min(axis=0),
            bounds.velocity / np.abs(dq).max(axis=0),
            bounds.acceleration / np.abs(ddq).max(axis=0),
            bounds.jerk / np.abs(dddq).max(axis=0),
        ],
        axis=0,
    )
    return scale
