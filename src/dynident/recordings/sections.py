"""Butterworth low-passes in second-order sections, as `scipy.signal` has them, to the last bit.

To load that package takes longer than to identify a robot from a short recording, and these filters are all that an
identification needs of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray
from dynident.expressions import Recurrence


@dataclass(frozen=True, eq=False)
class LowPass:
    """`sections` (k, 6) as `scipy.signal.sosfilt` takes them, the last with the poles next to the unit circle.

    `poles` (order,) are those of the whole.
    """

    sections: FloatArray
    poles: NDArray[np.complex128]

    @property
    def steady(self) -> FloatArray:
        """(k, 2): the state that a constant input of 1 keeps, as of `scipy.signal.sosfilt_zi`."""
        found, scale = np.empty((len(self.sections), 2)), 1.0
        for k, one in enumerate(self.sections):
            b, a = one[:3], one[3:]
            rest = np.array([[1.0 + a[1], -1.0], [a[2], 1.0]])
            found[k] = scale * np.linalg.solve(rest, b[1:] - a[1:] * b[0])
            scale *= np.sum(b) / np.sum(a)
        return found

    def run(self, rows: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Filter rows (m, n), each column by itself, from a state (k, 2, n); gives rows, and the state behind them."""
        k, _, n = state.shape
        filtered, behind = np.empty((len(rows), n)), np.empty(state.shape)
        step, constants = _step(k), self.sections.ravel()
        for column in range(n):
            after, samples = step.run(state[:, :, column].ravel(), rows[:, column : column + 1], constants)
            filtered[:, column], behind[:, :, column] = samples[:, 0], after.reshape(k, 2)
        return filtered, behind


def butterworth(order: int, cutoff: float, rate: float) -> LowPass:
    """Design one with half power at `cutoff` at a sampling `rate`, both in Hz."""
    share = np.float64(cutoff) / (rate / 2)
    if not 0 < share < 1:
        raise ValueError(f"a cut-off of {cutoff} Hz does not lie between zero and half the rate of {rate} Hz")
    # The prototype's poles, moved to the warped cut-off and then from the plane of s to that of z.
    warped = float(4.0 * np.tan(pi * share / 2.0))
    s = warped * -np.exp(1j * pi * np.arange(-order + 1, order, 2, dtype=np.float64) / (2 * order))
    poles = (4.0 + s) / (4.0 - s)
    gain = warped**order * np.real(1.0 / np.prod(4.0 - s))
    sections = _sections(poles)
    sections[0, :3] *= gain
    return LowPass(sections, poles)


def _sections(poles: NDArray[np.complex128]) -> FloatArray:
    """(k, 6): pairs of poles, those next to the unit circle last, and with each pair the zeros next to it."""
    n, half = len(poles), len(poles) // 2
    # They come in the order of their angles: conjugates from either end, and a real one in the middle.
    pairs = [(p, p.conjugate()) for p in (poles[:half] + poles[: n - half - 1 : -1].conj()) / 2]
    zeros = [-1.0] * n
    if n % 2:
        pairs.append((poles[half].real, 0.0))
        zeros.append(0.0)
    pairs.sort(key=lambda pair: abs(1.0 - abs(pair[0])))
    found = np.zeros((len(pairs), 6))
    for k, pair in enumerate(pairs):
        by_distance = np.argsort(np.abs(np.array(zeros) - pair[0]), kind="stable")
        zeros = [zeros[place] for place in by_distance]
        found[-1 - k] = [*np.poly(zeros[:2]), *np.poly(pair)]
        zeros = zeros[2:]
    return found


@cache
def _step(k: int) -> Recurrence:
    """One sample through k sections."""
    state, constants, sample = ca.SX.sym("state", 2 * k), ca.SX.sym("sections", 6 * k), ca.SX.sym("sample")
    following, passed = [], sample
    for one in range(k):
        b, a = constants[6 * one : 6 * one + 3], constants[6 * one + 3 : 6 * one + 6]
        first, second = state[2 * one], state[2 * one + 1]
        out = b[0] * passed + first
        following += [b[1] * passed - a[1] * out + second, b[2] * passed - a[2] * out]
        passed = out
    return Recurrence(state, sample, constants, ca.vertcat(*following), passed)
