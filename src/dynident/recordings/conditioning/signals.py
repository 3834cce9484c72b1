"""The signals that the steps of conditioning look at: limits, units, and which column belongs to which."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.recordings.columns import Layout
from dynident.recordings.timebase import TimeBase
from dynident.recordings.types import JointLimits

FASTEST = 25.0
"""rad/s or m/s: no joint of an arm is faster (240 rpm), where its limit is not known."""

TIMES_LIMIT = 3.0
"""Times a joint's velocity limit that is impossible."""


@dataclass(frozen=True, eq=False)
class Signals:
    """The columns of values (m, c) that are read.

    `sources` are the user's names. `needed` (c,): those that have to hold numbers; `smooth` (c,): positions; `turning`
    (c,): angles; `fastest` (c,): speed in rad/s or m/s that is impossible, inf of what is no position; `limits`:
    position limits by column. `velocity`: the column of an angle's logged velocity.
    `position`: that of the position of a torque's joint. `factors`, `offsets` (c,): what made SI units of the file's
    numbers; `registers`: columns, by kind of signal, that may be registers.
    """

    sources: tuple[str, ...]
    needed: BoolArray
    smooth: BoolArray
    turning: BoolArray
    fastest: FloatArray
    limits: dict[int, tuple[float, float]]
    velocity: dict[int, int]
    position: dict[int, int]
    step: float
    factors: FloatArray
    offsets: FloatArray
    registers: dict[str, tuple[int, ...]]

    @classmethod
    def from_layout(cls, layout: Layout, limits: tuple[JointLimits, ...], base: TimeBase) -> Signals:
        """Describe the columns of a layout."""
        kinds = [(kind, joint) for kind in layout.kinds for joint in range(len(getattr(layout, kind)))]
        positions = [kind in ("q", "q_command") for kind, _ in kinds]
        rates = layout.columns_of_kind("dq").start if layout.dq else None
        fastest = np.full(len(kinds), np.inf)
        ranges, velocity = {}, {}
        for column, (kind, joint) in enumerate(kinds):
            if not positions[column]:
                continue
            limit = limits[joint]
            fastest[column] = FASTEST if limit.velocity is None else max(TIMES_LIMIT * limit.velocity, 1.0)
            if limit.position is not None:
                ranges[column] = limit.position
            if rates is not None and kind == "q":
                velocity[column] = rates + joint
        return cls(
            sources=tuple(column.source for column in layout.columns),
            needed=np.array([kind in ("q", "tau", "wrench") for kind, _ in kinds]),
            smooth=np.array(positions),
            turning=np.array(
                [
                    is_position and limits[joint].kind == "revolute"
                    for is_position, (_, joint) in zip(positions, kinds, strict=True)
                ]
            ),
            fastest=fastest,
            limits=ranges,
            velocity=velocity,
            position={layout.columns_of_kind("tau").start + joint: joint for joint in range(len(layout.tau))},
            step=base.typical,
            factors=np.array([column.factor for column in layout.columns]),
            offsets=np.array([column.offset for column in layout.columns]),
            registers={kind: _find_register_columns(kind, layout) for kind in ("q", "tau")},
        )


def _find_register_columns(kind: str, layout: Layout) -> tuple[int, ...]:
    """Return the columns of a kind of signal that are the file's own numbers, but for their unit."""
    # Torques of coupled motors are sums of several columns: no bits are left in them.
    if kind == "tau" and layout.mixing is not None:
        return ()
    silent = layout.without_torque if kind == "tau" else ()
    return tuple(layout.columns_of_kind(kind).start + j for j in range(len(layout.q)) if j not in silent)
