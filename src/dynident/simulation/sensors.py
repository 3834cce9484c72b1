"""What a virtual robot's sensors make of the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.errors import DynidentError
from dynident.robot.model import Robot

_TITLE = "Unusable sensors"


@dataclass(frozen=True)
class Sensors:
    """Encoders, torque sensors and the clock of a virtual robot.

    Parameters
    ----------
    sampling_rate : float
        Hz.
    encoder_counts : int or None
        Counts per turn of the joint (per metre, if prismatic); None: exact positions.
    torque_noise : float
        Standard deviation of the white torque noise as a share of the joint's effort limit (of the largest torque of
        the run where the robot has no limit).
    torque_noise_absolute : (n,) or None
        Standard deviation per joint in N m or N, instead of a share.
    jitter : float
        Standard deviation of the sampling instants in s.
    current : bool
        Record currents (torque / drive gain, [12.17]) instead of torques.
    """

    sampling_rate: float = 1000.0
    encoder_counts: int | None = 2**19
    torque_noise: float = 0.005
    torque_noise_absolute: tuple[float, ...] | None = None
    jitter: float = 0.0
    current: bool = False


def check_sensors(sensors: Sensors, robot: Robot) -> None:
    """Raise `DynidentError` for a value that no sensor has."""
    positive = {"sampling_rate": sensors.sampling_rate}
    if sensors.encoder_counts is not None:
        positive["encoder_counts"] = float(sensors.encoder_counts)
    for name, value in positive.items():
        if not (np.isfinite(value) and value > 0):
            raise DynidentError(f"{name} is {value}; expected more than 0", pointer=f"/noise/{name}", title=_TITLE)
    for name, value in {"torque_noise": sensors.torque_noise, "jitter": sensors.jitter}.items():
        if not (np.isfinite(value) and value >= 0):
            raise DynidentError(f"{name} is {value}; expected 0 or more", pointer=f"/noise/{name}", title=_TITLE)
    absolute = sensors.torque_noise_absolute
    if absolute is not None and (len(absolute) != robot.n or not all(np.isfinite(x) and x >= 0 for x in absolute)):
        raise DynidentError(
            f"torque_noise_absolute is {list(absolute)}; expected {robot.n} numbers, each 0 or more",
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


def quantised(sensors: Sensors, robot: Robot, q: FloatArray) -> FloatArray:
    """Positions (m, n) as the encoders count them."""
    if sensors.encoder_counts is None:
        return q
    turn = np.array([2 * np.pi if joint.kind == "revolute" else 1.0 for joint in robot.joints])
    step = turn / sensors.encoder_counts
    return np.rint(q / step) * step


def noise_deviation(sensors: Sensors, robot: Robot, tau: FloatArray) -> FloatArray:
    """Standard deviation (n,) of the torque noise, for a run with the torques tau (m, n)."""
    if sensors.torque_noise_absolute is not None:
        return np.array(sensors.torque_noise_absolute, dtype=np.float64)
    largest = np.abs(tau).max(axis=0)
    limits = [joint.limits.effort for joint in robot.joints]
    scale = np.array([peak if limit is None else limit for limit, peak in zip(limits, largest, strict=True)])
    return sensors.torque_noise * scale


def sampling_steps(sensors: Sensors, steps_per_sample: int, n_samples: int, rng: np.random.Generator) -> IndexArray:
    """Internal steps (n_samples,) at which samples are taken: every so many, shifted by the jitter, ascending."""
    regular: IndexArray = np.arange(n_samples, dtype=np.intp) * steps_per_sample
    if sensors.jitter == 0:
        return regular
    spread = sensors.jitter * sensors.sampling_rate * steps_per_sample
    largest = max(0, (steps_per_sample - 1) // 2)
    shift = np.clip(np.rint(rng.normal(0.0, spread, n_samples)), -largest, largest).astype(np.intp)
    shift[0] = 0
    shifted: IndexArray = np.minimum(regular + shift, regular[-1])
    return shifted
