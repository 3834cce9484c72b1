"""Closed loops with passive positions as expressions of driven ones, checked against recorded positions.

The positions x of the passive joints are found by Newton's method from a first guess near the branch that the
description starts on. The guess is a polynomial that is fitted to positions which were followed from the start. The
results are expressions, like those of any other joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.expressions import Program
from dynident.expressions.sines_and_cosines import AngleTerms, substitute_angles
from dynident.robot.cut_joint import LOOP_TITLE, make_approximation_error
from dynident.robot.json_fields import join_names
from dynident.robot.loop_equations import CLOSED, SINGULAR, LoopEquations
from dynident.robot.loop_numerics import compute_condition
from dynident.robot.passive_positions import build_passive_positions

# One of so many recorded positions is checked: they change little from sample to sample.
_EVERY = 20
# A loop that is open by more (m) is not open by rounding alone.
_OPEN = 1e-6


@dataclass(frozen=True, eq=False)
class Closure(LoopEquations):
    """The loops of one machine with their solution: the passive positions at any driven ones within the limits."""

    @cached_property
    def solution(self) -> ca.Function:
        """(q_a) -> x, cos x and sin x SX (p, 1)."""
        function = build_passive_positions(self)
        if function is None:
            raise make_approximation_error(self.loops[0])
        return function

    def substitute_passive(self, expression: ca.SX, driven: ca.SX) -> ca.SX:
        """Return an expression of the symbols of x as an expression of the driven positions SX (n, 1)."""
        return substitute_angles(expression, self.symbols[1], AngleTerms(*self.solution(driven)))

    def compute_log_condition(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how near postures are to singular ones: ln of the condition of ∂φ/∂x, and its gradient.

        Parameters
        ----------
        q : ndarray (m, n)
            Driven positions.

        Returns
        -------
        values : ndarray (m,)
            Infinite where the loops are open or singular.
        slopes : ndarray (m, n)
            ∂ values / ∂ q; zero where the value is infinite.
        """
        x = self.solve_passive(q)
        gap, slopes = self.evaluate(q, x)
        regular = (np.abs(gap).max(axis=1) < CLOSED) & (compute_condition(slopes) < SINGULAR)
        left_vectors, values, right_vectors = np.linalg.svd(np.where(regular[:, None, None], slopes, np.eye(self.p)))
        # The gradient of a singular value is u_kᵀ (dA) v_k, with the singular vectors u_k and v_k: differentiate the
        # largest and the smallest one.
        bends = self._slope_derivatives(np.ascontiguousarray(q), np.ascontiguousarray(x))
        bends = bends.reshape(len(q), self.n, self.p, self.p).swapaxes(2, 3)

        def compute_slope(k: int) -> FloatArray:
            """Return ∂ ln σ_k / ∂q_a (m, n)."""
            along = np.einsum("mi,mjik,mk->mj", left_vectors[:, :, k], bends, right_vectors[:, k])
            return np.asarray(along / values[:, k, None])

        log_condition = np.where(regular, np.log(values[:, 0] / values[:, -1]), np.inf)
        return log_condition, np.where(regular[:, None], compute_slope(0) - compute_slope(-1), 0.0)

    def solve_passive(self, q: FloatArray) -> FloatArray:
        """Return the passive coordinates (m, p) at driven positions (m, n)."""
        return self._passive(np.ascontiguousarray(q, dtype=np.float64))

    def compute_gaps_and_conditions(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the largest gap (m,) in m or rad and the condition (m,) of ∂φ/∂x at driven positions (m, n)."""
        gap, slopes = self.evaluate(q, self.solve_passive(q))
        return np.abs(gap).max(axis=1), compute_condition(slopes)

    def check_closed(self, t: FloatArray, q: FloatArray) -> None:
        """Check at some of the driven positions q (m, n), recorded at times t (m,), that the loops are closed.

        Raises
        ------
        DynidentError
            If a loop is open or a posture is singular: no recording of this machine can hold it.
        """
        gaps, conditions = self.compute_gaps_and_conditions(q[::_EVERY])
        # Negated comparisons, so that positions that are not a number count as wrong.
        wrong = np.flatnonzero(~(gaps < _OPEN) | ~(conditions < SINGULAR))
        if len(wrong):
            k = int(wrong[0])
            raise DynidentError(
                f"At t = {t[::_EVERY][k]:.3f} s the loops ({join_names(loop.name for loop in self.loops)}) are open "
                f"by {gaps[k]:.3g} m, and their equations have the condition {conditions[k]:.3g}: the recorded "
                "positions are at or beyond a singular posture, or outside the limits of the driven joints within "
                "which the passive positions are known. Correct lengths, zeros or signs, or set wider limits.",
                title=LOOP_TITLE,
            )

    @cached_property
    def _slope_derivatives(self) -> Program:
        """d(∂φ/∂x)/dq_a along the closed loops: one p x p block after another, one for each driven joint."""
        free, rates = ca.vertcat(*self.symbols), self.rates(*self.symbols)
        ways = ca.vertcat(ca.SX.eye(self.n), rates)
        flat = ca.vec(ca.densify(self.slopes[1]))
        derivatives = [ca.jtimes(flat, free, ca.densify(ways[:, j])) for j in range(self.n)]
        return Program(list(self.symbols), ca.densify(ca.vertcat(*derivatives)))

    @cached_property
    def _passive(self) -> Program:
        return Program([self.symbols[0]], ca.densify(self.solution(self.symbols[0])[0]))
