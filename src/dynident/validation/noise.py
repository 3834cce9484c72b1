"""Estimate the noise of a recording's sensors from high differences, which no motion of a robot explains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation.robust_weights import estimate_robust_scale
from dynident.recordings import Recording, filtered_blocks
from dynident.recordings.preprocessing import Preprocessing

# Of a smooth signal nothing is left after so many differences; white noise of variance σ² leaves C(2k, k) σ².
_DIFFERENCES = 6
_LEFT = 924.0


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """White noise of a recording's sensors.

    Parameters
    ----------
    position : (n,)
        Standard deviation of the noise on positions, in rad or m.
    torque : (n,)
        Standard deviation of the noise on torques, in N m or N.
    """

    position: FloatArray
    torque: FloatArray


def sensor_noise(recording: Recording) -> SensorNoise:
    """Estimate the white noise of a recording from high differences of its unfiltered signals inside the windows.

    Parameters
    ----------
    recording : Recording
        The recording whose noise is estimated.

    Returns
    -------
    SensorNoise
        Standard deviations joint by joint.

    Raises
    ------
    DynidentError
        Where there are too few samples.
    """
    unfiltered = Preprocessing(None, None)
    position: list[FloatArray] = []
    torque: list[FloatArray] = []
    for block in filtered_blocks(recording, unfiltered):
        used = np.flatnonzero(block.used)
        # Differences must not reach across a gap between used samples: the jump there is no noise.
        for run in np.split(used, np.flatnonzero(np.diff(used) > 1) + 1):
            # Short runs have few differences, which all share the same samples.
            if len(run) > 2 * _DIFFERENCES:
                position.append(np.diff(block.q[run], _DIFFERENCES, axis=0))
                torque.append(np.diff(block.tau[run], _DIFFERENCES, axis=0))
    if not position:
        raise DynidentError(
            f"{recording.name} has too few samples inside its windows to tell its noise", pointer="/measurement_ids"
        )
    joint, effort = np.concatenate(position), np.concatenate(torque)
    # Torque jumps with friction where a joint reverses: the middle of its differences does not see that.
    spread = estimate_robust_scale(effort)
    return SensorNoise(np.sqrt(np.mean(joint**2, axis=0) / _LEFT), np.asarray(spread / np.sqrt(_LEFT)))
