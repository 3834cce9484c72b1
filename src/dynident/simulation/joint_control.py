"""Joint controller of a virtual robot: feed-forward torque, and gains that follow from the inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.simulation.dynamics import Dynamics
from dynident.simulation.reference_motion import ReferencePath
from dynident.simulation.virtual_robot_request import FeedForward

# States of the trajectory that the gains are derived from.
_STATES = 200
# A joint is never controlled faster than this, rad/s, whatever its friction: internal steps must resolve the control.
_FASTEST = 400.0
# Samples a second of the feed-forward torque, as a robot's own controller has them.
FEED_FORWARD_RATE = 1000.0


@dataclass(frozen=True)
class Controller:
    """Independent joint control with feed-forward.

    The controller knows the links but neither the friction nor any other effect, hence a realistic tracking error.

    Parameters
    ----------
    feed_forward : {"computed_torque", "gravity", "none"}
        What the controller knows of the torque: all that the links need, what holds them against gravity, or nothing.
    bandwidth : float
        Natural frequency of a joint's error, Hz.
    damping_ratio : float
        Damping ratio of a joint's error; 1 is critical damping.
    largest_lag : float
        A joint whose friction would hold it back by more than this (rad or m) is controlled more stiffly.
    """

    feed_forward: FeedForward = "computed_torque"
    bandwidth: float = 15.0
    damping_ratio: float = 1.0
    largest_lag: float = 1.5e-3


@dataclass(frozen=True, eq=False)
class Gains:
    """Stiffness and damping (n,) of the joint controller: N m/rad and N m s/rad, or N/m and N s/m."""

    stiffness: FloatArray
    damping: FloatArray


def compute_joint_gains(controller: Controller, dynamics: Dynamics, path: ReferencePath, times: FloatArray) -> Gains:
    """Return the gains for the mean inertia of each joint along the motion, sampled at times (k,) within it.

    Parameters
    ----------
    controller : Controller
        The joint controller.
    dynamics : Dynamics
        Equation of motion of the robot.
    path : ReferencePath
        The reference at any time.
    times : (k,)
        Times within the motion, s.
    """
    # The gains need a mean over the motion, not every sample: some 200 states are enough.
    sampled_times = times[:: max(1, len(times) // _STATES)]
    q, dq, _ = path.evaluate(sampled_times)
    states = len(sampled_times)
    # Each joint is controlled by itself, so the diagonal of the mass matrix stands for the inertia that it moves.
    inertia = dynamics.mass_diagonal(q).mean(axis=0)
    load = dynamics.rigid(q, np.zeros_like(q), np.zeros_like(q))
    heat = path.evaluate_temperature(sampled_times)
    # Hysteresis fully tensioned and every effect present: the largest resistance that the controller may meet.
    memory = np.ones((states, len(dynamics.signals.memory_signals)))
    still = np.zeros_like(q)
    runs = np.ones((states, len(dynamics.runs)))
    resistance = np.abs(dynamics.rest(q, dq, still, load, memory, sampled_times[:, None], heat, runs)).max(axis=0)
    least_frequency = 2 * np.pi * controller.bandwidth
    # The static error is resistance / stiffness, and stiffness = inertia * frequency².
    frequency = np.clip(
        np.sqrt(resistance / controller.largest_lag / inertia), least_frequency, max(least_frequency, _FASTEST)
    )
    # Stiffness m w² and damping 2 d m w: the gains of a second-order system of inertia m, frequency w and damping ratio
    # d.
    return Gains(inertia * frequency**2, 2 * controller.damping_ratio * inertia * frequency)


def compute_feed_forward_torque(
    controller: Controller, dynamics: Dynamics, path: ReferencePath, t: FloatArray
) -> FloatArray:
    """Return the feed-forward torque (k, n) at times t (k,).

    Parameters
    ----------
    controller : Controller
        The joint controller.
    dynamics : Dynamics
        Equation of motion of the robot.
    path : ReferencePath
        The reference at any time.
    t : (k,)
        Times, s.
    """
    q, dq, ddq = path.evaluate(t)
    if controller.feed_forward == "none":
        return np.zeros_like(q)
    if controller.feed_forward == "gravity":
        return dynamics.rigid(q, np.zeros_like(q), np.zeros_like(q))
    return dynamics.rigid(q, dq, ddq)
