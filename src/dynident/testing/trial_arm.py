"""A small arm with simulated recordings for conformance checks, and their error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dynident.recordings import FurtherColumns, Recording, recording_from_arrays
from dynident.robot import Robot, robot_from_urdf
from dynident.simulation import Reference, Sensors, SimulatedRecording, TrueEffect, VirtualRobot, Warming, add_warming


class ConformanceError(AssertionError):
    """Error: an effect or an estimator does not meet a requirement; the message tells which."""


def require(holds: object, message: str) -> None:
    """Raise `ConformanceError` with the message unless `holds` is true.

    Parameters
    ----------
    holds : object
        The requirement; true where it is met.
    message : str
        What is wrong, for the author of the effect or estimator.

    Raises
    ------
    ConformanceError
        Where the requirement is not met.
    """
    if not holds:
        raise ConformanceError(message)


_LINKS = (
    # axis, where the joint sits, mass, centre, moments of inertia
    ("0 0 1", "0 0 0.3", 6.0, "0.01 0.02 0.05", (0.05, 0.04, 0.03)),
    ("0 1 0", "0 0.1 0.1", 5.0, "0.2 0.03 0.02", (0.02, 0.12, 0.13)),
    ("0 1 0", "0.4 0 0.05", 3.0, "0.15 0.01 0.04", (0.01, 0.05, 0.06)),
)
_RATE = 250.0
_DURATION = 16.0
_LATER = 1500.0
"""Time in s from the start of one run to that of the next: effects that drift have changed by then."""


@cache
def build_trial_arm() -> Robot:
    """Return an arm of three revolute joints: one about the vertical, two that lift."""
    parts = ['<robot name="trial"><link name="base"/>']
    for k, (axis, place, mass, centre, moments) in enumerate(_LINKS):
        xx, yy, zz = moments
        parts.append(
            f'<link name="link{k + 1}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>'
            f'<joint name="joint{k + 1}" type="revolute"><parent link="{f"link{k}" if k else "base"}"/>'
            f'<child link="link{k + 1}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.5" upper="2.5" velocity="3" effort="{(60, 80, 40)[k]}"/></joint>'
        )
    return robot_from_urdf("trial", "".join(parts) + "</robot>")


def build_trial_motion(robot: Robot, seed: int) -> Reference:
    """Return a motion from rest to rest in a quarter of a minute, with all joints over much of their range.

    Parameters
    ----------
    robot : Robot
        The robot that moves.
    seed : int
        Seed of the random motion: the same one gives the same motion.

    Returns
    -------
    Reference
        Times, positions, velocities and accelerations.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(_DURATION * _RATE) + 1) / _RATE
    # Whole multiples of one base frequency: all joints are back at their start when the motion ends.
    rates = 2 * np.pi / _DURATION * np.array([1.0, 2.0, 3.0, 5.0, 8.0])[:, None]
    q, dq, ddq = (np.zeros((len(t), robot.n)) for _ in range(3))
    for j in range(robot.n):
        even, odd = rng.normal(size=(5, 1)) / rates, rng.normal(size=(5, 1)) / rates
        # The velocity at both ends is the sum of the sines' coefficients times their rates: the last one makes it zero.
        odd[-1] = -(odd[:-1] * rates[:-1]).sum() / rates[-1]
        x = (even * np.cos(rates * t) + odd * np.sin(rates * t)).sum(axis=0)
        dx = (rates * (odd * np.cos(rates * t) - even * np.sin(rates * t))).sum(axis=0)
        ddx = -(rates**2 * (even * np.cos(rates * t) + odd * np.sin(rates * t))).sum(axis=0)
        # As large as positions and velocities within the arm's limits allow.
        scale = min(1.5 / np.abs(x).max(), 2.2 / np.abs(dx).max())
        q[:, j], dq[:, j], ddq[:, j] = scale * x, scale * dx, scale * ddx
    return Reference(t, q, dq, ddq)


@dataclass(frozen=True, eq=False)
class TrialRecordings:
    """Recordings of the trial arm, and the true effects that it has.

    Parameters
    ----------
    robot : Robot
        The trial arm.
    recordings : tuple of Recording
        One a run.
    effects : tuple of TrueEffect
        Effects that the arm was simulated with, beside its links.
    """

    robot: Robot
    recordings: tuple[Recording, ...]
    effects: tuple[TrueEffect, ...]


def record_trial(effects: Sequence[TrueEffect], *, noise: float = 0.0, runs: int = 2) -> TrialRecordings:
    """Simulate the trial arm with some effects.

    Parameters
    ----------
    effects : sequence of TrueEffect
        Effects that the arm has.
    noise : float
        Standard deviation of the noise of the torque, in N m.
    runs : int
        Number of runs, which are named "run1", "run2" and so on.

    Returns
    -------
    TrialRecordings
        A recording of each run.
    """
    robot = build_trial_arm()
    virtual = VirtualRobot(robot, effects)
    sensors = Sensors(_RATE, None, torque_noise=0.0, torque_noise_absolute=(noise,) * robot.n)
    recordings = []
    for k in range(runs):
        reference = build_trial_motion(robot, k)
        # Each run begins much later than the one before, with joints that are warm by then.
        later = add_warming(replace(reference, t=reference.t + k * _LATER), Warming())
        name = f"run{k + 1}"
        recordings.append(_to_recording(virtual.measure(later, sensors, run=name, seed=k), name))
    return TrialRecordings(robot, tuple(recordings), tuple(effects))


def _to_recording(measured: SimulatedRecording, name: str) -> Recording:
    return recording_from_arrays(
        measured.t,
        measured.q,
        measured.tau,
        joint_names=measured.robot.joint_names,
        name=name,
        further=FurtherColumns(temperature=measured.temperature),
    )
