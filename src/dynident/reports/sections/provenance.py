"""Report section on the origin: versions, time, hashes, and commands that make the model again."""

from __future__ import annotations

import json
import platform
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

from dynident.effects import EffectChoice
from dynident.effects.effect_text_format import format_effect
from dynident.identification import Identification, IdentificationChoices
from dynident.recordings import Preprocessing, Recording, RecordingMetadata
from dynident.recordings.recording_metadata import Windows
from dynident.reports.reported_data import ReportedRecording, Section
from dynident.robot import Robot
from dynident.robot.stated_settings import GRAVITY
from dynident.schema.fields import get_default, get_description
from dynident.schema.registry import RegistryEntry
from dynident.text_encoding import encode_text
from dynident.version import __version__

ROBOT = "ROBOT"
"""Stands for the robot's description in the commands."""
# The shortest text that reads back as the same number: nine digits moved small inertias by 7e-5.
_EXACT = ""


StatedMetadata = Mapping[str, RecordingMetadata]
"""The metadata that users stated for the files of recordings, by the recordings' names."""


def collect_metadata_files(said: StatedMetadata) -> dict[str, str]:
    """Return the files for the option `--metadata` that the commands name.

    Parameters
    ----------
    said : mapping of str to RecordingMetadata
        Metadata that the user stated, by the recordings' names.

    Returns
    -------
    dict of file name to JSON text
        One for each recording that cannot be read without stated metadata.
    """
    values_by_name = {name: _collect_stated_fields(metadata) for name, metadata in said.items()}
    return {_name_metadata_file(name): json.dumps(values) for name, values in values_by_name.items() if values}


_STATED_FIELDS = ("columns", "units", "permutation", "signs", "scale", "torque_delay", "effort_kind", "skip")
"""Fields of the metadata that a file is read with. Accepted checks and windows have options of their own; excluded
times are already cut out of the windows."""


def _collect_stated_fields(metadata: RecordingMetadata) -> dict[str, Any]:
    """Return the stated fields of a file's metadata as JSON values."""
    # Empty values are left out: they are the defaults.
    values = {name: getattr(metadata, name) for name in _STATED_FIELDS}
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in values.items() if value}


def _name_metadata_file(name: str) -> str:
    return f"{name}.columns.json"


def build_commands(
    identification: Identification, recordings: Sequence[Recording] = (), said: StatedMetadata = MappingProxyType({})
) -> tuple[str, ...]:
    """Return the commands that make a model again: one for the first model of the ladder and one for every step.

    A step that changes something else than the effects becomes a new identification. Effects that only some segments
    have are named in a comment behind the command, since the option `--effects` cannot express them.

    Parameters
    ----------
    identification : Identification
        The identified model, with its ladder.
    recordings : sequence of Recording, optional
        Those of the model, for the windows that were used of them.
    said : mapping, optional
        Stated metadata of their files by recording name: see `collect_metadata_files`.

    Returns
    -------
    tuple of str
        Commands for a POSIX shell, in the order in which they are to run; recordings go by their names.
    """
    command_lines = []
    windows = {recording.name: recording.windows for recording in recordings}
    for number, ladder_model in enumerate(identification.ladder(), 1):
        files = [
            *ladder_model.data.measurement_names,
            *(part for name in ladder_model.data.validation_names for part in ("-v", name)),
        ]
        names = [*ladder_model.data.measurement_names, *ladder_model.data.validation_names]
        files += [*_list_window_options(names, windows), *_list_metadata_options(names, said)]
        before, out = f"model{number - 1}.npz", ["-o", f"model{number}.npz"]
        # An extension or a removal starts from the model of the step before, so that its file has to be named.
        step = ladder_model.step
        if step.added:
            texts = ",".join(format_effect(choice, _EXACT) for choice in step.added)
            words = ["extend", before, *files, "--effects", texts, *out]
        elif step.removed:
            texts = ",".join(format_effect(choice, _EXACT) for choice in step.removed)
            words = ["remove", before, "--effects", texts, *out]
        else:
            options = [
                *_list_robot_options(ladder_model.model.robot),
                *_list_choice_options(ladder_model.choices),
                *_list_filter_options(ladder_model.preprocessing),
            ]
            words = ["identify", ROBOT, *files, *options, *out]
        step_effects = step.added or step.removed or ladder_model.choices.effects
        command_lines.append(shlex.join(["dynident", *words]) + _comment_on_segments(step_effects))
    return tuple(command_lines)


def _list_robot_options(robot: Robot) -> Iterator[str]:
    """Yield the options for what a robot's description may lack: gravity, locked joints, drive gains."""
    if tuple(robot.gravity) != GRAVITY:
        yield from ("--gravity", ",".join(format(value, _EXACT) for value in robot.gravity))
    if robot.locked_joints:
        yield from ("--lock", ",".join(f"{name}={at:{_EXACT}}" for name, at in robot.locked_joints.items()))
    gains = {name: drive.gain for name, drive in zip(robot.joint_names, robot.drives, strict=True)}
    gain_texts = [f"{name}={gain:{_EXACT}}" for name, gain in gains.items() if gain is not None]
    if gain_texts:
        yield from ("--drive-gains", ",".join(gain_texts))


def _list_window_options(names: Sequence[str], windows: Mapping[str, Windows]) -> Iterator[str]:
    intervals = [(name, *window) for name in names for window in windows.get(name, ())]
    if intervals:
        texts = (f"{name}={start:{_EXACT}}:{end:{_EXACT}}" for name, start, end in intervals)
        yield from ("--windows", ",".join(texts))


def _list_metadata_options(names: Sequence[str], said: StatedMetadata) -> Iterator[str]:
    for name in names:
        if name in said and _collect_stated_fields(said[name]):
            yield from ("--metadata", f"{name}={_name_metadata_file(name)}")
    for check in dict.fromkeys(check for name in names if name in said for check in said[name].accept):
        yield from ("--accept", check)


def _comment_on_segments(choices: Sequence[EffectChoice]) -> str:
    texts = [f"{choice.effect} in {', '.join(choice.runs)} alone" for choice in choices if choice.runs]
    return f"  # {'; '.join(texts)}: give the diagnosis by --diagnosis, or the runs in Python" if texts else ""


def _list_choice_options(choices: IdentificationChoices) -> Iterator[str]:
    """Yield the options for all choices that differ from their defaults."""
    yield from ("--effects", ",".join(format_effect(choice, _EXACT) for choice in choices.effects))
    for choice_field in fields(choices):
        description, value = get_description(choice_field), getattr(choices, choice_field.name)
        # Choices without an option ("-") cannot be made on the command line; the defaults need none.
        if description.option == "-" or value == get_default(choice_field):
            continue
        option = description.option or f"--{choice_field.name.replace('_', '-')}"
        if isinstance(value, bool):
            yield option if value else option.replace("--", "--no-", 1)
        else:
            yield from (option, _format_value(value))


def _format_value(value: object) -> str:
    if isinstance(value, RegistryEntry):
        options = [(option_field.name, getattr(value, option_field.name)) for option_field in fields(value)]
        return f"{value.name}:{','.join(f'{name}={option}' for name, option in options)}" if options else value.name
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ",".join(map(str, value))
    return format(value, _EXACT) if isinstance(value, float) else str(value)


def _list_filter_options(preprocessing: Preprocessing) -> Iterator[str]:
    names = ("position_cutoff", "torque_cutoff", "decimation", "filter_order")
    values = [(name, getattr(preprocessing, name)) for name in names]
    texts = [f"{name}={'none' if value is None else format(value, _EXACT)}" for name, value in values]
    yield from ("--preprocessing", ",".join(texts))


_PACKAGES = ("casadi", "numpy", "scipy", "pin", "pyarrow")


@dataclass(frozen=True)
class ProvenanceContent:
    """The content of the section.

    Attributes
    ----------
    facts : tuple of pair of str
        Names and values, in the order in which they are shown.
    commands : tuple of str
        Commands that make the model again.
    files : tuple of pair of str
        Names and contents of the files that the commands name.
    address : str
        URL of a page that shows the model, "" where it is unknown.
    """

    facts: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]
    files: tuple[tuple[str, str], ...] = ()
    address: str = ""


def build_provenance_section(
    identification: Identification, runs: Sequence[ReportedRecording], created: datetime, address: str = ""
) -> Section:
    """Return the section on how to get the same model again.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    runs : sequence of ReportedRecording
        Recordings to show, each with the model's prediction.
    created : datetime
        When the report was made, with its time zone.
    address : str
        URL of a page that shows the model, or "".

    Returns
    -------
    Section
        Facts and commands.
    """
    robot = identification.model.robot
    # A digest instead of the text: descriptions can be long, and whoever has the file can compare.
    digest = sha256(encode_text(robot.description.content)).hexdigest()
    facts = (
        ("made", created.astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")),
        ("dynident", __version__),
        ("python", platform.python_version()),
        ("packages", ", ".join(f"{name} {version(name)}" for name in _PACKAGES)),
        ("robot description", f"{robot.description.format}, sha256 {digest}"),
        ("identified from", ", ".join(identification.data.measurement_names)),
        ("held-out data", ", ".join(identification.data.validation_names) or "none"),
        ("shown", ", ".join(run.name for run in runs)),
        *((f"file of {run.name}", f"sha256 {run.sha256}") for run in runs if run.sha256),
        *((f"changed metadata of {run.name}", "; then ".join(map(str, run.edits))) for run in runs if run.edits),
        ("models before this one", str(len(list(identification.ladder())) - 1)),
    )
    metadata = {run.name: run.stated_metadata for run in runs if run.stated_metadata is not None}
    command_lines = build_commands(identification, [run.recording for run in runs], metadata)
    files = tuple(collect_metadata_files(metadata).items())
    return Section("provenance", "Provenance", "provenance", ProvenanceContent(facts, command_lines, files, address))
