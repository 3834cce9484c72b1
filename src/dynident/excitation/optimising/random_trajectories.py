"""Random trajectories inside the limits, and the values of coefficients: where the optimisation starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.criteria.criterion_values import CriterionValues
from dynident.excitation.criteria.design_criterion import DesignCriterion
from dynident.excitation.design_model import DesignModel
from dynident.excitation.optimising.design_problem import count_period_samples
from dynident.excitation.row_models import RowModelName, build_row_model
from dynident.motion.joint_trajectories import Family
from dynident.motion.limits.bounds import Bounds
from dynident.motion.limits.margins import AmplitudeScaler
from dynident.motion.limits.postures import draw_holdable_postures
from dynident.progress import Progress, ignore_progress


@dataclass(frozen=True, eq=False)
class Candidate:
    """A trajectory that keeps the limits, and its criterion values.

    Parameters
    ----------
    x : (m, n)
        Coefficients of the family, a column a joint.
    values : CriterionValues
        Criterion values of the trajectory.
    """

    x: FloatArray
    values: CriterionValues


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
    ) -> None:
        self._model, self._design_criterion = model, design_criterion
        self.n_samples = max(n_samples, count_period_samples(model, family))
        self._basis = family.basis(np.arange(self.n_samples) * family.period / self.n_samples)
        self.row_model = build_row_model(rows, self.n_samples, family.period, family.highest_frequency)

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
        fitting = shrinking.scale_down(x)
        if fitting is not None:
            candidates.append(Candidate(fitting, judge.evaluate(fitting)))
    return sorted(candidates, key=lambda candidate: candidate.values.criterion)


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
