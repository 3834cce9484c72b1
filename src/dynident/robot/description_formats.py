"""Names of the formats of robot descriptions; loads no reader."""

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
