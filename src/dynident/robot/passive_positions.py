"""Solve passive positions of closed loops: triangles in closed form, else a polynomial guess with corrections.

Where every loop is a triangle (a dyad: two passive joints of a planar loop), it is solved in closed form. The two
equations are u + R(y₁) v + R(y₂) w = 0 with vectors u, v, w in the plane that the driven joints alone determine, and
turns y = T x of the two: each by itself, or one carried by the other. Sides of these lengths make two triangles, which
are the two branches; they meet where they are flat, and there the loop is singular. So the branch of the start holds
wherever the loop closes, and sines and cosines are known before any angle is.

Elsewhere a polynomial gives a guess x₀, and the
path to the closed posture is φ(x(t)) = (1 - t) φ(x₀), 0 ≤ t ≤ 1. The first term of its Taylor series at x₀ is Newton's
step. Every further term (Chebyshev's method, and so on) removes one more power of the guess's error, and needs no sine
or cosine beyond those of the first. The degree of the polynomial and the number of terms are those with the shortest
code, found by trying all combinations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.expressions.sines_and_cosines import AngleTerms, substitute_angles
from dynident.robot.loop_equations import LoopEquations
from dynident.robot.loop_numerics import list_products

# Postures of the other joints, and random angles of the two, at which the form of their equations is tried.
_POSTURES, _TURNS = 3, 8
# Misfit of that form per length of the loop, relative spread of a constant, and distance (rad) of a branch: rounding.
_EXACT_FORM, _CONSTANT, _SAME_BRANCH = 1e-12, 1e-13, 1e-8
_WIDEST = 5.5
"""Largest range (rad) of a passive joint: with less than a whole turn, its angle follows from cosine and sine."""
_FLAT = 1e-14
"""Lower bound of a triangle's squared area, as a share of the largest: keeps numbers finite where a loop is open."""


@dataclass(frozen=True, eq=False)
class _PlaneVector:
    """A vector or a rotation in the plane, multiplied like a complex number."""

    x: ca.SX
    y: ca.SX

    def __add__(self, other: _PlaneVector) -> _PlaneVector:
        return _PlaneVector(self.x + other.x, self.y + other.y)

    def __mul__(self, other: _PlaneVector) -> _PlaneVector:
        return _PlaneVector(self.x * other.x - self.y * other.y, self.x * other.y + self.y * other.x)

    def scale(self, factor: ca.SX) -> _PlaneVector:
        return _PlaneVector(self.x * factor, self.y * factor)

    def conjugate(self) -> _PlaneVector:
        return _PlaneVector(self.x, -self.y)

    def squared_length(self) -> ca.SX:
        return self.x * self.x + self.y * self.y


def solve_by_triangles(closure: LoopEquations, q: FloatArray, x: FloatArray) -> AngleTerms | None:
    """Return the passive coordinates as closed-form expressions of the driven ones.

    Parameters
    ----------
    closure : LoopEquations
        The closed loops of the machine.
    q, x : (m, n), (m, p)
        Closed postures on the branch of the start; they select the branch of each triangle.

    Returns
    -------
    AngleTerms or None
        Angles, cosines and sines SX (p, 1) of the closure's driven symbols; None if any loop is not a triangle. The
        sides of a triangle may depend on triangles that are solved before.
    """
    solution = AngleTerms(*(ca.SX.zeros(closure.p) for _ in range(3)))
    for rows, unknowns in _order_blocks(closure):
        part = _solve_triangle(closure, rows, unknowns, solution, q, x)
        if part is None:
            return None
        solution.angles[unknowns], solution.cosines[unknowns], solution.sines[unknowns] = (
            part.angles,
            part.cosines,
            part.sines,
        )
    return solution


def _order_blocks(closure: LoopEquations) -> list[tuple[list[int], list[int]]]:
    """Return blocks of equations with the passive coordinates that each determines, in an order to solve them."""
    # The block triangular form of ∂φ/∂x splits the loops into the smallest systems that can be solved one by one.
    over = np.asarray(ca.DM(closure.slopes[1].sparsity(), 1.0).full() != 0)
    count, rows, columns, row_borders, column_borders, *_ = closure.slopes[1].sparsity().btf()
    remaining_blocks = [
        (sorted(rows[row_borders[k] : row_borders[k + 1]]), sorted(columns[column_borders[k] : column_borders[k + 1]]))
        for k in range(count)
    ]
    ordered_blocks: list[tuple[list[int], list[int]]] = []
    while remaining_blocks:
        solved_unknowns = {k for _, unknowns in ordered_blocks for k in unknowns}
        # A block can be solved once all other unknowns of its equations are.
        ready = next(
            block
            for block in remaining_blocks
            if set(np.flatnonzero(over[block[0]].any(axis=0))) <= solved_unknowns | set(block[1])
        )
        remaining_blocks.remove(ready)
        ordered_blocks.append(ready)
    return ordered_blocks


def _solve_triangle(
    closure: LoopEquations,
    rows: list[int],
    unknowns: list[int],
    solved_before: AngleTerms,
    q: FloatArray,
    x: FloatArray,
) -> AngleTerms | None:
    """Solve two equations for two passive coordinates; None if they do not form a triangle."""
    if len(rows) != 2 or len(unknowns) != 2:
        return None
    turning = _find_turning(closure, rows, unknowns, q[:_POSTURES], x[:_POSTURES])
    vectors = None if turning is None else _extract_vectors(closure, rows, unknowns, turning, solved_before)
    if turning is None or vectors is None:
        return None
    passive, driven = x[:, unknowns], closure.symbols[0]
    if np.ptp(passive, axis=0).max() > _WIDEST:
        return None
    # Three sides make two triangles, mirrored at the base. The sampled postures tell which of them is the start's.
    middle = 0.5 * (passive.min(axis=0) + passive.max(axis=0))
    squares = [_to_constant(vector.squared_length(), driven, q) for vector in vectors[1:]]
    for side in (1.0, -1.0):
        turns = _close_triangle(vectors, squares, side)
        branch = _angles_near([_combine_rotations(turns, powers) for powers in np.linalg.inv(turning)], middle)
        if np.abs(_evaluate_at(branch.angles, driven, q) - passive).max() < _SAME_BRANCH:
            return branch
    return None


def _iter_turnings() -> Iterator[FloatArray]:
    """Yield T (2, 2): both joints on the same body, or one on the other, about the same axis or the opposite one."""
    for first, second in product((1, -1), repeat=2):
        yield np.array([[first, 0], [0, second]])
        yield np.array([[first, 0], [first, second]])
        yield np.array([[0, second], [first, second]])


def _find_turning(
    closure: LoopEquations, rows: list[int], unknowns: list[int], q: FloatArray, x: FloatArray
) -> FloatArray | None:
    """Return T of two equations, or None: with it they are linear in u, v and w for any angles of the two joints."""
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (_TURNS, 2))
    whole = np.repeat(x, _TURNS, axis=0)
    whole[:, unknowns] = np.tile(angles, (len(x), 1))
    gaps = closure.evaluate(np.repeat(q, _TURNS, axis=0), whole)[0][:, rows].reshape(len(q), -1).T
    for turning in _iter_turnings():
        y = angles @ turning.T
        matrices = np.array([[np.cos(y), -np.sin(y)], [np.sin(y), np.cos(y)]])
        # For one posture of the others, u, v and w are six numbers. Fit them to the gaps at random angles of the two:
        # an exact fit proves the form, since there are more angles than numbers.
        terms = np.hstack([np.tile(np.eye(2), (_TURNS, 1)), np.einsum("rctk->trkc", matrices).reshape(-1, 4)])
        misfit = gaps - terms @ np.linalg.lstsq(terms, gaps, rcond=None)[0]
        if np.abs(misfit).max() < _EXACT_FORM * closure.largest_length:
            return turning
    return None


def _extract_vectors(
    closure: LoopEquations, rows: list[int], unknowns: list[int], turning: FloatArray, solved_before: AngleTerms
) -> list[_PlaneVector] | None:
    """Return u, v and w: the constant part of the equations, and the factors of the cosines of y₁ and y₂."""
    # Replace cosines and sines by symbols: the gaps are then polynomials in them, and v and w their coefficients.
    x = closure.symbols[1]
    open_turns = AngleTerms(x, ca.SX.sym("cos", closure.p), ca.SX.sym("sin", closure.p))
    gaps = substitute_angles(ca.densify(closure.gaps[rows]), x, open_turns)
    if ca.depends_on(gaps, x):
        return None
    parts = [gaps, gaps, gaps]
    for k, powers in enumerate(turning, start=1):
        for unknown, power in zip(unknowns, powers, strict=True):
            if power:
                parts[k] = ca.jacobian(parts[k], open_turns.cosines[unknown])
    parts = ca.substitute(parts, [open_turns.cosines, open_turns.sines], [solved_before.cosines, solved_before.sines])
    return [_PlaneVector(*(ca.densify(part)[k] for k in range(2))) for part in parts]


def _close_triangle(vectors: Sequence[_PlaneVector], squares: Sequence[ca.SX], side: float) -> list[_PlaneVector]:
    """Return the rotations by y₁ and y₂ that close u + R(y₁) v + R(y₂) w = 0, with the corner on one side of u."""
    u, v, w = vectors
    base_squared = u.squared_length()
    # The law of cosines gives the corner's coordinate along the base u, Pythagoras the one across it. Multiplying by
    # the squared length of u avoids its square root.
    along = 0.5 * (squares[1] - squares[0] - base_squared)
    largest = squares[0] * base_squared
    across = side * ca.sqrt(ca.fmax(largest - along * along, _FLAT * largest))
    first = u * _PlaneVector(along / base_squared, across / base_squared)
    second = first + u
    return [first * v.conjugate().scale(1 / squares[0]), second * w.conjugate().scale(-1 / squares[1])]


def _combine_rotations(turns: Sequence[_PlaneVector], powers: FloatArray) -> _PlaneVector:
    """Return the rotation by a sum of angles, each counted with its power in `powers` (2,): 1, -1 or 0."""
    # A unit vector's conjugate turns back.
    used = [turn if power > 0 else turn.conjugate() for turn, power in zip(turns, powers, strict=True) if round(power)]
    return used[0] if len(used) == 1 else used[0] * used[1]


def _angles_near(turns: Sequence[_PlaneVector], middle: FloatArray) -> AngleTerms:
    """Return angles within half a turn of their middles, with their cosines and sines."""
    # Turned back by the middle first, so that the jump of atan2 lies half a turn away from it.
    away = [
        rotation * _PlaneVector(ca.SX(np.cos(centre)), ca.SX(-np.sin(centre)))
        for rotation, centre in zip(turns, middle, strict=True)
    ]
    angles = [centre + ca.atan2(rotation.y, rotation.x) for rotation, centre in zip(away, middle, strict=True)]
    return AngleTerms(
        *(
            ca.vertcat(*rotation)
            for rotation in (angles, [rotation.x for rotation in turns], [rotation.y for rotation in turns])
        )
    )


def _to_constant(value: ca.SX, driven: ca.SX, q: FloatArray) -> ca.SX:
    """Return a squared length as a number if the driven joints do not change it, else as it is."""
    values = _evaluate_at(value, driven, q)
    return ca.SX(float(values.mean())) if np.ptp(values) < _CONSTANT * values.max() else value


def _evaluate_at(value: ca.SX, driven: ca.SX, q: FloatArray) -> FloatArray:
    """Evaluate an expression SX (k, 1) at driven positions (m, n); returns (m, k)."""
    values = ca.Function("value", [driven], [ca.densify(value)]).map(len(q))(q.T)
    return np.asarray(values.full().T, dtype=np.float64)


# Postures to recognise triangles by, postures to fit polynomials to, and the error (rad, m) that counts as exact.
_FEW, _SAMPLES, _EXACT = 200, 3000, 1e-12
_DEGREES = (1, 2, 3, 5, 7, 9, 11, 13)
# Highest degree by the number of driven joints in a loop: the number of terms grows too fast with both.
_HIGHEST = {1: 13, 2: 13, 3: 8}
# Numbers of terms of a step that are tried, and steps one after the other.
_ORDERS, _MOST_STEPS = (1, 2, 3), 4
_WORK = {ca.OP_SIN: 30, ca.OP_COS: 30}
_QUOTIENT = 8
"""Cost of sines, cosines (`_WORK`) and quotients in products, measured by `benchmarks/closed_loops.py`."""
_NEGLIGIBLE = 0.01
"""Coefficients below this share of the guess's largest error are left out."""
_WIDE = 4.0
"""Widest range (rad) of an angle that is fitted as tan(x/2), which grows without bound towards ±π."""
_BEYOND = 4.0
"""Sines and cosines of a step are exact up to so many times the longest step of the samples."""

_Steps = tuple[int, ...]


def build_passive_positions(closure: LoopEquations) -> ca.Function | None:
    """Return the function (q_a) -> x, cos x, sin x SX (p, 1), exact within the limits of the driven joints.

    It is verified on closed postures within the limits that are far from singular ones.

    Parameters
    ----------
    closure : Closure
        The closed loops of the machine.

    Returns
    -------
    casadi.Function or None
        None where no polynomial comes near enough.
    """
    turns = solve_by_triangles(closure, *closure.sample_postures(_FEW))
    if turns is None:
        turns = _solve_by_steps(closure, *closure.sample_postures(_SAMPLES))
    return None if turns is None else ca.Function("solution", [closure.symbols[0]], list(turns.parts))


def _solve_by_steps(closure: LoopEquations, q: FloatArray, x: FloatArray) -> AngleTerms | None:
    steps = {order: _build_step(closure, order) for order in _ORDERS}
    guesses = {degree: _fit_guess(closure, q, x, degree) for degree in _DEGREES}
    positions_after: dict[tuple[int, _Steps], FloatArray] = {
        (d, ()): _evaluate(guess, q) for d, guess in guesses.items()
    }

    def compute_positions(degree: int, orders: _Steps) -> FloatArray:
        if (degree, orders) not in positions_after:
            before = compute_positions(degree, orders[:-1])
            positions_after[degree, orders] = before + _evaluate(
                steps[orders[-1]], q, before, np.cos(before), np.sin(before)
            )
        return positions_after[degree, orders]

    work = {order: estimate_work(step) for order, step in steps.items()}
    effort = {degree: estimate_work(guess) for degree, guess in guesses.items()}
    choices = [
        (effort[degree] + sum(work[order] for order in orders), degree, orders)
        for degree, orders in product(_DEGREES, _iter_step_orders())
    ]
    # Try the cheapest combination first. Numbers of shorter ones are remembered, since longer ones go on from them.
    for _, degree, orders in sorted(choices):
        if np.abs(compute_positions(degree, orders) - x).max() < _EXACT:
            driven = closure.symbols[0]
            turns = AngleTerms(*guesses[degree](driven))
            for k, order in enumerate(orders):
                longest = np.abs(
                    compute_positions(degree, orders[: k + 1]) - compute_positions(degree, orders[:k])
                ).max(axis=0)
                turns = turns.add_steps(steps[order](driven, *turns.parts), _BEYOND * longest)
            return turns
    return None


def estimate_work(function: ca.Function) -> int:
    """Return the cost of a function's code in products; a number that divides several others is inverted once."""
    # As machine code is made of it (`llvm_translation`): what divides several numbers is inverted once.
    work, divisors = 0, set[int]()
    made_by: dict[int, int] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        work += _WORK.get(operation, 1)
        if operation == ca.OP_DIV:
            divisors.add(made_by[function.instruction_input(k)[1]])
        if operation != ca.OP_OUTPUT:
            made_by[function.instruction_output(k)[0]] = k
    return work + _QUOTIENT * len(divisors)


def _iter_step_orders() -> Iterator[_Steps]:
    for count in range(_MOST_STEPS + 1):
        yield from product(_ORDERS, repeat=count)


def _evaluate(function: ca.Function, *inputs: FloatArray) -> FloatArray:
    """Evaluate a function's first result at the rows of arrays (m, …); returns (m, k)."""
    result = function.map(len(inputs[0])).call([values.T for values in inputs])[0]
    return np.asarray(result.full().T, dtype=np.float64)


def _build_step(closure: LoopEquations, order: int) -> ca.Function:
    """Return (q_a, x, cos x, sin x) -> step by `order` terms of the series: the error goes to the power order + 1."""
    driven, x = closure.symbols
    along, further = ca.SX.sym("along", closure.p), ca.SX.sym("further", closure.p)
    terms = [-closure.solve(closure.gaps)]
    # With F = ∂φ/∂x and the path's derivatives x', x'', x''' at t = 0: F x' = -φ, F x'' = -φ_xx x' x', and
    # F x''' = -(φ_xxx x' x' x' + 3 φ_xx x' x''). The same elimination of F serves all of them.
    if order > 1:
        slope = ca.jtimes(closure.gaps, x, along)
        bend = ca.jtimes(slope, x, along)
        terms.append(-closure.solve(ca.substitute(bend, along, terms[0])))
    if order > 2:
        turn = ca.jtimes(bend, x, along) + 3 * ca.jtimes(slope, x, further)
        terms.append(-closure.solve(ca.substitute([turn], [along, further], terms)[0]))
    shares = (1.0, 1 / 2, 1 / 6)  # Taylor's 1 / k!
    value = ca.densify(sum(share * term for share, term in zip(shares, terms, strict=False)))
    current = AngleTerms(x, ca.SX.sym("cos", closure.p), ca.SX.sym("sin", closure.p))
    return ca.Function("step", [driven, *current.parts], [ca.cse(substitute_angles(value, x, current))])


def _fit_guess(closure: LoopEquations, q: FloatArray, x: FloatArray, degree: int) -> ca.Function:
    """Fit the guess (q_a) -> x, cos x, sin x to positions (m, n), (m, p): polynomials, for angles of tan(x/2)."""
    driven = closure.symbols[0]
    # Scale the driven positions to [-1, 1]: high powers would otherwise make the least-squares problem singular.
    middle, half = 0.5 * (closure.low + closure.high), 0.5 * (closure.high - closure.low)
    scaled, symbols = (q - middle) / half, (driven - ca.DM(middle)) * ca.DM(1 / half)
    low, high = x.min(axis=0), x.max(axis=0)
    centre, halved = 0.5 * (low + high), np.array(closure.are_angles) & (high - low < _WIDE)
    # The guess is tan of half the angle where it can be: cosine and sine follow from that without evaluating either.
    target = np.where(halved, np.tan(0.5 * np.where(halved, x - centre, 0.0)), x)
    guess = ca.SX.zeros(closure.p)
    for _, unknowns, movers in closure.groups:
        own_degree = min(degree, _HIGHEST.get(len(movers), 4))
        terms = np.stack([np.ones(len(q)), *list_products(list(scaled[:, movers].T), own_degree)], axis=1)
        weights = np.linalg.lstsq(terms, target[:, unknowns], rcond=1e-12)[0]
        far = np.abs(terms @ weights - target[:, unknowns]).max(axis=0)
        # Terms that matter less than the guess's own error only cost time: the steps remove that error anyway.
        weights[np.abs(weights) < np.maximum(1e-13, _NEGLIGIBLE * far)] = 0.0
        columns = ca.vertcat(1, *list_products([symbols[j] for j in movers], own_degree))
        values = ca.mtimes(ca.sparsify(ca.SX(ca.DM(weights.T))), columns)
        for place, k in enumerate(unknowns):
            guess[k] = values[place]
    guess = ca.densify(guess)
    turns = [
        AngleTerms.from_half_tangents(guess[k], centre[k]) if halved[k] else AngleTerms.from_angles(guess[k])
        for k in range(closure.p)
    ]
    return ca.Function(
        "guess", [driven], [ca.vertcat(*parts) for parts in zip(*(turn.parts for turn in turns), strict=True)]
    )
