"""Read files of other loggers with the columns that are proposed for them, where no question is open.

Holds which questions a cure leaves open: gravity and joint zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from dynident.api.recording_collection import Recordings
from dynident.api.recordings_in_memory import SourceFile
from dynident.errors import Remedy, word_remedies, write_argument
from dynident.identification.column_inference import Inspection, Proposal, Question, inspect_file
from dynident.recordings import Check, RecordingError, RecordingMetadata
from dynident.recordings.file_names_and_digests import check_readable_path
from dynident.recordings.units import JOINT_KINDS
from dynident.robot import Robot

OPEN_QUESTIONS = "Open questions"
"""Title of the error of a file that cannot be used as proposed."""
COLUMNS = "columns"
"""Name of the finding that says which columns were taken as what."""
NEEDED_FOR_GAINS = "drives"
"""The question that asks for drive gains, which belong to the robot and not to the file."""
_CORRECTIONS = ("permutation", "signs", "scale", "zeros", "torque_delay")
"""Metadata by which a file states what a check of the dynamics proposes."""
_NOT_CURED = ("gravity", "zeros")
"""Questions about the robot as much as about the file: a cure leaves them open."""
_ABOUT_EFFORT = ("effort_kind", "units/tau")
"""What questions about the kind and the unit of efforts begin with; a single joint's has its number behind it."""

Writer = Callable[[Remedy], str]
"""Writes a remedy in the syntax of a front end: as an argument, as an option."""


@dataclass(frozen=True)
class StatedAnswers:
    """Answers to questions of a proposal: columns, units, checks to accept, whether to cure, and other metadata."""

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    accept: Sequence[str] = ()
    cure: bool = False
    metadata: RecordingMetadata = field(default_factory=RecordingMetadata)

    @property
    def are_currents(self) -> bool:
        """Whether the metadata say that the efforts are currents, and no answer names their columns or unit.

        Drive gains alone do not say so: the proposal has currents where the gains make the torque of the description
        of them, and without masses nothing shows that.
        """
        is_named = any(_signal_kind(signal) in ("tau", "current") for signal in (*self.columns, *self.units))
        return self.metadata.effort_kind == "motor_current" and not is_named

    def is_answered(self, question: Question) -> bool:
        """Tell whether these answers have one to a question."""
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


def describe_answer(question: Question, write: Writer = write_argument) -> str:
    """Return what answers a question, as it is written in a front end; "" where nothing that can be written does."""
    about, _, key = question.field.partition("/")
    gains = f"{write(Remedy('drives'))} (one a joint, in N m or N per unit of these numbers)"
    if question.check:
        mends = [write(remedy) for remedy in question.remedies]
        if question.field == "units/tau":
            mends += [write(Remedy("units", {"tau": ...})), f"{gains} (of motors' torques: the gear ratios)"]
        # What mends it comes first: to accept it is right only where nothing is wrong.
        accept = write(Remedy("accept", (question.check,)))
        return ", or ".join([*mends, f"{accept} if the recording is right as it is"])
    if about == "drives":
        return gains
    if about == "units" and key and question.choices:
        others = {"t": write(Remedy("rate")), "tau": gains}
        options = [write(Remedy("units", {key: choice})) for choice in question.choices[:3]]
        return " or ".join([*options, others[key]] if key in others else options)
    if about == "effort_kind" and question.choices:
        return " or ".join(write(Remedy("effort_kind", choice)) for choice in question.choices)
    if about == "effort_kind":
        measured = write(Remedy("effort_kind", "joint_torque"))
        return (
            f"{write(Remedy('columns', {'tau1': ...}))}, or {measured} if they were measured all the same, as where a "
            "maker calls the torque of the drives a reference"
        )
    if about != "columns" or not question.choices:
        return ""
    if key == "t":
        return f"{write(Remedy('columns', {'t': ...}))}, or {write(Remedy('rate'))}"
    if key == "base_qx":
        return write(Remedy("columns", {"base_qx": ..., "base_qy": ..., "base_qz": ..., "base_qw": ...}))
    # Choices may be whole sets of columns, from the first joint's to the last one's.
    first = question.choices[0].partition(" … ")[0] if " … " in question.choices[0] else ...
    return write(Remedy("columns", {f"{key}1": first, f"{key}2": ...})) if key else ""


def accept_proposal(
    inspection: Inspection,
    *,
    has_gains: bool,
    answers: StatedAnswers | None = None,
    accepted: Sequence[RecordingMetadata] = (),
    write: Writer = write_argument,
) -> RecordingMetadata:
    """Accept proposed metadata as they are.

    Parameters
    ----------
    inspection : Inspection
        What was found in the file, with a proposal.
    has_gains : bool
        Whether the robot states drive gains, or none are needed here.
    answers : StatedAnswers, optional
        What was stated, which answers questions and goes before what is proposed.
    accepted : sequence of RecordingMetadata
        Those of other files: what the content of a file leaves open is read as in one of them with the same columns.
    write : function
        Writes the answers to open questions.

    Raises
    ------
    RecordingError
        Where a question is open, as to accept would be a guess.
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
        question_list = "".join(f"\n  {word_question(question, write)}" for question in open_questions)
        # Only what a check proposes is corrected unasked, and of the file alone.
        can_cure = any(question.is_curable and question.field not in _NOT_CURED for question in open_questions)
        cure = f", or let dynident correct the file: {write(Remedy('cure'))}" if can_cure else ""
        raise RecordingError(
            f"This file cannot be used as proposed; these questions are open:{question_list}\n"
            f"State what is right{cure}.",
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
    # What is stated goes before what is proposed.
    return replace(
        stated_answers.metadata,
        columns={**columns, **stated_answers.metadata.columns},
        units={**units, **stated_answers.metadata.units},
        effort_kind=stated_answers.metadata.effort_kind or ("motor_current" if are_currents else proposal.effort_kind),
    )


def word_question(question: Question, write: Writer = write_argument) -> str:
    """Return a question with what answers it."""
    answer = describe_answer(question, write)
    detail = word_remedies(question.detail, question.remedies, write)
    return f"{question.field}: {detail}{f' → {answer}' if answer else ''}"


@dataclass(frozen=True, eq=False)
class ProposalReader:
    """Proposes metadata for files of one robot; what one leaves open, an earlier one with the same columns answers.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    files : sequence of SourceFile
        One recording each.
    metadata : sequence of RecordingMetadata
        What was stated of each of them, which answers questions.
    cure : bool
        Whether faults are corrected that checks can correct.
    write : function
        Writes remedies and answers to open questions in the syntax of a front end.
    is_whole : sequence of bool
        Whether the metadata of a file name all its columns, so that nothing is proposed; by default they may not.
    accepted : dict of int to RecordingMetadata
        What was proposed so far, by the number of the file.
    """

    robot: Robot
    files: Sequence[SourceFile]
    metadata: Sequence[RecordingMetadata]
    cure: bool = False
    write: Writer = write_argument
    is_whole: Sequence[bool] = ()
    accepted: dict[int, RecordingMetadata] = field(default_factory=dict)

    def propose(self, index: int) -> RecordingMetadata:
        """Return the metadata to read a file with; an error with the questions that are open."""
        if self.is_whole and self.is_whole[index]:
            return self.metadata[index]
        file, stated = self.files[index], self.metadata[index]
        check_readable_path(file.path)
        # Which gains currents have is no open question where the robot knows them. That efforts are currents is
        # another one, which gains do not answer.
        has_gains = all(drive.gain is not None for drive in self.robot.drives)
        self.accepted[index] = accept_proposal(
            inspect_file(file.path, self.robot, stated.rate, stated.columns),
            has_gains=has_gains,
            answers=StatedAnswers(stated.columns, stated.units, stated.accept, self.cure, stated),
            accepted=tuple(self.accepted.values()),
            write=self.write,
        )
        return self.accepted[index]

    def propose_all(self) -> list[RecordingMetadata]:
        """Return the metadata of all files: what one leaves open, a later one may answer, too."""
        sure = [self._propose_if_sure(index) for index in range(len(self.files))]
        for index, known in enumerate(sure):
            if known is None:
                try:
                    sure[index] = self.propose(index)
                except RecordingError as error:
                    error.detail = f"{self.files[index].path.name}: {error.detail}"
                    raise
        return [known for known in sure if known is not None]

    def _propose_if_sure(self, index: int) -> RecordingMetadata | None:
        try:
            return self.propose(index)
        except RecordingError as error:
            if error.title != OPEN_QUESTIONS:
                raise
            return None

    def report_columns(self, recordings: Recordings) -> Recordings:
        """Return the recordings of all files, with a finding where columns were taken as proposed."""
        items = list(recordings)
        for index, stated in self.accepted.items():
            note = Check(COLUMNS, "warning", f"Read as {describe_columns(stated)}.")
            items[index] = replace(items[index], checks=(*items[index].checks, note))
        return Recordings(tuple(items))

    def describe_columns_of_files(self) -> list[str]:
        """Describe which columns were taken as what, once for files that have the same."""
        names_by_columns: dict[str, list[str]] = {}
        for stated in self.accepted.values():
            names_by_columns.setdefault(describe_columns(stated), []).append(stated.name or "")
        return [f"Columns of {', '.join(names)} as proposed: {text}" for text, names in names_by_columns.items()]


def describe_columns(metadata: RecordingMetadata) -> str:
    """Return which columns are taken as what: "t: Time (ms); q: A1.pos … A7.pos (deg)"."""
    signals_by_kind: dict[str, list[str]] = {}
    for signal in metadata.columns:
        signals_by_kind.setdefault(_signal_kind(signal), []).append(signal)
    parts = []
    for kind, signals in signals_by_kind.items():
        columns = [metadata.columns[signal] for signal in signals]
        span = columns[0] if len(set(columns)) == 1 else f"{columns[0]} … {columns[-1]}"
        # A kind may have a unit, and joints of it others.
        units = [metadata.units[kind]] if kind in metadata.units else []
        units += [f"{key} in {metadata.units[key]}" for key in signals if key != kind and key in metadata.units]
        parts.append(f"{kind}: {span} ({', '.join(units)})" if units else f"{kind}: {span}")
    return "; ".join(parts)
