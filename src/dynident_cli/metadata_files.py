"""Read `--metadata` files, and write what `dynident inspect --out` proposes, with answers to its questions.

Holds which questions `--cure` leaves open: gravity and joint zeros.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

from dynident.errors import DynidentError, word_remedies
from dynident.identification.column_inference import EffortKind, Inspection, Proposal, Question
from dynident.recordings import RecordingMetadata
from dynident.recordings.units import JOINT_KINDS
from dynident_cli.contract_documents import parse_metadata
from dynident_cli.option_parsers import read_json_object
from dynident_cli.request_options import write_option

OPEN_QUESTIONS = "Open questions"
"""Title of the error of a file that cannot be used as proposed."""
NEEDED_FOR_GAINS = "drives"
"""The question that asks for drive gains, which belong to the robot and not to the file."""
_IGNORED_KEYS = ("questions", "name", "format")
"""Keys of such a file that are no metadata."""
_CORRECTIONS = ("permutation", "signs", "scale", "zeros", "torque_delay")
"""Metadata by which a file states what a check of the dynamics proposes."""
_NOT_CURED = ("gravity", "zeros")
"""Questions about the robot as much as about the file: `--cure` leaves them open."""
_ABOUT_EFFORT = ("effort_kind", "units/tau")
"""What questions about the kind and the unit of efforts begin with; a single joint's has its number behind it."""
_OTHER_SOURCES = ("name", "format", "role", "accept")
"""Metadata that the file itself tells, or that have options or commands of their own."""


def proposal_document(inspection: Inspection, rate: float | None = None) -> dict[str, object]:
    """Return the proposed metadata as a JSON object, with the open questions."""
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
class StatedAnswers:
    """Answers to questions of a proposal: columns, units, checks to accept, whether to cure, and a metadata file."""

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    accept: Sequence[str] = ()
    cure: bool = False
    metadata: RecordingMetadata = field(default_factory=RecordingMetadata)

    @property
    def are_currents(self) -> bool:
        """Whether a metadata file says that the efforts are currents, and no option names their columns or unit.

        Drive gains alone do not say so: the proposal has currents where the gains make the torque of the description
        of them, and without masses nothing shows that.
        """
        is_named = any(_signal_kind(signal) in ("tau", "current") for signal in (*self.columns, *self.units))
        return self.metadata.effort_kind == "motor_current" and not is_named

    def is_answered(self, question: Question) -> bool:
        """Tell whether these options answer a question."""
        if question.field in ("effort_kind", "units/tau") and any(
            _signal_kind(signal) == "current" for signal in self.columns
        ):
            # Drive gains turn currents into torques; whether their size is plausible is checked when they are read.
            return True
        if question.check:
            is_corrected = any(getattr(self.metadata, name) for name in _CORRECTIONS)
            return (
                (self.cure and question.is_curable and question.field not in _NOT_CURED)
                or is_corrected
                or question.check in self.accept
                or (question.field in ("units/tau",) and bool(self.units))
            )
        about, _, key = question.field.partition("/")
        if about == "effort_kind" and self.metadata.effort_kind is not None:
            return True
        if about == "effort_kind":
            # Without choices no unit makes the columns a torque, so only other columns are an answer.
            answered_signals = (*self.columns, *self.units) if question.choices else tuple(self.columns)
            return any(_signal_kind(signal) in ("tau", "current") for signal in answered_signals)
        answered = {"columns": self.columns, "units": self.units}.get(about, {})
        if question.field == "columns/tau" and any(_signal_kind(signal) == "current" for signal in answered):
            return True
        return any(not key or _signal_kind(signal) == _signal_kind(key) for signal in answered)


_ANSWERS = {
    ("drives", False): "--drive-gains G1,G2,…",
    ("columns/t", True): "--columns t=COLUMN, or --rate HZ",
    ("columns/base_qx", True): "--columns base_qx=COLUMN,base_qy=COLUMN,…",
    ("effort_kind", False): (
        '--columns tau1=COLUMN,…, or --metadata FILE with {"effort_kind": "joint_torque"} if they were measured all '
        "the same, as where a maker calls the torque of the drives a reference"
    ),
}
"""Options that answer questions, by field and whether the question has choices."""


def describe_answer(question: Question) -> str:
    """Return the options that answer a question, as they are typed; "" where no option does."""
    about, _, key = question.field.partition("/")
    if question.check:
        mends = [write_option(remedy) for remedy in question.remedies]
        if question.field == "units/tau":
            mends += [
                "--units tau=UNIT",
                "--drive-gains G1,… in N m per unit of these numbers (of motors' torques: the gear ratios)",
            ]
        # What mends it comes first: to accept it is right only where nothing is wrong.
        return ", or ".join([*mends, f"--accept {question.check} if the recording is right as it is"])
    if about == "units" and key and question.choices:
        options = [f"--units {key}={choice!r}" if " " in choice else f"--units {key}={choice}"
                   for choice in question.choices[:3]]  # fmt: skip
        others = {"t": "--rate HZ", "tau": "--drive-gains G1,…"}
        return " or ".join([*options, others[key]] if key in others else options)
    if (question.field, bool(question.choices)) in _ANSWERS:
        return _ANSWERS[question.field, bool(question.choices)]
    if about == "effort_kind" and question.choices:
        return f"--metadata FILE with effort_kind: {' or '.join(question.choices)}"
    if about == "columns" and key and question.choices:
        if " … " in question.choices[0]:
            # The choices are whole sets of columns, from the first joint's to the last one's.
            return f"--columns {key}1={question.choices[0].partition(' … ')[0]},{key}2=…"
        return f"--columns {key}1=COLUMN,{key}2=COLUMN,…"
    return ""


def _signal_kind(key: str) -> str:
    """Return the kind of signal that a key names: "tau" for tau2 and for tau_elbow, "q_command" for q_command_elbow."""
    kinds = (kind for kind in JOINT_KINDS if key.startswith(f"{kind}_") or key.rstrip("0123456789") == kind)
    return max(kinds, key=len, default=key)


def _name_current(tau: str) -> str:
    return f"current{tau.removeprefix('tau')}"


def _list_kinds(question: Question) -> set[str]:
    """Return the kinds of signals that a question is about; efforts are torques or currents, which is one question."""
    kind = _signal_kind(question.field.partition("/")[2])
    return {"tau", "current"} if kind in ("", "tau", "current") else {kind}


def _take_over_answers(proposal: Proposal, known: RecordingMetadata) -> Proposal | None:
    """Return the proposal with the answers that the metadata of another file give to its questions.

    None where it asks for none, where they have none, and where what the file itself shows contradicts them.
    """
    open_questions = [question for question in proposal.questions if question.is_about_meaning]
    open_kinds = set[str]().union(*map(_list_kinds, open_questions))
    without_columns = set[str]().union(
        *(_list_kinds(each) for each in open_questions if each.field.startswith("columns"))
    )
    own_kinds, known_kinds = {*map(_signal_kind, proposal.columns)}, {*map(_signal_kind, known.columns)}
    # Numbered columns of a file without names may be anything in another one.
    is_named = not any(column.removeprefix("column").isdigit() for column in known.columns.values())
    if (
        not open_questions
        or not is_named
        or not all(_list_kinds(question) & known_kinds for question in open_questions)
    ):
        return None
    known_columns = {_name_effort(ours): column for ours, column in known.columns.items()}
    own_columns = _select_kinds(proposal.columns, own_kinds - without_columns)
    if any(known_columns.get(_name_effort(ours), column) != column for ours, column in own_columns.items()):
        return None
    # A unit that is not stated is that of SI.
    shared = (own_kinds & known_kinds) - open_kinds
    if _select_kinds(proposal.units, shared) != _select_kinds(known.units, shared):
        return None
    return replace(
        proposal,
        columns=_select_kinds(proposal.columns, own_kinds - open_kinds) | _select_kinds(known.columns, open_kinds),
        units=_select_kinds(proposal.units, own_kinds - open_kinds) | _select_kinds(known.units, open_kinds),
        effort_kind=(known.effort_kind if "tau" in open_kinds else None) or proposal.effort_kind,
        questions=tuple(question for question in proposal.questions if question not in open_questions),
    )


def _select_kinds(values: Mapping[str, str], kinds: set[str]) -> dict[str, str]:
    return {ours: value for ours, value in values.items() if _signal_kind(ours) in kinds}


def _name_effort(ours: str) -> str:
    return _name_current(ours) if _signal_kind(ours) == "tau" else ours


def accept_proposal(
    path: Path,
    inspection: Inspection,
    *,
    has_gains: bool,
    answers: StatedAnswers | None = None,
    accepted: Sequence[RecordingMetadata] = (),
) -> RecordingMetadata:
    """Accept proposed metadata as they are; an error where a question is open, as to accept would be a guess.

    `has_gains` says whether the robot states drive gains, or none are needed here; `answers` are options that answer
    questions. What the content of a file leaves open is read as in one of the `accepted` with the same columns.
    """
    assert inspection.proposal is not None
    proposal = inspection.proposal
    stated_answers = answers or StatedAnswers()
    same = [known for known in accepted if {*known.columns.values()} <= {*inspection.columns}]
    proposal = next(filter(None, (_take_over_answers(proposal, known) for known in same)), proposal)
    are_currents = stated_answers.are_currents
    open_questions = [
        question
        for question in proposal.questions
        if not (has_gains and question.field == NEEDED_FOR_GAINS)
        and not (are_currents and question.field.startswith(_ABOUT_EFFORT))
        and not stated_answers.is_answered(question)
    ]
    # To go on would be a guess, of which the user would not learn.
    if open_questions:
        question_list = "".join(
            f"\n  {question.field}: {word_remedies(question.detail, question.remedies, write_option)}"
            + (f" → {answer}" if (answer := describe_answer(question)) else "")
            for question in open_questions
        )
        # Only what a check proposes is corrected unasked, and of the file alone.
        can_cure = any(question.is_curable and question.field not in _NOT_CURED for question in open_questions)
        raise DynidentError(
            f"{path.name} cannot be used as proposed; these questions are open:{question_list}\nAnswer them with "
            "--columns, --units or --gravity, with --accept CHECK if the recording is right as it is, "
            f"{'with --cure, ' if can_cure else ''}or with --metadata FILE, a JSON object of effort_kind, signs, "
            "scale, zeros, permutation or torque_delay. "
            f"Or write the proposal with `dynident inspect {path} --robot ROBOT --out {path.stem}.json`, "
            "answer there (and empty its questions), and give it as --metadata.",
            pointer=str(path),
            title=OPEN_QUESTIONS,
        )
    columns, units = dict(proposal.columns), dict(proposal.units)
    if are_currents:
        # A gain is per unit of the numbers as they are, and what a unit of torque makes of them would be another size.
        columns = {_name_current(ours) if ours.startswith("tau") else ours: column for ours, column in columns.items()}
        units = {ours: unit for ours, unit in units.items() if _signal_kind(ours) != "tau"}
    # The user says that the effort columns are currents: the proposed torque columns would contradict that.
    if any(_signal_kind(signal) == "current" for signal in stated_answers.columns):
        columns = {ours: theirs for ours, theirs in columns.items() if _signal_kind(ours) != "tau"}
    # What the metadata file says goes before what is proposed.
    return replace(
        stated_answers.metadata,
        columns={**columns, **stated_answers.metadata.columns},
        units={**units, **stated_answers.metadata.units},
        effort_kind=stated_answers.metadata.effort_kind or ("motor_current" if are_currents else proposal.effort_kind),
    )


def describe_columns(metadata: RecordingMetadata) -> str:
    """Return which columns are taken as what: "t: Time (ms); q: A1.pos … A7.pos (deg)"."""
    columns_by_kind: dict[str, list[str]] = {}
    for signal, column in metadata.columns.items():
        columns_by_kind.setdefault(_signal_kind(signal), []).append(column)
    parts = []
    for kind, columns in columns_by_kind.items():
        unit = metadata.units.get(kind)
        span = columns[0] if len(set(columns)) == 1 else f"{columns[0]} … {columns[-1]}"
        parts.append(f"{kind}: {span}{f' ({unit})' if unit else ''}")
    return "; ".join(parts)


def read_metadata(texts: Sequence[str], names: Sequence[str]) -> dict[str, RecordingMetadata]:
    """Read metadata files, each FILE for all recordings or NAME=FILE for one, by the names of the recordings."""
    metadata_by_name: dict[str, RecordingMetadata] = {}
    for text in texts:
        name, sign, path = text.partition("=")
        # A path may hold "=" itself: only the name of a recording before it makes it NAME=FILE.
        if sign and name in names:
            metadata_by_name[name] = _read_metadata_file(Path(path))
        else:
            metadata_by_name |= dict.fromkeys(names, _read_metadata_file(Path(text)))
    return metadata_by_name


def _read_metadata_file(path: Path) -> RecordingMetadata:
    document = read_json_object(path)
    field_names = [
        metadata_field.name for metadata_field in fields(RecordingMetadata) if metadata_field.name not in _OTHER_SOURCES
    ]
    if not set(document) <= {*field_names, *_IGNORED_KEYS}:
        allowed = ", ".join((*field_names, *_IGNORED_KEYS))
        raise DynidentError(
            f"{path.name} does not contain metadata; it needs an object of {allowed}", pointer=str(path)
        )
    questions: Any = document.get("questions") or ()
    # Drive gains belong to the robot: whether they are missing is found when the currents are read.
    open_questions = [question for question in questions if question.get("field") != NEEDED_FOR_GAINS]
    if open_questions:
        raise DynidentError(
            f"{path.name} has an open question: {open_questions[0].get('detail', '')} Answer it and empty its "
            "questions.",
            pointer=str(path),
            title=OPEN_QUESTIONS,
        )
    effort_kind = document.get("effort_kind")
    if effort_kind is not None and effort_kind not in get_args(EffortKind):
        raise DynidentError(
            f"{path.name}: effort_kind is {effort_kind!r}; allowed are {', '.join(get_args(EffortKind))}",
            pointer=str(path),
        )
    # Null means that the field is not stated.
    return parse_metadata(path, {name: document[name] for name in field_names if document.get(name) is not None})
