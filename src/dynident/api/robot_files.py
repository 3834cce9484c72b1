"""`dynident.load_robot` (any format, xacro, or the name of a known arm) and `set_drive_gains`."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from dynident.api.argument_checks import check_arguments, check_is_file
from dynident.errors import DynidentError, describe_missing_joint
from dynident.known_robots import find_library_arm, list_library_arms, locate_robot
from dynident.optional_dependencies import format_install_hint
from dynident.robot import Description, Drive, Limits, Robot, robot_from_description, robot_from_library
from dynident.robot.description_and_json import set_base
from dynident.robot.description_formats import FORMATS, DescriptionFormat
from dynident.robot.json_fields import (
    expect_mapping,
    expect_names,
    expect_number,
    expect_numbers,
    expect_text,
    join_names,
    parse_json,
)
from dynident.robot.limits_and_drives import split_hardware
from dynident.robot.link_meshes import find_package
from dynident.robot.mjcf_xml import expand_includes, has_includes
from dynident.robot.xml_text import read_root
from dynident.schema.fields import point_within
from dynident.text_encoding import decode_document

_XACRO_TITLE = "Unusable xacro"
_XACRO_SYNTAX = re.compile(r"<\s*xacro:|\$\{|\$\(")
_ROS_INDEX = "ament_index_python"


def needs_xacro(content: str) -> bool:
    """Return whether the content of a file is xacro, which has to be expanded."""
    return _XACRO_SYNTAX.search(content) is not None


def expand_xacro(path: Path, content: str) -> str:
    """Return the URDF of a file: its content, expanded where it is xacro.

    Included files are read from the folder of the file, those of packages from the folders above it or where the ROS
    environment says. Only for trusted files: xacro evaluates the expressions in them.

    Parameters
    ----------
    path : Path
        The file; packages that it names are looked for from its folder upwards.
    content : str
        Of the file.

    Returns
    -------
    str
        The URDF; `content` itself where nothing has to be expanded.

    Raises
    ------
    DynidentError
        The package xacro is not installed, or it cannot expand the file.
    """
    # Plain URDF needs neither the package xacro nor trust in the file.
    if not needs_xacro(content):
        return content
    try:
        import xacro
    except ModuleNotFoundError as missing:
        raise DynidentError(
            "this is xacro, and expanding it needs the package xacro, which is not installed: "
            f"{format_install_hint('xacro')}; or expand it first (xacro robot.xacro > robot.urdf)",
            pointer=str(path),
            title=_XACRO_TITLE,
        ) from missing
    try:
        with _find_packages_near(path):
            expanded = str(xacro.process_file(str(path)).toprettyxml(indent="  "))
        if "<link" not in expanded:
            raise ValueError("it defines parts and uses none of them; give the file that calls its macros")
        return expanded
    except Exception as error:  # xacro raises many kinds of errors, all about the file
        cause: Any = error
        # xacro wraps what our own search raises, perhaps several times. Its message would hide ours.
        while getattr(cause, "exc", None) is not None and not isinstance(cause, _PackageNotFound):
            cause = cause.exc
        reason = str(cause if isinstance(cause, _PackageNotFound) else error).strip() or type(error).__name__
        if "is not defined" in reason:
            reason += "; define it by <xacro:property> or <xacro:arg>, or write its value there"
        if "xacro:arg" in reason and "default" in reason:
            reason += (
                "; write the argument's value as its default, or expand the file with it first (xacro robot.xacro "
                "name:=value > robot.urdf)"
            )
        raise DynidentError(f"xacro cannot expand it: {reason}", pointer=str(path), title=_XACRO_TITLE) from error


class _PackageNotFound(Exception):
    """Raised for a package whose folder is not found, though a file names it with $(find …)."""


@contextmanager
def _find_packages_near(path: Path) -> Iterator[None]:
    """Let xacro's $(find package) search near a file, where ROS is not installed or does not know the package.

    xacro asks the ROS package `ament_index_python`, which is on no package index; a stand-in replaces it meanwhile.
    """
    # sys.modules belongs to the whole process: what was there before is put back, whatever happens.
    replaced = {name: sys.modules.get(name) for name in (_ROS_INDEX, f"{_ROS_INDEX}.packages")}
    ask_ros = _get_ros_index()

    def get_package_share_directory(name: str) -> str:
        # The folders near the file come before ROS: an installed package of the same name may be of another version.
        folder = find_package(name, path)
        if folder is not None:
            return str(folder)
        if ask_ros is not None:
            return str(ask_ros(name))
        raise _PackageNotFound(
            f"no folder of the package {name!r} was found in the folders above {path.name}; put it next to the file's "
            "own package, or give the folder that contains it in the environment variable ROS_PACKAGE_PATH"
        )

    packages: Any = ModuleType(f"{_ROS_INDEX}.packages")
    packages.get_package_share_directory = get_package_share_directory
    index: Any = ModuleType(_ROS_INDEX)
    index.packages = packages
    sys.modules.update({_ROS_INDEX: index, packages.__name__: packages})
    try:
        yield
    finally:
        for name, module in replaced.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def _get_ros_index() -> Any:
    try:
        return import_module(f"{_ROS_INDEX}.packages").get_package_share_directory
    except ImportError:
        return None


_ROBOT_TITLE = "Unusable robot"
_FIELDS = (
    "name", "description", "limits", "drives", "locked_joints", "gravity", "base_parameters_tolerance",
    "has", "has_not", "base", "contacts",
)  # fmt: skip
_CONTENT = "/description/content"
_DRIVE_FIELDS = ("drive_gain", "gear_ratio", "torque_constant", "amplifier_gain", "coupling")

DriveGains = Mapping[str, float] | Sequence[float]
"""Drive gains [12.17] in N m (N) per unit of current: by joint, or one a joint in the robot's order."""


@check_arguments
def load_robot(
    source: str | Path,
    *,
    name: str = "",
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    drive_gains: DriveGains | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    hardware: Mapping[str, bool] | None = None,
) -> Robot:
    """Read a robot.

    Parameters
    ----------
    source : str or path
        A URDF or xacro file; an MJCF model; a text file with a classical or modified Denavit-Hartenberg table (see
        `dynident.robot.dh_text`); a JSON file with a modified one (see `dynident.robot.modified_dh`) or with a robot as
        `POST /v1/robots` takes it (see docs/my-robot.md); or the name of a well-known arm, such as "ur10", or of a
        robot of the package example-robot-data, if that is installed, such as "so101".
    name : str
        Its name; by default the one in the file, or the file's own.
    limits : mapping of joint name to Limits
        They take precedence over the file's, field by field.
    drives : mapping of joint name to Drive
        Drive chains [12.17]; they take precedence over the file's.
    drive_gains : mapping of joint name to float, or one float a joint
        G_T of [12.17] in N m (N) per unit of current, for recordings that hold currents; instead of `drives`.
    locked_joints : mapping of joint name to position
        These joints (rad, m) do not move and are in no recording: a gripper's, for instance, or a floating base that
        is clamped (at 0).
    gravity : (x, y, z), optional
        In the base frame, m/s².
    hardware : mapping of part to bool
        Whether the robot has a part: "gravity_compensator", "spring" (or a cable that pulls a joint to a position),
        "cable" (between two links), "coupled_wrist". A diagnosis does not propose what is not there, and asks about
        what nobody has said. In a file these are the lists `has` and `has_not`.

    Returns
    -------
    Robot
        The robot, with what the arguments state in place of what the file says.

    Raises
    ------
    DynidentError
        Where there is neither such a file nor such an arm, or the file describes no robot; says where in the file.

    Examples
    --------
    >>> import dynident as dy
    >>> robot = dy.load_robot("scara")
    >>> robot.joint_names
    ('shoulder', 'elbow', 'quill', 'tool_roll')
    >>> hanging = dy.load_robot("scara", gravity=(0.0, 0.0, 9.81))
    >>> float(hanging.gravity[2])
    9.81
    """
    has, has_not = split_hardware(hardware or {})
    stated: dict[str, Any] = {
        "limits": dict(limits or {}),
        "drives": dict(drives or {}),
        "locked_joints": dict(locked_joints or {}),
        "gravity": None if gravity is None else tuple(gravity),
        "has": has,
        "has_not": has_not,
    }
    robot = _read_robot(source, name, stated)
    return robot if drive_gains is None else set_drive_gains(robot, drive_gains)


def set_drive_gains(robot: Robot, gains: DriveGains) -> Robot:
    """Return a robot with other drive gains; the couplings of its motors stay.

    Parameters
    ----------
    robot : Robot
        The robot whose gains are replaced.
    gains : mapping of joint name to float, or one float a joint
        In N m (N) per unit of current.

    Returns
    -------
    Robot
        A new robot; joints that are not named keep their drives.

    Raises
    ------
    DynidentError
        For a joint that the robot does not have, or another number of gains than of joints.
    """
    if not isinstance(gains, Mapping):
        # A list has no names, so a missing gain would shift all others to wrong joints.
        if len(gains) != robot.n:
            raise DynidentError(
                f"{len(gains)} drive gains for {robot.n} joints ({', '.join(robot.joint_names)}); give one gain per "
                "joint, or a mapping of joint names to gains",
                pointer="drive_gains",
                title=_ROBOT_TITLE,
            )
        gains = dict(zip(robot.joint_names, gains, strict=True))
    for joint in gains:
        if joint not in robot.joint_names:
            detail = describe_missing_joint(joint, robot.joint_names)
            raise DynidentError(detail, pointer="drive_gains", title=_ROBOT_TITLE)
    pairs = zip(robot.joint_names, robot.drives, strict=True)
    changed = (Drive(float(gains[n]), coupling=drive.coupling) if n in gains else drive for n, drive in pairs)
    return replace(robot, drives=tuple(changed))


def _read_robot(source: str | Path, name: str, stated: dict[str, Any]) -> Robot:
    # A folder of recordings may have the name of a well-known arm.
    if Path(source).is_dir() and str(source) not in list_library_arms():
        check_is_file(Path(source), "robot")
    path = locate_robot(str(source))
    if path is None:
        arm = robot_from_library(find_library_arm(str(source)) or str(source))
        return robot_from_description(name or arm.name, arm.description, **stated)
    content = _read_description(path)
    place_of_content = _CONTENT
    try:
        # The content decides on the format: the endings of such files are used for several formats.
        if content.lstrip().startswith("<"):
            root = read_root(content)
            is_mjcf = root is not None and root.tag == "mujoco"
            robot_name = (
                name or ("" if root is None else root.attributes.get("model" if is_mjcf else "name")) or path.stem
            )
            if is_mjcf:
                return robot_from_description(
                    robot_name, Description("mjcf", expand_includes(path, content, _CONTENT)), **stated
                )
            return robot_from_description(robot_name, Description("urdf", expand_xacro(path, content)), **stated)
        # Neither XML nor JSON: the only text format that is left is a Denavit-Hartenberg table.
        if not content.lstrip().startswith(("{", "[")):
            return _robot_from_table(name or path.stem, content, stated)
        document = _parse_document(content)
        if not (isinstance(document, dict) and "description" in document):
            return robot_from_description(name or path.stem, Description("modified_dh", content), **stated)
        place_of_content = ""
        return _robot_from_document(document, name or str(document.get("name") or path.stem), stated)
    except DynidentError as error:
        # Where the file is the description itself, the pointer's first part would name a place that is not in it.
        place = error.pointer.removeprefix(place_of_content).removeprefix(str(path))
        error.detail = f"{path.name}: {f'{place}: ' if place else ''}{error.detail}"
        error.pointer, error.args = place, (error.detail,)
        raise


_PRINTED = re.compile(r"(?:[^<{]*\n)?[^\S\n]*(?:String value is:|robot_description:|data:)\s*(?=[\"'<|])")
"""What stands before a description that ROS printed: `ros2 param get` and `dump`, `ros2 topic echo`."""


def _strip_printed(content: str) -> str:
    """Return the description itself where a program of ROS printed it."""
    printed = _PRINTED.match(content)
    if printed is None:
        return content
    text = content[printed.end() :].strip().removesuffix("---").strip()
    if text.startswith('"'):
        try:
            # A quoted text goes on behind line breaks that end with a backslash; other parameters may follow.
            return str(json.JSONDecoder(strict=False).raw_decode(re.sub(r"\\\n\s*\\?", "", text))[0])
        except ValueError:
            return content
    text = text[: text.rfind(">") + 1] or text
    return text.strip("'|").replace("''", "'") if text.startswith(("'", "|")) else text


def _robot_from_table(name: str, content: str, stated: dict[str, Any]) -> Robot:
    try:
        return robot_from_description(name, Description("dh", content), **stated)
    except DynidentError as error:
        if not error.pointer.startswith(_CONTENT):
            raise
        detail = f"this is neither XML (URDF, MJCF) nor JSON; read as a Denavit-Hartenberg table: {error.detail}"
        if re.match(r"[^\n]*\b(?:t|time)[,;\t][^\n]*q_?1", content):
            detail = "this looks like a recording: the robot's description comes first, and the recordings after it"
        for beginning, reason in _NO_DESCRIPTIONS:
            if re.match(beginning, content, re.IGNORECASE):
                detail = reason
        raise DynidentError(detail, pointer=error.pointer, title=error.title) from error


_NO_DESCRIPTIONS = (
    (
        r"solid\b|(?:#[^\n]*\n|\s)*(?:mtllib|o|v)\s|ply\s",
        "this is a mesh, which has no joints: give the URDF that names it",
    ),
    (r"version https://git-lfs", "this is a pointer of Git LFS: fetch what it stands for with `git lfs pull`"),
    (r"#usda\b", "this is a stage of USD: give the URDF or MJCF that it was made from"),
    (
        r"(?:%[^\n]*\n|\s)*\w+(?:\(\d+\))?\s*=|(?:function|clear|import|from)\b",
        "this is a program: write the Denavit-Hartenberg table in it as text, a row for each joint below the words "
        '"classical" (or "modified") and a line "a alpha d theta"',
    ),
)
"""How files begin that describe no robot, and what to do."""


def _parse_document(content: str) -> Any:
    try:
        return parse_json(content, "", _ROBOT_TITLE)
    except DynidentError as error:
        raise DynidentError(f"this is neither XML (URDF, MJCF) nor JSON: {error.detail}", title=error.title) from error


def check_reads_no_others(path: Path, pointer: str) -> None:
    """Refuse a robot's file that reads others, wherever they lie: an MJCF model with includes, and xacro."""
    content = _read_description(path)
    if has_includes(content):
        raise DynidentError(
            f"{path} includes files, which may lie outside of the folder; let MuJoCo write the whole model to one "
            "file first (mj_saveLastXML)",
            pointer=pointer,
            title="Unusable MJCF",
        )
    if needs_xacro(content):
        raise DynidentError(
            f"{path} is xacro, which can read files outside of the folder; expand it first "
            "(xacro robot.xacro > robot.urdf)",
            pointer=pointer,
            title=_XACRO_TITLE,
        )


def _read_description(path: Path) -> str:
    """Return the text of a file as it is taken for a description."""
    try:
        if (content := path.read_bytes()).startswith(b"PK\x03\x04"):
            raise DynidentError(f"{path} is an archive: unpack it, and give the URDF in it", title=_ROBOT_TITLE)
        return _strip_printed(decode_document(content))
    except (OSError, UnicodeDecodeError) as error:
        raise DynidentError(f"{path} cannot be read as text: {error}", pointer=str(path), title=_ROBOT_TITLE) from error


def _robot_from_document(document: Mapping[str, Any], name: str, stated: dict[str, Any]) -> Robot:
    """Return a robot from the body of a request; the stated arguments take precedence."""
    # An unknown field is refused: a misspelt "drives" would otherwise be ignored in silence.
    expect_mapping(document, _FIELDS, "", _ROBOT_TITLE)
    # A robot that was saved from a request may hold the field without a value.
    if document.get("base_parameters_tolerance") is not None:
        raise DynidentError(
            "base_parameters_tolerance is for the list of base parameters that POST /v1/robots returns; leave it out "
            "here, and state that of an identification as choices=IdentificationChoices(tolerance=…)",
            pointer="/base_parameters_tolerance",
            title=_ROBOT_TITLE,
        )
    limits = {
        joint: _parse_limits(value, f"/limits/{joint}") for joint, value in _get_object(document, "limits").items()
    }
    for joint, stated_limits in stated["limits"].items():
        # Limits that are not stated are None and must not wipe out those of the file.
        limits[joint] = stated_limits.override(limits.get(joint, Limits()))
    drives = {
        joint: _parse_drive(value, f"/drives/{joint}") for joint, value in _get_object(document, "drives").items()
    }
    locked = {
        joint: expect_number(value, f"/locked_joints/{joint}", _ROBOT_TITLE)
        for joint, value in _get_object(document, "locked_joints").items()
    }
    gravity = document.get("gravity")
    robot = robot_from_description(
        name,
        _parse_description(document["description"]),
        limits=limits,
        drives={**drives, **stated["drives"]},
        locked_joints={**locked, **stated["locked_joints"]},
        gravity=stated["gravity"]
        or (None if gravity is None else expect_numbers(gravity, 3, "/gravity", _ROBOT_TITLE)),
        **_merge_hardware(document, stated),
    )
    if not (document.get("base") or document.get("contacts")):
        return robot
    return set_base(robot, document.get("base"), document.get("contacts") or ())


def _merge_hardware(document: Mapping[str, Any], stated: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the parts that the robot has and has not: those of the file, and those stated, which take precedence."""
    merged = {}
    for part, other in (("has", "has_not"), ("has_not", "has")):
        parts = expect_names(document.get(part) or [], f"/{part}", _ROBOT_TITLE)
        merged[part] = list(dict.fromkeys([*(name for name in parts if name not in stated[other]), *stated[part]]))
    return merged


def _get_object(document: Mapping[str, Any], field: str) -> Mapping[str, Any]:
    value = document.get(field) or {}
    if not isinstance(value, Mapping):
        raise DynidentError("Expected an object with one entry per joint.", pointer=f"/{field}", title=_ROBOT_TITLE)
    return value


def _parse_description(value: object) -> Description:
    fields = expect_mapping(value, ("format", "content"), "/description", _ROBOT_TITLE)
    form = fields.get("format")
    if form not in FORMATS.names:
        raise DynidentError(f"Expected {join_names(FORMATS.names)}.", pointer="/description/format", title=_ROBOT_TITLE)
    content = fields.get("content")
    # The table may stand in the request as JSON itself instead of as text that holds JSON.
    if form == "modified_dh" and isinstance(content, (dict, list)):
        content = json.dumps(content)
    return Description(cast(DescriptionFormat, form), expect_text(content, "/description/content", _ROBOT_TITLE))


def _parse_limits(value: object, pointer: str) -> Limits:
    names = tuple(asdict(Limits()))
    # null counts as left out, as it does in the service.
    fields = {k: v for k, v in expect_mapping(value, names, pointer, _ROBOT_TITLE).items() if v is not None}
    position = fields.pop("position", None)
    numbers: dict[str, Any] = {
        key: expect_number(item, f"{pointer}/{key}", _ROBOT_TITLE) for key, item in fields.items()
    }
    if position is not None:
        low, high = expect_numbers(position, 2, f"{pointer}/position", _ROBOT_TITLE)
        numbers["position"] = (low, high)
    with point_within(pointer):
        return Limits(**numbers)


def _parse_drive(value: object, pointer: str) -> Drive:
    fields = {k: v for k, v in expect_mapping(value, _DRIVE_FIELDS, pointer, _ROBOT_TITLE).items() if v is not None}
    coupling = fields.pop("coupling", {})
    if not isinstance(coupling, Mapping):
        raise DynidentError(
            "Expected an object of joints and numbers.", pointer=f"{pointer}/coupling", title=_ROBOT_TITLE
        )
    shares = {
        joint: expect_number(item, f"{pointer}/coupling/{joint}", _ROBOT_TITLE) for joint, item in coupling.items()
    }
    numbers = {key: expect_number(item, f"{pointer}/{key}", _ROBOT_TITLE) for key, item in fields.items()}
    # Drive itself decides whether the gain is given or made of ratio, constant and amplifier.
    with point_within(pointer):
        return Drive(**numbers, coupling=shares)
