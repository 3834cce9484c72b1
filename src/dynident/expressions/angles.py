"""Sines and cosines of an angle as expressions of their own, where they are known before the angle is."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


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
