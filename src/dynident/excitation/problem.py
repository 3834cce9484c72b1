"""The optimisation problem of a design: criterion and limits as one smooth function of the coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.excitation.criteria import Criterion
from dynident.excitation.family import Family
from dynident.excitation.limits import Bounds
from dynident.excitation.model import DesignModel
from dynident.excitation.row_models import RowModelName, row_model
from dynident.excitation.sampling import samples_of_a_period, smooth_sign
from dynident.excitation.sensitivity import ObservationGradient
from dynident.robot.model import FloatArray

# Between the samples a motion swings out a little further than on them.
_SHARE_OF_LIMITS = 0.99


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Of the augmented Lagrangian: `values` (5, N, n), one for each limit and sample, and the penalty's weight."""

    values: FloatArray
    penalty: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """At one x: the augmented Lagrangian and its gradient (m n,), the criterion, the limits' excess (5, N, n).

    An excess of 0 touches a limit, above 0 breaks it: |value| / bound - 1.
    """

    lagrangian: float
    gradient: FloatArray
    criterion: float
    excess: FloatArray

    @property
    def worst(self) -> float:
        """The largest excess."""
        return float(self.excess.max())


class DesignProblem:
    """Criterion and limits over the coefficients x (m, n) of a family; those of joints without range stay as they are.

    Parameters
    ----------
    family : Family
    model : DesignModel
    criterion : Criterion
    bounds : Bounds
    rows : str
        The identification model whose rows the criterion is computed from.
    """

    def __init__(
        self,
        family: Family,
        model: DesignModel,
        criterion: Criterion,
        bounds: Bounds,
        rows: RowModelName = "dynamic",
    ) -> None:
        self.family, self.bounds = family, bounds
        self.n = model.robot.n
        self.n_samples = samples_of_a_period(model, family)
        self._model = model
        self._criterion = criterion
        self._basis = family.basis(np.arange(self.n_samples) * family.period / self.n_samples)
        self._row_model = row_model(rows, self.n_samples, family.period, family.highest_frequency)
        self._rows = ObservationGradient(model, self.n_samples, smooth_sign(model, bounds))
        b = model.n_parameters
        self._n_parameters = b
        self._nominal = model.nominal
        self._counted = model.counted[:, None]
        self._middle = np.zeros((5, 1, self.n))
        self._middle[0, 0] = bounds.middle
        room = np.stack([bounds.half_range, bounds.velocity, bounds.acceleration, bounds.jerk, bounds.torque])
        self._moving = bounds.half_range > 0
        room[0, ~self._moving] = np.inf
        # An absent limit has infinite room: its share is zero, and it never acts.
        self._per_room = 1.0 / (_SHARE_OF_LIMITS * room[:, None, :])

    def no_multipliers(self, penalty: float) -> Multipliers:
        """Where the augmented Lagrangian begins."""
        return Multipliers(np.zeros((5, self.n_samples, self.n)), penalty)

    def evaluate(self, flat: FloatArray, multipliers: Multipliers) -> Evaluation:
        """The augmented Lagrangian at coefficients (m n,), exact gradient included.

        F(W(x)) + 1/(2 μ) Σ max(0, λ + μ c(x))² - λ² with c the excess (Rockafellar 1973).
        """
        x = flat.reshape(self.family.n_coefficients, self.n)
        q, dq, ddq, dddq, ddddq = self._basis @ x
        w = self._rows.evaluate(q, dq, ddq, dddq, ddddq)
        torque = w @ self._nominal
        b = self._n_parameters
        scale = 1.0 / np.sqrt(self.n_samples)
        chosen = w[:, :, :b] * self._counted
        criterion, of_rows = self._criterion(scale * self._row_model.rows(chosen, dq))
        of_chosen, of_velocity = self._row_model.pull_back(chosen, dq, scale * of_rows)
        shares = (np.stack([q, dq, ddq, dddq, torque]) - self._middle) * self._per_room
        excess = np.abs(shares) - 1.0
        active = np.maximum(0.0, multipliers.values + multipliers.penalty * excess)
        penalty = float(np.sum(active**2) - np.sum(multipliers.values**2)) / (2 * multipliers.penalty)
        of_signals = active * np.sign(shares) * self._per_room
        of_w = of_signals[4][:, :, None] * self._nominal
        of_w[:, :, :b] += of_chosen * self._counted
        gradient = self._basis[1].T @ of_velocity
        for basis, of_derivative in zip(self._basis, of_signals[:4], strict=False):
            gradient += basis.T @ of_derivative
        for basis, of_derivative in zip(self._basis, self._rows.pull_back(of_w), strict=False):
            gradient += basis.T @ of_derivative
        gradient[:, ~self._moving] = 0.0
        return Evaluation(criterion + penalty, gradient.ravel(), criterion, excess)
