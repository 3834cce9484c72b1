"""Passive positions as expressions of the driven ones: in closed form, or a polynomial guess with exact corrections.

Where every loop is a triangle, it is solved in closed form (`dyads`). Elsewhere a polynomial gives a guess x₀, and the
path to the closed posture is φ(x(t)) = (1 - t) φ(x₀), 0 ≤ t ≤ 1. The first term of its Taylor series at x₀ is Newton's
step. Every further term (Chebyshev's method, and so on) removes one more power of the guess's error, and needs no sine
or cosine beyond those of the first. The degree of the polynomial and the number of terms are those with the shortest
code, found by trying all combinations.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.expressions.angles import AngleTerms, substitute_angles
from dynident.robot.dyads import solve_by_triangles
from dynident.robot.loop_equations import LoopEquations
from dynident.robot.loop_numbers import list_products

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
