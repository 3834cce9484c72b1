"""One case: an arm, what is hidden in it, and the session in which it is recorded."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Literal

from engine import Bandwidth, Hidden, Instruments

Size = Literal["full", "quarter"]
MotionKind = Literal["fourier", "point-to-point"]
Firmness = Literal["soft", "stiff"]

# Hz: between the bandwidths of controllers that are called soft and stiff.
_STIFF = 9.0


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

    `joined`: it shares its file with the run before, as another segment of it. `pace`: how fast the motion is run, as a
    share of full speed. `sitting`: runs of one sitting are recorded without a change to the arm between them.
    """

    start: float
    duration: float
    held_out: bool = False
    joined: bool = False
    pace: float = 1.0
    sitting: int = 0


@dataclass(frozen=True)
class Manner:
    """How an arm is moved: kind of motion, seed of it, the controller.

    `slope`: the larger, the wider a Fourier motion and the less quick.
    """

    motion: MotionKind
    seed: int
    servo: Bandwidth
    slope: float = 1.0

    @property
    def firmness(self) -> Firmness:
        """What the controller would be called."""
        return "stiff" if self.servo.hertz > _STIFF else "soft"


@dataclass(frozen=True)
class Case:
    """`hidden` empty: a clean arm. `noise` is a seed."""

    name: str
    arm: str
    hidden: tuple[Placed, ...]
    size: Size
    instruments: Instruments
    manner: Manner
    noise: int
    session: tuple[Take, ...]

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
        text = repr((self.arm, physics, seen, self.manner, self.session))
        return hashlib.sha256(text.encode()).hexdigest()[:20]
