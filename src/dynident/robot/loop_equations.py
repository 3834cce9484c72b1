"""Constraint equations of closed loops, their Jacobian, and when a posture is singular.

With the loops cut open, the machine is a tree. Its free coordinates are those of the driven joints, q_a, and of the
passive ones, x; φ(q_a, x) = 0 holds the cut frames together, so that ẋ = -(∂φ/∂x)⁻¹ (∂φ/∂q_a) q̇_a, and once more for ẍ.
x itself is found in `loops`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.expressions import Program
from dynident.robot.cut_joint import (
    LOOP_TITLE,
    Loop,
    build_gap,
    make_loop_error,
    make_reach_error,
    make_redundancy_error,
    to_sparse_constant,
)
from dynident.robot.joint import Joint
from dynident.robot.json_fields import join_names
from dynident.robot.loop_numerics import Pivots, choose_pivots, compute_condition, group_equations, solve_sparse

CLOSED = 1e-9
"""Largest gap of a closed loop (m, rad): rounding."""
SINGULAR = 1e3
"""Condition of ∂φ/∂x above which a posture counts as singular."""
FAR_FROM_SINGULAR = 30.0
"""Condition below which passive positions are reliable; designed trajectories stay there."""
_FOUND, _LEAP = 1e-13, 1.0
_STEP, _MOST_STEPS, _ROUNDS = 0.1, 80, 40
_PIVOT_SAMPLES = 200
# Share of random postures within the limits that have to be reached without passing a singular one.
_LEAST_REACHED = 0.02


@dataclass(frozen=True, eq=False)
class LoopEquations:
    """The loops of one machine as equations φ(q_a, x) = 0 of its free coordinates.

    Attributes
    ----------
    joints : tuple of Joint
        Joints of the tree.
    loops : tuple of Loop
    ratios, offsets : (N, n + p), (N,)
        The tree's positions are ratios [q_a; x] + offsets.
    start : (n + p,)
        A posture near which the loops are closed (rad, m).
    low, high : (n,)
        Bounds of the driven joints.
    names : tuple of str
        Names of the free coordinates, the driven joints first.
    """

    joints: tuple[Joint, ...]
    loops: tuple[Loop, ...]
    ratios: FloatArray
    offsets: FloatArray
    start: FloatArray
    low: FloatArray
    high: FloatArray
    names: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of driven joints."""
        return len(self.low)

    @property
    def p(self) -> int:
        """Number of passive coordinates."""
        return len(self.start) - self.n

    @cached_property
    def are_angles(self) -> tuple[bool, ...]:
        """Which of the passive coordinates are angles (p,)."""
        kinds = {joint.name: joint.kind for joint in self.joints}
        return tuple(kinds[name] == "revolute" for name in self.names[self.n :])

    @cached_property
    def symbols(self) -> tuple[ca.SX, ca.SX]:
        """q_a SX (n, 1) and x SX (p, 1)."""
        return ca.SX.sym("qa", self.n), ca.SX.sym("x", self.p)

    @cached_property
    def gaps(self) -> ca.SX:
        """φ SX (equations, 1): m, and rad where frames coincide wholly."""
        q = ca.mtimes(to_sparse_constant(self.ratios), ca.vertcat(*self.symbols)) + ca.DM(self.offsets)
        return ca.sparsify(ca.vertcat(*(build_gap(loop, self.joints, q) for loop in self.loops)))

    @cached_property
    def slopes(self) -> tuple[ca.SX, ca.SX]:
        """∂φ/∂q_a SX (equations, n) and ∂φ/∂x SX (equations, p)."""
        driven, passive = self.symbols
        return ca.jacobian(self.gaps, driven), ca.jacobian(self.gaps, passive)

    @cached_property
    def rates(self) -> ca.Function:
        """(q_a, x) -> ∂x/∂q_a SX (p, n)."""
        return ca.Function("rates", list(self.symbols), [-self.solve(self.slopes[0])])

    @cached_property
    def accelerations(self) -> ca.Function:
        """(q_a, x, q̇_a, q̈_a) -> ẍ SX (p, 1)."""
        driven, passive = self.symbols
        rate, acceleration = ca.SX.sym("dqa", self.n), ca.SX.sym("ddqa", self.n)
        moving = ca.vertcat(rate, ca.mtimes(self.rates(driven, passive), rate))
        speed = ca.SX.sym("speed", self.n + self.p)
        free = ca.vertcat(driven, passive)
        gap_rate = ca.jtimes(self.gaps, free, speed)
        # φ̈ = 0: the part of φ̈ that does not contain accelerations, evaluated at the velocities of the closed loops,
        # plus the slopes times the accelerations. Solve that for ẍ.
        turning = ca.substitute(ca.jtimes(gap_rate, free, speed), speed, moving)
        value = -self.solve(turning + ca.mtimes(self.slopes[0], acceleration))
        return ca.Function("accelerations", [driven, passive, rate, acceleration], [value])

    def solve(self, right: ca.SX) -> ca.SX:
        """Return (∂φ/∂x)⁻¹ right, SX (p, k), for expressions SX (equations, k)."""
        return solve_sparse(self.slopes[1], right, self._pivots)

    def compute_rates(self, q: FloatArray, x: FloatArray) -> FloatArray:
        """Return ∂x/∂q_a (m, p, n) at driven and passive positions (m, n) and (m, p)."""
        values = self._rates(np.ascontiguousarray(q), np.ascontiguousarray(x))
        return np.swapaxes(values.reshape(len(q), self.n, self.p), 1, 2)

    def compute_accelerations(self, q: FloatArray, x: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return ẍ (m, p) for driven motions q, dq, ddq (m, n) and passive positions x (m, p)."""
        return self._accelerations(*(np.ascontiguousarray(signal) for signal in (q, x, dq, ddq)))

    def get_movers(self, passive: int) -> tuple[int, ...]:
        """Return the driven joints that a passive coordinate moves with."""
        return next((tuple(driven) for _, unknowns, driven in self.groups if passive in unknowns), ())

    def check(self) -> FloatArray:
        """Check that the loops are well posed; return the closed posture (n + p,) near the start.

        Raises
        ------
        DynidentError
            Loops that do not close, have no driven joint, have dependent equations, leave a passive joint free, or are
            singular at the start.
        """
        self._check_counts()
        posture = self.close_start()
        _, slopes = self.evaluate(posture[None, : self.n], posture[None, self.n :])
        condition = float(compute_condition(slopes)[0])
        if condition > SINGULAR:
            self._check_rank(posture)
            raise make_loop_error(
                f"The loops are singular at the start (condition {condition:.3g}): the driven joints do not determine "
                "the passive ones there. Set another `start` of the joints, away from stretched postures.",
                self.loops[0],
            )
        return posture

    def draw_postures(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Return random driven positions (count, n) within the limits, with loops closed and far from singular."""
        accepted: list[FloatArray] = []
        while sum(map(len, accepted)) < count:
            q = rng.uniform(self.low, self.high, (2 * count, self.n))
            x, fine = self.follow_branch(q)
            fine &= compute_condition(self.evaluate(q, x)[1]) < FAR_FROM_SINGULAR
            self._check_reach(fine)
            accepted.append(q[fine])
        return np.vstack(accepted)[:count]

    def sample_postures(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return driven positions (m, n) and passive ones (m, p) of at most `count` closed postures in the limits.

        They are far from singular; some are near the start, some at the limits.
        """
        rng = np.random.default_rng(0)
        q = rng.uniform(self.low, self.high, (count, self.n))
        # An eighth near the start and an eighth at the limits: a fit to uniform samples alone is worst at the border,
        # which few of them come near.
        near, edge = slice(count // 8), slice(count // 8, count // 4)
        q[near] = self._posture[: self.n] + 0.3 * (q[near] - self._posture[: self.n])
        at_low, at_high = rng.uniform(size=(2, *q[edge].shape)) < 0.35
        q[edge] = np.where(at_low, self.low, np.where(at_high, self.high, q[edge]))
        x, fine = self.follow_branch(q)
        fine &= compute_condition(self.evaluate(q, x)[1]) < FAR_FROM_SINGULAR
        self._check_reach(fine)
        return q[fine], x[fine]

    def follow_branch(self, q: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Follow the passive coordinates along straight lines from the start to driven positions q (m, n).

        Newton's method goes on from the posture before in small steps, and so stays on the branch of the start.

        Returns
        -------
        x : ndarray (m, p)
        fine : bool ndarray (m,)
            False where the path met a singular posture, left its branch, or did not close the loops.
        """
        posture = self._posture
        away = q - posture[: self.n]
        count = int(np.clip(np.ceil(np.abs(away).max(initial=0.0) / _STEP), 1, _MOST_STEPS))
        x = np.tile(posture[self.n :], (len(q), 1))
        fine = np.ones(len(q), dtype=bool)
        for k in range(1, count + 1):
            here, before = posture[: self.n] + away * (k / count), x
            # Two steps keep up on the way; the last posture is refined to rounding.
            for _ in range(2 if k < count else 5):
                gap, slopes = self.evaluate(here, x)
                good = compute_condition(slopes) < SINGULAR
                fine &= good
                # Lost postures get a system that can be solved and moves nothing, so that the others can go on.
                slopes[~fine] = np.eye(self.p)
                gap[~fine] = 0.0
                x = x - np.linalg.solve(slopes, gap[:, :, None])[:, :, 0]
            # A posture that leaps has gone over to another branch.
            fine &= np.abs(x - before).max(axis=1) < _LEAP
        gap, slopes = self.evaluate(q, x)
        return x, fine & (np.abs(gap).max(axis=1) < _FOUND) & (compute_condition(slopes) < SINGULAR)

    @cached_property
    def largest_length(self) -> float:
        """Largest length (m) in the loops: the scale of gaps."""
        lengths = [float(np.linalg.norm(joint.placement[:3, 3])) for joint in self.joints]
        lengths += [float(np.linalg.norm(end.frame[:3, 3])) for loop in self.loops for end in loop.ends]
        return max(lengths, default=1.0) or 1.0

    @cached_property
    def _pivots(self) -> Pivots:
        q, x = self.sample_postures(_PIVOT_SAMPLES)
        return choose_pivots(self.evaluate(q, x)[1])

    @cached_property
    def _posture(self) -> FloatArray:
        return self.check()

    @cached_property
    def _program(self) -> Program:
        return Program(list(self.symbols), ca.densify(ca.horzcat(self.gaps, self.slopes[1])))

    @cached_property
    def _rates(self) -> Program:
        return Program(list(self.symbols), ca.densify(self.rates(*self.symbols)))

    @cached_property
    def _accelerations(self) -> Program:
        rate, acceleration = ca.SX.sym("dqa", self.n), ca.SX.sym("ddqa", self.n)
        value = self.accelerations(*self.symbols, rate, acceleration)
        return Program([*self.symbols, rate, acceleration], ca.densify(value))

    def evaluate(self, q: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return φ (m, e) and ∂φ/∂x (m, e, p) at driven and passive positions q (m, n) and x (m, p)."""
        values = self._program(np.ascontiguousarray(q), np.ascontiguousarray(x))
        # CasADi stores matrices by columns: φ first, then the columns of ∂φ/∂x.
        whole = values.reshape(len(q), 1 + self.p, -1)
        return whole[:, 0].copy(), np.swapaxes(whole[:, 1:], 1, 2).copy()

    def _check_counts(self) -> None:
        touched: set[int] = set()
        for rows, unknowns, driven in self.groups:
            loop = self.get_loop(rows[0])
            touched |= set(unknowns)
            if not unknowns:
                self._refuse_without_passive(loop, driven)
            passive = join_names(self.names[self.n + k] for k in unknowns)
            if not driven:
                detail = f"No driven joint moves loop '{loop.name}', so nothing in it would move. Drive one of "
                raise make_loop_error(f"{detail}{passive}.", loop)
            if len(unknowns) > len(rows):
                raise make_loop_error(
                    f"{len(unknowns)} passive joints ({passive}) but only {len(rows)} equations in loop "
                    f"'{loop.name}': the passive joints can move while the driven joints stand still. Drive or tie "
                    "joints, or let more directions of the frames coincide.",
                    loop,
                )
            if len(unknowns) < len(rows):
                raise make_redundancy_error(loop, len(rows), len(unknowns), passive)
        free = [self.names[self.n + k] for k in range(self.p) if k not in touched]
        if free:
            raise DynidentError(
                f"The passive joints {join_names(free)} belong to no loop; drive or tie them, or close a loop with "
                "them.",
                pointer="/loops",
                title=LOOP_TITLE,
            )

    def _refuse_without_passive(self, loop: Loop, driven: list[int]) -> None:
        """Raise the error of an equation without a passive joint: of driven joints alone, or of no joint at all."""
        if driven:
            names = join_names(self.names[k] for k in driven)
            raise make_loop_error(
                f"No passive joint can keep loop '{loop.name}' closed when the driven joints {names} move. Make as "
                "many joints of the loop passive as it has equations.",
                loop,
            )
        loop_rows = set(self.get_rows(loop))
        held = sorted({k for rows, unknowns, _ in self.groups if loop_rows & set(rows) for k in unknowns})
        raise make_redundancy_error(loop, len(loop_rows), len(held), join_names(self.names[self.n + k] for k in held))

    def _check_rank(self, posture: FloatArray) -> None:
        """Raise if equations are dependent in all postures nearby, not only at the start."""
        rng = np.random.default_rng(0)
        near = posture + 0.2 * rng.uniform(-1, 1, (20, len(posture)))
        _, slopes = self.evaluate(near[:, : self.n], near[:, self.n :])
        for rows, unknowns, _ in self.groups:
            part = slopes[:, rows][:, :, unknowns]
            if np.all(np.linalg.cond(part) > SINGULAR):
                loop = self.get_loop(rows[0])
                raise make_loop_error(
                    f"Loop '{loop.name}' has redundant constraints: its {len(rows)} equations are not independent in "
                    "any posture nearby, so they cannot determine "
                    f"{join_names(self.names[self.n + k] for k in unknowns)}. For a loop in a plane use the kind "
                    "planar, about the z axis of its first frame.",
                    loop,
                )

    def close_start(self) -> FloatArray:
        """Return the posture (n + p,) in which the loops are closed with the driven joints at their start.

        Raises
        ------
        DynidentError
            If there is none near the start; the message has the gap there and the best one.
        """
        posture = self.start.copy()
        first, _ = self.evaluate(posture[None, : self.n], posture[None, self.n :])
        for _ in range(_ROUNDS):
            gap, slopes = self.evaluate(posture[None, : self.n], posture[None, self.n :])
            if np.abs(gap).max() < 1e-14 * max(1.0, self.largest_length):
                break
            move = np.linalg.lstsq(slopes[0], -gap[0], rcond=1e-10)[0]
            # Newton's step, cut to half a radian (or metre): far from the solution a whole one leads anywhere.
            posture[self.n :] += move * min(1.0, 0.5 / max(float(np.abs(move).max()), 1e-300))
        gap, _ = self.evaluate(posture[None, : self.n], posture[None, self.n :])
        if np.abs(gap).max() > CLOSED:
            row = int(np.argmax(np.abs(gap[0])))
            loop = self.get_loop(row)
            rows = self.get_rows(loop)
            raise make_loop_error(
                f"Loop '{loop.name}' does not close: with the driven joints at their start its frames are "
                f"{float(np.linalg.norm(first[0, rows])):.3g} m apart, and at least "
                f"{float(np.linalg.norm(gap[0, rows])):.3g} m for any passive positions. Correct the lengths, or set "
                "a `start` of the joints near a posture in which the loop closes (in MJCF: the first <key qpos=…/>).",
                loop,
            )
        return posture

    @cached_property
    def groups(self) -> list[tuple[list[int], list[int], list[int]]]:
        """Groups of equations, passive coordinates and driven joints that are coupled with one another."""
        over_driven, over_passive = (np.asarray(ca.DM(slope.sparsity(), 1.0).full() != 0) for slope in self.slopes)
        return group_equations(over_driven, over_passive)

    def _check_reach(self, fine: BoolArray) -> None:
        if np.mean(fine) < _LEAST_REACHED:
            raise make_reach_error(self.loops[0], int(np.count_nonzero(fine)), len(fine))

    def get_loop(self, row: int) -> Loop:
        """Return the loop that an equation belongs to."""
        return next(loop for loop in self.loops if row in self.get_rows(loop))

    def get_rows(self, loop: Loop) -> list[int]:
        """Return the places of a loop's equations in φ."""
        first = 0
        for other in self.loops:
            if other is loop:
                break
            first += other.count
        return list(range(first, first + loop.count))
