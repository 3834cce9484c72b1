"""Physically feasible parameters: those of bodies that can exist, nearest to the data (Wensing, Kim and Slotine 2018).

The standard parameters φ are the unknowns and the base parameters are β = G φ, so the data are fitted as well as by any
parameters that a real robot could have: the pseudo-inertia of every link and payload has no negative eigenvalue, and no
rotor inertia is negative, nor friction where it is Coulomb and viscous alone. The data determine β alone. Of the φ that
give it those nearest to the description are taken; near is measured by how far descriptions usually are off
(`usual_errors`), and without a prior this decides nothing that the data can decide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import Column, effect_by_id
from dynident.errors import DynidentError
from dynident.estimation import Information, Reduction, Solution, errors, noise_levels, statistics, weighted
from dynident.estimation.deviations import deviations, null_space
from dynident.estimation.factors import IntArray
from dynident.estimation.least_squares import doubtful_noise, weighted_factor
from dynident.estimation.semidefinite import Constrained, InfeasibleError, MatrixBound, constrained_least_squares
from dynident.identification.bodies import Body, bodies_of
from dynident.identification.choices import IdentificationChoices
from dynident.identification.data import Data
from dynident.identification.fit import Fit
from dynident.identification.prior import Belief, belief_of, parted
from dynident.identification.standard import StandardParameters
from dynident.regressors.model import Model
from dynident.robot.model import FloatArray
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS

# Least eigenvalue of a pseudo-inertia, of that of a usual error in the description: exported bodies must not be flat.
_LEAST = 1e-5
# Weight of what decides between parameters that neither data nor prior tell apart: a usual error counts for so many
# standard deviations, or for so much of the largest weight of the data where those are so exact that it would be lost.
_WEAK, _LEAST_SHARE = 0.03, 1e-6
_ROUNDS = 3
_NULL = 1e-7
_NOTABLE = 1.02


def feasible(model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
    """Weighted least squares over all parameters that a real robot can have.

    Standard deviations take the constraints that hold the solution back as certain.

    Raises
    ------
    DynidentError
        Where the data, with what is known beside them, do not determine the base parameters, or where nothing that is
        possible was found.
    """
    unconstrained = weighted(data.equations, known)
    problem = _problem(model, choices, data.equations, known, unconstrained)
    levels = noise_levels if known is None else doubtful_noise
    noise = unconstrained.noise
    for _ in range(_ROUNDS):
        found = problem.solve(noise)
        noise = levels(data.equations, problem.base_of(found))
    values = problem.base_of(found)
    factor = weighted_factor(data.equations, noise, known)[:-1, :-1]
    solution = Solution(values, noise, factor, known, problem.free(found))
    return Fit(
        solution,
        statistics(data.equations, solution),
        _warnings(model, problem, found, data.equations, unconstrained),
        problem.standard(found),
    )


@dataclass(frozen=True, eq=False)
class _FeasibleProblem:
    """The problem in units in which standard parameters are about one: φ = unit · u.

    `grouping` (b, c) takes u to base parameters; `rest` rows for u and `mean` (c,), its value where they are zero;
    `open` rows for what neither data nor prior determine.
    """

    equations: Reduction
    known: Information | None
    grouping: FloatArray
    written: FloatArray
    unit: FloatArray
    mean: FloatArray
    rest: FloatArray
    open: FloatArray
    bodies: tuple[Body, ...]
    not_negative: IntArray

    def base_of(self, found: Constrained) -> FloatArray:
        """(b,): base parameters."""
        return np.asarray(self.grouping @ found.values)

    def solve(self, noise: FloatArray) -> Constrained:
        """The solution u with equations weighted by 1 / noise (n,)."""
        factor = weighted_factor(self.equations, noise, self.known)
        b = len(factor) - 1
        of_data = factor[:b, :b] @ self.grouping
        weak = max(_WEAK, _LEAST_SHARE * float(np.abs(of_data).max(initial=0.0)))
        rows = np.vstack([of_data, self.rest, weak * self.open])
        right = np.concatenate([factor[:b, b], self.rest @ self.mean, weak * (self.open @ self.mean)])
        bounds = [MatrixBound(body.columns, PSEUDO_INERTIA_PARTS, -_LEAST * np.eye(4)) for body in self.bodies]
        try:
            found = constrained_least_squares(rows, right, bounds, self.not_negative)
        except InfeasibleError as error:
            raise DynidentError(
                f"no physically feasible parameters were found: {error.detail}",
                pointer="/estimator",
                title=error.title,
            ) from error
        # Where nothing holds it back the solution is that of least squares, to the last digit.
        return found if len(found.held) else replace(found, values=np.linalg.lstsq(rows, right)[0])

    def free(self, found: Constrained) -> FloatArray | None:
        """(b, f): directions in which base parameters can move while the constraints that hold stay where they are."""
        if not len(found.held):
            return None
        size = np.linalg.norm(self.written, axis=1)
        left, singular, _ = np.linalg.svd((self.written / size[:, None]) @ null_space(found.held), full_matrices=False)
        reached = singular > _NULL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)
        if int(np.count_nonzero(reached)) == len(size):
            return None
        return np.asarray(left[:, reached] * size[:, None])

    def standard(self, found: Constrained) -> StandardParameters:
        """Standard parameters with their standard deviations."""
        noise = doubtful_noise(self.equations, self.base_of(found))
        b = len(self.grouping)
        rows = np.vstack([weighted_factor(self.equations, noise, self.known)[:b, :b] @ self.written, self.rest])
        return StandardParameters(self.unit * found.values, self.unit * deviations(rows, found.held))


def _problem(
    model: Model,
    choices: IdentificationChoices,
    equations: Reduction,
    known: Information | None,
    unconstrained: Solution,
) -> _FeasibleProblem:
    belief = belief_of(model, choices)
    belief = replace(belief, size=_sizes(model, belief, unconstrained))
    rest = parted(model, belief).rest if choices.prior is not None else np.zeros((0, len(belief.size)))
    grouping = model.base.grouping * belief.size
    written = np.where(model.base.written, grouping, 0.0)
    seen = np.vstack([written / np.linalg.norm(written, axis=1)[:, None], rest])
    return _FeasibleProblem(
        equations=equations,
        known=known,
        grouping=grouping,
        written=written,
        unit=belief.size,
        mean=belief.mean / belief.size,
        rest=rest,
        open=null_space(seen).T,
        bodies=bodies_of(model.columns),
        not_negative=_not_negative(model),
    )


def _sizes(model: Model, belief: Belief, unconstrained: Solution) -> FloatArray:
    """(c,): orders of magnitude of all standard parameters; outside of bodies, from the torque they explain."""
    factor = unconstrained.factor @ model.base.grouping
    torque = float(np.linalg.norm(unconstrained.factor @ unconstrained.values))
    columns = np.linalg.norm(factor, axis=0)
    bodies = {int(k) for body in bodies_of(model.columns) for k in body.columns}
    return np.array(
        [
            belief.size[k] if k in bodies or columns[k] == 0 or torque == 0 else torque / columns[k]
            for k in range(len(belief.size))
        ]
    )


def _not_negative(model: Model) -> IntArray:
    """The parameters that nature allows no negative value.

    Beside other friction effects Coulomb and viscous friction are only parts of a sum, which alone has a sign.
    """
    others = any(effect_by_id(c.effect).is_friction and c.effect not in _PLAIN_FRICTION for c in model.effects)
    always = ("rotor_inertia",) if others else ("rotor_inertia", *_PLAIN_FRICTION)
    return np.array(
        [
            k
            for k, column in enumerate(model.columns)
            # Friction of some runs alone is a difference from the others': it may have any sign.
            if (column.effect in always or _positive(column)) and not (column.runs and column.effect in _PLAIN_FRICTION)
        ],
        dtype=np.intp,
    )


def _positive(column: Column) -> bool:
    return any(spec.positive for spec in effect_by_id(column.effect).parameters if spec.name == column.parameter)


_PLAIN_FRICTION = ("coulomb", "viscous")


def _warnings(
    model: Model, problem: _FeasibleProblem, found: Constrained, equations: Reduction, unconstrained: Solution
) -> tuple[str, ...]:
    """What physical feasibility holds back, and what it costs."""
    told = []
    at_zero = [model.columns[k].name for k in found.zeros]
    if at_zero:
        told.append(f"Held at zero, below which nature allows nothing: {', '.join(at_zero)}.")
    at_edge = [problem.bodies[place].name for place in found.edges]
    if at_edge:
        told.append(
            f"Held at the edge of what a body can be (no mass is negative anywhere in it): {', '.join(at_edge)}."
        )
    if told:
        told.append("Standard deviations take these limits as certain.")
    before = errors(equations, unconstrained.values).rms_total
    after = errors(equations, problem.base_of(found)).rms_total
    if before > 0 and after > _NOTABLE * before:
        told.append(
            f"Physical feasibility costs {after / before - 1:.0%} of the residual in the fit: the data want parameters "
            "that no robot has, because the motion does not determine them or an effect is missing."
        )
    return tuple(told)
