"""What is said of a file in a file of its own, as `dynident inspect --out` writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_args

from dynident.errors import DynidentError
from dynident.identification.imports import EffortKind, Inspection, Question
from dynident.recordings import RecordingMetadata
from dynident_service.cli.files import document_of

NEEDED_FOR_GAINS = "drives"
_BESIDE = ("questions", "name", "format")
"""What stands in such a file and is no part of what is said."""
_ELSEWHERE = ("name", "format", "role", "accept")
"""What is told by the file itself, or has options and commands of its own."""


def proposed(inspection: Inspection, rate: float | None = None) -> dict[str, object]:
    """The metadata that are proposed, with what is still to be answered."""
    assert inspection.proposal is not None
    return {
        "format": inspection.format,
        "columns": dict(inspection.proposal.columns),
        "units": dict(inspection.proposal.units),
        "windows": [],
        **({} if rate is None else {"rate": rate}),
        "effort_kind": inspection.proposal.effort_kind,
        "questions": [
            {"field": question.field, "detail": question.detail} for question in inspection.proposal.questions
        ],
    }


@dataclass(frozen=True)
class Answers:
    """What options say beside a proposal: columns and units, checks to accept, and whether cures are wanted."""

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    accept: Sequence[str] = ()
    cure: bool = False

    def answer(self, question: Question) -> bool:
        """Whether a question is answered by them."""
        if question.field in ("effort_kind", "units/tau") and any(
            _kind(signal) == "current" for signal in self.columns
        ):
            # Currents, or registers, that drive gains make torques of: their size is looked at when they are read.
            return True
        if question.check:
            # What cannot be cured is refused when the file is read, with the same words.
            return self.cure or question.check in self.accept or (question.field in ("units/tau",) and bool(self.units))
        about, _, key = question.field.partition("/")
        if about == "effort_kind":
            # What is no measurement in any unit has other columns as an answer alone.
            answered_signals = (*self.columns, *self.units) if question.choices else tuple(self.columns)
            return any(_kind(signal) in ("tau", "current") for signal in answered_signals)
        answered = {"columns": self.columns, "units": self.units}.get(about, {})
        return any(not key or _kind(signal) == _kind(key) for signal in answered)


def _kind(key: str) -> str:
    """The kind of signal that a key is about: tau of tau2 and of tau_elbow."""
    return key.partition("_")[0].rstrip("0123456789")


def as_proposed(
    path: Path, inspection: Inspection, *, has_gains: bool, answers: Answers | None = None
) -> RecordingMetadata:
    """The proposal as it is, beside which `answers` are given.

    Raises
    ------
    DynidentError
        Where there is a question that has not been answered: taken as proposed would be a guess.
    """
    assert inspection.proposal is not None
    stated_answers = answers or Answers()
    open_questions = [
        question
        for question in inspection.proposal.questions
        if not (has_gains and question.field == NEEDED_FOR_GAINS) and not stated_answers.answer(question)
    ]
    if open_questions:
        question_list = "".join(f"\n  {question.field}: {question.detail}" for question in open_questions)
        raise DynidentError(
            f"{path.name} cannot be taken as proposed; to be answered:{question_list}\n"
            "Answer beside it by --columns, --units or --gravity, by --accept CHECK where the recording is right all "
            "the same, or by --cure. Or write the proposal with "
            f"`dynident inspect {path} --robot ROBOT --out {path.stem}.json`, answer there (and empty "
            "its questions), and give it as --metadata.",
            pointer=str(path),
            title="Open questions",
        )
    proposal = inspection.proposal
    columns = dict(proposal.columns)
    if any(_kind(signal) == "current" for signal in stated_answers.columns):
        columns = {ours: theirs for ours, theirs in columns.items() if _kind(ours) != "tau"}
    return RecordingMetadata(columns=columns, units=proposal.units, effort_kind=proposal.effort_kind)


def read_metadata(texts: Sequence[str], names: Sequence[str]) -> dict[str, RecordingMetadata]:
    """Metadata by the name of the measurement: FILE for all of them, NAME=FILE for one.

    Raises
    ------
    DynidentError
        For a file that is none, or holds open questions.
    """
    metadata_by_name: dict[str, RecordingMetadata] = {}
    for text in texts:
        name, sign, path = text.partition("=")
        if sign and name in names:
            metadata_by_name[name] = _read(Path(path))
        else:
            metadata_by_name |= dict.fromkeys(names, _read(Path(text)))
    return metadata_by_name


def _read(path: Path) -> RecordingMetadata:
    # Most commands are told everything by options, and need not wait for the contract.
    from pydantic import ValidationError

    from dynident_service.adapters.revisions import metadata_of
    from dynident_service.models.measurements import MeasurementMetadata

    document = document_of(path)
    field_names = [
        metadata_field.name for metadata_field in fields(RecordingMetadata) if metadata_field.name not in _ELSEWHERE
    ]
    if not set(document) <= {*field_names, *_BESIDE}:
        allowed = ", ".join((*field_names, *_BESIDE))
        raise DynidentError(f"{path.name} is no metadata: give an object of {allowed}", pointer=str(path))
    questions: Any = document.get("questions") or ()
    open_questions = [question for question in questions if question.get("field") != NEEDED_FOR_GAINS]
    if open_questions:
        raise DynidentError(
            f"{path.name} holds an open question: {open_questions[0].get('detail', '')} "
            "Answer it and empty its questions.",
            pointer=str(path),
            title="Open questions",
        )
    effort_kind = document.get("effort_kind")
    if effort_kind is not None and effort_kind not in get_args(EffortKind):
        raise DynidentError(
            f"{path.name}: effort_kind is {effort_kind!r}; there are {', '.join(get_args(EffortKind))}",
            pointer=str(path),
        )
    try:
        # Null says as much as nothing.
        values = {name: document[name] for name in field_names if document.get(name) is not None}
        return metadata_of(MeasurementMetadata.model_validate({"robot_id": "-", "name": "-", **values}))
    except ValidationError as error:
        first = error.errors()[0]
        place = "/".join(map(str, first["loc"]))
        raise DynidentError(f"{path.name}: {place}: {first['msg']}", pointer=str(path)) from error
