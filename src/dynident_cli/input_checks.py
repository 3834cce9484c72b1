"""Check and read input files, before anything slow is imported."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

from dynident.errors import DynidentError
from dynident.file_output import check_folder_exists
from dynident.known_robots import list_library_arms, locate_robot
from dynident.recordings.file_names_and_digests import split_path


@dataclass(frozen=True)
class InputCheck:
    """Marker in the annotation of an option: what the option names has to be there.

    `check` takes one value of the option and raises `DynidentError` where it is missing.
    """

    check: Callable[[Any], object]


def check_inputs(command: Callable[..., None], options: Mapping[str, object]) -> None:
    """Check all options of a command that are marked with an `InputCheck`, by the values that it is called with."""
    for name, hint in get_type_hints(command, include_extras=True).items():
        if get_origin(hint) is Annotated:
            for marker in hint.__metadata__:
                if isinstance(marker, InputCheck):
                    for value in _iterate_values(options.get(name)):
                        marker.check(value)


def _iterate_values(option: Any) -> Iterator[Any]:
    if isinstance(option, (list, tuple)):
        yield from option
    elif option is not None:
        yield option


def check_readable(path: Path) -> None:
    """Raise `DynidentError` where a file is missing or may not be read."""
    # Files that are one recording are given together, as q.csv+dq.csv+tau.csv.
    for part in split_path(path):
        if not part.is_file():
            hint = "; this is a robot, which comes before the recordings" if str(part) in list_library_arms() else ""
            raise DynidentError(f"there is no file {part}{hint}", pointer=str(path), title="No such file")
        if not os.access(part, os.R_OK):
            raise DynidentError(
                f"{part} cannot be read; check its permissions", pointer=str(path), title="Unreadable file"
            )


def read_json_object(path: Path) -> Mapping[str, object]:
    """Read a JSON object from a file; `DynidentError` where the file holds none."""
    try:
        document = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise DynidentError(f"{path.name} is not valid JSON: {error}", pointer=str(path)) from error
    if not isinstance(document, dict):
        raise DynidentError(f"{path.name} does not contain a JSON object", pointer=str(path))
    return document


def read_text(path: Path) -> str:
    """Read a text file in UTF-8; `DynidentError` where it is none."""
    check_readable(path)
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise DynidentError(f"{path.name} is not a text file: {error}", pointer=str(path)) from error


def check_folder(path: Path) -> None:
    """Raise `DynidentError` where a folder is missing."""
    if not path.is_dir():
        raise DynidentError(f"there is no folder {path}", pointer=str(path), title="No such folder")


READABLE_FILE = InputCheck(check_readable)
FILE_IN_FOLDER = InputCheck(check_folder_exists)
READABLE_FOLDER = InputCheck(check_folder)
KNOWN_ROBOT = InputCheck(locate_robot)
