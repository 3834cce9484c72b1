"""Which rows of a run say something of friction: where a joint moves, told from the positions alone."""

from __future__ import annotations

import numpy as np
from engine import FloatArray, Run
from engine.drives import speed_limits
from numpy.typing import NDArray
from scipy import ndimage, signal

from dynident.robot import Robot

BoolArray = NDArray[np.bool_]

_RESOLVED = 0.005
"""Share of a joint's speed limit below which it may as well stand: some 0.01 rad/s."""


def moving(run: Run, robot: Robot, cutoff: float) -> BoolArray:
    """(m, n): samples of a joint that are clear of any moment in which it hardly moves, by the filter's width.

    At a joint that sticks the torque is anything up to its static friction, and a filter of so many Hz smears that.
    """
    rate = rate_of(run)
    q = signal.filtfilt(*signal.butter(4, cutoff / (rate / 2)), run.q, axis=0)
    hardly = np.abs(np.gradient(q, 1 / rate, axis=0)) < _RESOLVED * speed_limits(robot)
    reach = 2 * round(rate / cutoff) + 1
    return ~ndimage.binary_dilation(hardly, np.ones((reach, 1)))


def moving_at(t: FloatArray, run: Run, robot: Robot, cutoff: float) -> BoolArray:
    """(m, n): the same at some times (m,) of the run."""
    rows = np.round((t - run.t[0]) * rate_of(run)).astype(np.intp)
    return moving(run, robot, cutoff)[np.clip(rows, 0, len(run.t) - 1)]


def rate_of(run: Run) -> float:
    """Samples a second."""
    return (len(run.t) - 1) / float(run.t[-1] - run.t[0])
