"""Load what a user names on the command line: robots, recordings, days, effects, models, diagnoses."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from dynident.api.recording_collection import Recordings
from dynident.api.recording_files import read_files
from dynident.api.recordings_in_memory import SourceFile
from dynident.api.robot_files import load_robot
from dynident.api.robot_files import set_drive_gains as set_gains
from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import parse_effects
from dynident.errors import DynidentError
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
from dynident_cli.metadata_files import (
    OPEN_QUESTIONS,
    StatedAnswers,
    accept_proposal,
    describe_columns,
    read_metadata,
)
from dynident_cli.option_parsers import check_readable
from dynident_cli.request_options import write_option
from dynident_cli.shared_options import RobotAdditions, TimedReading

if TYPE_CHECKING:
    # Loaded by those who need them: other commands need not wait.
    from dynident.recordings.recording_metadata import ConditioningStep

_NOTHING_BESIDE = RobotAdditions()


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
    proposed: list[RecordingMetadata] = []

    def propose(index: int) -> RecordingMetadata:
        # A metadata file without columns holds answers to what is proposed; one with columns is the whole proposal.
        stated = metadata[index]
        if reading.as_proposed is False or not stated.columns.keys() <= options.keys():
            return stated
        proposed.append(_propose_metadata(paths[index], robot, stated, reading, proposed))
        return proposed[-1]

    def propose_if_sure(index: int) -> RecordingMetadata | None:
        try:
            return propose(index)
        except DynidentError as error:
            if error.title != OPEN_QUESTIONS:
                raise
            return None

    files = [SourceFile(path, stated.name) for path, stated in zip(paths, metadata, strict=True)]
    try:
        if reading.as_proposed:
            # What one file leaves open, a later one with the same columns may answer.
            sure = [propose_if_sure(index) for index in range(len(paths))]
            metadata = [known or propose(index) for index, known in enumerate(sure)]
        # A file of another logger is read as proposed; where a question is open, that is the error.
        recordings = read_files(
            files, robot, metadata, cure=reading.cure, write_remedy=write_option, propose=propose, progress=progress
        )
        has_gains = isinstance(reading, RobotAdditions) and bool(reading.drive_gains)
        return recordings.report_unused_gains() if has_gains else recordings
    except RecordingError as error:
        _add_remedies(error, reading)
        raise
    finally:
        _tell_columns(proposed)


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


def _tell_columns(metadata: Sequence[RecordingMetadata]) -> None:
    """Print which columns were taken as what, once for files that have the same."""
    names_by_columns: dict[str, list[str]] = {}
    for stated in metadata:
        names_by_columns.setdefault(describe_columns(stated), []).append(stated.name or "")
    for columns, names in names_by_columns.items():
        message_console().print(f"Columns of {', '.join(names)} as proposed: {columns}", soft_wrap=True)


def _add_remedies(error: RecordingError, reading: TimedReading) -> None:
    """Name the options that might help: only the command line knows them."""
    refused = [check for check in error.checks if check.status == "error"]
    # An error without a cure stays, whatever is corrected besides it.
    if not reading.cure and refused and refused[0].apply is not None:
        error.detail += " Or let dynident correct it: --cure."
    if error.title == UNKNOWN_COLUMNS and reading.as_proposed is False:
        error.detail += " Or let dynident propose the columns from names and content: --as-proposed."


def _list_neighbours(paths: Sequence[Path]) -> set[str]:
    """Return the names of files in the same folders: windows may name them, as commands of one model share options."""
    folders = {path.parent for path in paths if path.parent.is_dir()}
    return {file.stem for folder in folders for file in folder.iterdir() if file.is_file()}


def _propose_metadata(
    path: Path,
    robot: Robot,
    stated: RecordingMetadata,
    reading: TimedReading,
    accepted: Sequence[RecordingMetadata],
) -> RecordingMetadata:
    from dynident.identification.column_inference import inspect_file

    check_readable(path)
    # Which gains currents have is no open question where the robot knows them. That efforts are currents is another
    # one, which gains do not answer.
    has_gains = all(drive.gain is not None for drive in robot.drives)
    answers = StatedAnswers(stated.columns, stated.units, reading.accept, reading.cure, stated)
    inspection = inspect_file(path, robot, stated.rate, stated.columns)
    return accept_proposal(path, inspection, has_gains=has_gains, answers=answers, accepted=accepted)


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
