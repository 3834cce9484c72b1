"""How a validation ends, and what it holds a torque error against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["pass", "fail", "not_evaluated"]

LARGEST_ERROR = 0.15
"""Relative torque error up to which a model passes where the user states no other: real arms reach 4 to 15 %."""


@dataclass(frozen=True)
class Judged:
    """The end of a validation: pass, fail or not evaluated, and why, in a sentence."""

    verdict: Verdict
    reason: str
