"""Whether a model is fit for a use: findings for and against it, combined into one statement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

UseName = Literal["simulation", "feed_forward", "collision_detection", "payload"]
USES: tuple[UseName, ...] = ("simulation", "feed_forward", "collision_detection", "payload")
State = Literal["yes", "limited", "no", "not_judged"]
MARKS: dict[State, str] = {"yes": "✓", "limited": "!", "no": "✕", "not_judged": "?"}
DIAGNOSE = "Find what is missing: dynident diagnose MODEL RUN."
GIVE_RECORDINGS = "Give the recordings that the model was tried on."
"""Next steps that several uses have."""
_GRAVEST_FIRST: tuple[State, ...] = ("no", "not_judged", "limited", "yes")


@dataclass(frozen=True)
class Use:
    """Whether a model is fit for a use, with the reason and one thing to do next.

    Parameters
    ----------
    use : str
        The use: "simulation", "feed_forward", "collision_detection" or "payload".
    state : str
        "yes", "limited" (fit within a limit that the reason says), "no" or "not_judged" (nothing was there to tell by).
    reason : str
        The reason in a sentence or two.
    next_step : str
        What to do next.
    """

    use: UseName
    state: State
    reason: str
    next_step: str

    @property
    def fit(self) -> bool:
        """Whether the model may be used so, if only within a limit."""
        return self.state in ("yes", "limited")

    @property
    def mark(self) -> str:
        """One character for the state."""
        return MARKS[self.state]

    @property
    def words(self) -> str:
        """Name of the use for people."""
        return self.use.replace("_", " ")


@dataclass(frozen=True)
class UseFinding:
    """Result of one test of a use.

    Parameters
    ----------
    state : str
        "yes", "limited", "no" or "not_judged".
    sentence : str
        The result in a whole sentence.
    next_step : str
        What to do about it where it is not good.
    """

    state: State
    sentence: str
    next_step: str = ""


def combine_findings(name: UseName, findings: Sequence[UseFinding], when_good: str) -> Use:
    """Combine all findings about a use into one statement: the gravest decide.

    Parameters
    ----------
    name : UseName
        The use.
    findings : sequence of UseFinding
        Results of its tests, in the order in which they are to be cured.
    when_good : str
        What to do next where nothing speaks against the use.

    Returns
    -------
    Use
        The gravest state, with the sentences of that state and the first next step among them.
    """
    # What was not judged is graver than a limit: it may hide a reason against the use.
    state = next(grade for grade in _GRAVEST_FIRST if any(finding.state == grade for finding in findings))
    # Where there is nothing to tell by, figures say nothing; a limit stands beside the figures that it limits.
    reported = (state, "yes") if state == "limited" else (state,)
    sentences = [finding.sentence for grade in reported for finding in findings if finding.state == grade]
    steps = [finding.next_step for finding in findings if finding.state == state and finding.next_step]
    return Use(name, state, " ".join(sentences), steps[0] if steps else when_good)
