"""A guessed unit, and what all motions of robots have in common, by which units are guessed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_MOTION = np.deg2rad(3.5)
"""rad: in every recording at least one joint moves that far."""

MOST_MOTION = 4.0 * np.pi * 1.05
"""rad: no joint moves further; two turns, and a little."""

CLEARLY = 1.25
"""Ratio of the unexplained shares above which another unit is ruled out."""


@dataclass(frozen=True)
class UnitGuess:
    """A unit, the confidence (0 to 1), and the reason.

    Below `SURE` it has to be confirmed, as one of `choices`, if any.
    """

    unit: str
    confidence: float
    reason: str
    choices: tuple[str, ...] = ()


SURE = 0.8
