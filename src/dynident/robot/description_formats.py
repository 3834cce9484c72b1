"""Names of the formats of robot descriptions, and kinds of bases with their coordinates; loads no reader."""

from __future__ import annotations

from typing import Literal

from dynident.schema.fields import Choice, OneOf

DescriptionFormat = Literal["urdf", "mjcf", "modified_dh", "dh"]
FORMATS = OneOf(
    Choice("urdf", "URDF"),
    Choice("mjcf", "MJCF"),
    Choice("modified_dh", "modified Denavit-Hartenberg table (JSON)"),
    Choice("dh", "Denavit-Hartenberg table, classical or modified (text)"),
)
"""All of them, the most usual first."""

BaseKind = Literal["fixed", "floating", "planar"]
"""How the root link of a robot moves: not at all, with six degrees of freedom, or in the horizontal plane."""

BASE_JOINTS: dict[BaseKind, tuple[str, ...]] = {
    "fixed": (),
    "floating": ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll"),
    "planar": ("base_x", "base_y", "base_yaw"),
}
"""Coordinates of the base, as joints in front of the robot's own: position of its frame in the world (m) and its angles
(rad), R = Rz(yaw) Ry(pitch) Rx(roll). They have no motor: their "torque" is what acts on the base from outside, as a
generalised force. The angles are singular at a pitch of ±90°."""

UPRIGHT = 1.0 - 1e-6
"""Cosine of the angle between the vertical and the z axis of a root link that stands upright; numbers are rounded."""
