"""What came out of one case, in plain values that a table and a file can hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Naming = Literal["right", "equivalent", "wrong", "none"]


@dataclass(frozen=True)
class Hint:
    """A candidate of the diagnosis as it was reported."""

    effect: str
    joints: tuple[str, ...]
    significant: bool
    equivalent: tuple[str, ...]
    evidence: str


@dataclass(frozen=True)
class HowRecorded:
    """How a case was recorded: kind of motion, controller, samples a second, speeds as shares of full speed."""

    motion: str
    controller: str
    rate: float
    paces: tuple[float, ...]


@dataclass(frozen=True)
class Outcome:
    """One case judged.

    `excess` is what the effect adds to the plain model's residual over the clean arm's, on the joint where it adds
    most; of two effects, the smaller one's. `shows`: that is above the noise. `known`: the product has the effect.

    `naming`: what stands first among the findings, or that there is none. `in_three`: the name is among the first
    three candidates. `joint`: the first finding is on the right joint (None where nothing is found or the effect has
    no joint). `complete`: every hidden effect is among the recommended, on its joint. `beside`: recommended names
    that are not hidden, and joints where one is not; an equivalent of what is hidden is let pass. `extra`: every
    recommended name that is not there, equivalents too. `unknown_right`: the joint and the variable of what has no
    name.

    `oracle_gain`: share by which the true structure lowers the held-out error. `plain`, `after`, `oracle`: held-out
    errors over the sensor's noise in the band, where joints move; `oracle` None where the product lacks the effect.
    `parameter_errors`: relative errors of the main parameters.
    """

    case: str
    kind: str
    size: str
    recorded: HowRecorded
    effects: tuple[str, ...]
    arm: str
    joints: tuple[str, ...]
    excess: float
    shows: bool
    known: bool
    verdict: str
    naming: Naming
    in_three: bool
    joint: bool | None
    complete: bool
    beside: tuple[str, ...]
    extra: tuple[str, ...]
    unknown_right: bool
    recommended: tuple[str, ...]
    unknown: tuple[str, ...]
    hints: tuple[Hint, ...]
    plain: float
    after: float
    oracle: float | None
    oracle_gain: float | None
    parameter_errors: tuple[tuple[str, float], ...]
    seconds: float
    simulating: float
    failure: str = ""

    @property
    def over_oracle(self) -> float | None:
        """Held-out error after adding what is recommended, over that of the true structure."""
        return None if self.oracle is None else self.after / self.oracle
