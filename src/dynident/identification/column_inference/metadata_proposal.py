"""Types of a proposal: guesses with their certainty and reason, questions with their choices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.errors import Remedy
from dynident.recordings.recording_metadata import Check, EffortKind


@dataclass(frozen=True)
class Guess:
    """One guess about a file.

    Parameters
    ----------
    field : str
        Field of the metadata that it is about, such as "columns/q".
    value : str
        The proposed value.
    confidence : float
        From 0 to 1.
    reason : str
        The reason, as a clause.
    remedies : tuple of Remedy
        Those that the reason quotes.
    """

    field: str
    value: str
    confidence: float
    reason: str
    remedies: tuple[Remedy, ...] = ()


SURE = 0.8
"""Confidence below which a unit has to be confirmed."""


@dataclass(frozen=True)
class UnitGuess:
    """A guess of a unit.

    Parameters
    ----------
    unit : str
        The unit.
    confidence : float
        From 0 to 1; below `SURE` the unit has to be confirmed.
    reason : str
        The reason, as a clause.
    choices : tuple of str
        Units to choose from, if any.
    """

    unit: str
    confidence: float
    reason: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Question:
    """A question that has to be answered before the file can be used.

    Parameters
    ----------
    field : str
        Field of the metadata that it is about.
    detail : str
        The question.
    choices : tuple of str
        Answers that make sense; none where any may be right.
    check : str
        Name of the check that asks, if one does: to accept it is an answer, too.
    remedies : tuple of Remedy
        Those that the question quotes.
    is_curable : bool
        Whether the check proposes a correction of the file.
    """

    field: str
    detail: str
    choices: tuple[str, ...] = ()
    check: str = ""
    remedies: tuple[Remedy, ...] = ()
    is_curable: bool = False

    @classmethod
    def from_check(cls, field: str, check: Check) -> Question:
        """Ask about what a check has found, in its words."""
        is_curable = check.apply is not None
        return cls(field, check.detail, check=check.name, remedies=check.remedies, is_curable=is_curable)


@dataclass(frozen=True)
class Proposal:
    """Proposed metadata of a file.

    Parameters
    ----------
    columns : mapping of str to str
        Our names of columns to the file's, as `RecordingMetadata` takes them.
    units : mapping of str to str
        Units by kind of signal, or by column.
    effort_kind : str
        What the efforts are: torques of joints or motors, currents, commands, …
    guesses : tuple of Guess
        The guesses with their reasons.
    questions : tuple of Question
        Questions that are open.
    """

    columns: Mapping[str, str]
    units: Mapping[str, str]
    effort_kind: EffortKind
    guesses: tuple[Guess, ...]
    questions: tuple[Question, ...]

    @property
    def is_sure(self) -> bool:
        """Whether the proposal can be used as it is."""
        return not self.questions


def ask_to_lock(why: str, places: Mapping[str, float]) -> Question:
    """Ask to lock joints at their places (rad, m).

    Parameters
    ----------
    why : str
        What says that they do not move, as a clause.
    places : mapping of str to float
        By joint.
    """
    remedy = Remedy("locked_joints", places)
    return Question("robot", f"{why}: lock {'them' if len(places) > 1 else 'it'}, {remedy}.", remedies=(remedy,))
