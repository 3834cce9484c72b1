"""Formats of a design's trajectory."""

from __future__ import annotations

from typing import Literal

from dynident.schema.fields import Choice, OneOf

TrajectoryFormat = Literal["csv", "parquet", "json", "ros2"]
TRAJECTORY_FORMATS = OneOf(
    Choice("csv", "CSV: t, q, dq, ddq"),
    Choice("parquet", "Parquet"),
    Choice("json", "JSON"),
    Choice("ros2", "ROS 2 JointTrajectory (YAML)"),
)
