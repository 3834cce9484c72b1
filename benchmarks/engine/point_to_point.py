"""Motions from posture to posture with pauses between them: what most people record."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from dynident.robot import Robot
from engine.motions import FloatArray, Motion

_SHORTEST, _LONGEST = 0.6, 2.2
"""Longest time (s) that a joint may take for a move, drawn between these: slow moves are short ones."""

_RAMP = 0.35
"""Share of a cruising move in which it speeds up, and slows down."""

_Profile = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]


@dataclass(frozen=True)
class _Law:
    """From 0 to 1 in a unit of time: the path with its derivatives, the largest speed and acceleration."""

    profile: _Profile
    speed: float
    acceleration: float


@dataclass(frozen=True, eq=False)
class _Move:
    """Every joint goes by `way` (n,) from `origin` (n,) in its own `time` (n,), beginning at `start` (s)."""

    origin: FloatArray
    way: FloatArray
    start: float
    time: FloatArray


def point_to_point_motion(
    robot: Robot,
    duration: float,
    seed: int,
    step: float = 0.5e-3,
    pace: float = 1.0,
    dwells: tuple[float, float] = (0.1, 0.6),
    moving: float = 0.9,
) -> Motion:
    """Jerk-limited moves between random postures, with pauses of so many seconds (least, most) at each of them.

    In each move a joint takes part with the chance `moving`: some stay where they are.

    The seed draws as well how: by a polynomial of fifth degree or with a stretch of constant speed, and whether all
    joints arrive together or each as soon as it can. The recording may end within a move.
    """
    rng = np.random.default_rng(seed)
    t: FloatArray = np.arange(round(duration / step) + 1, dtype=np.float64) * step
    law = _LAWS[int(rng.integers(len(_LAWS)))]
    together = bool(rng.random() < 0.5)
    q, dq, ddq = (np.zeros((len(t), robot.n), dtype=np.float64) for _ in range(3))
    for number, move in enumerate(_moves(robot, law, duration, rng, pace, dwells, moving, together=together)):
        # The first posture is held from the beginning; every move ends in one that is held until the next.
        later = slice(int(np.searchsorted(t, move.start)) if number else 0, None)
        share = np.clip((t[later, None] - move.start) / move.time, 0.0, 1.0)
        path, speed, acceleration = law.profile(share)
        q[later] = move.origin + move.way * path
        dq[later] = move.way / move.time * speed
        ddq[later] = move.way / move.time**2 * acceleration
    return Motion(t, q, dq, ddq)


def _moves(
    robot: Robot,
    law: _Law,
    duration: float,
    rng: np.random.Generator,
    pace: float,
    dwells: tuple[float, float],
    moving: float,
    *,
    together: bool,
) -> Iterator[_Move]:
    low, high = np.array([joint.limits.position or (-np.pi, np.pi) for joint in robot.joints]).T
    middle, half = (low + high) / 2, np.minimum((high - low) / 2, np.pi)
    speed = 0.7 * pace * np.array([joint.limits.velocity or 2.0 for joint in robot.joints])
    strength = 0.6 * pace * np.array([joint.limits.acceleration or 8.0 for joint in robot.joints])
    here = middle + 0.5 * half * rng.uniform(-1, 1, robot.n)
    now = float(rng.uniform(*dwells))
    while now < duration:
        there = middle + 0.85 * half * rng.uniform(-1, 1, robot.n)
        longest = rng.uniform(_SHORTEST, _LONGEST)
        reach = np.minimum(longest * speed / law.speed, longest**2 * strength / law.acceleration)
        way = np.where(rng.random(robot.n) < moving, np.clip(there - here, -reach, reach), 0.0)
        time = np.maximum(law.speed * np.abs(way) / speed, np.sqrt(law.acceleration * np.abs(way) / strength))
        # Nothing is that quick; and a joint that stays needs some time for its way of nothing.
        time = np.maximum(np.max(time) if together else time, 0.05)
        yield _Move(here, way, now, time)
        here = here + way
        now += float(time.max()) + float(rng.uniform(*dwells))


def _polynomial(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of fifth degree: at rest, without acceleration, at both ends."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _cruise(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Speeds up smoothly, goes on at one speed, slows down as it sped up."""
    fastest = 1 / (1 - _RAMP)
    passed = np.minimum(x, 1 - x)
    ramp = np.minimum(passed / _RAMP, 1.0)
    way = fastest * (_RAMP * (ramp**3 - ramp**4 / 2) + np.maximum(passed - _RAMP, 0.0))
    speed = fastest * ramp**2 * (3 - 2 * ramp)
    acceleration = np.sign(0.5 - x) * fastest / _RAMP * 6 * ramp * (1 - ramp)
    return np.where(x <= 0.5, way, 1 - way), speed, acceleration


_LAWS = (
    _Law(_polynomial, 1.875, 10 / np.sqrt(3)),
    _Law(_cruise, 1 / (1 - _RAMP), 1.5 / _RAMP / (1 - _RAMP)),
)
