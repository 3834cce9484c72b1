"""Check input files before anything slow is imported; write output files atomically."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

from dynident.errors import DynidentError
from dynident.known_robots import locate_robot
from dynident.recordings.file_names_and_digests import split_path


@dataclass(frozen=True)
class InputCheck:
    """Marker in the annotation of an option: what the option names has to be there.

    Parameters
    ----------
    check : callable
        Takes one value of the option and raises `DynidentError` where it is missing.
    """

    check: Callable[[Any], object]


def check_inputs(command: Callable[..., None], options: Mapping[str, object]) -> None:
    """Check all options of a command that are marked with an `InputCheck`.

    Parameters
    ----------
    command : callable
        The command, whose annotations hold the markers.
    options : mapping
        The values that the command is called with.

    Raises
    ------
    DynidentError
        Where an option names a file, folder or robot that is missing.
    """
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
            raise DynidentError(f"there is no file {part}", pointer=str(path), title="No such file")
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


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file atomically: it appears complete, or not at all."""
    if not path.parent.is_dir():
        raise DynidentError(f"there is no folder {path.parent}", pointer="--out", title="No such folder")
    # In the same folder, so that the final rename stays on one file system and is atomic.
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as unfinished:
        temporary = Path(unfinished.name)
    try:
        # Whoever reads the old file meanwhile reads all of it.
        temporary.write_bytes(content)
        # Temporary files are private (0600); this one is the user's and gets the permissions that the umask leaves.
        # The umask can only be read by setting it.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def check_folder(path: Path) -> None:
    """Raise `DynidentError` where a folder is missing."""
    if not path.is_dir():
        raise DynidentError(f"there is no folder {path}", pointer=str(path), title="No such folder")


READABLE_FILE = InputCheck(check_readable)
READABLE_FOLDER = InputCheck(check_folder)
KNOWN_ROBOT = InputCheck(locate_robot)
