"""The commands that make a model again."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from dynident.asking import default_of, said_of
from dynident.effects import EffectChoice
from dynident.effects.written import effect_text
from dynident.identification import Identification, IdentificationChoices
from dynident.kinds import Kind
from dynident.recordings import Preprocessing, Recording, RecordingMetadata
from dynident.recordings.stated import Windows
from dynident.robot import Robot
from dynident.robot.settings import GRAVITY

ROBOT = "ROBOT"
"""Stands for the robot's description in the commands."""
_DIGITS = ".9g"


Said = Mapping[str, RecordingMetadata]
"""What was said of the files of recordings, by the recordings' names."""


def metadata_files(said: Said) -> dict[str, str]:
    """The files for `--metadata` that the commands name, with what is in them: one of each recording that needs one."""
    told = {name: _told(one) for name, one in said.items()}
    return {_metadata_file(name): json.dumps(one) for name, one in told.items() if one}


_TOLD = ("columns", "units", "permutation", "signs", "scale", "torque_delay", "effort_kind", "skip")
"""What a file cannot be read without, where it was said. Accepted checks and windows, from which what was excluded is
gone, have options of their own."""


def _told(one: RecordingMetadata) -> dict[str, Any]:
    """What was said of a file, as far as anything was."""
    values = {name: getattr(one, name) for name in _TOLD}
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in values.items() if value}


def _metadata_file(name: str) -> str:
    return f"{name}.columns.json"


def commands(
    identification: Identification, recordings: Sequence[Recording] = (), said: Said = MappingProxyType({})
) -> tuple[str, ...]:
    """One command for the first model of a ladder and one for every rung; recordings go by their names.

    A rung for which something else was changed than the effects is identified anew. What only some runs have is said
    behind the command: `--effects` has no words for it.

    Parameters
    ----------
    recordings : sequence of Recording, optional
        Those of the model, for the windows that were used of them.
    said : mapping, optional
        What was said of their files: see `metadata_files`.
    """
    found = []
    windows = {one.name: one.windows for one in recordings}
    for number, rung in enumerate(identification.ladder(), 1):
        files = [*rung.data.measurement_names, *(part for name in rung.data.validation_names for part in ("-v", name))]
        names = [*rung.data.measurement_names, *rung.data.validation_names]
        files += [*_windows(names, windows), *_metadata(names, said)]
        before, out = f"model{number - 1}.npz", ["-o", f"model{number}.npz"]
        step = rung.step
        if step.added:
            texts = ",".join(effect_text(choice, _DIGITS) for choice in step.added)
            words = ["extend", before, *files, "--effects", texts, *out]
        elif step.removed:
            texts = ",".join(effect_text(choice, _DIGITS) for choice in step.removed)
            words = ["remove", before, "--effects", texts, *out]
        else:
            chosen = [*_of_robot(rung.model.robot), *_options(rung.choices), *_filters(rung.preprocessing)]
            words = ["identify", ROBOT, *files, *chosen, *out]
        told = step.added or step.removed or rung.choices.effects
        found.append(shlex.join(["dynident", *words]) + _in_some_runs(told))
    return tuple(found)


def _of_robot(robot: Robot) -> Iterator[str]:
    """What the description may not say of a robot: gravity, locked joints, drive gains."""
    if tuple(robot.gravity) != GRAVITY:
        yield from ("--gravity", ",".join(format(value, _DIGITS) for value in robot.gravity))
    if robot.locked_joints:
        yield from ("--lock", ",".join(f"{name}={at:{_DIGITS}}" for name, at in robot.locked_joints.items()))
    gains = {name: drive.gain for name, drive in zip(robot.joint_names, robot.drives, strict=True)}
    stated = [f"{name}={gain:{_DIGITS}}" for name, gain in gains.items() if gain is not None]
    if stated:
        yield from ("--drive-gains", ",".join(stated))


def _windows(names: Sequence[str], windows: Mapping[str, Windows]) -> Iterator[str]:
    said = [(name, *one) for name in names for one in windows.get(name, ())]
    if said:
        yield from ("--windows", ",".join(f"{name}={start:{_DIGITS}}:{end:{_DIGITS}}" for name, start, end in said))


def _metadata(names: Sequence[str], said: Said) -> Iterator[str]:
    for name in names:
        if name in said and _told(said[name]):
            yield from ("--metadata", f"{name}={_metadata_file(name)}")
    for check in dict.fromkeys(check for name in names if name in said for check in said[name].accept):
        yield from ("--accept", check)


def _in_some_runs(choices: Sequence[EffectChoice]) -> str:
    found = [f"{choice.effect} in {', '.join(choice.runs)} alone" for choice in choices if choice.runs]
    return f"  # {'; '.join(found)}: give the diagnosis by --diagnosis, or the runs in Python" if found else ""


def _options(choices: IdentificationChoices) -> Iterator[str]:
    """What differs from the defaults, as options."""
    yield from ("--effects", ",".join(effect_text(choice, _DIGITS) for choice in choices.effects))
    for one in fields(choices):
        said, value = said_of(one), getattr(choices, one.name)
        if said.option == "-" or value == default_of(one):
            continue
        option = said.option or f"--{one.name.replace('_', '-')}"
        if isinstance(value, bool):
            yield option if value else option.replace("--", "--no-", 1)
        else:
            yield from (option, _text(value))


def _text(value: object) -> str:
    if isinstance(value, Kind):
        options = [(one.name, getattr(value, one.name)) for one in fields(value)]
        return f"{value.name}:{','.join(f'{name}={option}' for name, option in options)}" if options else value.name
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ",".join(map(str, value))
    return format(value, _DIGITS) if isinstance(value, float) else str(value)


def _filters(preprocessing: Preprocessing) -> Iterator[str]:
    names = ("position_cutoff", "torque_cutoff", "decimation", "filter_order")
    values = [(name, getattr(preprocessing, name)) for name in names]
    texts = [f"{name}={'none' if value is None else format(value, _DIGITS)}" for name, value in values]
    yield from ("--preprocessing", ",".join(texts))
