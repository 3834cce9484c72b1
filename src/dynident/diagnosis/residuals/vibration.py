"""The frequency of a base that shakes: not simply the highest line, since the posture modulates what joints feel."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy import fft

from dynident.arrays import FloatArray
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.residuals.lines import (
    SLOWEST_VIBRATION,
    MotionLines,
    choose_spectrum_grid,
    find_peaks,
    split_pieces,
)
from dynident.effects import ReferenceParameters, Signals
from dynident.expressions import Program

_AROUND, _STEPS_A_WIDTH = 0.3, 4
_STANDS_OUT, _MOST_LINES = 6.0, 2
"""Times what frequencies beside it explain (clean arms reach three), and the most frequencies that are tried."""
_SOLVABLE = 1e-9
_LEAST_FELT = 1e-3
"""Residuals of a joint for one m/s² of gravity: below it, a base that shakes by g moves the torque by less than a
hundredth of the residual. A link with its mass on a joint's axis feels nothing, or what rounding left."""
_MOST_ROWS = 6000


def find_base_vibration(
    comparisons: Sequence[Comparison],
    signals: Signals,
    reference: ReferenceParameters,
    highest: float,
    motion: MotionLines,
) -> list[float]:
    """Frequencies (Hz) at which a shaking base explains far more of the residual than at others beside, best first.

    Sought in what every joint would feel of it in its posture, not in the spectra of single joints: there it is spread
    over side lobes, and drowned by what noise other joints have.

    Parameters
    ----------
    reference : ReferenceParameters
        Parameters that torque is predicted with.
    highest : Hz
        Nothing faster is looked for.
    motion : MotionLines
        What the motion itself repeats tells of the model, not of the base.
    """
    felt = _build_gravity_program(signals)
    columns = [_compute_gravity_sensitivities(c, felt, reference) for c in comparisons]
    frequency, gains = _compute_vibration_spectrum(comparisons, columns, highest)
    lines = motion.exclude_motion_lines(find_peaks(frequency, gains, _STANDS_OUT))[:_MOST_LINES]
    longest = max(float(c.t[-1] - c.t[0]) for c in comparisons)
    step = 1.0 / (_STEPS_A_WIDTH * max(longest, np.finfo(float).tiny))
    frequencies: list[float] = []
    for line in lines:
        if any(abs(line - other) <= 2 * _AROUND for other in frequencies):
            continue
        finer = np.arange(max(line - _AROUND, step), line + _AROUND, step)
        refined = [_compute_vibration_gain(comparisons, columns, float(value)) for value in finer]
        frequencies.append(float(finer[int(np.argmax(refined))]))
    return motion.exclude_motion_lines(frequencies)


def _compute_vibration_spectrum(
    comparisons: Sequence[Comparison], columns: Sequence[FloatArray], highest: float
) -> tuple[FloatArray, FloatArray]:
    """Frequencies (f,) in Hz, and the squared residual that a base shaking at each explains; a phase for every segment.

    The normal equations of all frequencies at once: products with waves are Fourier transforms.
    """
    own = {id(c): values for c, values in zip(comparisons, columns, strict=True)}
    pieces = split_pieces(comparisons)
    period, size = choose_spectrum_grid(pieces)
    if not size or highest <= SLOWEST_VIBRATION:
        return np.zeros(0), np.zeros(0)
    in_range = np.flatnonzero(
        (fft.rfftfreq(size, period) >= SLOWEST_VIBRATION) & (fft.rfftfreq(size, period) < highest)
    )
    gains = np.zeros(len(in_range))
    for c, rows in pieces:
        felt, y = own[id(c)][rows], c.counted_residual[rows] * _compute_joint_weights(c)
        place = np.round((c.t[rows] - c.t[rows[0]]) / period).astype(np.intp)
        right, squares = np.zeros((place[-1] + 1, 3)), np.zeros((place[-1] + 1, 9))
        right[place] = np.einsum("mja,mj->ma", felt, y)
        squares[place] = np.einsum("mja,mjb->mab", felt, felt).reshape(-1, 9)
        wave = fft.fft(right, size, axis=0)[in_range]
        twice = fft.fft(squares, size, axis=0)[(2 * in_range) % size].reshape(-1, 3, 3)
        still = squares.sum(axis=0).reshape(3, 3)
        if not still.any():
            continue
        w = np.block([[still + twice.real, -twice.imag], [-twice.imag, still - twice.real]]) / 2.0
        b = np.concatenate([wave.real, -wave.imag], axis=1)[..., None]
        w += _SOLVABLE * np.trace(still) * np.eye(6)
        gains += (b * np.linalg.solve(w, b)).sum(axis=(1, 2))
    return fft.rfftfreq(size, period)[in_range], gains


def _build_gravity_program(signals: Signals) -> Program:
    """Torque of every joint for one m/s² of gravity along each axis: (m, 3 n) of q (m, n) and the reference (14 n,)."""
    return Program([signals.q, signals.reference], ca.densify(signals.predicted.gravity_torques))


def _compute_gravity_sensitivities(comparison: Comparison, felt: Program, reference: ReferenceParameters) -> FloatArray:
    """(m, n, 3): torque of every joint for one m/s² of gravity along each axis, over the joint's usual residual.

    Zero where the joint's equation does not tell, and of joints that do not feel gravity.
    """
    values = felt(comparison.q, reference.vector).reshape(len(comparison.q), 3, -1).transpose(0, 2, 1)
    weighted = values * (comparison.counted_rows * _compute_joint_weights(comparison))[:, :, None]
    feels = np.abs(weighted).max(axis=(0, 2), initial=0.0) >= _LEAST_FELT
    return np.asarray(weighted * feels[:, None])


def _compute_joint_weights(comparison: Comparison) -> FloatArray:
    """(n,): one over every joint's usual residual, zero for one that has none: it stands all the time."""
    rms = comparison.errors.rms
    return np.divide(1.0, rms, out=np.zeros_like(rms), where=rms > 0.0)


def _compute_vibration_gain(
    comparisons: Sequence[Comparison], columns: Sequence[FloatArray], frequency: float
) -> float:
    """Squared residual, in units of its own, that a shaking base explains; a phase for every recording."""
    total = 0.0
    for c, sensitivity in zip(comparisons, columns, strict=True):
        every = max(1, len(c.t) // _MOST_ROWS)
        angle = 2 * np.pi * frequency * c.t[::every]
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        w = (sensitivity[::every, ..., None] * waves[:, None, None, :]).reshape(-1, 6)
        y = (c.counted_residual[::every] * _compute_joint_weights(c)).reshape(-1)
        right = w.T @ y
        total += float(right @ np.linalg.lstsq(w.T @ w, right, rcond=1e-9)[0])
    return total
