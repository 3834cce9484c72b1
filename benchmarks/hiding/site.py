"""An arm in which something is to be hidden, and the chance that draws where and how large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from engine.closed_loop import typical_torque
from engine.drives import Drives, effort_limits, speed_limits, usual_drives
from engine.scene import FloatArray

from dynident.robot import Robot
from hiding.case import Placed, Take


@dataclass(frozen=True, eq=False)
class Site:
    """An arm in which something is to be hidden, the session it is for, and the chance by which it is drawn."""

    robot: Robot
    rng: np.random.Generator
    scale: float
    session: tuple[Take, ...]

    @property
    def drives(self) -> Drives:
        return usual_drives(self.robot)

    @property
    def effort(self) -> FloatArray:
        return effort_limits(self.robot)

    @property
    def speed(self) -> FloatArray:
        return speed_limits(self.robot)

    @property
    def load(self) -> FloatArray:
        """(n,): what the links ask of each joint."""
        return _load(self.robot)

    @property
    def length(self) -> float:
        """Duration of the session's shortest run in s."""
        return min(take.duration for take in self.session)

    def runs_of(self, sitting: int) -> tuple[int, ...]:
        """Numbers of the runs of a sitting."""
        return tuple(k for k, take in enumerate(self.session) if take.sitting == sitting)

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def sized(self, low: float, high: float) -> float:
        """A size from the range, at the case's scale."""
        return self.scale * self.between(low, high)

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def joint(self, *, turning: bool = False) -> int:
        """Any joint, or any that turns."""
        return int(self.rng.choice([j for j in range(self.robot.n) if not turning or self.turns(j)]))

    def loaded(self, *, before_last: int = 0) -> int:
        """One of the two turning joints that carry the most of what they are built for."""
        joints = [j for j in range(self.robot.n - before_last) if self.turns(j)]
        return int(self.rng.choice(sorted(joints, key=lambda j: -self.load[j] / self.effort[j])[:2]))

    def turns(self, j: int) -> bool:
        """Whether a joint is revolute."""
        return self.robot.joints[j].kind == "revolute"


@cache
def _load(robot: Robot) -> FloatArray:
    return typical_torque(robot, seed=5)


def as_float(value: float | np.floating) -> float:
    """A plain number: what it is printed as tells cases apart."""
    return float(value)


def as_vector(values: FloatArray) -> tuple[float, float, float]:
    """Three plain numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z


Family = Callable[[Site], Placed]
"""Draws the place and the size of one kind of effect."""
