"""What the rows of the four identification models are on one period of a design (§12.4-§12.6), with exact gradients.

Over a whole number of periods every linear operation in time, a filter or an integral, acts on the N samples of one
period as a circulant matrix. So each model's rows are that matrix times the rows of the dynamic model, which the power
and the energy model first join into one equation by the joints' velocities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.excitation.observation.row_names import ROW_MODELS, RowModelName
from dynident.regressors.equations import SHARE_OF_PERIOD

__all__ = ["ROW_MODELS", "RowModel", "RowModelName", "row_model"]

_POLE_HARMONICS = 2.0
"""a of F(s) = a²/(s + a)² over the highest frequency of the motion, both in rad/s: the motion passes."""


@dataclass(frozen=True, eq=False)
class RowModel:
    """Rows of an identification model from W (N, n, b) of the dynamic model and q̇ (N, n).

    `joined`: the joints' rows are added, each times its velocity, [12.39] and [12.51]. `mix` (N, N): what is done to
    every column over time; None: nothing.
    """

    name: RowModelName
    joined: bool
    mix: FloatArray | None

    def rows(self, w: FloatArray, dq: FloatArray) -> FloatArray:
        """(N n, b), or (N, b) where the joints are joined."""
        n_samples, _, b = w.shape
        made = np.einsum("kj,kjb->kb", dq, w)[:, None] if self.joined else w
        if self.mix is not None:
            made = (self.mix @ made.reshape(n_samples, -1)).reshape(made.shape)
        return np.ascontiguousarray(made).reshape(-1, b)

    def pull_back(self, w: FloatArray, dq: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """∂/∂W (N, n, b) and ∂/∂q̇ (N, n) from ∂/∂rows."""
        of_made = gradient.reshape(len(w), -1)
        if self.mix is not None:
            of_made = self.mix.T @ of_made
        if not self.joined:
            return of_made.reshape(w.shape), np.zeros_like(dq)
        return dq[:, :, None] * of_made[:, None, :], np.einsum("kjb,kb->kj", w, of_made)

    def unmixed_noise(self, dq: FloatArray, noise: FloatArray) -> FloatArray:
        """(N, k): standard deviation of the k rows of a sample before the mixing, for noise (n,) of the joints."""
        if not self.joined:
            return np.broadcast_to(noise, dq.shape)
        return np.asarray(np.sqrt((dq**2) @ noise**2))[:, None]


EVERY_JOINT = RowModel("dynamic", False, None)
"""One row a joint, as it is."""


def row_model(name: RowModelName, n_samples: int, period: float, highest: float) -> RowModel:
    """The rows of a model on N samples of a period (s) of a motion with frequencies up to `highest` (Hz).

    filtered: F(s) of [12.29] on all columns; energy: integrals over intervals as an identification takes them, one
    beginning at every sample, [12.43]; power: the rows as they are, [12.51].
    """
    if name == "dynamic":
        return EVERY_JOINT
    frequencies = 2j * np.pi * np.fft.rfftfreq(n_samples, period / n_samples)
    if name == "filtered":
        pole = _POLE_HARMONICS * 2 * np.pi * highest
        return RowModel(name, False, _circulant(lambda s: (pole / (s + pole)) ** 2, frequencies, n_samples))
    if name == "power":
        return RowModel(name, True, None)
    length = 1.0 / (SHARE_OF_PERIOD * highest)
    return RowModel(name, True, _circulant(lambda s: _interval(s, length), frequencies, n_samples))


def _interval(s: np.ndarray, length: float) -> np.ndarray:
    """Transfer function of the integral from t to t + length."""
    safe = np.where(s == 0, 1.0, s)
    return np.where(s == 0, length, (np.exp(safe * length) - 1.0) / safe)


def _circulant(transfer: Callable[[np.ndarray], np.ndarray], s: np.ndarray, n_samples: int) -> FloatArray:
    """(N, N): what a transfer function does to N samples of a period."""
    response = np.fft.irfft(transfer(s), n_samples)
    places = (np.arange(n_samples)[:, None] - np.arange(n_samples)) % n_samples
    made: FloatArray = response[places]
    return made
