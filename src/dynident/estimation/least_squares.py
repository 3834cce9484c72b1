"""The least-squares solutions of Y = W χ + ρ, [12.5], from triangular factors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.estimation.correlation import correlation_factors
from dynident.estimation.factors import Reduction
from dynident.estimation.information import Information, root_of
from dynident.estimation.triangles import triangular

MOST_ROUNDS = 20
"""Of re-estimating the noise of every equation, at most; on sound data the third changes no digit that is read."""

WEIGHTS_SETTLED = 1e-6
"""Share by which no equation's noise may change any more: what it changes in the estimates is far below their own."""

_SINGULAR = 1e-12
_ROUNDING = 1e-10


class EstimationError(DynidentError):
    """The equations do not determine the parameters."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Estimates χ (c,), the noise of every equation that the rows were weighted by (n,), and the factor R (c, c).

    R is the triangular factor of the weighted W, so that (WᵀW)⁻¹ = R⁻¹R⁻ᵀ; `scales` (c,) are the norms of the
    weighted columns. `known`: what was known beside the data; its rows are part of R. `free` (c, f): the directions
    that constraints leave free, where they hold some back. `converged`: whether the rounds that it took have settled.
    """

    values: FloatArray
    noise: FloatArray
    factor: FloatArray
    known: Information | None = None
    free: FloatArray | None = None
    converged: bool = True

    @property
    def scales(self) -> FloatArray:
        """(c,): norms of the weighted columns of W."""
        return np.asarray(np.linalg.norm(self.factor, axis=0))

    @property
    def normal_inverse(self) -> FloatArray:
        """(c, c): (WᵀW)⁻¹ of the weighted W; with constraints that hold, its like in the free directions."""
        root = self.root
        return np.asarray(root @ root.T)

    @property
    def root(self) -> FloatArray:
        """(c, f): a factor of `normal_inverse`, as many columns as there are directions that nothing holds."""
        if self.free is None:
            return root_of(self.factor)
        return np.asarray(self.free @ root_of(triangular(self.factor @ self.free)))


@dataclass(frozen=True, eq=False)
class Errors:
    """How well parameters explain a data set, for every equation (n,): sums of squares and numbers of rows."""

    squares: FloatArray
    measured: FloatArray
    counts: FloatArray

    def __repr__(self) -> str:
        return f"Errors({len(self.counts)} equations: relative error {self.relative_total:.2%})"

    @property
    def rms(self) -> FloatArray:
        """(n,): root mean square of the residual, N m or N."""
        return np.sqrt(self.squares / np.maximum(self.counts, 1))

    @property
    def relative(self) -> FloatArray:
        """(n,): ||y - ŷ|| / ||y||; 1 where nothing was measured and something predicted."""
        safe = np.where(self.measured > 0, self.measured, 1.0)
        return np.where(self.measured > 0, np.sqrt(self.squares / safe), np.where(self.squares > 0, 1.0, 0.0))

    @property
    def relative_total(self) -> float:
        """||Y - Ŷ|| / ||Y|| over all equations."""
        total = float(self.measured.sum())
        return float(np.sqrt(self.squares.sum() / total)) if total > 0 else 0.0

    @property
    def rms_total(self) -> float:
        """Root mean square over all equations and samples."""
        return float(np.sqrt(self.squares.sum() / max(float(self.counts.sum()), 1.0)))


def weighted_factor(reduction: Reduction, noise: FloatArray, known: Information | None = None) -> FloatArray:
    """(c + 1, c + 1): factor of [W | Y] over all equations, each divided by its noise (n,), and of what is known."""
    c = reduction.n_columns
    parts = [np.zeros((0, c + 1)) if known is None else known.rows]
    for equation, sigma in zip(reduction.equations, noise, strict=True):
        k = len(equation.columns)
        if not len(equation.counts):
            continue
        wide = np.zeros((k + 1, c + 1))
        wide[:, equation.columns] = equation.joined[:, :k] / sigma
        wide[:, c] = equation.joined[:, k] / sigma
        parts.append(wide)
    stacked = np.concatenate(parts)
    if len(stacked) < c + 1:
        stacked = np.pad(stacked, [(0, c + 1 - len(stacked)), (0, 0)])
    return triangular(stacked)


def condition_number(reduction: Reduction) -> float:
    """cond(W), [12.12], of W as it is: no equation or row weighted, nothing known beside the data."""
    return _condition(weighted_factor(reduction.alike, np.ones(len(reduction.equations)))[:-1, :-1])


def equilibrated_condition_number(reduction: Reduction, noise: FloatArray) -> float:
    """cond(W) of the W weighted by noise (n,), with columns of the same size: units of parameters do not count."""
    factor = weighted_factor(reduction, noise)[:-1, :-1]
    scales = np.linalg.norm(factor, axis=0)
    return _condition(factor / np.where(scales > 0, scales, 1.0))


def _condition(factor: FloatArray) -> float:
    singular = np.linalg.svd(factor, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def errors(reduction: Reduction, values: FloatArray) -> Errors:
    """The residual of parameters χ (c,) on all rows of a data set.

    Where what is beside the equations is known, also at rest: there it is the distance of the torque to the band that
    static friction holds.
    """
    found = fitted_errors(reduction, values)
    squares, measured, counts = found.squares.copy(), found.measured.copy(), found.counts.copy()
    for k, equation in enumerate(reduction.equations):
        beside, own = equation.beside, values[equation.columns]
        if beside is None:
            continue
        # What rows beside a halt hold of motion is in the fit; as rows they are at rest.
        squares[k] += beside.standing_squares(own) - beside.partial.squares(own)
        measured[k] += beside.standing_measured - beside.partial.measured
        counts[k] += beside.n_standing - beside.partial.count
    return Errors(np.maximum(squares, 0.0), np.maximum(measured, 0.0), counts)


def moving_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """The residual of parameters χ (c,) on the rows of every equation where its joint moves."""
    found = fitted_errors(reduction, values)
    squares, measured, counts = found.squares.copy(), found.measured.copy(), found.counts.copy()
    for k, equation in enumerate(reduction.equations):
        if equation.beside is not None:
            for rows in (equation.turning, equation.beside.partial):
                if rows is None:
                    continue
                squares[k] -= rows.squares(values[equation.columns])
                measured[k] -= rows.measured
                counts[k] -= rows.count
    return Errors(np.maximum(squares, 0.0), np.maximum(measured, 0.0), counts)


def fitted_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """The residual of parameters χ (c,) on the rows that are fitted to, each of which counts alike."""
    squares, measured = weighed_squares(reduction, values), []
    for k, equation in enumerate(reduction.equations):
        own = float(equation.joined[:, -1] @ equation.joined[:, -1])
        if equation.turned is not None:
            lacks = 1.0 - equation.turned.weight
            squares[k] += lacks * equation.turned.squares(values[equation.columns])
            own += lacks * equation.turned.measured
        measured.append(own)
    return Errors(squares, np.array(measured), reduction.row_counts)


def weighed_squares(reduction: Reduction, values: FloatArray) -> FloatArray:
    """(n,): squared residual of parameters χ (c,) in every equation, its rows as they are weighed there."""
    rests = (e.joined[:, -1] - e.joined[:, :-1] @ values[e.columns] for e in reduction.equations)
    return np.array([float(rest @ rest) for rest in rests])


def share_of_measured(reduction: Reduction, change: FloatArray) -> float:
    """||W Δχ|| / ||Y||: what a change of the parameters (c,) changes, as a share of what was measured."""
    squares = measured = 0.0
    for equation in reduction.alike.equations:
        k = len(equation.columns)
        moved = equation.joined[:, :k] @ change[equation.columns]
        squares += float(moved @ moved)
        measured += float(equation.joined[:, k] @ equation.joined[:, k])
    return float(np.sqrt(squares / measured)) if measured > 0 else 0.0


def solve(reduction: Reduction, noise: FloatArray, known: Information | None = None) -> Solution:
    """Least squares [12.5] with every equation weighted by 1 / noise (n,), and what is known beside the data.

    Raises
    ------
    EstimationError
        Where there are fewer rows than parameters or W has not full rank.
    """
    c = reduction.n_columns
    check_rows(reduction.n_rows, c, known)
    r = weighted_factor(reduction, noise, known)
    factor, right = r[:c, :c], r[:c, c]
    check_rank(factor, _SINGULAR)
    return Solution(solve_triangular(factor, right), noise, factor, known)


def check_rows(n_rows: int, n_parameters: int, known: Information | None) -> None:
    """Raise `EstimationError` where there are fewer rows than parameters, what is known beside the data counted."""
    if n_rows + (0 if known is None else len(known.right)) <= n_parameters:
        raise EstimationError(
            f"{n_rows} equations cannot determine {n_parameters} parameters; use a longer recording or wider windows",
            pointer="/measurement_ids",
            title="Too few samples",
        )


def check_rank(factor: FloatArray, least: float, of: str = "") -> None:
    """Raise `EstimationError` where a triangular factor (c, c) of W is singular: a column depends on those before it.

    `least`: share of a column that has to be its own; `of`: whose W it is, for the message.
    """
    scales = np.linalg.norm(factor, axis=0)
    if np.any(scales == 0) or np.any(np.abs(np.diag(factor)) <= least * scales):
        raise EstimationError(
            f"the observation matrix{of} has not full rank on this data", pointer="/effects", title="Not identifiable"
        )


def ordinary(reduction: Reduction, known: Information | None = None) -> Solution:
    """Ordinary least squares: all equations count alike.

    What is known beside the data is weighed against the common noise of the equations, independent samples counted.
    """
    alike = np.ones(len(reduction.equations))
    if known is None:
        return solve(reduction, alike)
    counts = reduction.row_counts

    def common(values: FloatArray) -> FloatArray:
        doubt = doubtful_noise(reduction, values)
        return float(np.sqrt(np.sum(counts * doubt**2) / max(float(counts.sum()), 1.0))) * alike

    return _settled(reduction, solve(reduction, alike, known), common, known)


def weighted(reduction: Reduction, known: Information | None = None) -> Solution:
    """Weighted least squares: each equation divided by the standard deviation of its own residual.

    Where something is known beside the data, each row counts for as much as it is worth as an independent sample.
    """
    levels = noise_levels if known is None else doubtful_noise
    first = replace(ordinary(reduction, known), converged=True)
    return _settled(reduction, first, lambda values: levels(reduction, values), known)


def _settled(
    reduction: Reduction, first: Solution, noise_of: Callable[[FloatArray], FloatArray], known: Information | None
) -> Solution:
    """Solve and weigh by the noise that the estimates leave, by turns, until the noise settles."""
    solution = first
    for _ in range(MOST_ROUNDS):
        noise = noise_of(solution.values)
        solution = solve(reduction, noise, known)
        if weights_settled(reduction, noise, noise_of(solution.values)):
            return solution
    return replace(solution, converged=False)


def weights_settled(reduction: Reduction, before: FloatArray, after: FloatArray) -> bool:
    """Whether noise (n,) to weight by has stopped changing, or is no more than what rounding leaves of exact data."""
    measured = [float(np.linalg.norm(equation.joined[:, -1])) for equation in reduction.equations]
    rounding = _ROUNDING * np.array(measured) / np.sqrt(np.maximum(reduction.row_counts, 1.0))
    return bool(np.all(np.abs(after - before) <= np.maximum(WEIGHTS_SETTLED * before, rounding)))


def doubtful_noise(reduction: Reduction, values: FloatArray) -> FloatArray:
    """(n,): noise of every equation, larger by the correlation of its rows: what to weigh other knowledge against.

    Not less than what rounding leaves of the measured values, lest exact data outweigh other knowledge without end.
    """
    factors = correlation_factors(reduction, values)
    found = fitted_errors(reduction, values)
    rounding = _ROUNDING * np.sqrt(found.measured / np.maximum(found.counts, 1))
    return np.maximum(noise_levels(reduction, values) * np.sqrt(factors), rounding)


def noise_levels(reduction: Reduction, values: FloatArray) -> FloatArray:
    """(n,): standard deviation of every equation's residual, as one weights by it."""
    return floored(residual_noise(reduction, values))


def residual_noise(reduction: Reduction, values: FloatArray) -> FloatArray:
    """(n,): standard deviation of every equation's residual, [12.7] with the parameters shared out over the rows.

    Of rows as they are weighed within their equation; `noise_of_rows` has each count alike.
    """
    return _deviation(reduction, weighed_squares(reduction, values))


def noise_of_rows(reduction: Reduction, values: FloatArray) -> FloatArray:
    """(n,): standard deviation of the residual of all rows of every equation that are fitted to, weighed or not."""
    return _deviation(reduction, fitted_errors(reduction, values).squares)


def _deviation(reduction: Reduction, squares: FloatArray) -> FloatArray:
    share = max(1.0 - reduction.n_columns / max(reduction.n_rows, 1), 0.1)
    return np.asarray(np.sqrt(squares / np.maximum(reduction.row_counts * share, 1)))


def floored(sigma: FloatArray) -> FloatArray:
    """Noise (n,) to weight by: an equation without residual (no torque, no motion) must not get an infinite weight."""
    return np.asarray(np.maximum(sigma, 1e-9 * max(float(sigma.max(initial=0.0)), 1e-12)))
