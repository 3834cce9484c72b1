"""The least-squares problem over all standard parameters that a real robot can have."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.effects import Column, Role, effect_by_id, role_of, spec_of
from dynident.errors import DynidentError
from dynident.estimation import Information, Reduction, Solution
from dynident.estimation.deviations import deviations, null_space
from dynident.estimation.least_squares import doubtful_noise, weighted_factor
from dynident.estimation.semidefinite import Constrained, InfeasibleError, MatrixBound, constrained_least_squares
from dynident.identification.asked import Trust
from dynident.identification.parameters.bodies import Body, bodies_of
from dynident.identification.parameters.standard import StandardParameters
from dynident.identification.prior.belief import Belief, parted
from dynident.identification.prior.entropic import EntropicPrior, entropic_prior
from dynident.identification.prior.prior import belief_of
from dynident.regressors.model import Model
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS

# Least eigenvalue of a pseudo-inertia, of that of a usual error in the description: exported bodies must not be flat.
_LEAST = 1e-5
# Weight of what decides between parameters that neither data nor prior tell apart: a usual error counts for so many
# standard deviations, or for so much of the largest weight of the data where those are so exact that it would be lost.
WEAK, _LEAST_SHARE = 0.03, 1e-6
_NULL = 1e-7


@dataclass(frozen=True, eq=False)
class Believed:
    """What is believed of standard parameters; `prior` is false where that only decides what the data leave open.

    `entropic`: how far bodies are from the description's, where that is what is believed.
    """

    belief: Belief
    prior: bool
    entropic: EntropicPrior | None

    def at(self, values: FloatArray) -> Believed:
        """The same, as it looks near standard parameters (c,)."""
        if self.entropic is None:
            return self
        return replace(self, belief=self.entropic.belief_at(self.belief, values))

    @property
    def free_of_bounds(self) -> set[int]:
        """First columns of the bodies that the divergence keeps possible."""
        return set() if self.entropic is None else {int(columns[0]) for columns in self.entropic.columns}


@dataclass(frozen=True, eq=False)
class FeasibleProblem:
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
    not_negative: IndexArray

    def base_of(self, found: Constrained) -> FloatArray:
        """(b,): base parameters."""
        return np.asarray(self.grouping @ found.values)

    def rows(self, noise: FloatArray, known: Information | None, rest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """[rows | right] of u: equations weighted by 1 / noise (n,), what is known, the rest, and what is open."""
        factor = weighted_factor(self.equations, noise, known)
        b = len(factor) - 1
        of_data = factor[:b, :b] @ self.grouping
        weak = max(WEAK, _LEAST_SHARE * float(np.abs(of_data).max(initial=0.0)))
        rows = np.vstack([of_data, rest, weak * self.open])
        return rows, np.concatenate([factor[:b, b], rest @ self.mean, weak * (self.open @ self.mean)])

    def solve(self, noise: FloatArray) -> Constrained:
        """The solution u with equations weighted by 1 / noise (n,)."""
        return self._constrained(*self.rows(noise, self.known, self.rest))

    def nearest_to(self, solution: Solution, weak: float) -> Constrained:
        """The u whose base parameters are nearest to those of a solution, measured by how sure that one is.

        `weak`: what a usual error counts for in what the solution leaves open, in standard deviations.
        """
        of_data = solution.factor @ self.grouping
        weak *= max(1.0, _LEAST_SHARE / WEAK * float(np.abs(of_data).max(initial=0.0)))
        right = np.concatenate([solution.factor @ solution.values, weak * (self.open @ self.mean)])
        return self._constrained(np.vstack([of_data, weak * self.open]), right)

    def _constrained(self, rows: FloatArray, right: FloatArray) -> Constrained:
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
        return found if len(found.held) else replace(found, values=np.asarray(np.linalg.lstsq(rows, right)[0]))

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


def believed_of(model: Model, trust: Trust, unconstrained: Solution) -> Believed:
    """The belief in a description, parameters outside of bodies in units of the torque that they explain."""
    belief = belief_of(model, trust)
    entropic = entropic_prior(model, trust.error, belief) if trust.of_bodies else None
    sized = replace(belief, size=_sizes(model, belief, unconstrained))
    return Believed(sized, trust.prior is not None, entropic)


def problem_of(model: Model, equations: Reduction, known: Information | None, believed: Believed) -> FeasibleProblem:
    """The problem with a normal belief; an entropic one takes the place of what is known."""
    belief = believed.belief
    rest = np.zeros((0, len(belief.size)))
    if believed.prior:
        both = parted(model, belief)
        rest = both.rest
        if believed.entropic is not None:
            known = both.base
    grouping = model.base.grouping * belief.size
    written = np.where(model.base.written, grouping, 0.0)
    seen = np.vstack([written / np.linalg.norm(written, axis=1)[:, None], rest])
    return FeasibleProblem(
        equations=equations,
        known=known,
        grouping=grouping,
        written=written,
        unit=belief.size,
        mean=belief.mean / belief.size,
        rest=rest,
        open=null_space(seen).T,
        bodies=tuple(b for b in bodies_of(model.columns) if int(b.columns[0]) not in believed.free_of_bounds),
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


def _not_negative(model: Model) -> IndexArray:
    """The parameters that nature allows no negative value.

    Beside other friction effects Coulomb and viscous friction are only parts of a sum, which alone has a sign.
    """
    others = any(
        effect_by_id(c.effect).is_friction and not effect_by_id(c.effect).held_in(_PLAIN_FRICTION)
        for c in model.effects
    )
    return np.array(
        [
            k
            for k, column in enumerate(model.columns)
            # Friction of some runs alone is a difference from the others': it may have any sign.
            if _positive(column) and not (role_of(column) in _PLAIN_FRICTION and (column.runs or others))
        ],
        dtype=np.intp,
    )


def _positive(column: Column) -> bool:
    spec = spec_of(column)
    return spec is not None and (spec.positive or spec.resists)


_PLAIN_FRICTION: tuple[Role, ...] = ("dry", "damping")
