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
from dynident.robot.cut_joints import Loop, frames_of_joints, gap_of, sparse
from dynident.robot.loop_numbers import condition_of, products
from dynident.robot.model import Joint
from dynident.robot.pointers import listed

TITLE = "Unusable closed loop"
CLOSED = 1e-9
"""Gap of a closed loop (m, rad): rounding."""
SINGULAR = 1e3
"""Condition of ∂φ/∂x above which a posture counts as singular."""
_FOUND, _LEAP, _FAR_FROM_SINGULAR = 1e-13, 1.0, 30.0
_STEP, _MOST_STEPS, _ROUNDS = 0.1, 80, 40
_SAMPLES, _EXACT, _MOST_ROUNDS = 3000, 1e-12, 5
_NEARLY, _LEAST_REACHED = 1e-7, 0.02
_DEGREES = (1, 3, 5, 7, 9, 11, 13)
_HIGHEST = {1: 13, 2: 13, 3: 7}


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
    def symbols(self) -> tuple[ca.SX, ca.SX]:
        """q_a SX (n, 1) and x SX (p, 1)."""
        return ca.SX.sym("qa", self.n), ca.SX.sym("x", self.p)

    @cached_property
    def gaps(self) -> ca.SX:
        """φ SX (equations, 1): m, and rad where frames coincide wholly."""
        q = ca.mtimes(sparse(self.ratios), ca.vertcat(*self.symbols)) + ca.DM(self.offsets)
        frames = frames_of_joints(self.joints, q)
        return ca.vertcat(*(gap_of(loop, frames) for loop in self.loops))

    @cached_property
    def slopes(self) -> tuple[ca.SX, ca.SX]:
        """∂φ/∂q_a SX (equations, n) and ∂φ/∂x SX (equations, p)."""
        driven, passive = self.symbols
        return ca.jacobian(self.gaps, driven), ca.jacobian(self.gaps, passive)

    @cached_property
    def rates(self) -> ca.Function:
        """(q_a, x) -> ∂x/∂q_a SX (p, n)."""
        over_driven, over_passive = self.slopes
        return ca.Function("rates", list(self.symbols), [-ca.solve(over_passive, ca.densify(over_driven))])

    @cached_property
    def accelerations(self) -> ca.Function:
        """(q_a, x, q̇_a, q̈_a) -> ẍ SX (p, 1)."""
        driven, passive = self.symbols
        rate, acceleration = ca.SX.sym("dqa", self.n), ca.SX.sym("ddqa", self.n)
        over_driven, over_passive = self.slopes
        moving = ca.vertcat(rate, ca.mtimes(self.rates(driven, passive), rate))
        speed = ca.SX.sym("speed", self.n + self.p)
        free = ca.vertcat(driven, passive)
        gap_rate = ca.jtimes(self.gaps, free, speed)
        turning = ca.substitute(ca.jtimes(gap_rate, free, speed), speed, moving)
        value = -ca.solve(over_passive, turning + ca.mtimes(over_driven, acceleration))
        return ca.Function("accelerations", [driven, passive, rate, acceleration], [value])

    @cached_property
    def solution(self) -> ca.Function:
        """(q_a) -> x SX (p, 1)."""
        driven = self.symbols[0]
        guess, rounds = self._guess
        value = guess(driven)
        for _ in range(rounds):
            value = self._step(driven, value)
        return ca.Function("solution", [driven], [value])

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
            raise _error(
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
            fine &= condition_of(self.evaluated(q, x)[1]) < _FAR_FROM_SINGULAR
            self._check_reach(fine)
            kept.append(q[fine])
        return np.vstack(kept)[:count]

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
    def _step(self) -> ca.Function:
        """(q_a, x) -> x after a round of Newton's method."""
        driven, passive = self.symbols
        return ca.Function("step", [driven, passive], [passive - ca.solve(self.slopes[1], self.gaps)])

    @cached_property
    def _posture(self) -> FloatArray:
        return self.check()

    @cached_property
    def _program(self) -> Program:
        return Program(list(self.symbols), ca.densify(ca.horzcat(self.gaps, self.slopes[1])))

    @cached_property
    def _passive(self) -> Program:
        return Program([self.symbols[0]], ca.densify(self.solution(self.symbols[0])))

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
            if not driven:
                raise _error(
                    f"No driven joint moves loop '{loop.name}': everything in it would stand still. Drive one of "
                    f"{listed(self.names[self.n + k] for k in unknowns)}.",
                    loop,
                )
            if len(unknowns) > len(rows):
                raise _error(
                    f"{len(unknowns)} passive joints ({listed(self.names[self.n + k] for k in unknowns)}) for "
                    f"{len(rows)} equations of loop '{loop.name}': they can move while the driven joints stand. Drive "
                    "or tie joints, or let more of the frames coincide.",
                    loop,
                )
            if len(unknowns) < len(rows):
                raise _error(
                    f"Loop '{loop.name}' has redundant constraints: {len(rows)} equations for {len(unknowns)} passive "
                    f"joints ({listed(self.names[self.n + k] for k in unknowns)}). A loop in a plane is of the kind "
                    "planar (2 equations), one with ball joints of the kind point (3).",
                    loop,
                )
        free = [self.names[self.n + k] for k in range(self.p) if k not in touched]
        if free:
            raise DynidentError(
                f"No loop holds the passive joints {listed(free)}; drive or tie them, or close a loop with them.",
                pointer="/loops",
                title=TITLE,
            )

    def _check_rank(self, posture: FloatArray) -> None:
        """Raise where equations say the same thing twice wherever one looks."""
        rng = np.random.default_rng(0)
        near = posture + 0.2 * rng.uniform(-1, 1, (20, len(posture)))
        _, slopes = self.evaluated(near[:, : self.n], near[:, self.n :])
        for rows, unknowns, _ in self.groups:
            part = slopes[:, rows][:, :, unknowns]
            if np.all(np.linalg.cond(part) > SINGULAR):
                loop = self.loop_of(rows[0])
                raise _error(
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
            raise _error(
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
        left = set(range(over_passive.shape[0]))
        groups = []
        while left:
            rows, unknowns = {min(left)}, set()
            while True:
                unknowns = {int(k) for k in np.flatnonzero(over_passive[sorted(rows)].any(axis=0))}
                more = {int(r) for r in np.flatnonzero(over_passive[:, sorted(unknowns)].any(axis=1))} | rows
                if more == rows:
                    break
                rows = more
            driven = np.flatnonzero(over_driven[sorted(rows)].any(axis=0))
            groups.append((sorted(rows), sorted(unknowns), [int(j) for j in driven]))
            left -= rows
        return groups

    @cached_property
    def _guess(self) -> tuple[ca.Function, int]:
        """(q_a) -> a first guess of x, and how many rounds of Newton's method make it exact."""
        rng = np.random.default_rng(0)
        q = rng.uniform(self.low, self.high, (_SAMPLES, self.n))
        q[: _SAMPLES // 8] = self._posture[: self.n] + 0.3 * (q[: _SAMPLES // 8] - self._posture[: self.n])
        x, fine = self.follow(q)
        fine &= condition_of(self.evaluated(q, x)[1]) < _FAR_FROM_SINGULAR
        self._check_reach(fine)
        q, x = q[fine], x[fine]
        work = self._step.n_instructions()
        best: tuple[float, ca.Function, int] | None = None
        for degree in _DEGREES:
            guess, size = self._fitted(q, x, degree)
            if best is not None and size >= best[0]:
                break
            rounds = self._rounds_needed(Program([self.symbols[0]], guess(self.symbols[0]))(q), q, x)
            if rounds is not None and (best is None or size + rounds * work < best[0]):
                best = (size + rounds * work, guess, rounds)
        if best is None:
            raise _error(
                "The loops come too near singular postures within the limits of the driven joints for the passive "
                "positions to be found everywhere. State narrower limits of the driven joints.",
                self.loops[0],
            )
        return best[1], best[2]

    def _fitted(self, q: FloatArray, x: FloatArray, degree: int) -> tuple[ca.Function, float]:
        """Polynomials (q_a) -> x through positions (m, n) and (m, p), and how many operations they take."""
        driven = self.symbols[0]
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        scaled, symbols = (q - middle) / half, (driven - ca.DM(middle)) / ca.DM(half)
        guess = ca.SX.zeros(self.p, 1)
        for _, unknowns, movers in self.groups:
            own = min(degree, _HIGHEST.get(len(movers), 4))
            terms = np.stack([np.ones(len(q)), *products(list(scaled[:, movers].T), own)], axis=1)
            weights = np.linalg.lstsq(terms, x[:, unknowns], rcond=1e-12)[0]
            weights[np.abs(weights) < 1e-12] = 0.0
            columns = ca.vertcat(1, *products([symbols[j] for j in movers], own))
            values = ca.mtimes(ca.sparsify(ca.SX(ca.DM(weights.T))), columns)
            for place, k in enumerate(unknowns):
                guess[k] = values[place]
        function = ca.Function("guess", [driven], [ca.densify(guess)])
        return function, float(function.n_instructions())

    def _rounds_needed(self, guess: FloatArray, q: FloatArray, x: FloatArray) -> int | None:
        """How many rounds of Newton's method bring the guesses (m, p) to the positions x (m, p); None for too many."""
        found = guess
        for rounds in range(_MOST_ROUNDS + 1):
            far = np.abs(found - x).max(axis=1)
            if far.max() < _EXACT:
                return rounds
            # Every round squares what is left. At the edge some need one more.
            if far.max() < _NEARLY:
                return rounds + 1
            if np.quantile(far, 0.998) < _NEARLY:
                return rounds + 2
            gap, slopes = self.evaluated(q, found)
            found = found - np.linalg.solve(slopes, gap[:, :, None])[:, :, 0]
        return None

    def _check_reach(self, fine: BoolArray) -> None:
        if np.mean(fine) < _LEAST_REACHED:
            raise _error(
                "The loops can hardly move within the limits of the driven joints without passing a singular posture: "
                f"{np.count_nonzero(fine)} of {len(fine)} postures are reached. State limits of the driven joints, or "
                "another start.",
                self.loops[0],
            )

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


def _error(detail: str, loop: Loop) -> DynidentError:
    return DynidentError(f"line {loop.line}: {detail}" if loop.line else detail, pointer=loop.where, title=TITLE)
