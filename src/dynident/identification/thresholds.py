"""All thresholds by which a model is called good or bad: errors, condition numbers, determined parameters.

Also the outcome of a validation (pass, fail, not evaluated; with reason), and how several are combined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

ParameterJudgement = Literal["determined", "uncertain", "zero_in_interval", "held"]


def judge_parameter(value: float, deviation: float, half_width: float, owed: bool) -> ParameterJudgement:
    """Judge an estimate by its standard deviation and its 95 % interval.

    Parameters
    ----------
    value, deviation, half_width : float
        Estimate, standard deviation, and half of the interval's width, in one unit.
    owed : bool
        Whether prior knowledge rather than the data determines it.

    Returns
    -------
    str
        "determined", "uncertain" or "zero_in_interval".
    """
    # Zero in the interval comes first: such a parameter is small, which is no fault of the motion.
    if abs(value) <= half_width:
        return "zero_in_interval"
    return "determined" if deviation <= DETERMINED * abs(value) and not owed else "uncertain"


USUAL = (0.05, 0.10)
"""Relative held-out error of arms with Coulomb and viscous friction alone."""

USUAL_IN_FULL = (0.02, 0.07)
"""The same once the missing effects are in."""

LARGEST_ERROR = 0.15
"""Held-out error up to which a model is fit for feed-forward or simulation: real arms reach 4 to 15 %."""

LARGEST_TO_WEIGH = 0.10
"""The same to weigh a payload, where what the model leaves is taken for something else."""

LARGEST_OF_JOINT = 0.3
"""Of one joint, where it moves, reverses or starts: above it a controller has a third of the torque to find by itself,
and feed forward, simulation or a threshold on the residual are worth little there. Of nine real machines the worst
joints of sound models are at 5 to 25 %, those of poor motions and wrong structures at 31 % and more."""

NOTABLE_OF_JOINT = 0.15
"""The same from which on it is said: it is the limit of all joints together."""

NOTABLE_DRIFT, LARGEST_DRIFT = 0.25, 0.5
"""Distance of a simulation without a controller from the recorded motion within half a second, over the way that the
joint makes: above half, staying where one is would be about as good. First models of a UR10e are at 0.18, of a dVRK and
a Gen3 at 0.15; a TX40 with a coupled wrist at 0.43, and what is not positive definite diverges."""

LOAD_AND_GAINS = (
    "A gain that is 5 % off makes the load 5 % wrong, which no standard deviation shows: weigh a known load first."
)
"""What makes the identified mass of a load wrong while its fit is good: torque and load scale together."""

STOP = 0.5
"""Held-out error above which something else is wrong than a missing effect: the model is not to be used."""

OVERFIT = 1.5
"""Times the error of the fit from which on a held-out error says that the motion was too poor."""

FIRST_CONDITION_NUMBER = 100.0
"""Of W with the parameters as they are, below which a first model is good; a larger one is no harm by itself."""

LARGEST_CONDITION_NUMBER = 200.0
"""Of W with columns of the same size. Real arms on exciting motions: 12 to 24; where the motion was too poor: above
1,000."""

EQUATIONS_PER_PARAMETER = 500.0
"""As §12.7 asks for."""

DETERMINED = 0.1
"""Relative standard deviation of a determined parameter, at most: its first digit is sure, its 95 % interval within
about a fifth of the value."""


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
