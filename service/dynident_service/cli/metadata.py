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


def proposed(found: Inspection, rate: float | None = None) -> dict[str, object]:
    """The metadata that are proposed, with what is still to be answered."""
    assert found.proposal is not None
    return {
        "format": found.format,
        "columns": dict(found.proposal.columns),
        "units": dict(found.proposal.units),
        "windows": [],
        **({} if rate is None else {"rate": rate}),
        "effort_kind": found.proposal.effort_kind,
        "questions": [{"field": one.field, "detail": one.detail} for one in found.proposal.questions],
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
        if question.field in ("effort_kind", "units/tau") and any(_kind(one) == "current" for one in self.columns):
            # Currents, or registers, that drive gains make torques of: their size is looked at when they are read.
            return True
        if question.check:
            # What cannot be cured is refused when the file is read, with the same words.
            return self.cure or question.check in self.accept or (question.field in ("units/tau",) and bool(self.units))
        about, _, key = question.field.partition("/")
        if about == "effort_kind":
            # What is no measurement in any unit has other columns as an answer alone.
            given = (*self.columns, *self.units) if question.choices else tuple(self.columns)
            return any(_kind(one) in ("tau", "current") for one in given)
        told = {"columns": self.columns, "units": self.units}.get(about, {})
        return any(not key or _kind(one) == _kind(key) for one in told)


def _kind(key: str) -> str:
    """The kind of signal that a key is about: tau of tau2 and of tau_elbow."""
    return key.partition("_")[0].rstrip("0123456789")


def as_proposed(path: Path, found: Inspection, *, has_gains: bool, answers: Answers | None = None) -> RecordingMetadata:
    """The proposal as it is, beside which `answers` are given.

    Raises
    ------
    DynidentError
        Where there is a question that has not been answered: taken as proposed would be a guess.
    """
    assert found.proposal is not None
    given = answers or Answers()
    open_ones = [
        one
        for one in found.proposal.questions
        if not (has_gains and one.field == NEEDED_FOR_GAINS) and not given.answer(one)
    ]
    if open_ones:
        told = "".join(f"\n  {one.field}: {one.detail}" for one in open_ones)
        raise DynidentError(
            f"{path.name} cannot be taken as proposed; to be answered:{told}\nAnswer beside it by --columns, --units "
            "or --gravity, by --accept CHECK where the recording is right all the same, or by --cure. Or write the "
            f"proposal with `dynident inspect {path} --robot ROBOT --out {path.stem}.json`, answer there (and empty "
            "its questions), and give it as --metadata.",
            pointer=str(path),
            title="Open questions",
        )
    taken = found.proposal
    columns = dict(taken.columns)
    if any(_kind(one) == "current" for one in given.columns):
        columns = {ours: theirs for ours, theirs in columns.items() if _kind(ours) != "tau"}
    return RecordingMetadata(columns=columns, units=taken.units, effort_kind=taken.effort_kind)


def read_metadata(given: Sequence[str], names: Sequence[str]) -> dict[str, RecordingMetadata]:
    """Metadata by the name of the measurement: FILE for all of them, NAME=FILE for one.

    Raises
    ------
    DynidentError
        For a file that is none, or holds open questions.
    """
    found: dict[str, RecordingMetadata] = {}
    for text in given:
        name, sign, path = text.partition("=")
        if sign and name in names:
            found[name] = _read(Path(path))
        else:
            found |= dict.fromkeys(names, _read(Path(text)))
    return found


def _read(path: Path) -> RecordingMetadata:
    # Most commands are told everything by options, and need not wait for the contract.
    from pydantic import ValidationError

    from dynident_service.adapters.revisions import metadata_of
    from dynident_service.models.measurements import MeasurementMetadata

    document = document_of(path)
    known = [one.name for one in fields(RecordingMetadata) if one.name not in _ELSEWHERE]
    if not set(document) <= {*known, *_BESIDE}:
        allowed = ", ".join((*known, *_BESIDE))
        raise DynidentError(f"{path.name} is no metadata: give an object of {allowed}", pointer=str(path))
    questions: Any = document.get("questions") or ()
    asked = [one for one in questions if one.get("field") != NEEDED_FOR_GAINS]
    if asked:
        raise DynidentError(
            f"{path.name} holds an open question: {asked[0].get('detail', '')} Answer it and empty its questions.",
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
        told = {name: document[name] for name in known if document.get(name) is not None}
        return metadata_of(MeasurementMetadata.model_validate({"robot_id": "-", "name": "-", **told}))
    except ValidationError as error:
        first = error.errors()[0]
        place = "/".join(map(str, first["loc"]))
        raise DynidentError(f"{path.name}: {place}: {first['msg']}", pointer=str(path)) from error
