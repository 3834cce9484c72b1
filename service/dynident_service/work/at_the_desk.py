"""What requests have computed while they wait: plain values in, plain values out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dynident.recordings import RecordingError
from dynident_service.adapters.measurements import describe_recording, import_file, problem_with_file
from dynident_service.adapters.robots import base_parameters_of, describe_robot, robot_from_request, robot_of
from dynident_service.models.common import plain
from dynident_service.models.measurements import MeasurementMetadata
from dynident_service.models.robots import RobotRequest
from dynident_service.problems import ProblemError


def describe(request: Mapping[str, Any]) -> dict[str, Any]:
    """Describe a robot: its joints and its base parameters."""
    body = RobotRequest.model_validate(request)
    robot = robot_from_request(body)
    return plain(describe_robot(robot, base_parameters_of(robot, body.base_parameters_tolerance)))


def import_measurement(
    source: str, destination: str, robot: Mapping[str, Any], metadata: Mapping[str, Any], sha256: str
) -> dict[str, Any]:
    """Check a file, write its recording, and describe it."""
    from pathlib import Path

    said = MeasurementMetadata.model_validate(metadata)
    try:
        recording, checks = import_file(Path(source), Path(destination), robot_of(robot), said)
    except RecordingError as error:
        raise ProblemError.of(problem_with_file(error)) from error
    return plain(describe_recording(recording, checks, sha256))
