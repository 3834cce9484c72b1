"""Sensors of a virtual robot: quantisation, noise and sampling instants."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.asking import check_ranges
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.stated import Sensors

_TITLE = "Unusable sensors"


def check_sensors(sensors: Sensors, robot: Robot) -> None:
    """Raise `DynidentError` for a value that no sensor has."""
    check_ranges(sensors, "/noise")
    absolute = sensors.torque_noise_absolute
    if absolute is not None and len(absolute) != robot.n:
        raise DynidentError(
            f"torque_noise_absolute is {list(absolute)}; expected {robot.n} numbers, one a joint",
            pointer="/noise/torque_noise_absolute",
            title=_TITLE,
        )
    if 4 * sensors.jitter * sensors.sampling_rate > 1:
        raise DynidentError(
            f"a jitter of {sensors.jitter} s is too much at {sensors.sampling_rate} Hz; at most a quarter of the "
            "sampling period",
            pointer="/noise/jitter",
            title=_TITLE,
        )
    missing = [name for name, drive in zip(robot.joint_names, robot.drives, strict=True) if not drive.gain]
    if sensors.current and missing:
        raise DynidentError(
            f"currents need the drive gain of every joint [12.17]; it is missing for {', '.join(missing)}",
            pointer="/noise/current",
            title=_TITLE,
        )


def quantise_positions(sensors: Sensors, robot: Robot, q: FloatArray) -> FloatArray:
    """Return positions (m, n) rounded to the encoders' counts."""
    if not sensors.encoder_counts:
        return q
    turn = np.array([2 * np.pi if joint.kind == "revolute" else 1.0 for joint in robot.joints])
    step = turn / sensors.encoder_counts
    return np.rint(q / step) * step


def compute_noise_deviation(sensors: Sensors, robot: Robot, tau: FloatArray) -> FloatArray:
    """Return the standard deviation (n,) of the torque noise, for a run with the torques tau (m, n)."""
    if sensors.torque_noise_absolute is not None:
        return np.array(sensors.torque_noise_absolute, dtype=np.float64)
    largest = np.abs(tau).max(axis=0)
    limits = [joint.limits.effort for joint in robot.joints]
    scale = np.array([peak if limit is None else limit for limit, peak in zip(limits, largest, strict=True)])
    return sensors.torque_noise * scale


def draw_sampling_steps(
    sensors: Sensors, steps_per_sample: int, n_samples: int, rng: np.random.Generator
) -> IndexArray:
    """Return the internal steps (n_samples,) at which samples are taken: regular, shifted by the jitter, ascending."""
    regular: IndexArray = np.arange(n_samples, dtype=np.intp) * steps_per_sample
    if sensors.jitter == 0:
        return regular
    spread = sensors.jitter * sensors.sampling_rate * steps_per_sample
    # Two neighbouring samples are shifted by less than half a period each, so that their order stays.
    largest = max(0, (steps_per_sample - 1) // 2)
    shift = np.clip(np.rint(rng.normal(0.0, spread, n_samples)), -largest, largest).astype(np.intp)
    shift[0] = 0
    shifted: IndexArray = np.minimum(regular + shift, regular[-1])
    return shifted
