"""The proposal of a file's metadata, which the user has to confirm: guesses and questions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.recordings.metadata import EffortKind


@dataclass(frozen=True)
class Guess:
    """One guess: the field of the metadata, its value, the confidence (0 to 1), and the reason."""

    field: str
    value: str
    confidence: float
    reason: str


@dataclass(frozen=True)
class Question:
    """A question that has to be answered before the file can be used; `choices` are the answers that make sense.

    `check` is the name of the check that asks, if one does: to accept it is an answer, too.
    """

    field: str
    detail: str
    choices: tuple[str, ...] = ()
    check: str = ""


@dataclass(frozen=True)
class Proposal:
    """Proposed metadata of a file.

    `columns` are ours to the file's, `units` by kind of signal, as `RecordingMetadata` takes them.
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
