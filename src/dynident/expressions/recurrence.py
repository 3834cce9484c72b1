"""Recurrences: a state that is stepped through time, each step from the one before."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.expressions.machine_code import Compiled


class Recurrence:
    """Recurrence x_(k+1), y_k = f(x_k, u_k, p) in machine code.

    Parameters
    ----------
    state, inputs, constants : SX (s, 1), SX (w, 1), SX (c, 1)
        Symbols of the state x, of the inputs u and of the constants p.
    following, sample : SX (s, 1), SX (o, 1)
        Expressions of the next state x_(k+1) and of what a step gives, y.
    """

    def __init__(self, state: ca.SX, inputs: ca.SX, constants: ca.SX, following: ca.SX, sample: ca.SX) -> None:
        self._sizes = (int(state.numel()), int(inputs.numel()), int(constants.numel()))
        outputs = ca.densify(ca.vertcat(following, sample))
        self._width = int(outputs.numel())
        function = ca.Function("step", [ca.vertcat(state, inputs, constants)], [ca.cse(outputs)])
        # One lane: a step needs the result of the step before, so that none can be taken side by side.
        self._compiled = Compiled(function, self._sizes, 1)

    def run(self, state: FloatArray, inputs: FloatArray, constants: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Step the state through m samples.

        Parameters
        ----------
        state : (s,)
            The first state x_0.
        inputs : (m, w)
            Inputs u of every step.
        constants : (c,)
            Constants p, the same for all steps.

        Returns
        -------
        state : (s,)
            State after the last step.
        samples : (m, o)
            What every step gives, y.

        Raises
        ------
        ValueError
            For a state, inputs or constants of another size.
        """
        m = len(inputs)
        shapes, n_state = (state.shape, inputs.shape, constants.shape), self._sizes[0]
        needed = ((n_state,), (m, self._sizes[1]), (self._sizes[2],))
        if shapes != needed:
            raise ValueError(f"state, inputs and constants of {shapes}; {needed} are needed")
        # Row k + 1 takes what step k gives and is what step k + 1 reads: one sample at a time, in order.
        table = np.empty((m + 1, self._width))
        table[0, :n_state] = state
        if m:
            others = [np.ascontiguousarray(item, np.float64) for item in (inputs, constants)]
            self._compiled.run(m, table[1:], [table[:-1, :n_state], *others])
        return table[-1, :n_state].copy(), table[1:, n_state:]
