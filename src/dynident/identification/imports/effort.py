"""What kind of torque or current a column of effort holds: by its name, or by the data against the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.imports.fits import Fits
from dynident.identification.imports.proposal import EffortKind
from dynident.identification.mistakes.search import left_of
from dynident.robot import Robot

_LOST = 0.75
"""Share of the residual with gravity that the one without must stay below to call it compensated."""
_NOTHING = 0.9
"""Share left from which on the motion explains nothing of a torque."""


@dataclass(frozen=True)
class EffortGuess:
    """The kind, how sure (0 to 1), and why."""

    kind: EffortKind
    confidence: float
    reason: str


def classify_effort(fits: Fits, q: FloatArray, tau: FloatArray, signal: str | None, unit: str | None) -> EffortGuess:
    """Tell what torques (m, n) are, with positions (m, n) in rad or m; "unknown" where the data do not say."""
    motion = fits.motion(q, tau)
    if motion is None or not len(motion.q) or not np.isfinite(motion.tau).all():
        return _by_word(signal, unit, 0.6, "by its name; the sample is too short to be held against the robot")
    with_gravity = left_of(fits.robot, motion)
    if with_gravity > _NOTHING:
        return EffortGuess("external", 0.6, f"motion and gravity explain next to nothing of it ({with_gravity:.0%} left)")
    if _has_gravity(fits.robot):
        without = left_of(_floating(fits.robot), motion)
        if without < _LOST * with_gravity:
            reason = f"without gravity the robot's dynamics leave {without:.0%} of it, with gravity {with_gravity:.0%}"
            return EffortGuess("gravity_compensated", 0.9, reason)
    return _by_word(signal, unit, 0.9, "by its name; gravity and motion of the robot explain it")


def _by_word(signal: str | None, unit: str | None, confidence: float, reason: str) -> EffortGuess:
    if signal == "current" or unit in ("A", "mA"):
        return EffortGuess("motor_current", confidence, reason)
    if unit in ("permille", "percent"):
        return EffortGuess("motor_torque", confidence, reason)
    if signal == "tau" or unit in ("N m", "mN m", "kN m", "N cm", "N mm"):
        return EffortGuess("joint_torque", confidence, reason)
    return EffortGuess("unknown", 0.3, "neither name nor data tell torque from current")


def _has_gravity(robot: Robot) -> bool:
    return bool(np.linalg.norm(robot.gravity) > 1.0)


def _floating(robot: Robot) -> Robot:
    return replace(robot, gravity=np.zeros(3))
