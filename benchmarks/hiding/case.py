"""One case: an arm, what is hidden in it, and the session in which it is recorded."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Literal

from engine import Hidden, Instruments

Size = Literal["full", "quarter"]


@dataclass(frozen=True)
class Truth:
    """A parameter of an effect as it is in the arm: the norm of the parameters `names` of the catalogue's effect.

    One parameter counts with its sign where it is `signed`: some have theirs by convention.
    """

    names: tuple[str, ...]
    value: float
    signed: bool = True


@dataclass(frozen=True)
class Placed:
    """An effect in an arm. `effect` is its id in the catalogue, or a name of its own where no catalogue has it.

    `joints` are counted from 0; empty: the whole robot. `shape` are shape constants of the catalogue's form of it.
    `equals` are other ids that are as right; `variable` is what an unknown effect has to be said to depend on.
    """

    effect: str
    joints: tuple[int, ...]
    physics: Hidden
    truths: tuple[Truth, ...] = ()
    shape: tuple[tuple[str, float], ...] = ()
    equals: tuple[str, ...] = ()
    variables: tuple[str, ...] = ()

    @property
    def in_catalogue(self) -> bool:
        """Whether it is one of the catalogue's families."""
        return not self.variables

    @property
    def names(self) -> tuple[str, ...]:
        """Ids that name it rightly."""
        return (self.effect, *self.equals)


@dataclass(frozen=True)
class Take:
    """One run of a session: when it starts (s of the session), how long it is, and whether it is held out.

    `joined`: it shares its file with the run before, as another segment of it.
    """

    start: float
    duration: float
    held_out: bool = False
    joined: bool = False


USUAL_SESSION = (Take(0.0, 24.0), Take(60.0, 24.0), Take(120.0, 24.0, held_out=True))


@dataclass(frozen=True)
class Case:
    """`hidden` empty: a clean arm. `motion` and `noise` are seeds, `slope` is the motion's, `lag` the controller's."""

    name: str
    arm: str
    hidden: tuple[Placed, ...]
    size: Size
    instruments: Instruments
    motion: int
    noise: int
    slope: float = 1.0
    lag: float = 1.0e-3
    session: tuple[Take, ...] = USUAL_SESSION

    @property
    def kind(self) -> str:
        """What the case tests: clean, single, double or outside."""
        if not self.hidden:
            return "clean"
        if not all(placed.in_catalogue for placed in self.hidden):
            return "outside"
        return "single" if len(self.hidden) == 1 else "double"

    @property
    def clean(self) -> Case:
        """The same arm, motions and instruments with nothing hidden."""
        return replace(self, name="clean", hidden=(), size="full")

    @property
    def key(self) -> str:
        """Tells the simulated runs of cases apart."""
        physics = tuple(placed.physics for placed in self.hidden)
        seen = (self.instruments.counts, self.instruments.rate)
        text = repr((self.arm, physics, seen, self.motion, self.slope, self.lag, self.session))
        return hashlib.sha256(text.encode()).hexdigest()[:20]
