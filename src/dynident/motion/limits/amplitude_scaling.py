"""Scale the amplitude of a periodic trajectory until it keeps the limits."""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.motion.limits.bounds import Bounds, TorqueModel
from dynident.motion.limits.postures import CENTRAL_SHARE
from dynident.motion.trajectories.motion import Family

# Twelve halvings give the amplitude to a four-thousandth.
_BISECTIONS = 12
# Between so many samples a wave of the highest frequency exceeds its value at them by less than a thousandth.
_SAMPLES_PER_WAVE = 80


class AmplitudeScaler:
    """Scales the coefficients of a family to the largest amplitude at which they keep the limits.

    Parameters
    ----------
    family : Family
        Family of trajectories.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.
    fine : bool
        Whether to look at the motion as closely as its highest frequency needs; coarse is for a first selection.
    """

    def __init__(self, family: Family, bounds: Bounds, model: TorqueModel, *, fine: bool = True) -> None:
        self._bounds, self._model = bounds, model
        count = _SAMPLES_PER_WAVE * family.waves if fine else 2 * _SAMPLES_PER_WAVE
        self._basis = family.basis(np.arange(count) * family.period / count)[:4]

    def scale_down(self, x: FloatArray, most: float = 1.0) -> FloatArray | None:
        """Return coefficients with the amplitude scaled to keep the limits.

        The centre (the offsets) stays, except that it is moved inside the position limits.

        Parameters
        ----------
        x : (m, n)
            Coefficients of the family.
        most : float
            Largest factor on the amplitude.

        Returns
        -------
        (m, n) or None
            The scaled coefficients; None where no amplitude keeps the limits.
        """
        b = self._bounds
        scaled = x.copy()
        scaled[0] = np.clip(x[0], b.middle - CENTRAL_SHARE * b.half_range, b.middle + CENTRAL_SHARE * b.half_range)
        # A centre outside of the limits is moved well inside, since there would be no room to swing right at the limit.
        inside = (b.position_low < x[0]) & (x[0] < b.position_high)
        scaled[0, inside] = x[0, inside]
        # Position, velocity, acceleration and jerk are linear in the amplitude, so these limits give the scale
        # directly.
        q, dq, ddq, dddq = self._basis[:, :, 1:] @ scaled[1:]
        # A joint that is locked has neither room nor motion: 0 / 0.
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = min(
                most,
                float(np.nanmin((b.position_high - scaled[0]) / np.maximum(q.max(axis=0), 0.0))),
                float(np.nanmin((scaled[0] - b.position_low) / np.maximum(-q.min(axis=0), 0.0))),
                float((b.velocity / np.abs(dq).max(axis=0)).min()),
                float((b.acceleration / np.abs(ddq).max(axis=0)).min()),
                float((b.jerk / np.abs(dddq).max(axis=0)).min()),
            )
        amplitude = self._find_amplitude(scaled[0], q, dq, ddq, scale)
        if amplitude is None:
            return None
        scaled[1:] *= amplitude
        return scaled

    def _find_amplitude(
        self, centre: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, most: float
    ) -> float | None:
        """Return the largest amplitude up to `most` that keeps torque, power, clearances and followers' limits."""
        bounds = self._bounds
        if not bounds.has_torque_limits and bounds.space is None:
            return most

        def keeps_limits(scale: float) -> bool:
            # Bodies scaled in amplitude by s at unchanged frequency: q̇ and q̈ scale alike.
            positions, velocities = centre + scale * q, scale * dq
            if bounds.has_torque_limits:
                torque = self._model.torque(positions, velocities, scale * ddq)
                if not ((np.abs(torque) <= bounds.torque) & (np.abs(torque * velocities) <= bounds.power)).all():
                    return False
            if not bounds.are_follower_rates_kept(positions, velocities, scale * ddq):
                return False
            return bounds.space is None or bool((bounds.space.compute_least_slack(positions) >= 0).all())

        if keeps_limits(most):
            return most
        # At amplitude zero the arm stands still at the centre: if that is not possible, no amplitude is.
        if not keeps_limits(0.0):
            return None
        low, high = 0.0, most
        # Torque and clearances are not linear in the amplitude: bisect. The lower end always keeps the limits.
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if keeps_limits(middle) else (low, middle)
        # Zero would be no motion at all.
        return low or None
