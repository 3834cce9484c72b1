"""A user's file as a recording of a robot: with its joints, drive gains and limits, and held against its dynamics."""

from __future__ import annotations

from pathlib import Path

from dynident.identification.mistakes import checks_against
from dynident.progress import Progress, silent
from dynident.recordings import Check, JointLimits, Recording, RecordingMetadata, import_recording
from dynident.robot import Robot, coupling_matrix


def import_for_robot(
    robot: Robot, source: Path, destination: Path, metadata: RecordingMetadata, progress: Progress = silent
) -> tuple[Recording, tuple[Check, ...]]:
    """Check a file and store it as a canonical Parquet file.

    Raises
    ------
    RecordingError
        For a file that cannot be used, as `import_recording` says.
    """
    return import_recording(
        source,
        destination,
        joint_names=robot.joint_names,
        gains=[drive.gain for drive in robot.drives],
        coupling=coupling_matrix(robot),
        metadata=metadata,
        limits=[JointLimits(j.kind, j.limits.position, j.limits.velocity, j.limits.effort) for j in robot.joints],
        against=checks_against(robot),
        progress=progress,
    )
