"""Sines and cosines of an angle as expressions of their own, where they are known before the angle is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from dynident.arrays import FloatArray

_SMALL, _ROUNDING = 0.25, 1e-17
"""An angle (rad) whose series is shorter than a sine, and what of its series is too little to be seen."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Coordinates with their cosines and sines, SX (k, 1) each; of what is no angle nobody asks for the last two."""

    angles: ca.SX
    cosines: ca.SX
    sines: ca.SX

    @classmethod
    def of(cls, angles: ca.SX) -> Turns:
        """Of angles whose sines and cosines have to be computed."""
        return cls(angles, ca.cos(angles), ca.sin(angles))

    @classmethod
    def of_half(cls, tangents: ca.SX, middle: float) -> Turns:
        """Of angles by the tangents SX (k, 1) of half of what they are away from a middle."""
        squares = tangents * tangents
        whole = 1 + squares
        c, s = math.cos(middle), math.sin(middle)
        along, across = (1 - squares) / whole, 2 * tangents / whole
        return cls(middle + 2 * ca.atan(tangents), c * along - s * across, s * along + c * across)

    @property
    def parts(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Angles, cosines, sines."""
        return self.angles, self.cosines, self.sines

    def onward(self, steps: ca.SX, longest: FloatArray) -> Turns:
        """The coordinates after steps SX (k, 1) of at most `longest` (k,), whose sines and cosines are short series."""
        cosines, sines = [], []
        for k, reach in enumerate(longest):
            along, across = _of_small(steps[k], float(reach))
            cosines.append(self.cosines[k] * along - self.sines[k] * across)
            sines.append(self.sines[k] * along + self.cosines[k] * across)
        return Turns(self.angles + steps, ca.vertcat(*cosines), ca.vertcat(*sines))


def _of_small(angle: ca.SX, longest: float) -> tuple[ca.SX, ca.SX]:
    """Cosine and sine of an angle of at most `longest`: of Taylor's series what is more than rounding."""
    if longest > _SMALL:
        return ca.cos(angle), ca.sin(angle)
    shares = [1.0, 1.0]
    while longest ** len(shares) * abs(shares[-1]) / len(shares) > _ROUNDING:
        shares.append(-shares[-2] / (len(shares) * (len(shares) - 1)))
    squared = angle * angle
    found = [ca.SX(0), ca.SX(0)]
    for power in reversed(range(len(shares))):
        found[power % 2] = found[power % 2] * squared + shares[power]
    return found[0], angle * found[1]


def turned(expression: ca.SX, symbols: ca.SX, turns: Turns) -> ca.SX:
    """The expression with `turns` in place of symbols SX (k, 1), their sines and cosines in place of those of symbols.

    CasADi's list of instructions is gone through once. Sines of sums with a symbol are those of its angle.
    """
    given = ca.symvar(expression)
    places = {symbols[k].element_hash(): k for k in range(symbols.numel())}
    at = [places.get(symbol.element_hash()) for symbol in given]
    if all(place is None for place in at):
        return expression
    function = ca.Function("open", [ca.vertcat(*given)], [expression.nz[:]])
    values: dict[int, ca.SX] = {}
    replaced: dict[int, int] = {}
    found = [ca.SX(0)] * int(expression.nnz())
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        target, source = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            found[target[1]] = values[source[0]]
            continue
        turn = replaced.get(source[0]) if operation in (ca.OP_SIN, ca.OP_COS) else None
        place = at[source[1]] if operation == ca.OP_INPUT else None
        if operation == ca.OP_INPUT:
            value = given[source[1]] if place is None else turns.angles[place]
        elif operation == ca.OP_CONST:
            value = ca.SX(function.instruction_constant(k))
        elif turn is not None:
            value = (turns.sines if operation == ca.OP_SIN else turns.cosines)[turn]
        elif len(source) == 1:
            value = ca.SX.unary(operation, values[source[0]])
        else:
            value = ca.SX.binary(operation, values[source[0]], values[source[1]])
        values[target[0]] = value
        replaced.pop(target[0], None)
        if place is not None:
            replaced[target[0]] = place
    return ca.SX(expression.sparsity(), ca.vertcat(*found))
