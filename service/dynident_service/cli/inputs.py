"""From what a user types to robots, recordings, choices and models."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from dynident.desk.robots import load_robot
from dynident.desk.robots import with_gains as set_gains
from dynident.effects import EffectChoice
from dynident.effects.written import written_effects
from dynident.errors import DynidentError
from dynident.identification import Identification, from_bytes
from dynident.identification.robot_recordings import MOST_CURES, import_cured
from dynident.identification.shapes.shapes import check_choices
from dynident.progress import Progress, part
from dynident.recordings import Check, Recording, RecordingError, RecordingMetadata
from dynident.recordings.names import unique_names
from dynident.robot import Robot
from dynident_service.cli import parsing
from dynident_service.cli.files import check_readable, check_robot, document_of
from dynident_service.cli.metadata import Answers, as_proposed, read_metadata
from dynident_service.cli.options import Beside, TimedReading
from dynident_service.cli.terminal import progress_bar

if TYPE_CHECKING:
    # Loaded by those who need them: other commands need not wait.
    from dynident.advice import AdvisedDiagnosis
    from dynident.recordings.stated import ConditioningStep

# How the contract words it, and the same in the words of the command line.
_REWORDED = (
    (re.compile(r'say "accept": \["(\w+)"\]'), r"say --accept \1"),
    (re.compile(r'say "skip": \["(\w+)"\]'), r"say --skip \1"),
    (re.compile(r'"windows": \[\[([^,\]]+), ([^,\]]+)\]\]'), r"--windows {name}=\1:\2"),
    (re.compile(r'"units": \{"(\w+)": "([^"]+)"\}'), r"--units \1=\2"),
    (re.compile(r'"locked_joints": \{"([^"]+)": 0\}'), r"--lock \1"),
    (re.compile(r'"columns": \{"(\w+)": "(\w+)"\}'), r"--columns \1=\2"),
    (re.compile(r'Name it by columns, \{"(\w+)": "…"\}'), r"Name it by --columns \1=…"),
    (re.compile(r'say "rate": …'), "say --rate HZ"),
    (re.compile(r'say "role": "friction" for'), "give it as --friction if it is"),
    (re.compile(r'State "gravity": \[([^\]]+)\] with the robot'), r"Say --gravity \1"),
    (re.compile(r'give the robot "drives": .* in N m/A \(or [^)]*\)'), "give --drive-gains in N m/A"),
)


_NOTHING_BESIDE = Beside()


@dataclass(frozen=True, eq=False)
class Loaded:
    """A checked measurement, the file that it is from, and what was said of it."""

    recording: Recording
    checks: tuple[Check, ...]
    path: Path
    said: RecordingMetadata


def robot_of(text: str, additions: Beside = _NOTHING_BESIDE) -> Robot:
    """The robot that an argument means, a file or a well-known arm, with what options say beside it."""
    check_robot(text)
    upright = parsing.vector(additions.gravity, "--gravity") if additions.gravity else None
    robot = load_robot(text, locked_joints=parsing.locks(additions.lock), gravity=upright)
    return with_gains(robot, additions.drive_gains)


def with_gains(robot: Robot, gains: str) -> Robot:
    """The robot with drive gains stated on the command line."""
    return set_gains(robot, parsing.drive_gains(gains, robot.joint_names)) if gains else robot


@contextmanager
def loaded(
    paths: Sequence[Path],
    robot: Robot,
    reading: TimedReading,
    progress: Progress,
    others: Sequence[Path] = (),
    friction: Collection[Path] = (),
) -> Iterator[tuple[list[Loaded], list[Loaded]]]:
    """Check measurement files (and others beside them); what is kept of them is gone when the work is done.

    With `cure` what would be refused is read as its checks propose. `friction` are those of them that test the friction
    of single joints.

    Yields
    ------
    measurements, others : each with its checks
    """
    everything = [*paths, *others]
    names = unique_names(everything)
    windows = parsing.windows_of(reading.windows, names, _neighbours(everything))
    columns, units = parsing.pairs(reading.columns, "--columns"), parsing.pairs(reading.units, "--units")
    metadata_by_name = read_metadata(reading.metadata, names)
    answers = Answers(columns, units, reading.accept, reading.cure)
    with tempfile.TemporaryDirectory(prefix="dynident-") as folder:
        measurements = []
        for index, (path, name) in enumerate(zip(everything, names, strict=True)):
            base_metadata = metadata_by_name.get(name)
            if base_metadata is None:
                base_metadata = (
                    _proposed(path, robot, answers, reading.rate) if reading.as_proposed else RecordingMetadata()
                )
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
            share = part(progress, index / len(everything), (index + 1) / len(everything))
            try:
                measurements.append(
                    _load(path, Path(folder) / f"{index}.parquet", robot, metadata, share, cure=reading.cure)
                )
            except RecordingError as error:
                if error.title == "Missing column" and name not in metadata_by_name and not reading.as_proposed:
                    error.detail += " Or have the columns told by names and content: --as-proposed."
                raise
        yield measurements[: len(paths)], measurements[len(paths) :]


def _neighbours(paths: Sequence[Path]) -> set[str]:
    """Names of the files that lie beside those of this call: other commands of the same study may be about them."""
    folders = {path.parent for path in paths if path.parent.is_dir()}
    return {file.stem for folder in folders for file in folder.iterdir() if file.is_file()}


def _proposed(path: Path, robot: Robot, answers: Answers, rate: float | None) -> RecordingMetadata:
    from dynident.identification.imports import inspect_file

    check_readable(path)
    has_gains = all(drive.gain is not None for drive in robot.drives)
    return as_proposed(path, inspect_file(path, robot, rate), has_gains=has_gains, answers=answers)


def _load(
    path: Path, destination: Path, robot: Robot, metadata: RecordingMetadata, progress: Progress, *, cure: bool
) -> Loaded:
    check_readable(path)
    try:
        imported = import_cured(robot, path, destination, metadata, progress, most=MOST_CURES if cure else 0)
    except RecordingError as error:
        if not cure and any(check.status == "error" and check.apply is not None for check in error.checks):
            error.detail += " Or have it put right: --cure."
        # Which of the files: the science knows columns, rows and times alone.
        error.detail = f"{path.name}: {_reworded(error.detail, metadata.name)}"
        error.checks = tuple(replace(check, detail=_reworded(check.detail, metadata.name)) for check in error.checks)
        raise
    checks = tuple(replace(check, detail=_reworded(check.detail, imported.metadata.name)) for check in imported.checks)
    return Loaded(imported.recording, checks, path, imported.metadata)


def _reworded(detail: str, name: str) -> str:
    """What is wrong with the measurement of that name, with options in place of the contract's fields."""
    for pattern, words in _REWORDED:
        detail = pattern.sub(words.replace("{name}", name), detail)
    return detail


def recordings_of(measurements: Sequence[Loaded]) -> list[Recording]:
    """The recordings alone."""
    return [item.recording for item in measurements]


@dataclass(frozen=True, eq=False)
class Read:
    """The measurements of a command and those beside them, and what is left of its progress bar."""

    given: list[Loaded]
    others: list[Loaded]
    progress: Progress

    @property
    def recordings(self) -> list[Recording]:
        """The measurements' recordings."""
        return recordings_of(self.given)

    @property
    def other_recordings(self) -> list[Recording]:
        """Those of the ones beside them."""
        return recordings_of(self.others)


@contextmanager
def read(
    title: str,
    paths: Sequence[Path],
    robot: Robot,
    reading: TimedReading,
    others: Sequence[Path] = (),
    friction: Collection[Path] = (),
    *,
    share: float = 0.5,
) -> Iterator[Read]:
    """Check measurement files as `loaded` does, behind a progress bar of which that takes a share."""
    with (
        progress_bar(title) as progress,
        loaded(paths, robot, reading, part(progress, 0.0, share), others, friction) as (
            measurements,
            other_measurements,
        ),
    ):
        yield Read(measurements, other_measurements, part(progress, share, 1.0))


def effects_of(texts: Sequence[str], robot: Robot) -> tuple[EffectChoice, ...]:
    """The effects that were asked for, checked against the robot."""
    choices = named_effects(texts)
    check_choices(choices, robot)
    return choices


def named_effects(texts: Sequence[str]) -> tuple[EffectChoice, ...]:
    """The effects that were named, as they were written."""
    return written_effects(texts, "--effects")


def model_of(path: Path) -> Identification:
    """Read an identified model."""
    check_readable(path)
    try:
        return from_bytes(path.read_bytes())
    except DynidentError as error:
        error.pointer = str(path)
        raise


def stored_diagnosis(path: Path) -> AdvisedDiagnosis:
    """Read what `dynident diagnose --out` wrote."""
    from pydantic import ValidationError

    from dynident_service.adapters.diagnoses import diagnosis_of

    try:
        return diagnosis_of(document_of(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise DynidentError(
            f"{path.name} is no diagnosis: {first['msg']} at {'/'.join(map(str, first['loc']))}", pointer=str(path)
        ) from error
