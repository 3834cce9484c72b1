"""How a validation ends, and what it holds a torque error against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["pass", "fail", "not_evaluated"]


@dataclass(frozen=True)
class Judged:
    """The end of a validation: pass, fail or not evaluated, and why, in a sentence."""

    verdict: Verdict
    reason: str


def together(parts: Sequence[tuple[str, Judged]]) -> Judged:
    """One verdict of several tries, each with its name: one that fails makes all fail, one that passes is needed."""
    words = [judged.verdict for _, judged in parts]
    verdict: Verdict = "fail" if "fail" in words else "pass" if "pass" in words else "not_evaluated"
    if not parts:
        return Judged(verdict, "Nothing was tried.")
    if len(parts) == 1:
        return parts[0][1]
    return Judged(verdict, " ".join(f"{name}: {judged.reason}" for name, judged in parts if judged.verdict == verdict))
