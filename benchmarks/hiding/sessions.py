"""Sessions in which arms are recorded: when, how often, how fast; drawn to suit what is hidden in the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiding.case import Take

# s: a run that is the only one of its sitting, one of several, and the pause between these.
_ALONE, _OF_SEVERAL, _PAUSE = 24.0, 9.0, 3.0


@dataclass(frozen=True)
class _Sitting:
    """Runs of a session from a time of it on (s); `joined`: they go on in the file of the sitting before."""

    start: float
    held_out: bool = False
    joined: bool = False


def draw_session(names: Sequence[str], paces: Sequence[float], rng: np.random.Generator) -> tuple[Take, ...]:
    """The runs from which the effects with these names could be found; one at each pace in every sitting."""
    duration = _ALONE if len(paces) == 1 else _OF_SEVERAL
    return tuple(
        Take(
            sitting.start + k * (duration + _PAUSE),
            duration,
            sitting.held_out,
            joined=sitting.joined or k > 0,
            pace=pace,
            sitting=number,
        )
        for number, sitting in enumerate(_sittings(names, rng))
        for k, pace in enumerate(paces)
    )


def _sittings(names: Sequence[str], rng: np.random.Generator) -> tuple[_Sitting, ...]:
    if "temperature_friction" in names:
        return _Sitting(0.0), _Sitting(3600.0), _Sitting(1800.0, held_out=True)
    if "warm_up_friction" in names:
        starts = (0.0, 900.0, 2400.0, 6000.0)
        return (*(_Sitting(start) for start in starts), _Sitting(1500.0, held_out=True))
    if "payload" in names and rng.random() < 0.5:
        # Both in one file, told apart by its segment column.
        return _Sitting(0.0), _Sitting(60.0, joined=True), _Sitting(120.0, held_out=True)
    if rng.random() < 0.5:
        # Most people's files begin at t = 0.
        return _Sitting(0.0), _Sitting(0.0), _Sitting(0.0, held_out=True)
    return _Sitting(0.0), _Sitting(60.0), _Sitting(120.0, held_out=True)
