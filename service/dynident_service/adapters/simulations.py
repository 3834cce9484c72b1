"""Virtual robots: trajectories from bodies, and views of simulated measurements."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from dynident.errors import DynidentError
from dynident.simulation import Reference, SimulatedRecording
from dynident_service.adapters.serialise import to_view
from dynident_service.models import simulations as wire

RATE_OF_SAMPLES = 1000.0
"""Sampling rate in Hz of a virtual robot that follows samples."""


def to_reference(samples: wire.Samples) -> Reference:
    """Build a reference trajectory from samples.

    Parameters
    ----------
    samples : Samples
        t (m,) in s and q (m, n); dq and ddq where they are stated.

    Returns
    -------
    Reference
        The trajectory; missing derivatives are those of a cubic spline through q.

    Raises
    ------
    DynidentError
        Where t does not increase, or rows have different lengths.
    """
    t, q = np.array(samples.t, dtype=np.float64), _to_matrix(samples.q, "q")
    if samples.dq is not None and samples.ddq is not None:
        return Reference(t, q, _to_matrix(samples.dq, "dq"), _to_matrix(samples.ddq, "ddq"))
    # A cubic spline needs four points and increasing times.
    if len(t) != len(q) or not np.all(np.diff(t) > 0) or len(t) < 4:
        detail = "t has to increase, with one row of q for each, four at least, for dq and ddq to follow from q"
        raise DynidentError(detail, pointer="/trajectory/t", title="Unusable trajectory")
    # A cubic has a continuous acceleration, which the torque needs.
    spline = CubicSpline(t, q)
    dq = spline(t, 1) if samples.dq is None else _to_matrix(samples.dq, "dq")
    return Reference(t, q, dq, spline(t, 2) if samples.ddq is None else _to_matrix(samples.ddq, "ddq"))


def describe_simulation(measurement: SimulatedRecording, rate: float) -> wire.SimulationResult:
    """Build the view of a simulated measurement; `rate` in Hz."""
    return to_view(wire.SimulationResult, measurement, sampling_rate=rate)


def _to_matrix(rows: list[list[float]], name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    if len({len(row) for row in rows}) != 1:
        detail = f"the rows of {name} have different lengths; each has a value for every joint"
        raise DynidentError(detail, pointer=f"/trajectory/{name}", title="Unusable trajectory")
    return np.array(rows, dtype=np.float64)
