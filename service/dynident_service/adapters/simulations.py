"""Virtual robots between the contract and the science."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from dynident.errors import DynidentError
from dynident.simulation import Measurement, Reference
from dynident_service.adapters.answers import shown
from dynident_service.models import simulations as wire

RATE_OF_SAMPLES = 1000.0


def reference_of(samples: wire.Samples) -> Reference:
    """Take a trajectory off the wire; derivatives that are not given are those of a spline through q."""
    t, q = np.array(samples.t, dtype=np.float64), _matrix(samples.q, "q")
    if samples.dq is not None and samples.ddq is not None:
        return Reference(t, q, _matrix(samples.dq, "dq"), _matrix(samples.ddq, "ddq"))
    if len(t) != len(q) or not np.all(np.diff(t) > 0) or len(t) < 4:
        detail = "t has to increase, with one row of q for each, four at least, for dq and ddq to follow from q"
        raise DynidentError(detail, pointer="/trajectory/t", title="Unusable trajectory")
    spline = CubicSpline(t, q)
    dq = spline(t, 1) if samples.dq is None else _matrix(samples.dq, "dq")
    return Reference(t, q, dq, spline(t, 2) if samples.ddq is None else _matrix(samples.ddq, "ddq"))


def describe_simulation(measurement: Measurement, rate: float) -> wire.SimulationResult:
    """Describe a virtual robot's measurement for the wire."""
    return shown(wire.SimulationResult, measurement, sampling_rate=rate)


def _matrix(rows: list[list[float]], name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    if len({len(row) for row in rows}) != 1:
        detail = f"the rows of {name} have different lengths; each has a value for every joint"
        raise DynidentError(detail, pointer=f"/trajectory/{name}", title="Unusable trajectory")
    return np.array(rows, dtype=np.float64)
