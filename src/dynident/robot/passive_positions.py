"""Passive positions as expressions of the driven ones: in closed form, or a polynomial's guess and what makes it exact.

Where every loop is a triangle, that is solved (`dyads`). Elsewhere, from a guess x₀ the way to the closed posture is
φ(x(t)) = (1 - t) φ(x₀), 0 ≤ t ≤ 1. Its Taylor series at x₀ is Newton's step where it ends after the first term; every
further one (Chebyshev's method, and so on) takes one power more of the guess's error off, and needs no sine or cosine
that the first one has not computed. Which degree of the polynomial and which terms make the shortest code is found by
trying.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from dynident.arrays import FloatArray
from dynident.expressions.angles import Turns, turned
from dynident.robot.dyads import solved_by_triangles
from dynident.robot.loop_numbers import products

if TYPE_CHECKING:
    from dynident.robot.loops import Closure

_FEW, _SAMPLES, _EXACT = 200, 3000, 1e-12
_DEGREES = (1, 2, 3, 5, 7, 9, 11, 13)
_HIGHEST = {1: 13, 2: 13, 3: 8}
_ORDERS, _MOST_STEPS = (1, 2, 3), 4
_WORK = {ca.OP_SIN: 30, ca.OP_COS: 30}
_QUOTIENT = 8
"""How many products take the time of what takes longer than one (`benchmarks/closed_loops.py`)."""
_NEGLIGIBLE = 0.01
"""Coefficients below this share of the guess's largest error are left out."""
_WIDE = 4.0
"""Angles (rad) that reach over more are no tangents of a half."""
_BEYOND = 4.0
"""Sines and cosines of a step are exact up to so many times the longest that was seen."""

_Steps = tuple[int, ...]


def passive_positions(closure: Closure) -> ca.Function | None:
    """(q_a) -> x, cos x and sin x SX (p, 1), exact within the limits of the driven joints.

    `None` where no polynomial comes near enough. Tried on closed postures within the limits, far from singular ones.
    """
    turns = solved_by_triangles(closure, *closure.sampled(_FEW))
    if turns is None:
        turns = _solved_by_steps(closure, *closure.sampled(_SAMPLES))
    return None if turns is None else ca.Function("solution", [closure.symbols[0]], list(turns.parts))


def _solved_by_steps(closure: Closure, q: FloatArray, x: FloatArray) -> Turns | None:
    steps = {order: _step(closure, order) for order in _ORDERS}
    guesses = {degree: _fitted(closure, q, x, degree) for degree in _DEGREES}
    known: dict[tuple[int, _Steps], FloatArray] = {(d, ()): _at(guess, q) for d, guess in guesses.items()}

    def reached(degree: int, orders: _Steps) -> FloatArray:
        if (degree, orders) not in known:
            at = reached(degree, orders[:-1])
            known[degree, orders] = at + _at(steps[orders[-1]], q, at, np.cos(at), np.sin(at))
        return known[degree, orders]

    work = {order: work_of(step) for order, step in steps.items()}
    effort = {degree: work_of(guess) for degree, guess in guesses.items()}
    choices = [
        (effort[degree] + sum(work[order] for order in orders), degree, orders)
        for degree, orders in product(_DEGREES, _ways())
    ]
    for _, degree, orders in sorted(choices):
        if np.abs(reached(degree, orders) - x).max() < _EXACT:
            driven = closure.symbols[0]
            turns = Turns(*guesses[degree](driven))
            for k, order in enumerate(orders):
                longest = np.abs(reached(degree, orders[: k + 1]) - reached(degree, orders[:k])).max(axis=0)
                turns = turns.onward(steps[order](driven, *turns.parts), _BEYOND * longest)
            return turns
    return None


def work_of(function: ca.Function) -> int:
    """How long a function's code takes, counted in products; what several numbers are divided by is inverted once."""
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


def _ways() -> Iterator[_Steps]:
    for count in range(_MOST_STEPS + 1):
        yield from product(_ORDERS, repeat=count)


def _at(function: ca.Function, *inputs: FloatArray) -> FloatArray:
    """Values (m, k) of a function's first result at rows of arrays (m, …)."""
    found = function.map(len(inputs[0])).call([one.T for one in inputs])[0]
    return np.asarray(found.full().T, dtype=np.float64)


def _step(closure: Closure, order: int) -> ca.Function:
    """(q_a, x, cos x, sin x) -> how far to go by so many terms of the series: to an error to the power order + 1."""
    driven, x = closure.symbols
    along, further = ca.SX.sym("along", closure.p), ca.SX.sym("further", closure.p)
    terms = [-closure.solve(closure.gaps)]
    if order > 1:
        slope = ca.jtimes(closure.gaps, x, along)
        bend = ca.jtimes(slope, x, along)
        terms.append(-closure.solve(ca.substitute(bend, along, terms[0])))
    if order > 2:
        turn = ca.jtimes(bend, x, along) + 3 * ca.jtimes(slope, x, further)
        terms.append(-closure.solve(ca.substitute([turn], [along, further], terms)[0]))
    shares = (1.0, 1 / 2, 1 / 6)
    value = ca.densify(sum(share * term for share, term in zip(shares, terms, strict=False)))
    given = Turns(x, ca.SX.sym("cos", closure.p), ca.SX.sym("sin", closure.p))
    return ca.Function("step", [driven, *given.parts], [ca.cse(turned(value, x, given))])


def _fitted(closure: Closure, q: FloatArray, x: FloatArray, degree: int) -> ca.Function:
    """(q_a) -> x, cos x and sin x near positions (m, n) and (m, p): polynomials, of angles in the tangent of a half."""
    driven = closure.symbols[0]
    middle, half = 0.5 * (closure.low + closure.high), 0.5 * (closure.high - closure.low)
    scaled, symbols = (q - middle) / half, (driven - ca.DM(middle)) * ca.DM(1 / half)
    low, high = x.min(axis=0), x.max(axis=0)
    centre, halved = 0.5 * (low + high), np.array(closure.turning) & (high - low < _WIDE)
    wanted = np.where(halved, np.tan(0.5 * np.where(halved, x - centre, 0.0)), x)
    guess = ca.SX.zeros(closure.p)
    for _, unknowns, movers in closure.groups:
        own = min(degree, _HIGHEST.get(len(movers), 4))
        terms = np.stack([np.ones(len(q)), *products(list(scaled[:, movers].T), own)], axis=1)
        weights = np.linalg.lstsq(terms, wanted[:, unknowns], rcond=1e-12)[0]
        far = np.abs(terms @ weights - wanted[:, unknowns]).max(axis=0)
        weights[np.abs(weights) < np.maximum(1e-13, _NEGLIGIBLE * far)] = 0.0
        columns = ca.vertcat(1, *products([symbols[j] for j in movers], own))
        values = ca.mtimes(ca.sparsify(ca.SX(ca.DM(weights.T))), columns)
        for place, k in enumerate(unknowns):
            guess[k] = values[place]
    guess = ca.densify(guess)
    turns = [Turns.of_half(guess[k], centre[k]) if halved[k] else Turns.of(guess[k]) for k in range(closure.p)]
    return ca.Function(
        "guess", [driven], [ca.vertcat(*parts) for parts in zip(*(one.parts for one in turns), strict=True)]
    )
