"""States whose torque a model shall predict, and the moments of their rows, which weigh the parameters' covariance.

Holds how many states stand for a region, and the smallest torque that errors are relative to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.criteria.criterion_choice import REGION_SPEED
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.motion.limits.bounds import build_bounds
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.low_pass_decimation import filter_in_parallel
from dynident.recordings.recording import SampleBlock
from dynident.robot.limits_and_drives import Limits
from dynident.robot.robot_model import Robot

N_STATES = 400
"""States that stand for a region; the mean of rows over twice as many differs by a few per cent."""
_SMALLEST_SQUARE = 1e-6
# Each harmonic is two unknowns a joint in the search for a motion.
_MOST_HARMONICS = 20


@dataclass(frozen=True, eq=False)
class Region:
    """States in which the torque shall be predicted.

    Parameters
    ----------
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    def __repr__(self) -> str:
        return f"Region({len(self.q)} states)"


def draw_region(robot: Robot, limits: Mapping[str, Limits], speed: float = REGION_SPEED, seed: int = 0) -> Region:
    """Draw states within the limits of a robot, evenly.

    Parameters
    ----------
    robot : Robot
        The robot, whose limits of position, velocity and acceleration bound the states.
    limits : mapping of str to Limits
        Tighter limits of the experiment by joint name.
    speed : float
        Share of the limits of velocity and acceleration that the states reach.
    seed : int
        Seed of the draw.

    Returns
    -------
    Region
        The states.
    """
    bounds = build_bounds(robot, limits)
    rng = np.random.default_rng(seed)
    size = (N_STATES, robot.n)
    return Region(
        rng.uniform(bounds.position_low, bounds.position_high, size),
        speed * bounds.velocity * rng.uniform(-1.0, 1.0, size),
        speed * bounds.acceleration * rng.uniform(-1.0, 1.0, size),
    )


def count_harmonics(region: Region, robot: Robot, limits: Mapping[str, Limits], period: float) -> int:
    """Return how many harmonics a motion needs so that every joint can reach the speeds of a region.

    The highest harmonic over the whole stroke of a joint has to be as fast as the fastest state of the region. With
    fewer, a joint of short stroke (a quill, a gripper) moves slowly, and its friction at the speeds of the region is
    extrapolated.

    Parameters
    ----------
    region : Region
        The states.
    robot : Robot
        The robot.
    limits : mapping of str to Limits
        Tighter limits of the experiment by joint name.
    period : float
        Period of the motion, s.

    Returns
    -------
    int
        Number of harmonics, at most 20.
    """
    bounds = build_bounds(robot, limits)
    amplitudes = (bounds.position_high - bounds.position_low) / 2
    # Over a short stroke a sine reaches the limit of the acceleration before that speed.
    speeds = np.minimum(np.abs(region.dq).max(axis=0), np.sqrt(bounds.acceleration * amplitudes))
    frequencies = np.divide(speeds, amplitudes, out=np.zeros(robot.n), where=amplitudes > 0)
    return min(math.ceil(float(frequencies.max(initial=0.0)) * period / (2 * math.pi)), _MOST_HARMONICS)


def collect_region(recordings: Sequence[Recording]) -> Region:
    """Return states of recorded motions, evenly over their time, filtered as for an identification.

    Parameters
    ----------
    recordings : sequence of Recording
        Motions in which the torque shall be predicted: those of the application.

    Returns
    -------
    Region
        The states.
    """
    preprocessing = choose_preprocessing(recordings)
    parts = [
        states
        for recording in recordings
        for _, _, states in filter_in_parallel(recording, preprocessing, _stack_motion)
    ]
    states = np.concatenate(parts)
    chosen = states[np.linspace(0, len(states) - 1, min(N_STATES, len(states))).astype(int)]
    q, dq, ddq = np.split(chosen, 3, axis=1)
    return Region(q, dq, ddq)


def _stack_motion(block: SampleBlock) -> FloatArray:
    return np.concatenate([block.q, block.dq, block.ddq], axis=1)


def compute_moments(model: DesignModel, region: Region) -> FloatArray:
    """Return for each joint the mean of wᵀw over the region's rows w, over the mean square of its torque.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    region : Region
        The states.

    Returns
    -------
    (n, b, b)
        With the covariance C of the parameters, the trace of C times a joint's moments is the square of the relative
        standard deviation of its predicted torque.
    """
    rows = model.observe(region.q, region.dq, region.ddq).reshape(len(region.q), model.robot.n, -1)
    moments: FloatArray = np.einsum("mja,mjb->jab", rows, rows) / len(region.q)
    if model.expected is None and model.robot.inertias is None:
        return moments
    torque = model.torque(region.q, region.dq, region.ddq)
    squares = (torque**2).mean(axis=0)
    # A joint that needs hardly any torque, such as a massless flange, must not rule over all others.
    squares = np.maximum(squares, max(_SMALLEST_SQUARE * float(squares.max()), np.finfo(float).tiny))
    relative: FloatArray = moments / squares[:, None, None]
    return relative
