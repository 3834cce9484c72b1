"""How arms may be moved and recorded, and what is drawn of that for a case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from engine import Arm, Bandwidth, Instruments

from hiding.case import Firmness, Manner, MotionKind

T = TypeVar("T")

_COUNTS = (2**17, 2**18, 2**19)
# Hz.
_BANDWIDTHS: Mapping[Firmness, tuple[float, float]] = {"soft": (3.0, 7.0), "stiff": (12.0, 20.0)}
_SLOPES = (0.7, 1.3)
# Shares of full speed.
_MIDDLE, _SLOW = (0.4, 0.7), (0.15, 0.3)


@dataclass(frozen=True)
class Manners:
    """What a case may be drawn from.

    `rates` in Hz: the engine takes the nearest that its steps allow. `paces`: the speeds at which every sitting runs
    its motions, as shares of full speed; empty: full speed, a middle one and a slow one, drawn.
    """

    motions: tuple[MotionKind, ...] = ("fourier", "point-to-point")
    firmnesses: tuple[Firmness, ...] = ("soft", "stiff")
    rates: tuple[float, ...] = (1000.0, 500.0, 250.0, 125.0, 60.0)
    paces: tuple[float, ...] = ()


def draw_manner(manners: Manners, rng: np.random.Generator) -> Manner:
    """A motion and a controller. Every choice takes its chance, so that one does not change another."""
    motion, firmness = _one(manners.motions, rng), _one(manners.firmnesses, rng)
    low, high = np.log(_BANDWIDTHS[firmness])
    hertz = round(float(np.exp(low + (high - low) * rng.random())), 2)
    return Manner(motion, int(rng.integers(2**31)), Bandwidth(hertz), _one(_SLOPES, rng))


def draw_paces(manners: Manners, rng: np.random.Generator) -> tuple[float, ...]:
    """The speeds of a sitting's runs."""
    drawn = (1.0, round(float(rng.uniform(*_MIDDLE)), 2), round(float(rng.uniform(*_SLOW)), 2))
    return manners.paces or drawn


def draw_instruments(manners: Manners, rng: np.random.Generator) -> Instruments:
    """Encoders, torque sensors and a rate that the engine's steps allow."""
    counts, noise = _one(_COUNTS, rng), float(rng.uniform(0.004, 0.008))
    steps = Instruments(rate=_one(manners.rates, rng)).every(Arm.step)
    return Instruments(counts, noise, 1 / (steps * Arm.step))


def _one(items: Sequence[T], rng: np.random.Generator) -> T:
    return items[int(rng.random() * len(items))]
