"""Signals that joint torque may depend on besides position, velocity and acceleration."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class FurtherSignals:
    """Values at m samples; what is left out counts as zero.

    Parameters
    ----------
    dddq, ddddq : (m, n), optional
        Third and fourth derivative of q in rad/s³ and rad/s⁴, or m/s³ and m/s⁴.
    time : (m,), optional
        s.
    temperature : (m, n), optional
        °C.
    runs : (number of run signals,) or (m, number of run signals), optional
        1 where the samples' run is one of the signal's.
    period : float
        Sampling period in s, for columns that jump.
    """

    dddq: FloatArray | None = None
    ddddq: FloatArray | None = None
    time: FloatArray | None = None
    temperature: FloatArray | None = None
    runs: FloatArray | None = None
    period: float = 1e-3


NOTHING_FURTHER = FurtherSignals()
"""For columns that depend on the motion alone, to its second derivative."""
