"""The family of periodic trajectories that a request asks for."""

from __future__ import annotations

from dynident.errors import DynidentError
from dynident.excitation.b_spline import BSplineFamily
from dynident.excitation.family import Family
from dynident.excitation.fourier import FourierFamily
from dynident.excitation.request import TrajectoryRequest


def family_of(wanted: TrajectoryRequest, period: float) -> Family:
    """Fourier series or B-splines of one period (s); `DynidentError` for what is neither."""
    if wanted.family == "b_spline":
        return BSplineFamily(wanted.intervals, period)
    if wanted.family == "fourier":
        return FourierFamily(wanted.harmonics, period)
    raise DynidentError(f"a trajectory of the family {wanted.family} has no period", pointer="/trajectory/family")
