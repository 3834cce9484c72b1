"""Number of samples of a period during the design, and rounding of the velocity's sign."""

from __future__ import annotations

from dynident.effects import get_effect
from dynident.excitation.observation.design_model import DesignModel
from dynident.motion.limits.bounds import Bounds
from dynident.motion.trajectories.motion import Family

# Samples of a period, and samples of each wave of the highest frequency.
_N_SAMPLES = 100
_SAMPLES_PER_WAVE = 16
# Hysteresis and low-speed friction happen within a few per cent of a period.
_N_CLOSE_SAMPLES = 600
# Share of the velocity limit over which sign(q̇) is rounded while optimising, and at most so much of a shape constant.
_SMOOTH_SIGN = 0.01
_SHARE_OF_SHAPE = 0.25


def count_period_samples(model: DesignModel, family: Family) -> int:
    """Return the number of samples N of one period that the criterion is computed from.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    family : Family
        Family of trajectories.
    """
    close = model.needs_path or bool(_find_narrow_speeds(model))
    # The fastest wave of the family must be sampled well, or the motion could break limits between the samples.
    return max(_N_CLOSE_SAMPLES if close else _N_SAMPLES, _SAMPLES_PER_WAVE * family.waves)


def choose_sign_rounding(model: DesignModel, bounds: Bounds) -> float:
    """Return the velocity (rad/s, m/s) over which sign(q̇) is rounded, small compared to limits and friction peaks.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    bounds : Bounds
        Limits of the motion.
    """
    narrow = [_SHARE_OF_SHAPE * speed for speed in _find_narrow_speeds(model)]
    return min([_SMOOTH_SIGN * float(bounds.velocity.min()), *narrow])


def _find_narrow_speeds(model: DesignModel) -> list[float]:
    """Return the shape constants of the model that are a speed near rest."""
    return [
        dict(column.shape)[spec.name]
        for column in model.base_columns[: model.n_parameters]
        for spec in get_effect(column.effect).shapes
        if spec.resolved_by == "speed" and spec.name in dict(column.shape)
    ]
