"""Robots from MJCF, MuJoCo's own format, read by Pinocchio."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from dynident.errors import DynidentError
from dynident.robot.model import Description, Drive, Limits, Robot
from dynident.robot.pinocchio_model import PinocchioModel, from_pinocchio
from dynident.robot.settings import settings_from
from dynident.robot.urdf import robot_from_urdf
from dynident.robot.urdf_writer import urdf_from_robot

TITLE = "Unusable MJCF"
_GRAVITY = (0.0, 0.0, -9.81)


def robot_from_mjcf(
    name: str,
    text: str,
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    pointer: str = "",
) -> Robot:
    """Return the robot that an MJCF model describes, on a fixed base; its description is then a URDF of that tree.

    Bodies, hinge and slide joints, inertias (stated, or of geoms), ranges and `<option gravity>` are read; armature,
    damping, actuators, tendons and equality constraints are not. The other arguments are those of `robot_from_urdf`.

    Raises
    ------
    DynidentError
        The text is not XML (line and column), names other files, or has joints of more than one degree of freedom.
    """
    root = _parsed(text, pointer)
    _name(root)
    model = _model(ElementTree.tostring(root, encoding="unicode"), pointer)
    _check_joints(model, pointer)
    tree = from_pinocchio(
        model,
        name,
        Description("urdf", ""),
        settings_from(None, None, None, None),
        described_limits=_limits(model, in_degrees=_in_degrees(root)),
        links={},
        pointer=pointer,
    )
    return robot_from_urdf(
        name,
        urdf_from_robot(tree),
        limits=limits,
        drives=drives,
        locked_joints=locked_joints,
        gravity=_gravity(root, pointer) if gravity is None else gravity,
        pointer=pointer,
    )


def _parsed(text: str, pointer: str) -> ElementTree.Element:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DynidentError("An MJCF model needs no document type; leave it out.", pointer=pointer, title=TITLE)
    try:
        root = ElementTree.fromstring(text.strip())
    except ElementTree.ParseError as error:
        line, column = error.position
        detail = f"line {line}: The XML is malformed at column {column}: {error.msg.split(':')[0]}."
        raise DynidentError(detail, pointer=pointer, title=TITLE) from error
    if root.tag != "mujoco":
        raise DynidentError(
            f"The root element is <{root.tag}>; an MJCF model's is <mujoco>.", pointer=pointer, title=TITLE
        )
    included = next(root.iter("include"), None)
    if included is not None:
        raise DynidentError(
            f"The model includes {included.get('file')}: give it in one file (MuJoCo's mj_saveLastXML writes it).",
            pointer=pointer,
            title=TITLE,
        )
    if all(root.find(f".//body//{tag}") is None for tag in ("joint", "freejoint")):
        raise DynidentError("The model has no joint that moves.", pointer=pointer, title=TITLE)
    return root


def _name(root: ElementTree.Element) -> None:
    """Give bodies and joints without a name one: Pinocchio reads them by their names."""
    for tag in ("body", "joint"):
        taken = {one.get("name") for one in root.iter(tag)}
        every = [one for world in root.iter("worldbody") for one in world.iter(tag)]
        for count, one in enumerate(every, start=1):
            if one.get("name") is None:
                called = f"{tag}{count}"
                while called in taken:
                    called += "_"
                taken.add(called)
                one.set("name", called)


def _model(text: str, pointer: str) -> PinocchioModel:
    with tempfile.TemporaryDirectory(prefix="dynident-") as folder:
        path = Path(folder) / "model.xml"
        path.write_text(text, encoding="utf-8")
        try:
            return pin.buildModelFromMJCF(str(path))
        except (ValueError, RuntimeError) as error:
            detail = f"Pinocchio cannot read the MJCF: {str(error).replace(str(path), 'model.xml')}"
            raise DynidentError(detail, pointer=pointer, title=TITLE) from error


def _check_joints(model: PinocchioModel, pointer: str) -> None:
    for name, joint in zip(tuple(model.names)[1:], tuple(model.joints)[1:], strict=True):
        if joint.nv != 1:
            raise DynidentError(
                f"Joint '{name}' has {joint.nv} degrees of freedom; expected hinge or slide joints, one a body, on a "
                "fixed base (no freejoint, no ball).",
                pointer=pointer,
                title=TITLE,
            )


def _limits(model: PinocchioModel, *, in_degrees: bool) -> dict[str, Limits]:
    found = {}
    for name, joint in zip(tuple(model.names)[1:], tuple(model.joints)[1:], strict=True):
        low, high = float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])
        if in_degrees and "P" in joint.shortname().removeprefix("JointModel")[:1]:
            # Pinocchio turns every range into radians; those of slides are in metres.
            low, high = math.degrees(low), math.degrees(high)
        bounded = joint.nq == 1 and math.isfinite(low) and math.isfinite(high) and low < high and high - low < 1e6
        effort = float(np.abs(model.effortLimit[joint.idx_v]))
        found[name] = Limits(
            position=(low, high) if bounded else None,
            effort=effort if math.isfinite(effort) and 0.0 < effort < 1e12 else None,
        )
    return found


def _in_degrees(root: ElementTree.Element) -> bool:
    """Whether angles are in degrees, as they are where no compiler says otherwise."""
    stated = [one.get("angle") for one in root.iter("compiler") if one.get("angle")]
    return not stated or stated[-1] != "radian"


def _gravity(root: ElementTree.Element, pointer: str) -> tuple[float, ...]:
    stated = next((one.get("gravity") for one in root.iter("option") if one.get("gravity")), None)
    if stated is None:
        return _GRAVITY
    try:
        return tuple(float(part) for part in stated.split())
    except ValueError as error:
        raise DynidentError(
            f"The option gravity is '{stated}'; expected three numbers.", pointer=pointer, title=TITLE
        ) from error
