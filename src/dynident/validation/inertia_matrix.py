"""Validation of the inertia matrix: search the posture with its smallest eigenvalue (§12.7).

A search for the worst posture, not a few samples: minima of the smallest eigenvalue are sought from the worst of many
random postures, with the exact gradient. The eigenvalue λ of S(q) v = λ v, ||v|| = 1, changes with the posture by
vᵀ (∂S/∂q) v.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy

from dynident.array_types import FloatArray
from dynident.effects import get_effect
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.identification import Identification
from dynident.identification.standard_parameters import draw_postures, get_joint_range
from dynident.identification.thresholds import ValidationOutcome
from dynident.number_format import format_number
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.regressors.model_structure import Model
from dynident.robot.robot_model import Robot

# Random postures, the worst of them that descents start from, and steps of a descent at most.
_SAMPLES = 2000
_STARTS = 16
_ITERATIONS = 80


@dataclass(frozen=True, eq=False)
class InertiaMatrixValidation:
    """The worst posture that was found.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the joints.
    posture : (n,) or None
        The worst posture in rad or m; None where nothing was evaluated.
    smallest_eigenvalue : float or None
        Smallest eigenvalue there of A(q) scaled to a unit diagonal.
    standard_deviation : float or None
        Standard deviation of that eigenvalue, from the covariance of the parameters.
    sampled : float or None
        Smallest eigenvalue among the random postures alone, before the descents.
    evaluations : int
        Number of postures that were tried in all.
    judged : ValidationOutcome
        Whether the matrix is positive definite, and the reason.
    """

    joint_names: tuple[str, ...]
    posture: FloatArray | None
    smallest_eigenvalue: float | None
    standard_deviation: float | None
    sampled: float | None
    evaluations: int
    judged: ValidationOutcome


@single_threaded
def validate_inertia_matrix(
    identification: Identification, *, seed: int = 0, progress: Progress = ignore_progress
) -> InertiaMatrixValidation:
    """Search the joint range for the posture where the inertia matrix is least positive.

    The matrix is scaled to a unit diagonal, because a wrist's inertia is a thousandth of a shoulder's: the sign is what
    counts. Joints without limits are searched over a full turn (± 1 m).

    Parameters
    ----------
    identification : Identification
        The identified model.
    seed : int
        Of the random postures.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    InertiaMatrixValidation
        The worst posture; not evaluated for a model without inertial parameters or of poses at rest.
    """
    model, values = identification.model, identification.values
    if not any(get_effect(column.effect).is_inertia for column in model.kept):
        judged = ValidationOutcome("not_evaluated", "The model has no inertial parameters: there is no inertia matrix.")
        return InertiaMatrixValidation(model.robot.joint_names, None, None, None, None, 0, judged)
    if model.is_at_rest:
        judged = ValidationOutcome(
            "not_evaluated",
            "The model was identified from poses at rest, which contain no information about the inertia matrix.",
        )
        return InertiaMatrixValidation(model.robot.joint_names, None, None, None, None, 0, judged)
    search = _PostureSearch(model, values)
    postures = draw_postures(model.robot, _SAMPLES, seed)
    progress(0.0, "sampling postures")
    sampled = search.sample(postures)
    low, high = get_joint_range(model.robot)
    # A descent finds only the nearest minimum, so several are started, from the worst of the random postures.
    starts = postures[np.argsort(sampled)[:_STARTS]]
    for number, start in enumerate(starts):
        progress((number + 1) / (len(starts) + 1), f"searching for the worst posture, start {number + 1}")
        search.descend(start, low, high)
    deviation = search.standard_deviation(identification.statistics.covariance)
    return InertiaMatrixValidation(
        joint_names=model.robot.joint_names,
        posture=search.worst,
        smallest_eigenvalue=search.smallest,
        standard_deviation=deviation,
        sampled=float(sampled.min()),
        evaluations=search.evaluations,
        judged=_judge_inertia_matrix(model.robot, search.worst, search.smallest, deviation),
    )


class _PostureSearch:
    """Minimisation of the smallest eigenvalue over postures, which keeps the worst posture of all evaluations."""

    def __init__(self, model: Model, values: FloatArray) -> None:
        self._values = values
        self._matrix, self._slope, self._parts = _build_functions(model, values)
        self.worst = np.zeros(model.robot.n)
        self.smallest = float("inf")
        self.evaluations = 0

    def sample(self, postures: FloatArray) -> FloatArray:
        """Return the smallest scaled eigenvalue (k,) at postures (k, n)."""
        n = postures.shape[1]
        # CasADi puts the matrices side by side; one call for all is much faster than one a posture.
        stacked = np.asarray(self._matrix.map(len(postures))(postures.T), dtype=np.float64)
        matrices = stacked.reshape(n, len(postures), n).transpose(1, 0, 2)
        return np.array([self._evaluate_posture(q, a)[0] for q, a in zip(postures, matrices, strict=True)])

    def descend(self, start: FloatArray, low: FloatArray, high: FloatArray) -> None:
        """Go from a posture to a local minimum of the smallest eigenvalue."""
        scipy.optimize.minimize(
            self._value_and_gradient,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
            options={"maxiter": _ITERATIONS},
        )

    def standard_deviation(self, covariance: FloatArray) -> float:
        """Return that of the eigenvalue at the worst posture, from the covariance (b, b) of the parameters."""
        a = np.asarray(self._matrix(self.worst), dtype=np.float64)
        value, v, scale = _compute_smallest_eigenvalue(a)
        u = v * scale
        weights = np.zeros_like(a)
        np.fill_diagonal(weights, np.sign(np.diag(a)) * value * (v * scale) ** 2)
        # First order: the change of λ is ⟨u uᵀ - diag(…), ∂A/∂χ⟩, since the scaling by the diagonal changes with A as
        # well.
        direction = np.outer(u, u) - weights
        parts = np.asarray(self._parts(self.worst), dtype=np.float64)
        gradient = direction.reshape(-1) @ parts
        return float(np.sqrt(max(float(gradient @ covariance @ gradient), 0.0)))

    def _value_and_gradient(self, q: FloatArray) -> tuple[float, FloatArray]:
        a = np.asarray(self._matrix(q), dtype=np.float64)
        value, v, scale = self._evaluate_posture(q, a)
        # vᵀ S v with S = D A D, D = diag(A)^-½: the derivative of D comes in through the diagonal.
        gradient = np.asarray(self._slope(q, v * scale, value * (v * scale) ** 2), dtype=np.float64).reshape(-1)
        return value, gradient

    def _evaluate_posture(self, q: FloatArray, a: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        self.evaluations += 1
        eigenpair = _compute_smallest_eigenvalue(a)
        if eigenpair[0] < self.smallest:
            self.smallest, self.worst = eigenpair[0], np.array(q, dtype=np.float64)
        return eigenpair


def _compute_smallest_eigenvalue(a: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return the smallest eigenvalue of A (n, n) scaled to a unit diagonal, its vector (n,), and the scale (n,).

    A diagonal entry that is not positive is scaled to minus one: the matrix is indefinite there.
    """
    diagonal = np.abs(np.diag(a))
    # The bound keeps an entry of zero from a division by zero; it is far below any real inertia.
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-300)))
    values, vectors = np.linalg.eigh(a * np.outer(scale, scale))
    return float(values[0]), vectors[:, 0], scale


def _build_functions(model: Model, values: FloatArray) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Build the functions q -> A(q); (q, u, w) -> gradient of uᵀAu - wᵀ|diag A|; q -> ∂A/∂χ (n², b)."""
    signals = model.signals
    n = model.robot.n
    parts = []
    for column in model.kept:
        inertial = get_effect(column.effect).is_inertia
        parts.append(ca.jacobian(column.torque, signals.ddq) if inertial else ca.SX(n, n))
    # Torque is linear in the accelerations, so its Jacobian with respect to them is the column's share of A(q).
    matrix = ca.SX(n, n)
    for each, value in zip(parts, values, strict=True):
        matrix += float(value) * each
    matrix = 0.5 * (matrix + matrix.T)
    stacked = ca.horzcat(*(ca.densify(ca.reshape(each, n * n, 1)) for each in parts))
    u, w = ca.SX.sym("u", n), ca.SX.sym("w", n)
    # With u and w held fixed, the gradient of this form is that of the eigenvalue.
    form = ca.mtimes([u.T, matrix, u]) - ca.dot(w, ca.fabs(ca.diag(matrix)))
    gradient = ca.gradient(form, signals.q)
    return (
        ca.Function("inertia_matrix", [signals.q], [ca.cse(ca.densify(matrix))]),
        ca.Function("slope", [signals.q, u, w], [ca.cse(ca.densify(gradient))]),
        ca.Function("parts", [signals.q], [stacked]),
    )


def _judge_inertia_matrix(robot: Robot, posture: FloatArray, value: float, deviation: float) -> ValidationOutcome:
    where = "at " + ", ".join(
        f"{name} = {format_number(float(x))}" for name, x in zip(robot.joint_names, posture, strict=True)
    )
    units = "rad" if all(joint.kind == "revolute" for joint in robot.joints) else "rad or m"
    size = f"{value:.3g} ± {NORMAL_95 * deviation:.2g}"
    description = f"its smallest eigenvalue, scaled to a unit diagonal, is {size} {where} ({units})"
    if value <= 0:
        doubt = (
            " Within its uncertainty it may be positive: a feasible estimate that predicts as well may exist."
            if value + NORMAL_95 * deviation > 0
            else ""
        )
        return ValidationOutcome(
            "fail", f"The inertia matrix is not positive definite in every posture: {description}.{doubt}"
        )
    doubt = " The parameters' uncertainty includes zero." if value - NORMAL_95 * deviation <= 0 else ""
    return ValidationOutcome(
        "pass", f"The inertia matrix is positive definite; in the worst posture that was found, {description}.{doubt}"
    )
