"""A design as a ROS 2 message, trajectory_msgs/JointTrajectory, in the YAML that `ros2 topic pub` takes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from dynident.array_types import FloatArray

_NANOSECONDS = 1_000_000_000


def format_joint_trajectory(
    joint_names: Sequence[str], t: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> Iterator[str]:
    """Yield the lines of the message.

    The header's stamp is zero: the controller begins as soon as it has the message.

    Parameters
    ----------
    joint_names : sequence of str
        Names as the controller knows them.
    t : (m,)
        Times from the start, s.
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
    """
    yield "header:\n  stamp: {sec: 0, nanosec: 0}\n  frame_id: ''\n"
    yield f"joint_names: [{', '.join(json.dumps(name) for name in joint_names)}]\n"
    yield "points:\n"
    # Whole nanoseconds before seconds are split off: rounding the remainder alone could give a full second.
    stamps = np.rint((t - t[0]) * _NANOSECONDS).astype(np.int64)
    for stamp, position, velocity, acceleration in zip(stamps, q, dq, ddq, strict=True):
        seconds, rest = divmod(int(stamp), _NANOSECONDS)
        yield (
            f"- positions: {_format_list(position)}\n"
            f"  velocities: {_format_list(velocity)}\n"
            f"  accelerations: {_format_list(acceleration)}\n"
            f"  time_from_start: {{sec: {seconds}, nanosec: {rest}}}\n"
        )


def _format_list(values: Iterable[float]) -> str:
    # YAML takes 1e-05 for a word: a number with an exponent needs a decimal point.
    return "[" + ", ".join(_format_number(float(value)) for value in values) + "]"


def _format_number(value: float) -> str:
    text = f"{value:.12g}"
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text if any(mark in text for mark in ".e") else f"{text}.0"
