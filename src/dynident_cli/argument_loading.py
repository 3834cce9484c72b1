"""Load what a user names on the command line: robots, recordings, days, effects, models, diagnoses."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

from dynident.api.proposed_metadata import NEEDED_FOR_GAINS, OPEN_QUESTIONS, ProposalReader
from dynident.api.recording_collection import Recordings
from dynident.api.recording_files import read_files
from dynident.api.recordings_in_memory import SourceFile
from dynident.api.robot_files import load_robot
from dynident.api.robot_files import set_drive_gains as set_gains
from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import parse_effects
from dynident.errors import DynidentError
from dynident.identification.column_inference import EffortKind, Inspection
from dynident.identification.shape_search import check_choices
from dynident.progress import Progress, scale_progress
from dynident.recordings import RecordingError, RecordingMetadata
from dynident.recordings.file_names_and_digests import make_unique_names
from dynident.recordings.recording_metadata import UNKNOWN_COLUMNS
from dynident.robot import Robot
from dynident.robot.description_and_json import set_base
from dynident.robot.limits_and_drives import check_hardware
from dynident_cli import option_parsers
from dynident_cli.command_output import message_console, show_progress_bar
from dynident_cli.contract_documents import parse_metadata
from dynident_cli.option_parsers import check_readable
from dynident_cli.request_options import write_option
from dynident_cli.shared_options import RobotAdditions, TimedReading

if TYPE_CHECKING:
    # Loaded by those who need them: other commands need not wait.
    from dynident.recordings.recording_metadata import ConditioningStep

_NOTHING_BESIDE = RobotAdditions()
_IGNORED_KEYS = ("questions", "name", "format")
"""Keys of a metadata file that are no metadata."""
_OTHER_SOURCES = ("name", "format", "role", "accept")
"""Metadata that the file itself tells, or that have options or commands of their own."""


def load_robot_argument(text: str, additions: RobotAdditions = _NOTHING_BESIDE) -> Robot:
    """Load the robot of a file, or a well-known arm, with what the options add."""
    upright = option_parsers.parse_vector(additions.gravity, "--gravity") if additions.gravity else None
    has, has_not = _split_names(additions.has), _split_names(additions.has_not)
    check_hardware(has, has_not)
    robot = load_robot(
        text,
        locked_joints=option_parsers.parse_locks(additions.lock),
        gravity=upright,
        hardware={**dict.fromkeys(has, True), **dict.fromkeys(has_not, False)},
    )
    if additions.base or additions.contacts:
        kind, contacts = option_parsers.parse_base(additions.base), option_parsers.split_contacts(additions.contacts)
        robot = set_base(robot, kind, contacts)
    return with_gains(robot, additions.drive_gains)


def _split_names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def with_gains(robot: Robot, gains: str) -> Robot:
    """Return the robot with the drive gains of `--drive-gains`; the same robot where none are given."""
    return set_gains(robot, option_parsers.parse_drive_gains(gains, robot.joint_names)) if gains else robot


@contextmanager
def read_recordings(
    title: str,
    paths: Sequence[Path],
    robot: Robot,
    reading: TimedReading,
    others: Sequence[Path] = (),
    friction: Collection[Path] = (),
    *,
    share: float = 0.5,
) -> Iterator[tuple[Recordings, Recordings, Progress]]:
    """Read and check measurement files, with a progress bar.

    `friction` are those of the files that test the friction of single joints. Reading takes `share` of the bar; yield
    the recordings, the others, and a function that reports progress on the rest.
    """
    with show_progress_bar(title) as progress:
        everything = [*paths, *others]
        recordings = load_recordings(everything, robot, reading, scale_progress(progress, 0.0, share), friction)
        yield recordings[: len(paths)], recordings[len(paths) :], scale_progress(progress, share, 1.0)


def load_recordings(
    paths: Sequence[Path],
    robot: Robot,
    reading: TimedReading,
    progress: Progress,
    friction: Collection[Path] = (),
) -> Recordings:
    """Read and check measurement files; see `read_recordings`."""
    # Options and metadata files are read before the first recording, which may take minutes.
    metadata = _list_metadata(paths, reading, friction)
    options = option_parsers.parse_pairs(reading.columns, "--columns")
    files = [SourceFile(path, stated.name) for path, stated in zip(paths, metadata, strict=True)]
    # A metadata file without columns holds answers to what is proposed; one with columns is the whole proposal.
    is_whole = [reading.as_proposed is False or not stated.columns.keys() <= options.keys() for stated in metadata]
    reader = ProposalReader(robot, files, metadata, reading.cure, write_option, is_whole)
    try:
        if reading.as_proposed:
            for path in paths:
                check_readable(path)
            metadata = reader.propose_all()
        # A file of another logger is read as proposed; where a question is open, that is the error.
        recordings = read_files(reader, metadata, progress)
        has_gains = isinstance(reading, RobotAdditions) and bool(reading.drive_gains)
        return recordings.report_unused_gains() if has_gains else recordings
    except RecordingError as error:
        _add_remedies(error, reading)
        raise
    finally:
        for line in reader.describe_columns_of_files():
            message_console().print(line, soft_wrap=True)


def _list_metadata(paths: Sequence[Path], reading: TimedReading, friction: Collection[Path]) -> list[RecordingMetadata]:
    """Return the metadata of each file by the options, with the names by which options name the recordings."""
    names = make_unique_names(paths)
    windows = option_parsers.parse_windows(reading.windows, names, _list_neighbours(paths))
    columns = option_parsers.parse_pairs(reading.columns, "--columns")
    units = option_parsers.parse_pairs(reading.units, "--units")
    metadata_by_name = read_metadata(reading.metadata, names)
    metadata_of_files = []
    for path, name in zip(paths, names, strict=True):
        base_metadata = metadata_by_name.get(name, RecordingMetadata())
        # Options win over a metadata file, key by key for columns and units.
        metadata = replace(
            base_metadata,
            name=name,
            columns={**base_metadata.columns, **columns},
            units={**base_metadata.units, **units},
            role="friction" if path in friction else None,
            windows=windows.get(name, base_metadata.windows),
            rate=base_metadata.rate if reading.rate is None else reading.rate,
            accept=tuple(reading.accept),
            skip=(*base_metadata.skip, *(cast("ConditioningStep", step) for step in reading.skip)),
        )
        metadata_of_files.append(metadata)
    return metadata_of_files


def _add_remedies(error: RecordingError, reading: TimedReading) -> None:
    """Name the options that might help: only the command line knows them."""
    refused = [check for check in error.checks if check.status == "error"]
    # An error without a cure stays, whatever is corrected besides it.
    if not reading.cure and refused and refused[0].apply is not None:
        error.detail += " Or let dynident correct it: --cure."
    if error.title == OPEN_QUESTIONS:
        error.detail += (
            " Or write the proposal with `dynident inspect FILE --robot ROBOT --out FILE.json`, answer there "
            "(and empty its questions), and give it as --metadata."
        )
    if error.title == UNKNOWN_COLUMNS and reading.as_proposed is False:
        error.detail += " Or let dynident propose the columns from names and content: --as-proposed."


def _list_neighbours(paths: Sequence[Path]) -> set[str]:
    """Return the names of files in the same folders: windows may name them, as commands of one model share options."""
    folders = {path.parent for path in paths if path.parent.is_dir()}
    return {file.stem for folder in folders for file in folder.iterdir() if file.is_file()}


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
    document = option_parsers.read_json_object(path)
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


def read_effects(texts: Sequence[str], robot: Robot) -> tuple[EffectChoice, ...]:
    """Parse effects and check that they fit the robot."""
    choices = parse_unchecked_effects(texts)
    check_choices(choices, robot)
    return choices


def parse_unchecked_effects(texts: Sequence[str]) -> tuple[EffectChoice, ...]:
    """Parse effects without checking them against a robot; `run=2` is a run by its number, which `name_runs` names."""
    choices = []
    for choice in parse_effects(texts, "--effects"):
        constants = dict(choice.shape)
        run = constants.pop("run", None)
        choices.append(choice if run is None else replace(choice, shape=tuple(constants.items()), runs=(f"{run:g}",)))
    return tuple(choices)


def name_runs(choices: Sequence[EffectChoice], names: Sequence[str]) -> tuple[EffectChoice, ...]:
    """Replace the numbers of runs, counted from 1 in the order of the measurements, by the names of these."""
    by_number = {str(k + 1): name for k, name in enumerate(names)}
    for choice in choices:
        for run in choice.runs:
            if run not in by_number:
                raise DynidentError(
                    f"{choice.effect} is to be in run {run}, but the measurements are run 1 to {len(names)}",
                    pointer="--effects",
                    title="Unusable effect",
                )
    return tuple(replace(choice, runs=tuple(by_number[run] for run in choice.runs)) for choice in choices)
