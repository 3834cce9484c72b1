"""`dynident.inspect`, `read_recordings` and `revise`: look at a file, read files, correct metadata."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypedDict, Unpack

from dynident.api.argument_checks import CheckedResult, check_arguments, require
from dynident.api.proposed_metadata import COLUMNS, ProposalReader, word_question
from dynident.api.recording_collection import CheckedRecording, Recordings, RecordingSource
from dynident.api.recordings_in_memory import RecordingData, SourceFile, TemporaryFile, open_recording_source
from dynident.api.robot_files import DriveGains, set_drive_gains
from dynident.errors import DynidentError, Remedy, word_remedies, write_argument
from dynident.identification.column_inference import Guess, Inspection, Question, inspect_file
from dynident.identification.robot_recording_import import (
    CONTRADICTION,
    MOST_CURES,
    contains_fact,
    import_cured,
    list_shared_cures,
    note_cure,
    refute_zeros,
    word_contradiction,
)
from dynident.number_format import format_percent
from dynident.presentation.recording_tables import build_guess_table
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Check, RecordingError, RecordingMetadata, Revision
from dynident.recordings.file_names_and_digests import check_readable_path, make_unique_names
from dynident.recordings.recording_metadata import UNKNOWN_COLUMNS, RevisionFields
from dynident.robot import Robot
from dynident.text_and_html_tables import join_html, render_list, render_paragraph

_SHOWN, _NAMES = 30, 12


class ProposedColumns(TypedDict, total=False):
    """Arguments of `read_recordings` that are proposed; empty where nothing is."""

    columns: dict[str, str]
    units: dict[str, str]
    metadata: RecordingMetadata


@dataclass(frozen=True, eq=False)
class InspectedFile(CheckedResult):
    """The probable contents of a file; `read_recordings(path, robot=robot, **found.said)` reads it as proposed.

    Parameters
    ----------
    inspection : Inspection
        What was found in the file, as the library gives it.
    rate : float, optional
        Rate of the rows in Hz, where the user stated it because the file has no time.
    owner : object
        Removes the temporary file of data from memory when nothing refers to it any more.
    """

    inspection: Inspection
    rate: float | None = None
    owner: object = None

    @property
    def guesses(self) -> tuple[Guess, ...]:
        """The guesses, with their probability and reason."""
        return () if self.inspection.proposal is None else self.inspection.proposal.guesses

    @property
    def questions(self) -> tuple[Question, ...]:
        """Questions to answer before the file can be used."""
        return () if self.inspection.proposal is None else self.inspection.proposal.questions

    @property
    def said(self) -> ProposedColumns:
        """Proposed columns and units, commands as the torque's source, and a stated rate, for `read_recordings`."""
        proposal = self.inspection.proposal
        if proposal is None:
            return {}
        # Copies, so that changing the proposal for a call leaves the inspection as it was.
        arguments: ProposedColumns = {"columns": dict(proposal.columns), "units": dict(proposal.units)}
        effort_kind = proposal.effort_kind if proposal.effort_kind == "position_command" else None
        if self.rate is not None or effort_kind is not None:
            arguments["metadata"] = RecordingMetadata(rate=self.rate, effort_kind=effort_kind)
        return arguments

    def __repr__(self) -> str:
        lines = [self._format_head()]
        lines += [
            f"  {guess.field}: {guess.value} ({format_percent(guess.confidence, decimals=0)}: "
            f"{word_remedies(guess.reason, guess.remedies, write_argument)})"
            for guess in self.guesses[:_SHOWN]
        ]
        left_out = len(self.guesses) - _SHOWN
        lines += [f"  … and {left_out} more (.guesses)"] if left_out > 0 else []
        lines += [f"  ? {word_question(question)}" for question in self.questions]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return join_html(
            render_paragraph(self._format_head(), strong=True),
            build_guess_table(self.guesses, write_argument).to_html() if self.guesses else "",
            render_paragraph("Questions to answer:") if self.questions else "",
            render_list(word_question(question) for question in self.questions),
        )

    def _format_head(self) -> str:
        names = self.inspection.columns
        rest = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
        return f"{self.inspection.format}, {len(names)} columns: {', '.join(names[:_NAMES])}{rest}"


@check_arguments
def inspect(
    path: RecordingData,
    robot: Robot | None = None,
    *,
    drive_gains: DriveGains | None = None,
    rate: float | None = None,
) -> InspectedFile:
    """Find out what the columns of a file are, in which units, and which questions are open.

    Parameters
    ----------
    path : path, several, a data frame or a dictionary
        In any format that can be read. Several files that are one recording are given as a tuple: ("q.csv", "dq.csv",
        "tau.csv"). Data in memory need the robot.
    robot : Robot, optional
        The robot that was recorded; without it the columns are only listed.
    drive_gains : mapping of joint name to float, or one float a joint
        In N m (N) per unit of current, instead of the robot's.
    rate : float, optional
        Hz of the rows, where the file has no time.

    Returns
    -------
    InspectedFile
        The columns of the file, what each of them probably is, and what has to be answered first.

    Raises
    ------
    DynidentError
        For a file that is not there.
    RecordingError
        For a file that cannot be read.

    Examples
    --------
    >>> file = dy.inspect("run1.csv", robot)
    >>> file.questions
    ()
    >>> (run,) = dy.read_recordings("run1.csv", robot=robot, **file.said)
    >>> run.name
    'run1'
    """
    if robot is None and not isinstance(path, (str, Path, tuple)):
        raise DynidentError("data in memory are inspected for a robot: give it, inspect(frame, robot)", pointer="robot")
    is_file = robot is None or isinstance(path, (str, Path))
    source = SourceFile(check_readable_path(path), "") if is_file else open_recording_source(path, robot)  # type: ignore[arg-type]
    # Without the right gains currents look like torques of a wrong size, and the guesses would say so.
    machine = set_drive_gains(robot, drive_gains) if robot is not None and drive_gains is not None else robot
    rate = source.rate if rate is None else rate
    return InspectedFile(inspect_file(source.path, machine, rate), rate, source.owner)


@check_arguments
def read_recordings(
    *sources: RecordingData,
    robot: Robot,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    windows: Sequence[tuple[float, float]] = (),
    drive_gains: DriveGains | None = None,
    metadata: RecordingMetadata | None = None,
    cure: bool = False,
    progress: Progress = ignore_progress,
) -> Recordings:
    """Read recordings from files, data frames or arrays, and check them for common faults.

    Files hold the columns `t`, `q1`, … (or `q_<joint>`, …) and `tau1`, … or `current1`, …; see docs/my-robot.md. Others
    are read as `inspect` proposes, and a finding says so; an open question is an error. The arguments apply to all
    files of a call: read files that differ by a call each, and join the results with +.

    A checked recording is a temporary Parquet file (`TMPDIR` says where) in SI units on an even grid of time, since it
    may be larger than memory: it is removed when nothing that reads it is left. `Recordings.save` keeps it.

    Parameters
    ----------
    *sources : paths, data frames or dictionaries
        One recording each. Files that are one recording are given as a tuple: ("q.csv", "dq.csv", "tau.csv"). A data
        frame (pandas, polars, Arrow) has the columns of a file. A dictionary may also hold signals of all joints as
        arrays (m, n), and a sampling period instead of times: {"dt": 0.001, "q": q, "tau": tau}.
    robot : Robot
        The columns are of its joints; its limits are checked against, and its drive gains turn currents into torques.
    columns : mapping of our name to the file's
        Such as {"q1": "shoulder_angle", "tau1": "torque_a"}.
    units : mapping of a kind of signal, or of one column, to its unit
        Such as {"q": "deg", "t": "ms"}; SI by default.
    windows : pairs (from, to)
        Seconds of t to use; all of them by default.
    drive_gains : mapping of joint name to float, or one float a joint
        G_T of [12.17] in N m (N) per unit of current, for these files instead of the robot's.
    metadata : RecordingMetadata, optional
        All options of a file: its role ("friction" for motions at constant velocity, one joint at a time), a known
        payload, the rate of rows without a time, checks to accept, signs, factors and order of columns, a delay of the
        torque. The other arguments take precedence over it. Its name is that of data from memory; recordings in files
        are named after these.
    cure : bool
        Read what would be refused as its checks propose (their `apply`), and say so among the findings.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Recordings
        In the order of the files; its `findings` are the warnings of the checks.

    Raises
    ------
    DynidentError
        For a file that is not there, or no file at all; with the questions that a proposal leaves open.
    RecordingError
        Where files cannot be used: one error for all of them, with all findings in its text and `checks`.

    Examples
    --------
    `dynident simulate scara --effects stribeck@elbow --rate 200 --seed 1 -o run1.csv` writes the first of these files;
    the second is another motion, by `--seed 2`.

    >>> import dynident as dy
    >>> robot = dy.load_robot("scara")
    >>> runs = dy.read_recordings("run1.csv", "run2.csv", robot=robot)
    >>> [run.name for run in runs]
    ['run1', 'run2']
    >>> runs[0].recording.sampling_rate
    200.0
    """
    if not sources:
        raise DynidentError("give at least one file to read", title="No such file")
    files = [open_recording_source(source, robot) for source in sources]
    machine = robot if drive_gains is None else set_drive_gains(robot, drive_gains)
    stated = metadata or RecordingMetadata()
    own = stated.columns if columns is None else dict(columns)
    stated = replace(stated, columns=own, units=stated.units if units is None else dict(units))
    if windows:
        stated = replace(stated, windows=tuple((float(start), float(end)) for start, end in windows))
    names = make_unique_names([Path(file.name or stated.name) for file in files])
    metadata_of_files = [
        replace(stated, name=name, rate=file.rate or stated.rate) for file, name in zip(files, names, strict=True)
    ]
    reader = ProposalReader(machine, files, metadata_of_files, cure)
    recordings = reader.report_columns(read_files(reader, progress=progress))
    return recordings if drive_gains is None else recordings.report_unused_gains()


def read_files(
    reader: ProposalReader,
    metadata: Sequence[RecordingMetadata] | None = None,
    progress: Progress = ignore_progress,
) -> Recordings:
    """Read and check files, each with metadata of its own, and word what is wrong for a front end.

    Parameters
    ----------
    reader : ProposalReader
        The files and what was stated of each; files without the usual columns are read as it proposes.
    metadata : sequence of RecordingMetadata, optional
        Of each file, with its name, where more was proposed than was stated.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Recordings
        In the order of the files, the details of their checks in the words of the front end.

    Raises
    ------
    RecordingError
        Where files cannot be used: one error for all of them, with all findings in its text and `checks`.
    """
    files, robot, write_remedy, cure = reader.files, reader.robot, reader.write, reader.cure
    metadata = reader.metadata if metadata is None else metadata
    recordings: list[CheckedRecording] = []
    failures: list[tuple[str, str, RecordingError]] = []
    outcomes: dict[str, Sequence[Revision] | RecordingError] = {}
    # Each file takes an equal share of the bar, whatever its size: sizes of different formats do not compare. Where
    # faults are cured, a file may be read again with the cures of the others.
    n_shares = (2 if cure else 1) * len(files)
    shares = [scale_progress(progress, k / n_shares, (k + 1) / n_shares) for k in range(n_shares)]
    for index, (file, stated) in enumerate(zip(files, metadata, strict=True)):
        share = shares[index]
        try:
            known = list_shared_cures(outcomes) if cure else ()
            read = partial(_read_recording, file, robot, write_remedy=write_remedy, cure=cure, known=known)
            try:
                recordings.append(read(stated, progress=share))
            except RecordingError as error:
                proposed = reader.propose(index) if error.title == UNKNOWN_COLUMNS else stated
                if proposed == stated:
                    raise
                recordings.append(read(proposed, progress=share))
            source = recordings[-1].source
            outcomes[stated.name] = () if source is None else source.edits
        # All files are read before the error is raised, so that one attempt reports what is wrong with every file.
        except RecordingError as error:
            failures.append((stated.name if file.owner else file.path.name, stated.name, error))
            outcomes[stated.name] = error
    contradiction = word_contradiction(robot, outcomes)
    if failures:
        raise _join_errors(failures, len(files), contradiction, write_remedy) from failures[0][2]
    if contradiction:
        raise RecordingError(contradiction, title=CONTRADICTION)
    # A recording that shows a wrong sign or order does not only tell what is wrong with itself.
    shared = list_shared_cures(outcomes)
    again = zip(recordings, shares[-len(files) :], strict=True)
    items = [_share_cures(recording, shared, write_remedy, share) for recording, share in again]
    checks = refute_zeros(robot, [item.recording for item in items], [item.checks for item in items], metadata)
    return Recordings(tuple(replace(item, checks=own) for item, own in zip(items, checks, strict=True)))


def _share_cures(
    recording: CheckedRecording, shared: Sequence[Revision], write_remedy: Callable[[Remedy], str], progress: Progress
) -> CheckedRecording:
    """Return a recording with the cures of others, where it was read without them because it does not show the fault.

    Raises
    ------
    RecordingError
        Where it is right as it is: the recordings contradict each other.
    """
    source, robot = recording.source, recording.robot
    if source is None or robot is None:
        return recording
    metadata, file = source.metadata, SourceFile(source.path, source.metadata.name, owner=source.owner)
    missing = []
    for revision in shared:
        # Its metadata may state what others were cured of.
        if (revised := revision.apply_to(metadata)) != metadata:
            missing.append(revision)
            metadata = revised
    if not missing:
        return recording
    edits = (*source.edits, *missing)
    try:
        read = _read_recording(file, robot, metadata, write_remedy, edits=edits, progress=progress)
    except RecordingError as error:
        # Anything else than another sign or order, such as a file that is gone, contradicts no recording.
        if not contains_fact(error):
            raise _join_errors([(recording.name, recording.name, error)], 1, "", write_remedy) from error
        raise RecordingError(
            f"Other recordings need {'; '.join(map(str, missing))}, but {recording.name} does not: with it, "
            f"{error.detail} Look at whether the recordings were made in different ways.",
            title=CONTRADICTION,
        ) from error
    return replace(read, checks=(*read.checks, *map(note_cure, missing)))


def _read_recording(
    file: SourceFile,
    robot: Robot,
    metadata: RecordingMetadata,
    write_remedy: Callable[[Remedy], str] = write_argument,
    *,
    cure: bool = False,
    known: tuple[Revision, ...] = (),
    edits: tuple[Revision, ...] = (),
    progress: Progress = ignore_progress,
) -> CheckedRecording:
    destination = TemporaryFile()
    try:
        most = MOST_CURES if cure else 0
        read = import_cured(robot, file.path, destination.path, metadata, progress, most=most, known=known)
    # An interrupt counts, too. The error refers to this call, so the file would stay as long as the error is known.
    except BaseException:
        destination.path.unlink(missing_ok=True)
        raise
    # Copies of a recording (other windows, another name) share its source, so the source decides how long the file is
    # needed.
    weakref.finalize(read.recording.source, _let_go, destination)
    checks = tuple(replace(check, detail=_word(check, write_remedy)) for check in read.checks)
    return CheckedRecording(
        read.recording, checks, robot, RecordingSource(file.path, read.metadata, (*edits, *read.revisions), file.owner)
    )


def revise(
    recording: CheckedRecording, change: Revision | None = None, **fields: Unpack[RevisionFields]
) -> CheckedRecording:
    """Change the metadata of a recording's file, and read and check it again; the given recording stays as it is.

    Parameters
    ----------
    recording : CheckedRecording
        As `read_recordings` gives it.
    change : Revision, optional
        The `apply` of a check; or state the changes as fields.
    **fields : fields of Revision
        Any of windows, exclude, columns, units, permutation, signs, scale, zeros, torque_delay, role and name. They
        take precedence over `change`.

    Returns
    -------
    CheckedRecording
        The recording as it is read with the changes; " r1", " r2" … is added to its name unless one is stated.

    Raises
    ------
    DynidentError
        For a recording that was not read from a file.
    RecordingError
        Where the file cannot be used with these changes.

    Examples
    --------
    >>> shorter = dy.revise(runs[0], windows=((1.0, 6.0),))
    >>> shorter.name
    'run1 r1'
    >>> shorter.source.metadata.windows
    ((1.0, 6.0),)
    """
    require(
        isinstance(recording, CheckedRecording),
        recording,
        "recording",
        "give one recording of read_recordings: runs[0]",
    )
    if recording.source is None or recording.robot is None:
        raise DynidentError(
            f"{recording.name} was not read from a file with read_recordings, so it cannot be revised",
            title="Nothing to revise",
        )
    revision = Revision(**fields) if change is None else replace(change, **fields)
    source = recording.source
    # Edits are kept one by one beside the metadata that they lead to, so that a report can list what was changed.
    edits = (*source.edits, revision)
    revised = revision.apply_to(source.metadata)
    # A revised recording stands beside the first one in tables: it needs a name of its own.
    if revision.name is None:
        revised = replace(revised, name=f"{source.metadata.name} r{len(edits)}")
    file = SourceFile(source.path, source.metadata.name, owner=source.owner)
    read = _read_recording(file, recording.robot, revised, edits=edits)
    # What was guessed is guessed still.
    guessed = [c for c in recording.checks if c.name == COLUMNS and revised.columns == source.metadata.columns]
    return replace(read, checks=(*read.checks, *guessed))


def _let_go(_: TemporaryFile) -> None:
    """Drop the last reference to a temporary file."""


def _join_errors(
    failures: Sequence[tuple[str, str, RecordingError]],
    n_files: int,
    contradiction: str,
    write_remedy: Callable[[Remedy], str],
) -> RecordingError:
    """Join the errors of all files that cannot be used to one, with every blocking finding in it."""
    (*_, first), names_by_text, checks = failures[0], dict[str, list[str]](), list[Check]()
    for name, of, error in failures:
        write = write_remedy if len(failures) == n_files else partial(_write_for_one, write_remedy, of)
        # The error's text quotes the first failed check already; only the others are added.
        own = [check for check in error.checks if check.status == "error" and check.detail not in error.detail]
        further = [f"\n    also {check.name.replace('_', ' ')}: {_word(check, write)}" for check in own]
        names_by_text.setdefault(f"{_word(error, write)}{''.join(further)}", []).append(name)
        checks += [replace(check, detail=_word(check, write)) for check in error.checks]
    # Files of one logger lack the same, which is said once.
    texts = [f"{', '.join(names)}: {text}" for text, names in names_by_text.items()]
    text = "\n  ".join([*texts, contradiction] if contradiction else texts)
    if len(failures) == 1:
        return RecordingError(
            text, pointer=first.pointer, title=first.title, row=first.row, time=first.time, checks=tuple(checks)
        )
    text = f"{len(failures)} of {n_files} files cannot be used:\n  {text}"
    return RecordingError(text, pointer=first.pointer, title=first.title, checks=tuple(checks))


def _word(finding: Check | RecordingError, write_remedy: Callable[[Remedy], str]) -> str:
    return word_remedies(finding.detail, finding.remedies, write_remedy)


def _write_for_one(write_remedy: Callable[[Remedy], str], name: str, remedy: Remedy) -> str:
    """Word a unit for the recording that has it alone: stated for all it would spoil those that are right."""
    return write_remedy(remedy.for_recording(name) if remedy.field == "units" else remedy)
