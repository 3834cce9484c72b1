"""W at a fixed number of samples, and the reverse sweep from ∂/∂W back to ∂/∂(q, q̇, q̈)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column, Signals, build_columns
from dynident.excitation.observation.design_model import JUMP_TIME, DesignModel
from dynident.excitation.observation.hysteresis import PathMemory
from dynident.expressions import Program


class ObservationGradient:
    """W (N, n, c) of all base parameters of a design model at N samples of a period, and its transposed derivative.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    n_samples : int
        Number of samples N.
    smooth_sign : float
        Velocity (rad/s, m/s) over which sign(q̇) is rounded: W then changes without jumps, which a line search needs.
    """

    def __init__(self, model: DesignModel, n_samples: int, smooth_sign: float) -> None:
        self.n, self.n_samples = model.robot.n, n_samples
        signals = Signals(model.robot, smooth_sign=smooth_sign)
        columns = _rebuild_columns(model, signals)
        self.n_columns = len(columns)
        matrix = ca.horzcat(*(column.torque for column in columns))
        # Most entries of W are zero for every motion; only the others are evaluated.
        rows, at = matrix.sparsity().get_triplet()
        self._places = np.array(rows, dtype=np.intp) * self.n_columns + np.array(at, dtype=np.intp)
        memory = signals.find_memory_signals(matrix)
        states = ca.vertcat(*(signals.memory(item) for item in memory))
        derivatives = [signals.q, signals.dq, signals.ddq]
        if ca.depends_on(matrix, ca.vertcat(signals.dddq, signals.ddddq)):
            derivatives += [signals.dddq, signals.ddddq]
        self._n_derivatives = len(derivatives)
        state = ca.vertcat(*derivatives, states)
        entries = ca.substitute(ca.vec(matrix.nz[:]), signals.reference, ca.DM(model.reference.vector))
        entries = ca.substitute(entries, signals.period, JUMP_TIME)
        runs = signals.run_symbols
        entries = ca.substitute(entries, runs, ca.DM.ones(runs.numel())) if runs.numel() else entries
        seeds = ca.SX.sym("seeds", entries.numel())
        # Reverse mode: one sweep gives the gradient by all states of a sample, however many entries W has.
        swept = ca.densify(ca.jtimes(entries, state, seeds, True))
        self._memory = PathMemory(memory)
        # These arrays are used again by every evaluation, so that one object belongs to one thread.
        self._state = np.zeros((n_samples, self._n_derivatives * self.n + len(memory)))
        self._seeds = np.zeros((n_samples, entries.numel()))
        self._entries = np.zeros_like(self._seeds)
        self._swept = np.zeros_like(self._state)
        self._w = np.zeros((n_samples, self.n * self.n_columns))
        self._forward = Program([state], entries)
        self._reverse = Program([state, seeds], swept)

    def evaluate(self, *derivatives: FloatArray) -> FloatArray:
        """Return W (N, n, c) at q and its derivatives (N, n), as many as the columns need.

        The array is used again by the next call.
        """
        for part, values in enumerate(derivatives[: self._n_derivatives]):
            self._state[:, part * self.n : (part + 1) * self.n] = values
        if self._memory.signals:
            self._state[:, self._n_derivatives * self.n :] = self._memory.compute_states(derivatives[0], periodic=True)
        self._forward(self._state, out=self._entries)
        self._w[:, self._places] = self._entries
        return self._w.reshape(self.n_samples, self.n, self.n_columns)

    def pull_back(self, gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈, … (N, n) from ∂/∂W (N, n, c), at the states of the last `evaluate`."""
        np.take(gradient.reshape(self.n_samples, -1), self._places, axis=1, out=self._seeds)
        self._reverse(self._state, self._seeds, out=self._swept)
        n = self.n
        end = self._n_derivatives * n
        gradients = [self._swept[:, part * n : (part + 1) * n] for part in range(self._n_derivatives)]
        if self._memory.signals:
            of_path = self._memory.pull_back(self._state[:, :n], self._state[:, end:], self._swept[:, end:])
            # Positions act on W directly and through the hysteresis states; the two add up.
            gradients[0] = gradients[0] + of_path
        return gradients


def _rebuild_columns(model: DesignModel, signals: Signals) -> list[Column]:
    """Return the model's base columns, made from other symbols."""
    by_key = {column.key: column for column in build_columns(model.choices, signals)}
    return [by_key[column.key] for column in model.base_columns]
