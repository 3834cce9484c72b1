"""Load what a user names on the command line: robots, recordings, days, effects, models, diagnoses."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from dynident.api.robot_files import load_robot
from dynident.api.robot_files import set_drive_gains as set_gains
from dynident.diagnosis.monitoring import Day, Measure, build_measure, find_free_name, load_days, reduce_day
from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import parse_effects
from dynident.errors import DynidentError, word_remedies
from dynident.identification import Identification, from_bytes
from dynident.identification.robot_recording_import import (
    CONTRADICTION,
    MOST_CURES,
    import_cured,
    list_shared_cures,
    word_contradiction,
)
from dynident.identification.shape_search import check_choices
from dynident.progress import Progress, scale_progress
from dynident.recordings import Check, Recording, RecordingError, RecordingMetadata, Revision
from dynident.recordings.file_names_and_digests import compute_digest, make_unique_names
from dynident.robot import Robot
from dynident.robot.limits_and_drives import check_hardware
from dynident_cli import option_parsers
from dynident_cli.input_checks_and_writes import check_readable, read_json_object
from dynident_cli.metadata_files import StatedAnswers, accept_proposal, read_metadata
from dynident_cli.request_options import write_option
from dynident_cli.shared_options import Reading, RobotAdditions, TimedReading
from dynident_cli.terminal import show_progress_bar

if TYPE_CHECKING:
    # Loaded by those who need them: other commands need not wait.
    from dynident.advice import AdvisedDiagnosis
    from dynident.recordings.recording_metadata import ConditioningStep


_NOTHING_BESIDE = RobotAdditions()


@dataclass(frozen=True, eq=False)
class LoadedRecording:
    """A checked recording with its checks, its file, its metadata, and the cures that made it usable."""

    recording: Recording
    checks: tuple[Check, ...]
    path: Path
    metadata: RecordingMetadata
    revisions: tuple[Revision, ...] = ()


def load_robot_argument(text: str, additions: RobotAdditions = _NOTHING_BESIDE) -> Robot:
    """Load the robot that an argument names.

    Parameters
    ----------
    text : str
        A file, or the name of a well-known arm.
    additions : RobotAdditions
        Drive gains, locked joints, gravity and hardware from options.

    Returns
    -------
    Robot
        The robot with what the options add.

    Raises
    ------
    DynidentError
        Where there is no such robot, or an option does not fit it.
    """
    upright = option_parsers.parse_vector(additions.gravity, "--gravity") if additions.gravity else None
    has, has_not = _split_names(additions.has), _split_names(additions.has_not)
    check_hardware(has, has_not)
    robot = load_robot(
        text,
        locked_joints=option_parsers.parse_locks(additions.lock),
        gravity=upright,
        hardware={**dict.fromkeys(has, True), **dict.fromkeys(has_not, False)},
    )
    return with_gains(robot, additions.drive_gains)


def _split_names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def with_gains(robot: Robot, gains: str) -> Robot:
    """Return the robot with the drive gains of `--drive-gains`; the same robot where none are given."""
    return set_gains(robot, option_parsers.parse_drive_gains(gains, robot.joint_names)) if gains else robot


@contextmanager
def load_recordings(
    paths: Sequence[Path],
    robot: Robot,
    reading: TimedReading,
    progress: Progress,
    others: Sequence[Path] = (),
    friction: Collection[Path] = (),
) -> Iterator[tuple[list[LoadedRecording], list[LoadedRecording]]]:
    """Read and check measurement files.

    The recordings are stored in a temporary folder, which is removed when the context ends.

    Parameters
    ----------
    paths : sequence of Path
        Files to identify from.
    robot : Robot
        The robot that they are recordings of.
    reading : TimedReading
        How they are read. With `cure`, files that would be refused are read as their checks propose.
    progress : callable
        Reports progress.
    others : sequence of Path
        Further files, for example held-out data.
    friction : collection of Path
        Those of the files that test the friction of single joints.

    Yields
    ------
    measurements, others : list of LoadedRecording
        The recordings of `paths` and of `others`, each with its checks.
    """
    everything = [*paths, *others]
    # Recordings go by the names of their files, by which options name them.
    names = make_unique_names(everything)
    windows = option_parsers.parse_windows(reading.windows, names, _list_neighbours(everything))
    columns, units = (
        option_parsers.parse_pairs(reading.columns, "--columns"),
        option_parsers.parse_pairs(reading.units, "--units"),
    )
    # Options and metadata files are read before the first recording, which may take minutes.
    metadata_by_name = read_metadata(reading.metadata, names)
    with tempfile.TemporaryDirectory(prefix="dynident-") as folder:
        measurements: list[LoadedRecording] = []
        outcomes: dict[str, Sequence[Revision] | RecordingError] = {}
        for index, (path, name) in enumerate(zip(everything, names, strict=True)):
            base_metadata = metadata_by_name.get(name, RecordingMetadata())
            # A metadata file without columns holds answers to what is proposed; one with columns is the whole proposal.
            if reading.as_proposed and not base_metadata.columns:
                answers = StatedAnswers(columns, units, reading.accept, reading.cure, base_metadata)
                base_metadata = _propose_metadata(path, robot, answers, reading.rate)
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
                skip=(*base_metadata.skip, *(cast("ConditioningStep", name) for name in reading.skip)),
            )
            # Each file takes an equal share of the bar, whatever its size: sizes of different formats do not compare.
            share = scale_progress(progress, index / len(everything), (index + 1) / len(everything))
            target, known = Path(folder) / f"{index}.parquet", list_shared_cures(outcomes) if reading.cure else ()
            try:
                measurements.append(
                    _load_recording(path, target, robot, metadata, share, cure=reading.cure, known=known)
                )
                outcomes[name] = measurements[-1].revisions
            except RecordingError as error:
                outcomes[name] = error
                # The others are read for the sake of what they say of the robot: one error tells of all files.
                if error.checks:
                    continue
                # Only where columns can still be proposed: neither stated in a file nor proposed already.
                if error.title == "Missing column" and name not in metadata_by_name and not reading.as_proposed:
                    error.detail += " Or let dynident propose the columns from names and content: --as-proposed."
                raise
        _check_outcomes(robot, outcomes)
        yield measurements[: len(paths)], measurements[len(paths) :]


def _check_outcomes(robot: Robot, outcomes: Mapping[str, Sequence[Revision] | RecordingError]) -> None:
    """Raise the first error of the files, with what contradicts it; or that, where all files could be cured."""
    contradiction = word_contradiction(robot, outcomes)
    for outcome in outcomes.values():
        if isinstance(outcome, RecordingError):
            outcome.detail += f" {contradiction}" if contradiction else ""
            raise outcome
    if contradiction:
        raise RecordingError(contradiction, title=CONTRADICTION)


def _list_neighbours(paths: Sequence[Path]) -> set[str]:
    """Return the names of files in the same folders: windows may name them, as commands of one model share options."""
    folders = {path.parent for path in paths if path.parent.is_dir()}
    return {file.stem for folder in folders for file in folder.iterdir() if file.is_file()}


def _propose_metadata(path: Path, robot: Robot, answers: StatedAnswers, rate: float | None) -> RecordingMetadata:
    from dynident.identification.column_inference import inspect_file

    check_readable(path)
    # Currents are no open question where the robot knows what torque they mean.
    has_gains = all(drive.gain is not None for drive in robot.drives)
    return accept_proposal(path, inspect_file(path, robot, rate), has_gains=has_gains, answers=answers)


def _load_recording(
    path: Path,
    destination: Path,
    robot: Robot,
    metadata: RecordingMetadata,
    progress: Progress,
    *,
    cure: bool,
    known: Sequence[Revision] = (),
) -> LoadedRecording:
    check_readable(path)
    try:
        most = MOST_CURES if cure else 0
        imported = import_cured(robot, path, destination, metadata, progress, most=most, known=known)
    except RecordingError as error:
        refused = [check for check in error.checks if check.status == "error"]
        # An error without a cure stays, whatever is corrected besides it.
        if not cure and refused and refused[0].apply is not None:
            error.detail += " Or let dynident correct it: --cure."
        # The library knows columns, rows and times, but not which of the files it is.
        error.detail = f"{path.name}: {word_remedies(error.detail, error.remedies, write_option)}"
        error.checks, error.remedies = _word_checks(error.checks), ()
        raise
    checks = _word_checks(imported.checks)
    return LoadedRecording(imported.recording, checks, path, imported.metadata, imported.revisions)


def _word_checks(checks: Sequence[Check]) -> tuple[Check, ...]:
    return tuple(replace(check, detail=word_remedies(check.detail, check.remedies, write_option)) for check in checks)


def extract_recordings(measurements: Sequence[LoadedRecording]) -> list[Recording]:
    """Return the recordings of loaded files."""
    return [item.recording for item in measurements]


@dataclass(frozen=True, eq=False)
class CommandInputs:
    """The recordings that a command has read.

    Attributes
    ----------
    loaded : list of LoadedRecording
        Those that the command is about.
    others : list of LoadedRecording
        Further ones, for example held-out data.
    progress : callable
        Reports progress on the part of the bar that reading has left.
    """

    loaded: list[LoadedRecording]
    others: list[LoadedRecording]
    progress: Progress

    @property
    def recordings(self) -> list[Recording]:
        """Recordings that the command is about."""
        return extract_recordings(self.loaded)

    @property
    def other_recordings(self) -> list[Recording]:
        """Recordings of the further files."""
        return extract_recordings(self.others)


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
) -> Iterator[CommandInputs]:
    """Read and check measurement files as `load_recordings` does, with a progress bar.

    Parameters
    ----------
    title : str
        What the bar says.
    share : float
        The share of the bar that reading takes, 0 to 1; the rest is for the computation.

    Yields
    ------
    CommandInputs
        The recordings and the rest of the progress bar.
    """
    with (
        show_progress_bar(title) as progress,
        load_recordings(paths, robot, reading, scale_progress(progress, 0.0, share), others, friction) as (
            measurements,
            other_measurements,
        ),
    ):
        yield CommandInputs(measurements, other_measurements, scale_progress(progress, share, 1.0))


def read_effects(texts: Sequence[str], robot: Robot) -> tuple[EffectChoice, ...]:
    """Parse effects and check that they fit the robot."""
    choices = parse_unchecked_effects(texts)
    check_choices(choices, robot)
    return choices


def parse_unchecked_effects(texts: Sequence[str]) -> tuple[EffectChoice, ...]:
    """Parse effects without checking them against a robot."""
    return parse_effects(texts, "--effects")


def load_model(path: Path) -> Identification:
    """Read an identified model from a file; `DynidentError` where it holds none."""
    check_readable(path)
    try:
        return from_bytes(path.read_bytes())
    except DynidentError as error:
        error.pointer = str(path)
        raise


def load_diagnosis(path: Path) -> AdvisedDiagnosis:
    """Read a diagnosis that `dynident diagnose --out` wrote; `DynidentError` where the file holds none."""
    from pydantic import ValidationError

    from dynident_service.diagnoses.adapters import restore_diagnosis

    try:
        return restore_diagnosis(read_json_object(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise DynidentError(
            f"{path.name} is not a diagnosis: {first['msg']} at {'/'.join(map(str, first['loc']))}", pointer=str(path)
        ) from error


def load_continued_days(
    identification: Identification,
    paths: Sequence[Path],
    reading: Reading,
    keep: Path | None,
    progress: Progress,
) -> tuple[Measure, tuple[Day, ...]]:
    """Estimate the parameters of each day.

    Parameters
    ----------
    identification : Identification
        The model whose parameters are followed.
    paths : sequence of Path
        One file a day, in their order.
    reading : Reading
        How the files are read.
    keep : Path, optional
        The file that stores earlier days.
    progress : callable
        Reports progress.

    Returns
    -------
    measure : Measure
        Which parameters may differ from day to day.
    days : tuple of Day
        The stored days in their order, then the new ones.
    """
    robot = identification.model.robot
    days: tuple[Day, ...] = ()
    content = keep.read_bytes() if keep is not None and keep.exists() else None
    with load_recordings(paths, robot, reading, scale_progress(progress, 0.0, 0.6)) as (measurements, _):
        recordings = [item.recording for item in measurements]
        if content is None:
            # The first files decide whether temperature is a regressor: all later days have to be comparable.
            warm = all(recording.has_temperature for recording in recordings)
            measure = build_measure(identification, with_temperature=warm)
        else:
            measure, days = load_days(identification, content)
        all_days = list(days)
        # A digest of its file is what a day is known by.
        sources = [compute_digest(path) for path in paths]
        for number, (recording, source) in enumerate(zip(recordings, sources, strict=True)):
            # A file that is stored already is known by its hash, whatever it is called now.
            if any(day.source == source for day in all_days):
                continue
            day_progress = scale_progress(
                progress, 0.6 + 0.4 * number / len(paths), 0.6 + 0.4 * (number + 1) / len(paths)
            )
            all_days.append(
                reduce_day(measure, find_free_name(recording.name, all_days), [recording], day_progress, source)
            )
    return measure, tuple(all_days)
