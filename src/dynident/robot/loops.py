"""Closed loops: cut joints whose two frames coincide, and the passive joints that follow from that (chapter 10).

With the loops cut open, the machine is a tree. Its free coordinates are those of the driven joints, q_a, and of the
passive ones, x; φ(q_a, x) = 0 holds the cut frames together, so that ẋ = -(∂φ/∂x)⁻¹ (∂φ/∂q_a) q̇_a, and once more for ẍ.

x itself is found by Newton's method from a first guess near the branch that the description starts on: a polynomial
that was fitted to positions followed from there. What follows are expressions, like those of any other joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.expressions import Program
from dynident.expressions.angles import Turns, turned
from dynident.robot.cut_joints import Loop, gap_of, sparse
from dynident.robot.elimination import Pivots, pivots_of, solved
from dynident.robot.loop_errors import TITLE, hardly_reached, loop_error, nowhere_near, redundant
from dynident.robot.loop_numbers import condition_of, hanging_together
from dynident.robot.model import Joint
from dynident.robot.passive_positions import passive_positions
from dynident.robot.pointers import listed

CLOSED = 1e-9
"""Gap of a closed loop (m, rad): rounding."""
SINGULAR = 1e3
"""Condition of ∂φ/∂x above which a posture counts as singular."""
FAR_FROM_SINGULAR = 30.0
"""Condition below which passive positions are known surely; designs stay there."""
_FOUND, _LEAP = 1e-13, 1.0
_STEP, _MOST_STEPS, _ROUNDS = 0.1, 80, 40
_PIVOT_SAMPLES, _LEAST_REACHED = 200, 0.02


@dataclass(frozen=True, eq=False)
class Closure:
    """The loops of one machine as equations of its free coordinates.

    The tree's positions are `ratios` (N, n + p) [q_a; x] + `offsets` (N,). `start` (n + p,) is a posture near which the
    loops are closed; `low`, `high` (n,) bound the driven joints; `names` are those of the free coordinates.
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
    def turning(self) -> tuple[bool, ...]:
        """Of the passive coordinates, which are angles."""
        kinds = {joint.name: joint.kind for joint in self.joints}
        return tuple(kinds[name] == "revolute" for name in self.names[self.n :])

    @cached_property
    def symbols(self) -> tuple[ca.SX, ca.SX]:
        """q_a SX (n, 1) and x SX (p, 1)."""
        return ca.SX.sym("qa", self.n), ca.SX.sym("x", self.p)

    @cached_property
    def gaps(self) -> ca.SX:
        """φ SX (equations, 1): m, and rad where frames coincide wholly."""
        q = ca.mtimes(sparse(self.ratios), ca.vertcat(*self.symbols)) + ca.DM(self.offsets)
        return ca.sparsify(ca.vertcat(*(gap_of(loop, self.joints, q) for loop in self.loops)))

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
        turning = ca.substitute(ca.jtimes(gap_rate, free, speed), speed, moving)
        value = -self.solve(turning + ca.mtimes(self.slopes[0], acceleration))
        return ca.Function("accelerations", [driven, passive, rate, acceleration], [value])

    @cached_property
    def solution(self) -> ca.Function:
        """(q_a) -> x, cos x and sin x SX (p, 1)."""
        found = passive_positions(self)
        if found is None:
            raise nowhere_near(self.loops[0])
        return found

    def closed(self, expression: ca.SX, driven: ca.SX) -> ca.SX:
        """An expression of the symbols of x as one of the driven positions SX (n, 1)."""
        return turned(expression, self.symbols[1], Turns(*self.solution(driven)))

    def solve(self, right: ca.SX) -> ca.SX:
        """(∂φ/∂x)⁻¹ right, SX (p, k) of expressions SX (equations, k)."""
        return solved(self.slopes[1], right, self._pivots)

    def rates_at(self, q: FloatArray, x: FloatArray) -> FloatArray:
        """∂x/∂q_a (m, p, n) at driven and passive positions (m, n) and (m, p)."""
        values = self._rates(np.ascontiguousarray(q), np.ascontiguousarray(x))
        return np.swapaxes(values.reshape(len(q), self.n, self.p), 1, 2)

    def accelerations_at(self, q: FloatArray, x: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """ẍ (m, p) of driven motions q, dq, ddq (m, n) and passive positions x (m, p)."""
        return self._accelerations(*(np.ascontiguousarray(one) for one in (q, x, dq, ddq)))

    def nearness(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln of the condition (m,) of ∂φ/∂x, and its slopes (m, n) over the driven positions q (m, n).

        Where the loops are open or singular it is infinite, without a slope.
        """
        x = self.passive(q)
        gap, slopes = self.evaluated(q, x)
        known = (np.abs(gap).max(axis=1) < CLOSED) & (condition_of(slopes) < SINGULAR)
        left, values, right = np.linalg.svd(np.where(known[:, None, None], slopes, np.eye(self.p)))
        bends = self._bends(np.ascontiguousarray(q), np.ascontiguousarray(x))
        bends = bends.reshape(len(q), self.n, self.p, self.p).swapaxes(2, 3)

        def slope_of(k: int) -> FloatArray:
            """∂ ln σ_k / ∂q_a (m, n)."""
            along = np.einsum("mi,mjik,mk->mj", left[:, :, k], bends, right[:, k])
            return np.asarray(along / values[:, k, None])

        found = np.where(known, np.log(values[:, 0] / values[:, -1]), np.inf)
        return found, np.where(known[:, None], slope_of(0) - slope_of(-1), 0.0)

    def passive(self, q: FloatArray) -> FloatArray:
        """Passive coordinates (m, p) at driven positions (m, n)."""
        return self._passive(np.ascontiguousarray(q, dtype=np.float64))

    def movers(self, passive: int) -> tuple[int, ...]:
        """The driven joints that a passive coordinate moves with."""
        return next((tuple(driven) for _, unknowns, driven in self.groups if passive in unknowns), ())

    def conditions(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Largest gap (m,) in m or rad, and the condition (m,) of ∂φ/∂x, at driven positions (m, n)."""
        gap, slopes = self.evaluated(q, self.passive(q))
        return np.abs(gap).max(axis=1), condition_of(slopes)

    def check(self) -> FloatArray:
        """Close the loops from the start; the closed posture (n + p,).

        Raises
        ------
        DynidentError
            Loops that do not close (their gap at the start), have no driven joint, say the same thing twice, leave a
            passive joint free, or are singular where they start.
        """
        self._check_counts()
        posture = self.closed_start()
        _, slopes = self.evaluated(posture[None, : self.n], posture[None, self.n :])
        condition = float(condition_of(slopes)[0])
        if condition > SINGULAR:
            self._check_rank(posture)
            raise loop_error(
                f"The loops are singular at the start (condition {condition:.3g}): the driven joints do not determine "
                "the passive ones there. State another `start` of the joints, away from stretched postures.",
                self.loops[0],
            )
        return posture

    def postures(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Random driven positions (count, n) at which the loops are closed, far from singular, within the limits."""
        kept: list[FloatArray] = []
        while sum(map(len, kept)) < count:
            q = rng.uniform(self.low, self.high, (2 * count, self.n))
            x, fine = self.follow(q)
            fine &= condition_of(self.evaluated(q, x)[1]) < FAR_FROM_SINGULAR
            self._check_reach(fine)
            kept.append(q[fine])
        return np.vstack(kept)[:count]

    def sampled(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Driven positions (m, n) and passive ones (m, p) of at most `count` closed postures within the limits.

        They are far from singular; some are near the start, some at the limits.
        """
        rng = np.random.default_rng(0)
        q = rng.uniform(self.low, self.high, (count, self.n))
        near, edge = slice(count // 8), slice(count // 8, count // 4)
        q[near] = self._posture[: self.n] + 0.3 * (q[near] - self._posture[: self.n])
        at_low, at_high = rng.uniform(size=(2, *q[edge].shape)) < 0.35
        q[edge] = np.where(at_low, self.low, np.where(at_high, self.high, q[edge]))
        x, fine = self.follow(q)
        fine &= condition_of(self.evaluated(q, x)[1]) < FAR_FROM_SINGULAR
        self._check_reach(fine)
        return q[fine], x[fine]

    def follow(self, q: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Passive coordinates (m, p) on the straight ways from the start to q (m, n), and which did not get lost (m,).

        The branch is that of the start: Newton's method from the last posture, in small steps.
        """
        posture = self._posture
        away = q - posture[: self.n]
        count = int(np.clip(np.ceil(np.abs(away).max(initial=0.0) / _STEP), 1, _MOST_STEPS))
        x = np.tile(posture[self.n :], (len(q), 1))
        fine = np.ones(len(q), dtype=bool)
        for k in range(1, count + 1):
            here, before = posture[: self.n] + away * (k / count), x
            for _ in range(2 if k < count else 5):
                gap, slopes = self.evaluated(here, x)
                good = condition_of(slopes) < SINGULAR
                fine &= good
                slopes[~fine] = np.eye(self.p)
                gap[~fine] = 0.0
                x = x - np.linalg.solve(slopes, gap[:, :, None])[:, :, 0]
            # What leaps has left its branch.
            fine &= np.abs(x - before).max(axis=1) < _LEAP
        gap, slopes = self.evaluated(q, x)
        return x, fine & (np.abs(gap).max(axis=1) < _FOUND) & (condition_of(slopes) < SINGULAR)

    @cached_property
    def size(self) -> float:
        """Length (m) that gaps are measured by."""
        lengths = [float(np.linalg.norm(joint.placement[:3, 3])) for joint in self.joints]
        lengths += [float(np.linalg.norm(end.frame[:3, 3])) for loop in self.loops for end in loop.ends]
        return max(lengths, default=1.0) or 1.0

    @cached_property
    def _pivots(self) -> Pivots:
        q, x = self.sampled(_PIVOT_SAMPLES)
        return pivots_of(self.evaluated(q, x)[1])

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

    @cached_property
    def _bends(self) -> Program:
        """d(∂φ/∂x)/dq_a, each driven joint's p x p behind that of the one before."""
        free, rates = ca.vertcat(*self.symbols), self.rates(*self.symbols)
        ways = ca.vertcat(ca.SX.eye(self.n), rates)
        flat = ca.vec(ca.densify(self.slopes[1]))
        made = [ca.jtimes(flat, free, ca.densify(ways[:, j])) for j in range(self.n)]
        return Program(list(self.symbols), ca.densify(ca.vertcat(*made)))

    @cached_property
    def _passive(self) -> Program:
        return Program([self.symbols[0]], ca.densify(self.solution(self.symbols[0])[0]))

    def evaluated(self, q: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """φ (m, e) and ∂φ/∂x (m, e, p)."""
        values = self._program(np.ascontiguousarray(q), np.ascontiguousarray(x))
        whole = values.reshape(len(q), 1 + self.p, -1)
        return whole[:, 0].copy(), np.swapaxes(whole[:, 1:], 1, 2).copy()

    def _check_counts(self) -> None:
        touched: set[int] = set()
        for rows, unknowns, driven in self.groups:
            loop = self.loop_of(rows[0])
            touched |= set(unknowns)
            if not unknowns:
                self._refuse_without_passive(loop, driven)
            passive = listed(self.names[self.n + k] for k in unknowns)
            if not driven:
                detail = f"No driven joint moves loop '{loop.name}': everything in it would stand still. Drive one of "
                raise loop_error(f"{detail}{passive}.", loop)
            if len(unknowns) > len(rows):
                raise loop_error(
                    f"{len(unknowns)} passive joints ({passive}) for {len(rows)} equations of loop '{loop.name}': they "
                    "can move while the driven joints stand. Drive or tie joints, or let more of the frames coincide.",
                    loop,
                )
            if len(unknowns) < len(rows):
                raise redundant(loop, len(rows), len(unknowns), passive)
        free = [self.names[self.n + k] for k in range(self.p) if k not in touched]
        if free:
            raise DynidentError(
                f"No loop holds the passive joints {listed(free)}; drive or tie them, or close a loop with them.",
                pointer="/loops",
                title=TITLE,
            )

    def _refuse_without_passive(self, loop: Loop, driven: list[int]) -> None:
        """An equation of a loop that no passive joint can keep: of driven joints alone, or of none at all."""
        if driven:
            names = listed(self.names[k] for k in driven)
            raise loop_error(
                f"No passive joint can keep loop '{loop.name}' closed when the driven joints {names} move. Make as "
                "many of its joints passive as it has equations.",
                loop,
            )
        own = set(self.rows_of(loop))
        held = sorted({k for rows, unknowns, _ in self.groups if own & set(rows) for k in unknowns})
        raise redundant(loop, len(own), len(held), listed(self.names[self.n + k] for k in held))

    def _check_rank(self, posture: FloatArray) -> None:
        """Raise where equations say the same thing twice wherever one looks."""
        rng = np.random.default_rng(0)
        near = posture + 0.2 * rng.uniform(-1, 1, (20, len(posture)))
        _, slopes = self.evaluated(near[:, : self.n], near[:, self.n :])
        for rows, unknowns, _ in self.groups:
            part = slopes[:, rows][:, :, unknowns]
            if np.all(np.linalg.cond(part) > SINGULAR):
                loop = self.loop_of(rows[0])
                raise loop_error(
                    f"Loop '{loop.name}' has redundant constraints: its {len(rows)} equations are not independent in "
                    "any posture nearby, so that they cannot determine "
                    f"{listed(self.names[self.n + k] for k in unknowns)}. A loop in a plane is of the kind planar, "
                    "about the z axis of its first frame.",
                    loop,
                )

    def closed_start(self) -> FloatArray:
        """The posture (n + p,) in which the loops are closed with the driven joints at their start.

        Raises
        ------
        DynidentError
            There is none near the start (gap there, and at best).
        """
        posture = self.start.copy()
        first, _ = self.evaluated(posture[None, : self.n], posture[None, self.n :])
        for _ in range(_ROUNDS):
            gap, slopes = self.evaluated(posture[None, : self.n], posture[None, self.n :])
            if np.abs(gap).max() < 1e-14 * max(1.0, self.size):
                break
            move = np.linalg.lstsq(slopes[0], -gap[0], rcond=1e-10)[0]
            posture[self.n :] += move * min(1.0, 0.5 / max(float(np.abs(move).max()), 1e-300))
        gap, _ = self.evaluated(posture[None, : self.n], posture[None, self.n :])
        if np.abs(gap).max() > CLOSED:
            row = int(np.argmax(np.abs(gap[0])))
            loop = self.loop_of(row)
            rows = self.rows_of(loop)
            raise loop_error(
                f"Loop '{loop.name}' does not close: with the driven joints at their start its frames are "
                f"{float(np.linalg.norm(first[0, rows])):.3g} m apart, and {float(np.linalg.norm(gap[0, rows])):.3g} m "
                "at best. Correct the lengths, or state a `start` of the joints near a posture in which it closes (in "
                "MJCF: the first <key qpos=…/>).",
                loop,
            )
        return posture

    @cached_property
    def groups(self) -> list[tuple[list[int], list[int], list[int]]]:
        """Equations, passive coordinates and driven joints that hang together."""
        over_driven, over_passive = (np.asarray(ca.DM(one.sparsity(), 1.0).full() != 0) for one in self.slopes)
        return hanging_together(over_driven, over_passive)

    def _check_reach(self, fine: BoolArray) -> None:
        if np.mean(fine) < _LEAST_REACHED:
            raise hardly_reached(self.loops[0], int(np.count_nonzero(fine)), len(fine))

    def loop_of(self, row: int) -> Loop:
        """The loop that an equation is of."""
        return next(loop for loop in self.loops if row in self.rows_of(loop))

    def rows_of(self, loop: Loop) -> list[int]:
        """Places of a loop's equations."""
        first = 0
        for other in self.loops:
            if other is loop:
                break
            first += other.count
        return list(range(first, first + loop.count))
