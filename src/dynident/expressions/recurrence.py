"""A state that is stepped through time, each step from the one before."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynident.expressions.machine_code import Compiled

FloatArray = NDArray[np.float64]


class Recurrence:
    """x_(k+1), y_k = f(x_k, u_k) in machine code.

    Parameters
    ----------
    state, inputs : SX column vectors
        x (s,) and u (w,).
    following, sample : SX
        x_(k+1) (s,) and y (p,).
    """

    def __init__(self, state: ca.SX, inputs: ca.SX, following: ca.SX, sample: ca.SX) -> None:
        self.n_state, self._n_inputs = int(state.numel()), int(inputs.numel())
        outputs = ca.densify(ca.vertcat(following, sample))
        self._width = int(outputs.numel())
        function = ca.Function("step", [ca.vertcat(state, inputs)], [ca.cse(outputs)])
        self._compiled = Compiled(function, (self.n_state, self._n_inputs), 1)

    def run(self, state: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The state (s,) after m steps from a first one (s,) with inputs (m, w), and the samples y (m, p).

        Raises
        ------
        ValueError
            For a state or inputs of another size.
        """
        m = len(inputs)
        if state.shape != (self.n_state,) or inputs.shape != (m, self._n_inputs):
            raise ValueError(
                f"a state of {state.shape} and inputs of {inputs.shape}; ({self.n_state},) and (m, {self._n_inputs}) "
                "are needed"
            )
        # Row k + 1 takes what step k gives and is what step k + 1 reads: one sample at a time, in order.
        table = np.empty((m + 1, self._width))
        table[0, : self.n_state] = state
        if m:
            self._compiled.run(m, table[1:], [table[:-1, : self.n_state], np.ascontiguousarray(inputs, np.float64)])
        return table[-1, : self.n_state].copy(), table[1:, self.n_state :]
