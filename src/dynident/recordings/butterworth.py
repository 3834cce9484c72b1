"""Butterworth low-pass filters in second-order sections.

They are those of SciPy (`scipy.signal.butter` and `sosfilt_zi`) to the last bit. Importing `scipy.signal`, which
imports `scipy.stats`, would take a quarter of the time that a command needs to start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray

ComplexArray = NDArray[np.complex128]


def design_butterworth(rate: float, cutoff: float, order: int) -> tuple[FloatArray, ComplexArray]:
    """Design a Butterworth low-pass.

    Parameters
    ----------
    rate, cutoff : float
        Sampling rate and cut-off frequency (half power) in Hz.
    order : int
        Number of poles.

    Returns
    -------
    sections : (s, 6)
        Second-order sections, b0, b1, b2, 1, a1, a2 of each; the poles that are nearest to the unit circle come last.
    poles : (order,) of complex
        The filter's poles.

    Raises
    ------
    ValueError
        For a cut-off frequency that is not between zero and half of the sampling rate.
    """
    if not 0.0 < 2.0 * cutoff < rate:
        raise ValueError(f"cut-off frequency {cutoff:g} Hz; it must be between 0 and {rate / 2:g} Hz")
    # Poles of the analog filter on the left half of a circle. The bilinear transform, at two samples in a second,
    # bends the frequency axis, so that the circle's radius is the bent cut-off frequency.
    k = np.arange(-order + 1, order, 2, dtype=np.float64)
    analog = 4.0 * np.tan(np.pi * (2.0 * cutoff / rate) / 2.0) * -np.exp(1j * np.pi * k / (2 * order))
    poles = (4.0 + analog) / (4.0 - analog)
    gain = (4.0 * np.tan(np.pi * (2.0 * cutoff / rate) / 2.0)) ** order * np.real(1.0 / np.prod(4.0 - analog))
    return _pair_sections(poles, gain), poles


def _pair_sections(poles: ComplexArray, gain: float) -> FloatArray:
    """Return the sections of a low-pass whose zeros are all at -1: each pole with the zeros nearest to it."""
    order = len(poles)
    # Of an odd order one section has a real pole, and a pole and a zero at the origin to fill it up.
    zeros = [-1.0] * order + [0.0] * (order % 2)
    pairs = [pole for pole in poles if pole.imag > 0.0]
    real = [complex(pole) for pole in poles if pole.imag == 0.0]
    sections = np.zeros((len(zeros) // 2, 6))
    # From the last section to the first. Poles near the unit circle are the sharpest and come last.
    for section in sections[::-1]:
        pole = min((*pairs, *real), key=lambda candidate: abs(1.0 - abs(candidate)))
        if pole in pairs:
            pairs.remove(pole)
            both = [pole, np.conj(pole)]
        else:
            real.remove(pole)
            both = [pole, 0.0]
        zeros.sort(key=lambda zero: abs(pole - zero))
        section[:3], section[3:] = np.poly(zeros[:2]), np.poly(both)
        del zeros[:2]
    sections[0, :3] *= gain
    return sections


def compute_steady_state(sections: FloatArray) -> FloatArray:
    """Return the state (s, 2) that a constant input of one leaves in the sections.

    Parameters
    ----------
    sections : (s, 6)
        Second-order sections.
    """
    state, level = np.empty((len(sections), 2)), 1.0
    for index, (b0, b1, b2, _, a1, a2) in enumerate(sections):
        # The state that no longer changes: z = A z + B.
        unchanged = np.linalg.solve([[1.0 + a1, -1.0], [a2, 1.0]], [b1 - a1 * b0, b2 - a2 * b0])
        state[index] = level * unchanged
        # The next section's input is the gain of this one at zero frequency.
        level *= (b0 + b1 + b2) / (1.0 + a1 + a2)
    return state
