"""A guessed unit, and what motions of robots have in common that units are told by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_MOTION = np.deg2rad(3.5)
"""rad: whoever records a robot moves one joint at least so far."""

MOST_MOTION = 4.0 * np.pi * 1.05
"""rad: two turns, and a little."""

CLEARLY = 1.25
"""Times what another unit has to leave of the torque to be ruled out."""


@dataclass(frozen=True)
class UnitGuess:
    """A unit, how sure it is (0 to 1), and why; below `SURE` it has to be confirmed, as one of `choices`, if any."""

    unit: str
    confidence: float
    reason: str
    choices: tuple[str, ...] = ()


SURE = 0.8
