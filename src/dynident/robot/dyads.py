"""Two passive joints of a loop in a plane, in closed form: a triangle whose sides are known.

Their two equations are u + R(y₁) v + R(y₂) w = 0 with vectors u, v, w in the plane that the driven joints alone
determine, and turns y = T x of the two: each by itself, or one carried by the other. Sides of these lengths make two
triangles, which are the two branches; they meet where they are flat, and there the loop is singular. So the branch of
the start holds wherever the loop closes, and sines and cosines are known before any angle is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from dynident.arrays import FloatArray
from dynident.expressions.angles import Turns, turned

if TYPE_CHECKING:
    from dynident.robot.loops import Closure

_POSTURES, _TURNS = 3, 8
_EXACT, _CONSTANT, _SAME_BRANCH = 1e-12, 1e-13, 1e-8
_WIDEST = 5.5
"""Reach (rad) of a passive joint that is surely less than a whole turn."""
_FLAT = 1e-14
"""Share of its largest below which a triangle's squared area does not go: where loops are open, numbers stay finite."""


@dataclass(frozen=True, eq=False)
class _Plane:
    """A vector or a turn in the plane, multiplied like a complex number."""

    x: ca.SX
    y: ca.SX

    def __add__(self, other: _Plane) -> _Plane:
        return _Plane(self.x + other.x, self.y + other.y)

    def __mul__(self, other: _Plane) -> _Plane:
        return _Plane(self.x * other.x - self.y * other.y, self.x * other.y + self.y * other.x)

    def times(self, factor: ca.SX) -> _Plane:
        return _Plane(self.x * factor, self.y * factor)

    def back(self) -> _Plane:
        return _Plane(self.x, -self.y)

    def squared(self) -> ca.SX:
        return self.x * self.x + self.y * self.y


def solved_by_triangles(closure: Closure, q: FloatArray, x: FloatArray) -> Turns | None:
    """The passive coordinates SX (p, 1) of a closure's driven symbols; `None` where some of its loops are no triangles.

    `q` (m, n) and `x` (m, p) are closed postures on the branch of the start. A triangle's sides may be those of others.
    """
    found = Turns(*(ca.SX.zeros(closure.p) for _ in range(3)))
    for rows, unknowns in _one_after_the_other(closure):
        part = _solved(closure, rows, unknowns, found, q, x)
        if part is None:
            return None
        found.angles[unknowns], found.cosines[unknowns], found.sines[unknowns] = part.angles, part.cosines, part.sines
    return found


def _one_after_the_other(closure: Closure) -> list[tuple[list[int], list[int]]]:
    """Equations and the passive coordinates that they determine, from those that all of the others are known of."""
    over = np.asarray(ca.DM(closure.slopes[1].sparsity(), 1.0).full() != 0)
    count, rows, columns, row_borders, column_borders, *_ = closure.slopes[1].sparsity().btf()
    left = [
        (sorted(rows[row_borders[k] : row_borders[k + 1]]), sorted(columns[column_borders[k] : column_borders[k + 1]]))
        for k in range(count)
    ]
    found: list[tuple[list[int], list[int]]] = []
    while left:
        known = {k for _, unknowns in found for k in unknowns}
        ready = next(one for one in left if set(np.flatnonzero(over[one[0]].any(axis=0))) <= known | set(one[1]))
        left.remove(ready)
        found.append(ready)
    return found


def _solved(
    closure: Closure, rows: list[int], unknowns: list[int], known: Turns, q: FloatArray, x: FloatArray
) -> Turns | None:
    """Two passive coordinates by two equations, of the driven ones and of those known; zeros stand for the rest."""
    if len(rows) != 2 or len(unknowns) != 2:
        return None
    turning = _turning(closure, rows, unknowns, q[:_POSTURES], x[:_POSTURES])
    vectors = None if turning is None else _vectors(closure, rows, unknowns, turning, known)
    if turning is None or vectors is None:
        return None
    own, driven = x[:, unknowns], closure.symbols[0]
    if np.ptp(own, axis=0).max() > _WIDEST:
        return None
    middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
    squares = [_constant(one.squared(), driven, q) for one in vectors[1:]]
    for side in (1.0, -1.0):
        turns = _third_corner(vectors, squares, side)
        found = _angles([_combined(turns, powers) for powers in np.linalg.inv(turning)], middle)
        if np.abs(_at(found.angles, driven, q) - own).max() < _SAME_BRANCH:
            return found
    return None


def _candidates() -> Iterator[FloatArray]:
    """T (2, 2): both joints on the same body, or one of them on the other, about the same axis or the opposite one."""
    for first, second in product((1, -1), repeat=2):
        yield np.array([[first, 0], [0, second]])
        yield np.array([[first, 0], [first, second]])
        yield np.array([[0, second], [first, second]])


def _turning(closure: Closure, rows: list[int], unknowns: list[int], q: FloatArray, x: FloatArray) -> FloatArray | None:
    """T of two equations, by trying: with it they are linear in u, v and w, wherever the two joints are."""
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (_TURNS, 2))
    whole = np.repeat(x, _TURNS, axis=0)
    whole[:, unknowns] = np.tile(angles, (len(x), 1))
    gaps = closure.evaluated(np.repeat(q, _TURNS, axis=0), whole)[0][:, rows].reshape(len(q), -1).T
    for turning in _candidates():
        y = angles @ turning.T
        matrices = np.array([[np.cos(y), -np.sin(y)], [np.sin(y), np.cos(y)]])
        terms = np.hstack([np.tile(np.eye(2), (_TURNS, 1)), np.einsum("rctk->trkc", matrices).reshape(-1, 4)])
        left = gaps - terms @ np.linalg.lstsq(terms, gaps, rcond=None)[0]
        if np.abs(left).max() < _EXACT * closure.size:
            return turning
    return None


def _vectors(
    closure: Closure, rows: list[int], unknowns: list[int], turning: FloatArray, known: Turns
) -> list[_Plane] | None:
    """u, v and w: what is left of the equations without sines and cosines, and what the cosines of y₁ and y₂ carry."""
    x = closure.symbols[1]
    open_turns = Turns(x, ca.SX.sym("cos", closure.p), ca.SX.sym("sin", closure.p))
    gaps = turned(ca.densify(closure.gaps[rows]), x, open_turns)
    if ca.depends_on(gaps, x):
        return None
    parts = [gaps, gaps, gaps]
    for k, powers in enumerate(turning, start=1):
        for unknown, power in zip(unknowns, powers, strict=True):
            if power:
                parts[k] = ca.jacobian(parts[k], open_turns.cosines[unknown])
    parts = ca.substitute(parts, [open_turns.cosines, open_turns.sines], [known.cosines, known.sines])
    return [_Plane(*(ca.densify(part)[k] for k in range(2))) for part in parts]


def _third_corner(vectors: Sequence[_Plane], squares: Sequence[ca.SX], side: float) -> list[_Plane]:
    """The turns by y₁ and y₂ that close the triangle u + R(y₁) v + R(y₂) w = 0, whose corner lies on one side of u."""
    u, v, w = vectors
    own = u.squared()
    along = 0.5 * (squares[1] - squares[0] - own)
    largest = squares[0] * own
    across = side * ca.sqrt(ca.fmax(largest - along * along, _FLAT * largest))
    first = u * _Plane(along / own, across / own)
    second = first + u
    return [first * v.back().times(1 / squares[0]), second * w.back().times(-1 / squares[1])]


def _combined(turns: Sequence[_Plane], powers: FloatArray) -> _Plane:
    """The turn by a sum of angles, each taken as often as `powers` (2,) says: once, back, or not at all."""
    used = [one if power > 0 else one.back() for one, power in zip(turns, powers, strict=True) if round(power)]
    return used[0] if len(used) == 1 else used[0] * used[1]


def _angles(turns: Sequence[_Plane], middle: FloatArray) -> Turns:
    """Angles within half a turn of their middles."""
    away = [one * _Plane(ca.SX(np.cos(at)), ca.SX(-np.sin(at))) for one, at in zip(turns, middle, strict=True)]
    angles = [at + ca.atan2(one.y, one.x) for one, at in zip(away, middle, strict=True)]
    return Turns(*(ca.vertcat(*one) for one in (angles, [one.x for one in turns], [one.y for one in turns])))


def _constant(value: ca.SX, driven: ca.SX, q: FloatArray) -> ca.SX:
    """A squared length as a number where the driven joints do not change it."""
    values = _at(value, driven, q)
    return ca.SX(float(values.mean())) if np.ptp(values) < _CONSTANT * values.max() else value


def _at(value: ca.SX, driven: ca.SX, q: FloatArray) -> FloatArray:
    """Values (m, k) of an expression SX (k, 1) at driven positions (m, n)."""
    found = ca.Function("value", [driven], [ca.densify(value)]).map(len(q))(q.T)
    return np.asarray(found.full().T, dtype=np.float64)
