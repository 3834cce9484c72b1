"""Rows of dynamic, filtered, power and energy models over one period of a design, with gradients (§12.4-§12.6).

Over a whole number of periods every linear operation in time, a filter or an integral, acts on the N samples of one
period as a circulant matrix. So each model's rows are that matrix times the rows of the dynamic model, which the power
and the energy model first combine into one equation by the joints' velocities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.regressors import ROW_MODELS, RowModelName
from dynident.regressors.filtered_energy_power_rows import SHARE_OF_PERIOD

__all__ = ["ROW_MODELS", "RowModel", "RowModelName", "build_row_model"]

_POLE_HARMONICS = 2.0
"""a of F(s) = a²/(s + a)² over the highest frequency of the motion, both in rad/s: the motion passes the filter."""


@dataclass(frozen=True, eq=False)
class RowModel:
    """Rows of an identification model from W (N, n, b) of the dynamic model and q̇ (N, n).

    Parameters
    ----------
    name : str
        Name of the identification model.
    joined : bool
        Whether the joints' rows are added, each times its velocity, [12.39] and [12.51].
    mix : (N, N) or None
        Linear operation in time on every column; None for none.
    """

    name: RowModelName
    joined: bool
    mix: FloatArray | None

    def build_rows(self, w: FloatArray, dq: FloatArray) -> FloatArray:
        """Return the rows (N n, b), or (N, b) where the joints are joined.

        Parameters
        ----------
        w : (N, n, b)
            W of the dynamic model by sample and joint.
        dq : (N, n)
            Velocities, rad/s or m/s.
        """
        n_samples, _, b = w.shape
        rows = np.einsum("kj,kjb->kb", dq, w)[:, None] if self.joined else w
        if self.mix is not None:
            rows = (self.mix @ rows.reshape(n_samples, -1)).reshape(rows.shape)
        return np.ascontiguousarray(rows).reshape(-1, b)

    def pull_back(self, w: FloatArray, dq: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ∂/∂W (N, n, b) and ∂/∂q̇ (N, n) from ∂/∂rows.

        Parameters
        ----------
        w : (N, n, b)
            W of the dynamic model by sample and joint.
        dq : (N, n)
            Velocities, rad/s or m/s.
        gradient : (rows, b)
            Derivative of a function by the rows.
        """
        of_rows = gradient.reshape(len(w), -1)
        if self.mix is not None:
            # The gradient goes back through a linear operation by its transpose.
            of_rows = self.mix.T @ of_rows
        if not self.joined:
            return of_rows.reshape(w.shape), np.zeros_like(dq)
        return dq[:, :, None] * of_rows[:, None, :], np.einsum("kjb,kb->kj", w, of_rows)

    def compute_unmixed_noise(self, dq: FloatArray, noise: FloatArray) -> FloatArray:
        """Return the standard deviation (N, k) of the k rows of a sample before mixing, for joint noise (n,).

        Parameters
        ----------
        dq : (N, n)
            Velocities, rad/s or m/s.
        noise : (n,)
            Standard deviation of the noise of each joint, N m or N.
        """
        if not self.joined:
            return np.broadcast_to(noise, dq.shape)
        return np.asarray(np.sqrt((dq**2) @ noise**2))[:, None]


DYNAMIC_ROWS = RowModel("dynamic", False, None)
"""Rows of the dynamic model: one per joint, unchanged."""


def build_row_model(name: RowModelName, n_samples: int, period: float, highest: float) -> RowModel:
    """Return the rows of a model on N samples of a period of a motion.

    Parameters
    ----------
    name : {"dynamic", "filtered", "energy", "power"}
        Name of the identification model. filtered: F(s) of [12.29] on all columns; energy: integrals over intervals as
        an identification takes them, one beginning at every sample, [12.43]; power: the joined rows themselves,
        [12.51].
    n_samples : int
        Number of samples N of a period.
    period : float
        Period, s.
    highest : float
        Highest frequency of the motion, Hz.

    Returns
    -------
    RowModel
        The rows, as an operation on those of the dynamic model.
    """
    if name == "dynamic":
        return DYNAMIC_ROWS
    # A periodic signal has only the harmonics of its period, at which the transfer function is evaluated.
    frequencies = 2j * np.pi * np.fft.rfftfreq(n_samples, period / n_samples)
    if name == "filtered":
        pole = _POLE_HARMONICS * 2 * np.pi * highest
        return RowModel(name, False, _build_circulant(lambda s: (pole / (s + pole)) ** 2, frequencies, n_samples))
    if name == "power":
        return RowModel(name, True, None)
    length = 1.0 / (SHARE_OF_PERIOD * highest)
    return RowModel(name, True, _build_circulant(lambda s: _interval_transfer(s, length), frequencies, n_samples))


def _interval_transfer(s: np.ndarray, length: float) -> np.ndarray:
    """Return the transfer function of the integral from t to t + length."""
    # At s = 0 the quotient is 0 / 0; its limit is the length.
    safe = np.where(s == 0, 1.0, s)
    return np.where(s == 0, length, (np.exp(safe * length) - 1.0) / safe)


def _build_circulant(transfer: Callable[[np.ndarray], np.ndarray], s: np.ndarray, n_samples: int) -> FloatArray:
    """Return the matrix (N, N) of a transfer function that acts on N samples of a period."""
    response = np.fft.irfft(transfer(s), n_samples)
    # Entry (i, j) is the response to an impulse i - j samples earlier, around the period.
    places = (np.arange(n_samples)[:, None] - np.arange(n_samples)) % n_samples
    matrix: FloatArray = response[places]
    return matrix
