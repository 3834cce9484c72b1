"""Parse option texts (pairs, windows, gains, filters), and check input files before anything slow is imported."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_origin, get_type_hints

from dynident.errors import DynidentError, describe_missing_joint
from dynident.file_output import check_folder_exists
from dynident.known_robots import list_library_arms, locate_robot
from dynident.recordings.file_names_and_digests import describe_folder, split_path
from dynident.robot.description_formats import BASE_JOINTS, BaseKind

if TYPE_CHECKING:
    from dynident.recordings import Filters


Window = tuple[float, float]


def parse_pairs(texts: Sequence[str], option: str) -> dict[str, str]:
    """Parse pairs of `name=value`, several in one text with commas between, or JSON objects; later ones win."""
    parsed: dict[str, str] = {}
    for text in texts:
        # A JSON object is for names or values that hold commas or equals signs.
        if text.lstrip().startswith("{"):
            parsed |= _parse_json_pairs(text, option)
            continue
        for item in _split_items(text):
            # At the first equals sign: a value may hold further ones.
            name, sign, value = item.partition("=")
            if not sign or not name.strip() or not value.strip():
                raise _unreadable_error(option, item, "name=value")
            parsed[name.strip()] = value.strip()
    return parsed


def parse_effect_place(text: str, joint_names: Sequence[str]) -> tuple[str, str]:
    """Parse `effect@joint`, or the id of an effect alone, with "" for its joint; both are checked."""
    # The catalogue takes a second to load.
    from dynident.effects import get_effect

    effect, _, joint = (part.strip() for part in text.partition("@"))
    get_effect(effect, "--why")
    if joint and joint not in joint_names:
        raise DynidentError(
            describe_missing_joint(joint, joint_names),
            pointer="--why",
            title="Unusable option",
        )
    return effect, joint


def parse_numbers(text: str, option: str) -> list[float]:
    """Parse numbers with commas between."""
    return [parse_number(item, option) for item in _split_items(text)]


def parse_number(text: str, option: str) -> float:
    """Parse a number; `DynidentError` where the text is none."""
    try:
        return float(text)
    except ValueError:
        raise _unreadable_error(option, text, "a number") from None


def parse_drive_gains(text: str, joint_names: Sequence[str]) -> dict[str, float]:
    """Parse drive gains [12.17] in N m per unit of current: one a joint in the robot's order, or `joint=gain` pairs."""
    if "=" not in text:
        values = parse_numbers(text, "--drive-gains")
        if len(values) != len(joint_names):
            raise DynidentError(
                f"{len(values)} drive gains for {len(joint_names)} joints ({', '.join(joint_names)}); give one "
                "per joint, or joint=gain pairs",
                pointer="--drive-gains",
            )
        return dict(zip(joint_names, values, strict=True))
    gains = {name: parse_number(value, "--drive-gains") for name, value in parse_pairs([text], "--drive-gains").items()}
    for name in gains:
        if name not in joint_names:
            raise DynidentError(describe_missing_joint(name, joint_names), pointer="--drive-gains")
    return gains


def parse_locks(text: str) -> dict[str, float]:
    """Parse positions to lock joints at, rad or m: `joint=position`, or `joint` alone for 0."""
    positions: dict[str, float] = {}
    for item in _split_items(text):
        joint, sign, position = item.partition("=")
        positions[joint.strip()] = parse_number(position, "--lock") if sign else 0.0
    return positions


def parse_vector(text: str, option: str) -> tuple[float, float, float]:
    """Parse three numbers with commas between."""
    values = parse_numbers(text, option)
    if len(values) != 3:
        raise DynidentError(f"{text!r} has {len(values)} numbers; expected three", pointer=option)
    return values[0], values[1], values[2]


def parse_base(text: str) -> BaseKind | None:
    """Parse how the root link of a robot moves; nothing where no text is given."""
    kinds: dict[str, BaseKind] = {kind: kind for kind in BASE_JOINTS}
    if text and text not in kinds:
        raise DynidentError(f"the base is {text!r}; expected {', '.join(kinds)}", pointer="--base")
    return kinds.get(text)


def split_contacts(text: str) -> list[str]:
    """Split names of contacts; between points of links, which have commas themselves, stand semicolons."""
    first, _, others = text.partition("@")
    if ";" not in text and others and ("," in first or "@" in others):
        raise DynidentError(
            f"{text!r} names several contacts, and points have commas themselves; write semicolons between the "
            "contacts: fl_calf@0,0,-0.21;fr_calf@0,0,-0.21",
            pointer="--contacts",
        )
    return [item.strip() for item in text.split(";" if ";" in text or "@" in text else ",") if item.strip()]


def parse_windows(
    texts: Sequence[str], names: Sequence[str], neighbours: Collection[str] = ()
) -> dict[str, tuple[Window, ...]]:
    """Parse windows of time, by the names of the recordings.

    `from:to` is for all recordings, `name=from:to` for one, in seconds; several have commas between. A window without a
    name that follows a named one is of the same recording. Windows of `neighbours`, which are recordings of other
    calls, are skipped, so that the commands of one model can share their options.
    """
    windows_by_name: dict[str, tuple[Window, ...]] = {}
    for text in texts:
        targets = list(names)
        for item in _split_items(text):
            # From the right: the name of a file may hold "=", a window does not.
            name, sign, rest = item.rpartition("=")
            if sign and name not in names and name not in neighbours:
                raise DynidentError(
                    f"there is no measurement {name!r}; there are: {', '.join(names)}", pointer="--windows"
                )
            # A name holds for the windows behind it, too, until another name comes.
            targets = [name] if sign else targets
            for target in targets:
                windows_by_name[target] = (*windows_by_name.get(target, ()), _parse_window(rest))
    for name, windows in windows_by_name.items():
        _check_no_overlap(name, windows)
    # Windows of neighbours were read, so that their mistakes are found, and are left out here.
    return {name: windows for name, windows in windows_by_name.items() if name in names}


def _check_no_overlap(name: str, windows: Sequence[Window]) -> None:
    """Refuse windows that overlap; most likely each was meant for a file of its own."""
    in_time = sorted(windows)
    for first, second in pairwise(in_time):
        if second[0] < first[1]:
            raise DynidentError(
                f"the windows {first[0]:g}:{first[1]:g} and {second[0]:g}:{second[1]:g} of {name} overlap; to use "
                f"a window for one recording only, write {name}={first[0]:g}:{first[1]:g}",
                pointer="--windows",
            )


def parse_filters(text: str) -> Filters | None:
    """Parse pairs such as position_cutoff=6,torque_cutoff=6,decimation=3; `none` is no filter, `auto` None."""
    from dynident.recordings.preprocessing import values_from_request
    from dynident.recordings.recording_metadata import Filters

    if text.strip() == "auto":
        return None
    if text.strip() == "none":
        return Filters(position_cutoff=None, torque_cutoff=None)
    # Both spellings of no filter: that of the command line, and that of JSON.
    words: dict[str, object] = {"auto": "auto", "none": None, "null": None}
    values = {
        name: words[value] if value in words else parse_number(value, f"--preprocessing {name}")
        for name, value in parse_pairs([text], "--preprocessing").items()
    }
    return Filters(**values_from_request(values))  # type: ignore[arg-type]


def _split_items(text: str) -> list[str]:
    return [item.strip() for item in text.split(",") if item.strip()]


def _parse_window(text: str) -> Window:
    first, sign, last = text.partition(":")
    if not sign:
        raise _unreadable_error("--windows", text, "from:to in seconds of t")
    return parse_number(first, "--windows"), parse_number(last, "--windows")


def _parse_json_pairs(text: str, option: str) -> dict[str, str]:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise DynidentError(f"this is not a JSON object: {error}", pointer=option) from error
    if not isinstance(document, dict):
        raise _unreadable_error(option, text, "a JSON object")
    return {str(key): str(value) for key, value in document.items()}


def _unreadable_error(option: str, text: str, expected: str) -> DynidentError:
    return DynidentError(f"cannot read {text!r}; write {expected}", pointer=option, title="Unusable option")


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
        if part.is_dir():
            raise DynidentError(describe_folder(part), pointer=str(path), title="No such file")
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
