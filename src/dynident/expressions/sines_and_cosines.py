"""Joint angles with cosines and sines as expressions of their own, where those are known first (passive joints)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from dynident.array_types import FloatArray

_SMALL, _ROUNDING = 0.25, 1e-17
"""An angle (rad) whose series is shorter than a sine, and what of its series is too little to be seen."""


@dataclass(frozen=True, eq=False)
class AngleTerms:
    """Joint coordinates together with their cosines and sines.

    Parameters
    ----------
    angles, cosines, sines : SX (k, 1)
        Coordinates in rad or m, and their cosines and sines; of prismatic joints nothing reads the last two.
    """

    angles: ca.SX
    cosines: ca.SX
    sines: ca.SX

    @classmethod
    def from_angles(cls, angles: ca.SX) -> AngleTerms:
        """Return angles with sines and cosines that have to be computed."""
        return cls(angles, ca.cos(angles), ca.sin(angles))

    @classmethod
    def from_half_tangents(cls, tangents: ca.SX, middle: float) -> AngleTerms:
        """Return angles from the tangents of half of their distances from a middle.

        Parameters
        ----------
        tangents : SX (k, 1)
            Tangents.
        middle : float
            Middle, rad.

        Returns
        -------
        AngleTerms
            Within half a turn of the middle.
        """
        # With t = tan(x / 2), cos x = (1 - t²) / (1 + t²) and sin x = 2 t / (1 + t²): no sine is evaluated.
        squares = tangents * tangents
        whole = 1 + squares
        c, s = math.cos(middle), math.sin(middle)
        along, across = (1 - squares) / whole, 2 * tangents / whole
        return cls(middle + 2 * ca.atan(tangents), c * along - s * across, s * along + c * across)

    @property
    def parts(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Angles, cosines and sines."""
        return self.angles, self.cosines, self.sines

    def add_steps(self, steps: ca.SX, longest: FloatArray) -> AngleTerms:
        """Return the coordinates after small steps, whose sines and cosines come from short series.

        Parameters
        ----------
        steps : SX (k, 1)
            Steps, rad or m.
        longest : (k,)
            Largest size of each step, which decides how long its series is.

        Returns
        -------
        AngleTerms
            Exact to rounding for steps up to these sizes.
        """
        cosines, sines = [], []
        for k, reach in enumerate(longest):
            along, across = _expand_small_angle(steps[k], float(reach))
            # The addition theorems turn the known sine and cosine onward by the small step.
            cosines.append(self.cosines[k] * along - self.sines[k] * across)
            sines.append(self.sines[k] * along + self.cosines[k] * across)
        return AngleTerms(self.angles + steps, ca.vertcat(*cosines), ca.vertcat(*sines))


def _expand_small_angle(angle: ca.SX, longest: float) -> tuple[ca.SX, ca.SX]:
    """Return cosine and sine of an angle of at most `longest`, by Taylor's series down to rounding."""
    if longest > _SMALL:
        return ca.cos(angle), ca.sin(angle)
    # Coefficients of the powers: the even ones are those of the cosine, the odd ones those of the sine (without the
    # leading factor of the angle).
    shares = [1.0, 1.0]
    while longest ** len(shares) * abs(shares[-1]) / len(shares) > _ROUNDING:
        shares.append(-shares[-2] / (len(shares) * (len(shares) - 1)))
    squared = angle * angle
    sums = [ca.SX(0), ca.SX(0)]
    # Horner's scheme in the square of the angle, for both series at once.
    for power in reversed(range(len(shares))):
        sums[power % 2] = sums[power % 2] * squared + shares[power]
    return sums[0], angle * sums[1]


def substitute_angles(expression: ca.SX, symbols: ca.SX, turns: AngleTerms) -> ca.SX:
    """Return an expression with angles in place of symbols, and of their sines and cosines.

    CasADi's list of instructions is gone through once. Sines of sums with a symbol are those of its angle.

    Parameters
    ----------
    expression : SX
        Any expression.
    symbols : SX (k, 1)
        Symbols of coordinates in it.
    turns : AngleTerms
        What takes their place.

    Returns
    -------
    SX
        Of the same shape and sparsity.
    """
    free_symbols = ca.symvar(expression)
    places = {symbols[k].element_hash(): k for k in range(symbols.numel())}
    symbol_places = [places.get(symbol.element_hash()) for symbol in free_symbols]
    if all(place is None for place in symbol_places):
        return expression
    function = ca.Function("open", [ca.vertcat(*free_symbols)], [expression.nz[:]])
    values: dict[int, ca.SX] = {}
    # By register of the instruction list: which symbol it holds at this point, if it is exactly one of them.
    replaced: dict[int, int] = {}
    entries = [ca.SX(0)] * int(expression.nnz())
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        target, source = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            entries[target[1]] = values[source[0]]
            continue
        turn = replaced.get(source[0]) if operation in (ca.OP_SIN, ca.OP_COS) else None
        place = symbol_places[source[1]] if operation == ca.OP_INPUT else None
        if operation == ca.OP_INPUT:
            value = free_symbols[source[1]] if place is None else turns.angles[place]
        elif operation == ca.OP_CONST:
            value = ca.SX(function.instruction_constant(k))
        elif turn is not None:
            value = (turns.sines if operation == ca.OP_SIN else turns.cosines)[turn]
        elif len(source) == 1:
            value = ca.SX.unary(operation, values[source[0]])
        else:
            value = ca.SX.binary(operation, values[source[0]], values[source[1]])
        values[target[0]] = value
        # CasADi reuses registers: what this one held before is overwritten.
        replaced.pop(target[0], None)
        if place is not None:
            replaced[target[0]] = place
    return ca.SX(expression.sparsity(), ca.vertcat(*entries))
