"""What a robot can be described in: known also where nothing of the robot is read."""

from __future__ import annotations

from typing import Literal, get_args

DescriptionFormat = Literal["urdf", "mjcf", "modified_dh", "dh"]
FORMATS: tuple[DescriptionFormat, ...] = get_args(DescriptionFormat)
"""All of them, the most usual first."""
