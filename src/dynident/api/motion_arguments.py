"""Read states (q, dq, ddq), motions, times and confidence levels that are given as arguments.

Holds the checks of shapes and of degrees instead of radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dynident.api.argument_checks import require
from dynident.array_types import FloatArray
from dynident.errors import DynidentError, describe_value
from dynident.identification.robot_recording_import import build_recorded_joints
from dynident.recordings.position_checks import has_other_unit
from dynident.robot import Robot

if TYPE_CHECKING:
    from dynident.excitation import Design
    from dynident.simulation import Simulated, SimulationRequest


_TITLE = "Unusable motion"
_DEGREE = pi / 180.0
_LEAST_LEVEL = 0.5


@dataclass(frozen=True, eq=False)
class Motion:
    """Samples of a motion as (m, n) arrays, and the shape in which results are returned.

    Parameters
    ----------
    arrays : tuple of (m, n) arrays
        Positions, and where they were given velocities and accelerations.
    shape : tuple of int
        Shape of what was given: (n,) for one state, (m, n) for several.
    """

    arrays: tuple[FloatArray, ...]
    shape: tuple[int, ...]

    @property
    def is_single(self) -> bool:
        """Whether one state was given."""
        return len(self.shape) < 2


def read_motion(robot: Robot, **signals: ArrayLike) -> Motion:
    """Return positions and derivatives as arrays of the same shape, in the order in which they are given.

    Parameters
    ----------
    robot : Robot
        The robot whose joints they belong to.
    **signals : (n,) or (m, n)
        By name: q, dq, ddq.

    Returns
    -------
    Motion
        Arrays (m, n) of float.

    Raises
    ------
    DynidentError
        For arrays of other shapes, values that are no numbers, and positions that look like degrees.
    """
    joints = f"{robot.n} joint{'s' if robot.n > 1 else ''} ({', '.join(robot.joint_names)})"
    arrays: list[FloatArray] = []
    shape: tuple[int, ...] = ()
    for name, values in signals.items():
        array = read_numbers(values, name)
        if array.ndim not in (1, 2) or array.shape[-1] != robot.n:
            raise DynidentError(
                f"{name} has the shape {array.shape}, but the robot has {joints}: give ({robot.n},) for one state or "
                f"(m, {robot.n}) for m samples",
                pointer=name,
                title=_TITLE,
            )
        if not array.size:
            raise DynidentError(f"{name} is empty; give one state or more", pointer=name, title=_TITLE)
        shape = shape or array.shape
        if array.shape != shape:
            first = next(iter(signals))
            raise DynidentError(
                f"{name} has the shape {array.shape} and {first} the shape {shape}: give arrays of the same shape",
                pointer=name,
                title=_TITLE,
            )
        arrays.append(np.atleast_2d(array))
    _check_angles(robot, arrays[0])
    return Motion(tuple(arrays), shape)


def read_numbers(values: ArrayLike, name: str) -> FloatArray:
    """Return an argument as an array of finite numbers.

    Parameters
    ----------
    values : array_like
        What was given.
    name : str
        Name of the argument, for the message.

    Returns
    -------
    array
        Of any shape.

    Raises
    ------
    DynidentError
        For what is no array of numbers, or holds a value that is not finite.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise DynidentError(
            f"{name} is {describe_value(values)}, which is no array of numbers", pointer=name, title=_TITLE
        ) from None
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        place = ", ".join(map(str, bad[0]))
        raise DynidentError(
            f"{name} contains {array[tuple(bad[0])]}{f' at [{place}]' if place else ''}; give finite numbers",
            pointer=name,
            title=_TITLE,
        )
    return array


def read_times(motion: Motion, t: ArrayLike | None, dt: float | None) -> FloatArray | None:
    """Return the times of a motion's samples from `t` or `dt`; None where neither is given.

    Parameters
    ----------
    motion : Motion
        The samples.
    t : (m,), optional
        Times in s, increasing.
    dt : float, optional
        Sampling period in s; the first sample is then at 0.

    Returns
    -------
    array (m,) or None
        Times in s.

    Raises
    ------
    DynidentError
        For both, for times that do not increase or do not fit, and for a single state.
    """
    if t is None and dt is None:
        return None
    m = len(motion.arrays[0])
    if t is not None and dt is not None:
        raise DynidentError("both t and dt are given; leave one of them out", pointer="dt", title=_TITLE)
    if motion.is_single:
        raise DynidentError(
            "t and dt belong to a motion of several samples, (m, n); a single state has no time",
            pointer="t" if dt is None else "dt",
            title=_TITLE,
        )
    if dt is not None:
        period = read_numbers(dt, "dt")
        if period.ndim or period <= 0:
            raise DynidentError(
                f"dt is {dt!r}; give the sampling period in s, a number above 0", pointer="dt", title=_TITLE
            )
        return np.asarray(np.arange(m) * float(period))
    assert t is not None
    times = read_numbers(t, "t")
    if times.shape != (m,):
        raise DynidentError(
            f"t has the shape {times.shape}; {m} samples have times of the shape ({m},)", pointer="t", title=_TITLE
        )
    backwards = np.flatnonzero(np.diff(times) <= 0)
    if len(backwards):
        k = int(backwards[0])
        raise DynidentError(
            f"t does not increase: t[{k + 1}] = {times[k + 1]:g} s comes after t[{k}] = {times[k]:g} s; give the "
            "samples in the order of time",
            pointer="t",
            title=_TITLE,
        )
    return times


def check_level(level: float, name: str) -> float:
    """Return the probability of an interval.

    Parameters
    ----------
    level : float
        What was given.
    name : str
        Name of the argument, for the message.

    Returns
    -------
    float
        The same number.

    Raises
    ------
    DynidentError
        For what is no probability of at least one half.
    """
    is_number = isinstance(level, (int, float, np.number)) and not isinstance(level, bool)
    # Nobody asks for an interval that is more often wrong than right: such a number is 1 - level, or a percentage.
    if not is_number or not _LEAST_LEVEL <= level < 1:
        raise DynidentError(
            f"{name} is {level!r}; give the probability that the interval holds, from {_LEAST_LEVEL:g} to below 1: "
            "0.95 for 95 %, where other packages take alpha = 0.05",
            pointer=name,
            title="No probability",
        )
    return float(level)


def _check_angles(robot: Robot, q: FloatArray) -> None:
    """Refuse positions that fit the joints' limits in degrees and not in radians, as recordings are checked."""
    for joint, limit in enumerate(build_recorded_joints(robot).known_limits):
        low, high = float(q[:, joint].min()), float(q[:, joint].max())
        # Without limits any angle may be meant: only a range that is moved through tells, of which there is no rate.
        if limit.kind == "revolute" and limit.position and has_other_unit(limit, low, high, 0.0, _DEGREE):
            lower, upper = limit.position
            raise DynidentError(
                f"q of {robot.joint_names[joint]} reaches {high if high > -low else low:.4g}, far beyond its limits "
                f"({lower:.4g} to {upper:.4g} rad): it looks like degrees; give radians, numpy.deg2rad(q)",
                pointer="q",
                title=_TITLE,
            )


def resolve_simulation(
    robot: Robot, parameters: Mapping[str, float] | None, request: Simulated | None, design: Design | None
) -> SimulationRequest:
    """Return the simulation of a virtual robot with some true parameters.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    parameters : mapping of str to float, optional
        Standard parameters by name; they take precedence over those of the request.
    request : Simulated, optional
        Effects, noise and more; the usual ones where left out.
    design : Design, optional
        The motion; None where only the parameters are wanted.

    Returns
    -------
    SimulationRequest
        The simulation.

    Raises
    ------
    DynidentError
        For what is no mapping, or a parameter that the robot does not have.
    """
    from dynident.simulation import Reference, Simulated, build_simulation_request

    require(
        parameters is None or isinstance(parameters, Mapping),
        parameters,
        "parameters",
        'give true values by name: {"Fc1": 3.0}',
    )
    requested = request or Simulated()
    requested = replace(requested, parameters={**requested.parameters, **(parameters or {})})
    at_rest = np.zeros((2, robot.n))
    motion = (np.arange(2.0), at_rest, at_rest, at_rest, 1.0)
    if design is not None:
        motion = (design.t, design.q, design.dq, design.ddq, design.sampling_rate)
    return build_simulation_request(requested, robot, Reference(*motion[:4]), motion[4])
