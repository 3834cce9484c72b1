"""Pose the constrained problem of `feasible`: all standard parameters, bounds on bodies and friction, the prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Column, get_effect, get_spec, is_plain_friction
from dynident.errors import DynidentError
from dynident.estimation import PriorInformation, Reduction, Solution
from dynident.estimation.constrained_least_squares import (
    ConstrainedSolution,
    EqualityConstraints,
    InfeasibleError,
    MatrixBound,
    solve_constrained,
)
from dynident.estimation.least_squares import build_weighted_factor, compute_correlated_noise
from dynident.estimation.parameter_covariance import compute_null_space, compute_standard_deviations
from dynident.identification.description_prior import (
    EntropicPrior,
    NormalPrior,
    build_entropic_prior,
    build_normal_prior,
    split_prior,
)
from dynident.identification.estimation_problem_options import DescriptionTrust
from dynident.identification.standard_parameters import Body, StandardParameters, find_bodies
from dynident.regressors.model_structure import Model
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS
from dynident.simulation.true_effects import has_bent_friction

# Smallest eigenvalue of a pseudo-inertia, in units of the usual error of a description: exported bodies must not be
# flat.
_LEAST = 1e-5
# Weight of the description where neither data nor prior determine a parameter: its usual error counts for so many
# standard deviations. Where the data are so exact that this would be lost in rounding, for so much of their largest
# weight.
WEAK, _LEAST_SHARE = 0.03, 1e-6
# Singular value, of rows of unit length, below which a direction cannot be reached under the active constraints; a
# share of the largest one where that is larger.
_NULL = 1e-7


@dataclass(frozen=True, eq=False)
class StandardPrior:
    """Prior on standard parameters.

    Parameters
    ----------
    belief : NormalPrior
        Mean and standard deviation of the standard parameters.
    prior : bool
        False where it only decides what the data leave open.
    entropic : EntropicPrior or None
        Distance of bodies from the description's, where that is the prior.
    """

    belief: NormalPrior
    prior: bool
    entropic: EntropicPrior | None

    def approximate_at(self, values: FloatArray) -> StandardPrior:
        """Return the prior with its normal approximation at standard parameters (c,)."""
        if self.entropic is None:
            return self
        return replace(self, belief=self.entropic.approximate_at(self.belief, values))

    @property
    def first_columns_without_bound(self) -> set[int]:
        """First columns of the bodies that the entropic prior keeps possible by itself."""
        return set() if self.entropic is None else {int(columns[0]) for columns in self.entropic.columns}


@dataclass(frozen=True, eq=False)
class FeasibleProblem:
    """The least-squares problem in units in which standard parameters are about one: φ = unit · u.

    Parameters
    ----------
    equations : Reduction
        Equations of the data.
    known : PriorInformation or None
        What is known of the base parameters.
    grouping : (b, c)
        It takes u to base parameters.
    written : (b, c)
        The part of `grouping` that base parameters are named by.
    unit : (c,)
        Sizes of the standard parameters.
    mean : (c,)
        The u that the rows of `rest` and `open` are zero at.
    rest : (k, c)
        Rows for u of what the prior says beyond the base parameters.
    open : (j, c)
        Rows for what neither data nor prior determine.
    bodies : tuple of Body
        Bodies whose pseudo-inertia must have no negative eigenvalue.
    not_negative : (k,)
        Numbers of the parameters that cannot be negative.
    friction : tuple of FrictionBound
        Sums of friction that must resist.
    """

    equations: Reduction
    known: PriorInformation | None
    grouping: FloatArray
    written: FloatArray
    unit: FloatArray
    mean: FloatArray
    rest: FloatArray
    open: FloatArray
    bodies: tuple[Body, ...]
    not_negative: IndexArray
    friction: tuple[FrictionBound, ...] = ()

    @property
    def bound_names(self) -> list[str]:
        """Names of what the matrix bounds hold, in their order."""
        return [body.name for body in self.bodies] + [bound.name for bound in self.friction]

    def to_base_parameters(self, constrained: ConstrainedSolution) -> FloatArray:
        """Return the base parameters (b,) of a solution."""
        values = self.grouping @ constrained.values
        # The solver's rounding must not show in parameters that are held.
        return np.asarray(values if self.known is None else self.known.restore_held(values[~self.known.is_held]))

    def build_rows(
        self, noise: FloatArray, known: PriorInformation | None, rest: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Build the rows of u: equations weighted by their noise, the prior, its rest, and what is open.

        Parameters
        ----------
        noise : (n,)
            Standard deviation of each equation; rows are weighted by one over it.
        known : PriorInformation or None
            What is known of the base parameters.
        rest : (k, c)
            Rows for u of what the prior says beyond these.

        Returns
        -------
        rows, right : (r, c), (r,)
            Rows, and their right-hand side.
        """
        factor = build_weighted_factor(self.equations, noise, known)
        b = len(factor) - 1
        of_data = factor[:b, :b] @ self.grouping
        # Too small a weight would be lost in rounding beside the rows of exact data.
        weak = max(WEAK, _LEAST_SHARE * float(np.abs(of_data).max(initial=0.0)))
        rows = np.vstack([of_data, rest, weak * self.open])
        return rows, np.concatenate([factor[:b, b], rest @ self.mean, weak * (self.open @ self.mean)])

    def solve(self, noise: FloatArray) -> ConstrainedSolution:
        """Return the solution u with equations weighted by 1 / noise (n,)."""
        return self._solve_constrained(*self.build_rows(noise, self.known, self.rest))

    def solve_nearest_to(self, solution: Solution, weak: float) -> ConstrainedSolution:
        """Return the u whose base parameters are nearest to those of a solution, in its own covariance.

        Parameters
        ----------
        solution : Solution
            Estimated base parameters.
        weak : float
            What a usual error counts for in what the solution leaves open, in standard deviations.
        """
        of_data = solution.factor @ self.grouping
        weak *= max(1.0, _LEAST_SHARE / WEAK * float(np.abs(of_data).max(initial=0.0)))
        right = np.concatenate(
            [solution.factor @ solution.values, self.rest @ self.mean, weak * (self.open @ self.mean)]
        )
        return self._solve_constrained(np.vstack([of_data, self.rest, weak * self.open]), right)

    def _solve_constrained(self, rows: FloatArray, right: FloatArray) -> ConstrainedSolution:
        # One matrix inequality for each body: its pseudo-inertia, in units of its usual error, at least a small
        # multiple of the identity.
        bounds = [MatrixBound(body.columns, PSEUDO_INERTIA_PARTS, -_LEAST * np.eye(4)) for body in self.bodies]
        # A sum of friction that must not be negative is a matrix of one entry.
        sums = [
            MatrixBound(bound.columns, (self.unit[bound.columns] * bound.weights)[:, None, None], np.zeros((1, 1)))
            for bound in self.friction
        ]
        held: list[int] = []
        # Few sums are ever below zero. Only those are given to the solver, which is the more exact the fewer there are.
        while True:
            constrained = self._solve_with_bounds(rows, right, [*bounds, *(sums[place] for place in held)])
            below = [k for k, bound in enumerate(sums) if k not in held and _is_below_zero(bound, constrained.values)]
            if not below:
                break
            held += below
        # Numbers of the matrices as in `bound_names`.
        places = [*range(len(bounds)), *(len(bounds) + place for place in held)]
        return replace(constrained, edges=tuple(places[place] for place in constrained.edges))

    def _solve_with_bounds(
        self, rows: FloatArray, right: FloatArray, bounds: Sequence[MatrixBound]
    ) -> ConstrainedSolution:
        equations = self._build_held_equations()
        try:
            constrained = solve_constrained(rows, right, bounds, self.not_negative, equations)
        except InfeasibleError as error:
            raise DynidentError(
                f"no physically feasible parameters were found: {error.detail}",
                pointer="/estimator" if equations is None else "/known",
                title=error.title,
            ) from error
        # Where no constraint is active, return plain least squares: the semidefinite solver is less exact.
        if constrained.zeros or constrained.edges:
            return constrained
        start: FloatArray = np.zeros(rows.shape[1])
        moving: FloatArray = np.eye(rows.shape[1])
        if equations is not None:
            start, moving = equations.solutions
        step = np.linalg.lstsq(rows @ moving, right - rows @ start)[0]
        plain = np.asarray(start + moving @ step)
        # The interior-point method may stop short of a limit that least squares lies far beyond.
        lowest = [float(np.linalg.eigvalsh(bound.evaluate(plain)).min()) for bound in bounds]
        if min([*plain[self.not_negative], *lowest], default=0.0) < -_NULL:
            return constrained
        return replace(constrained, values=plain)

    def _build_held_equations(self) -> EqualityConstraints | None:
        """Return the equations of u that hold base parameters at known values."""
        if self.known is None or self.known.held is None:
            return None
        where = self.known.is_held
        sizes = np.linalg.norm(self.written[where], axis=1)
        return EqualityConstraints(self.written[where] / sizes[:, None], self.known.held[where] / sizes)

    def find_free_directions(self, constrained: ConstrainedSolution) -> FloatArray | None:
        """Return the directions (b, f) in which base parameters can move while the active constraints stay active.

        None where they can move in all directions.
        """
        if not len(constrained.held):
            return None
        # Base parameters in units of their own size: kg m² and kg would not compare.
        size = np.linalg.norm(self.written, axis=1)
        moves = np.ones(len(size), dtype=bool) if self.known is None else ~self.known.is_held
        directions, singular, _ = np.linalg.svd(
            (self.written / size[:, None])[moves] @ compute_null_space(constrained.held), full_matrices=False
        )
        reached = singular > _NULL * max(float(singular.max(initial=0.0)), 1.0)
        if int(np.count_nonzero(reached)) == len(size):
            return None
        free = np.zeros((len(size), int(np.count_nonzero(reached))))
        free[moves] = directions[:, reached] * size[moves, None]
        return free

    def to_solution(self, constrained: ConstrainedSolution, noise: FloatArray) -> Solution:
        """Return the base parameters as estimates with this noise (n,) of the equations."""
        factor = build_weighted_factor(self.equations, noise, self.known)[:-1, :-1]
        free = self.find_free_directions(constrained)
        return Solution(self.to_base_parameters(constrained), noise, factor, self.known, free)

    def to_standard_parameters(self, constrained: ConstrainedSolution, noise: FloatArray) -> StandardParameters:
        """Return the standard parameters with their standard deviations; equations are weighted by `noise` (n,)."""
        # Noise of correlated residuals: deviations must not fall with every sample more.
        noise = compute_correlated_noise(self.equations, self.to_solution(constrained, noise))
        b = len(self.grouping)
        rows = np.vstack([build_weighted_factor(self.equations, noise, self.known)[:b, :b] @ self.written, self.rest])
        return StandardParameters(
            self.unit * constrained.values, self.unit * compute_standard_deviations(rows, constrained.held)
        )


def build_standard_prior(model: Model, trust: DescriptionTrust, unconstrained: Solution) -> StandardPrior:
    """Return the prior of a description, with parameters outside of bodies in units of the torque that they explain.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    trust : DescriptionTrust
        Prior from the description, if any, and how far it is trusted.
    unconstrained : Solution
        Least squares, for these units.
    """
    belief = build_normal_prior(model, trust)
    # Only where the prior is one of bodies: the others are a normal distribution.
    entropic = build_entropic_prior(model, trust.error, belief) if trust.of_bodies else None
    sized = replace(belief, size=_estimate_sizes(model, belief, unconstrained))
    return StandardPrior(sized, trust.prior is not None, entropic)


def build_problem(
    model: Model,
    equations: Reduction,
    known: PriorInformation | None,
    believed: StandardPrior,
    speeds: FloatArray | None = None,
) -> FeasibleProblem:
    """Build the problem with a normal prior; an entropic one replaces what is known.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    equations : Reduction
        Equations of the data.
    known : PriorInformation or None
        What is known of the base parameters.
    believed : StandardPrior
        Prior on the standard parameters, with its normal approximation.
    speeds : (n,), optional
        Largest recorded speed of each joint, in rad/s or m/s, up to which all friction together must resist.

    Returns
    -------
    FeasibleProblem
        The problem in units in which standard parameters are about one.
    """
    belief = believed.belief
    rest = np.zeros((0, len(belief.size)))
    if believed.prior:
        both = split_prior(model, belief)
        rest = both.rest
        # The entropic prior is linearised anew in each step, so its rows replace those from before.
        if believed.entropic is not None:
            known = both.base
    grouping = model.base.grouping * belief.size
    written = np.where(model.base.written, grouping, 0.0)
    # What data or prior determine; its null space is what the description may decide.
    determined = np.vstack([written / np.linalg.norm(written, axis=1)[:, None], rest])
    return FeasibleProblem(
        equations=equations,
        known=known,
        grouping=grouping,
        written=written,
        unit=belief.size,
        mean=belief.mean / belief.size,
        rest=rest,
        open=compute_null_space(determined).T,
        bodies=tuple(
            b for b in find_bodies(model.columns) if int(b.columns[0]) not in believed.first_columns_without_bound
        ),
        not_negative=_list_not_negative(model, speeds),
        friction=() if speeds is None else list_friction_bounds(model, speeds),
    )


def _estimate_sizes(model: Model, belief: NormalPrior, unconstrained: Solution) -> FloatArray:
    """Return orders of magnitude (c,) of all standard parameters; outside of bodies, from the torque they explain."""
    factor = unconstrained.factor @ model.base.grouping
    # A parameter is of the size that would explain all of the torque by itself.
    torque = float(np.linalg.norm(unconstrained.factor @ unconstrained.values))
    columns = np.linalg.norm(factor, axis=0)
    bodies = {int(k) for body in find_bodies(model.columns) for k in body.columns}
    return np.array(
        [
            belief.size[k] if k in bodies or columns[k] == 0 or torque == 0 else torque / columns[k]
            for k in range(len(belief.size))
        ]
    )


def _list_not_negative(model: Model, speeds: FloatArray | None = None) -> IndexArray:
    """Return the parameters that cannot be negative.

    Beside other friction effects of their joint Coulomb and viscous friction are only parts of a sum, which alone has a
    sign.
    """
    bent = {column.link for column in model.columns if has_bent_friction([column.effect])}
    bent -= set() if speeds is None else list_unbounded_joints(model, speeds)
    return np.array(
        [
            k
            for k, column in enumerate(model.columns)
            # Friction of some runs alone is the difference from the other runs, and may have any sign.
            if _is_positive(column) and not (is_plain_friction(column.effect) and (column.runs or column.link in bent))
        ],
        dtype=np.intp,
    )


def _is_positive(column: Column) -> bool:
    spec = get_spec(column)
    return spec is not None and (spec.positive or spec.resists)


# Speeds, as shares of the largest recorded one, at which friction must resist: close where laws bend. Few rows of
# motion are slower, so that what a law says below is little more than its continuation.
_SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)


# Share of a sum's terms by which rounding leaves it below zero.
_BELOW = 1e-8


def _is_below_zero(bound: MatrixBound, values: FloatArray) -> bool:
    terms = bound.parts[:, 0, 0] * values[bound.columns]
    return bool(terms.sum() < -_BELOW * np.abs(terms).sum())


@dataclass(frozen=True, eq=False)
class FrictionBound:
    """A sum of friction that must resist the motion: Σ weights φ ≥ 0.

    Parameters
    ----------
    name : str
        What it is of, such as "friction of joint2".
    columns : (k,)
        Numbers of the parameters in it.
    weights : (k,)
        Torque for a unit of each, against the motion.
    share : float
        Speed as a share of the largest recorded one, below zero backward.
    """

    name: str
    columns: IndexArray
    weights: FloatArray
    share: float


def find_resisting_speeds(model: Model, speeds: FloatArray | None) -> FloatArray:
    """Return the speeds (n,) up to which all friction of a joint together must resist.

    Parameters
    ----------
    model : Model
        The model, with its columns.
    speeds : (n,) or None
        Largest recorded speeds, in rad/s or m/s. Where they are not known the joints' limits stand for them; 0 where
        there is no limit either.
    """
    if speeds is not None:
        return speeds
    limits = [joint.limits.velocity for joint in model.robot.joints]
    return np.array([limit if limit is not None and np.isfinite(limit) else 0.0 for limit in limits])


def list_unbounded_joints(model: Model, speeds: FloatArray) -> set[str]:
    """Return the joints without a speed up to which friction must resist, so that no sum of it can be bounded."""
    return {name for name, speed in zip(model.robot.joint_names, speeds, strict=True) if not speed > 0}


def list_friction_bounds(model: Model, speeds: FloatArray) -> tuple[FrictionBound, ...]:
    """Return the sums of friction, one a joint, direction and speed, that nature does not let be negative.

    Effects by load, position, temperature or time count with none of it, and those of some runs do not count: each
    sum is that of a joint alone, unloaded, which slides steadily.

    Parameters
    ----------
    model : Model
        The model, with its columns.
    speeds : (n,)
        Largest recorded speed of each joint, in rad/s or m/s.
    """
    robot, signals = model.robot, model.signals
    if robot.linkage is not None or not has_bent_friction(choice.effect for choice in model.effects):
        return ()
    moves = (signals.dq, signals.memory_symbols)
    own = [
        (k, robot.joint_names.index(column.link))
        for k, column in enumerate(model.columns)
        if get_effect(column.effect).is_friction
        and not column.runs
        and column.link in robot.joint_names
        and set(map(str, ca.symvar(column.torque))) <= set(map(str, ca.symvar(ca.vertcat(*moves))))
    ]
    torque = ca.vertcat(*(model.columns[k].torque[j] for k, j in own)) if own else ca.SX(0, 1)
    # The columns' own signs are of the velocity; hysteresis that slides steadily has the sign of its joint.
    evaluate = ca.Function("friction", list(moves), [ca.densify(torque)])
    joints = [item.joint for item in signals.memory_signals]
    bounds = []
    for joint, name in enumerate(robot.joint_names):
        members = [place for place, (_, j) in enumerate(own) if j == joint]
        if not members or not speeds[joint] > 0:
            continue
        columns = np.array([own[place][0] for place in members], dtype=np.intp)
        for speed in (*_SPEEDS, *(-share for share in _SPEEDS)):
            dq = np.zeros(robot.n)
            dq[joint] = speed * speeds[joint]
            sliding = np.array([np.sign(dq[j]) for j in joints])
            weights = np.sign(speed) * np.asarray(ca.DM(evaluate(dq, sliding))).ravel()[members]
            bounds.append(FrictionBound(f"friction of {name}", columns, weights, speed))
    return tuple(bounds)
