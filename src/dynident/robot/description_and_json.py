"""Read a robot from a description of any format; convert a robot to JSON and back for stored models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NotRequired, Protocol, TypedDict

from dynident.errors import DynidentError
from dynident.robot.contacts import read_contacts
from dynident.robot.description_formats import BASE_JOINTS, FORMATS, BaseKind, DescriptionFormat
from dynident.robot.dh_text import robot_from_dh_text
from dynident.robot.json_fields import join_names
from dynident.robot.limits_and_drives import Drive, Limits, check_hardware
from dynident.robot.mjcf_reader import robot_from_mjcf
from dynident.robot.modified_dh import robot_from_modified_dh
from dynident.robot.robot_model import Description, Robot
from dynident.robot.stated_settings import Settings
from dynident.robot.urdf_reader import read_urdf, robot_from_urdf

_POINTER = "/description/content"
_BASE_TITLE = "Unusable base"


class _Reader(Protocol):
    def __call__(
        self,
        name: str,
        content: str,
        /,
        *,
        limits: Mapping[str, Limits] | None,
        drives: Mapping[str, Drive] | None,
        locked_joints: Mapping[str, float] | None,
        gravity: Sequence[float] | None,
        pointer: str,
    ) -> Robot: ...


_READERS: dict[DescriptionFormat, _Reader] = {
    "urdf": robot_from_urdf,
    "modified_dh": robot_from_modified_dh,
    "mjcf": robot_from_mjcf,
    "dh": robot_from_dh_text,
}


def robot_from_description(
    name: str,
    description: Description,
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    has: Sequence[str] = (),
    has_not: Sequence[str] = (),
) -> Robot:
    """Return the robot of a description, with settings that override or complete it.

    Parameters
    ----------
    name : str
        Name of the robot.
    description : Description
        A URDF, an MJCF model, a modified Denavit-Hartenberg table as JSON text (`dynident.robot.modified_dh`), or a
        classical or modified one pasted as text ("dh", `dynident.robot.dh_text`).
    limits : mapping of str to Limits, optional
        By joint; they win over the description's, field by field.
    drives : mapping of str to Drive, optional
        Drive chains [12.17], by joint.
    locked_joints : mapping of str to float, optional
        Positions (rad, m) of joints that no longer move; their links become part of the link before.
    gravity : sequence of float, optional
        Acceleration of gravity in the base frame (m/s²); else the description's, else (0, 0, -9.81).
    has, has_not : sequence of str
        Parts that the robot has or does not have, of `dynident.robot.stated_settings.HARDWARE`.

    Returns
    -------
    Robot
        With limits, drives and inertial parameters, as far as they are known.

    Raises
    ------
    DynidentError
        Its pointer says where: "/description/content/…", "/limits/<joint>/position", "/locked_joints/<joint>", ….
    """
    reader = _READERS.get(description.format)
    if reader is None:
        raise DynidentError(
            f"Unknown format '{description.format}'; expected {join_names(FORMATS.names)}.",
            pointer="/description/format",
            title="Unusable robot description",
        )
    check_hardware(has, has_not)
    robot = reader(
        name,
        description.content,
        limits=limits,
        drives=drives,
        locked_joints=locked_joints,
        gravity=gravity,
        pointer=_POINTER,
    )
    return replace(robot, has=tuple(has), has_not=tuple(has_not))


def list_described_joints(robot: Robot) -> list[str]:
    """Return the names of all joints that a robot's description has, those that are locked included.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    list of str
        Those of the robot alone where its description cannot be read without locking the others.
    """
    try:
        whole = robot_from_description(robot.name, robot.description) if robot.locked_joints else robot
    except DynidentError:
        whole = robot
    return list(whole.joint_names)


def set_base(robot: Robot, base: BaseKind | None = None, contacts: Sequence[str] = ()) -> Robot:
    """Return a robot whose root link moves in another way; it is read anew, and what was stated of it stays.

    Parameters
    ----------
    robot : Robot
        The robot.
    base : {"fixed", "floating", "planar"}, optional
        How its root link moves. By default as the description says: a floating joint of a URDF, or a free joint of an
        MJCF, that carries the root link makes a floating base.
    contacts : sequence of str
        Links of a robot with a floating base on which forces act that nobody measured, such as its feet: "left_foot",
        or a point of a link in its frame (m), "calf@0,0,-0.21", with the radius of a ball around it that rolls on the
        ground, "calf@0,0,-0.21,0.02". They are eliminated from its equations. "left_foot^0.03": on level ground
        nothing acts on it from 0.03 m above the lowest contact on; from twice that height on it is not eliminated. The
        height is that of the point, or of the link's frame.

    Returns
    -------
    Robot
        With the coordinates of the base in front of its joints.

    Raises
    ------
    DynidentError
        For a robot whose description has no root link, such as a Denavit-Hartenberg table, or an unusable contact.

    Examples
    --------
    >>> import dynident as dy
    >>> dy.set_base(dy.load_robot("scara"), "fixed").base
    'fixed'
    """
    if base not in (None, *BASE_JOINTS):
        raise DynidentError(
            f"The base is '{base}'; expected {join_names(BASE_JOINTS)}.", pointer="/base", title=_BASE_TITLE
        )
    if robot.description.format not in ("urdf", "mjcf"):
        if base in (None, "fixed"):
            return replace(robot, contacts=read_contacts(robot, contacts))
        raise DynidentError(
            f"A Denavit-Hartenberg table describes no root link, so its base cannot be {base}: give a URDF or an MJCF.",
            pointer="/base",
            title=_BASE_TITLE,
        )
    name, content = robot.name, robot.description.content
    limits = {joint.name: joint.limits for joint in robot.tree.joints[robot.n_base :]}
    drives = {joint.name: drive for joint, drive in zip(robot.joints, robot.drives, strict=True) if drive != Drive()}
    locked, gravity = robot.locked_joints, robot.gravity
    if robot.description.format == "urdf":
        released = read_urdf(name, content, Settings(limits, drives, locked, gravity), base, pointer=_POINTER)
    else:
        released = robot_from_mjcf(
            name,
            content,
            limits=limits,
            drives=drives,
            locked_joints=locked,
            gravity=gravity.tolist(),
            base=base,
            pointer=_POINTER,
        )
    return replace(
        released,
        has=robot.has,
        has_not=robot.has_not,
        joints_without_torque=robot.joints_without_torque,
        contacts=read_contacts(released, contacts),
    )


class DescriptionDocument(TypedDict):
    """The text that a robot was read from, and its format."""

    format: DescriptionFormat
    content: str


class LimitsDocument(TypedDict):
    """The fields of `Limits`."""

    position: tuple[float, float] | None
    velocity: float | None
    acceleration: float | None
    jerk: float | None
    effort: float | None
    power: float | None


class DriveDocument(TypedDict):
    """The fields of `Drive`."""

    drive_gain: float | None
    gear_ratio: float | None
    torque_constant: float | None
    amplifier_gain: float | None
    coupling: Mapping[str, float]


class RobotDocument(TypedDict):
    """A robot: limits and drives by joint name (only drives that differ from the default), gravity (3,) in m/s²."""

    name: str
    description: DescriptionDocument
    limits: Mapping[str, LimitsDocument]
    drives: Mapping[str, DriveDocument]
    locked_joints: Mapping[str, float]
    gravity: Sequence[float]
    joints_without_torque: NotRequired[Sequence[str]]
    has: NotRequired[Sequence[str]]
    has_not: NotRequired[Sequence[str]]
    base: NotRequired[BaseKind]
    contacts: NotRequired[Sequence[str]]


def robot_to_document(robot: Robot) -> RobotDocument:
    """Return JSON values from which `robot_from_document` builds the same robot.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    RobotDocument
        The text of the description, and the settings beside it.
    """
    document: RobotDocument = {
        "name": robot.name,
        "description": {"format": robot.description.format, "content": robot.description.content},
        "limits": {joint.name: _limits_to_document(joint.limits) for joint in robot.tree.joints[robot.n_base :]},
        "drives": {
            joint.name: _drive_to_document(drive)
            for joint, drive in zip(robot.joints, robot.drives, strict=True)
            if drive != Drive()
        },
        "locked_joints": dict(robot.locked_joints),
        "gravity": [float(value) for value in robot.gravity],
    }
    if robot.joints_without_torque:
        document["joints_without_torque"] = list(robot.joints_without_torque)
    if robot.base != "fixed":
        document["base"] = robot.base
    if robot.contacts:
        document["contacts"] = [str(contact) for contact in robot.contacts]
    if robot.has:
        document["has"] = list(robot.has)
    if robot.has_not:
        document["has_not"] = list(robot.has_not)
    return document


def robot_from_document(document: RobotDocument) -> Robot:
    """Return the robot of a document that `robot_to_document` wrote.

    Parameters
    ----------
    document : RobotDocument
        JSON values.

    Returns
    -------
    Robot
        Read from the description again.
    """
    robot = robot_from_description(
        document["name"],
        Description(**document["description"]),
        limits={name: _limits_from_document(fields) for name, fields in document["limits"].items()},
        drives={name: Drive(**fields) for name, fields in document["drives"].items()},
        locked_joints=document["locked_joints"],
        gravity=document["gravity"],
        has=document.get("has", ()),
        has_not=document.get("has_not", ()),
    )
    if "base" in document or "contacts" in document:
        robot = set_base(robot, document.get("base"), document.get("contacts", ()))
    return replace(robot, joints_without_torque=tuple(document.get("joints_without_torque", ())))


def _limits_to_document(limits: Limits) -> LimitsDocument:
    return {
        "position": limits.position,
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
        "jerk": limits.jerk,
        "effort": limits.effort,
        "power": limits.power,
    }


def _limits_from_document(fields: LimitsDocument) -> Limits:
    position = fields["position"]  # a list, where it has been JSON
    values: LimitsDocument = {**fields, "position": (position[0], position[1]) if position else None}
    return Limits(**values)


def _drive_to_document(drive: Drive) -> DriveDocument:
    return {
        "drive_gain": drive.drive_gain,
        "gear_ratio": drive.gear_ratio,
        "torque_constant": drive.torque_constant,
        "amplifier_gain": drive.amplifier_gain,
        "coupling": dict(drive.coupling),
    }
