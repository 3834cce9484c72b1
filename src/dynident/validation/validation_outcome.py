"""The outcome of a validation (pass, fail, not evaluated; with reason), and how several are combined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

Verdict = Literal["pass", "fail", "not_evaluated"]


@dataclass(frozen=True)
class ValidationOutcome:
    """Verdict of a validation, and the reason.

    Parameters
    ----------
    verdict : "pass", "fail" or "not_evaluated"
        The verdict.
    reason : str
        The reason in a sentence, with the figures that it rests on.
    """

    verdict: Verdict
    reason: str

    def prepend_reason(self, sentence: str) -> ValidationOutcome:
        """Return the same verdict with a sentence before its reason; nothing changes for an empty one."""
        return replace(self, reason=f"{sentence} {self.reason}") if sentence else self


def combine_verdicts(parts: Sequence[tuple[str, ValidationOutcome]]) -> ValidationOutcome:
    """Combine the verdicts of several validations into one.

    One that fails makes all fail, and at least one has to pass.

    Parameters
    ----------
    parts : sequence of (name, ValidationOutcome)
        The validations, each with the name that its reason is given under.

    Returns
    -------
    ValidationOutcome
        The reasons are those of the validations with the common verdict, each with its name.
    """
    words = [judged.verdict for _, judged in parts]
    verdict: Verdict = "fail" if "fail" in words else "pass" if "pass" in words else "not_evaluated"
    if not parts:
        return ValidationOutcome(verdict, "No test ran.")
    # A single reason needs no name in front of it.
    if len(parts) == 1:
        return parts[0][1]
    return ValidationOutcome(
        verdict, " ".join(f"{name}: {judged.reason}" for name, judged in parts if judged.verdict == verdict)
    )
