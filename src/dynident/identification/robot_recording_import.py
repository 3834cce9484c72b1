"""Import a user's file as a recording of a robot, and check it against the robot's dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dynident.identification.recording_faults import build_dynamics_checks
from dynident.progress import Progress, ignore_progress
from dynident.recordings import (
    Check,
    JointLimits,
    RecordedJoints,
    Recording,
    RecordingError,
    RecordingMetadata,
    Revision,
    import_recording,
)
from dynident.robot import Robot, coupling_matrix


def build_recorded_joints(robot: Robot) -> RecordedJoints:
    """Return what the columns of a robot's recordings stand for: its joints with their limits, gains and coupling.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    RecordedJoints
        The joints with their limits, gains and coupling.
    """
    return RecordedJoints(
        robot.joint_names,
        limits=[JointLimits(j.kind, j.reach, j.limits.velocity, j.limits.effort) for j in robot.joints],
        gains=[drive.gain for drive in robot.drives],
        coupling=coupling_matrix(robot),
    )


def import_for_robot(
    robot: Robot, source: Path, destination: Path, metadata: RecordingMetadata, progress: Progress = ignore_progress
) -> tuple[Recording, tuple[Check, ...]]:
    """Check a file and store it as a canonical Parquet file.

    Parameters
    ----------
    robot : Robot
        The robot.
    source, destination : Path
        The user's file, and the Parquet file to write.
    metadata : RecordingMetadata
        How the file is to be read.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    tuple of Recording and its checks

    Raises
    ------
    RecordingError
        For a file that cannot be used, as `import_recording` says.
    """
    return import_recording(
        source,
        destination,
        build_recorded_joints(robot),
        metadata=metadata,
        against=build_dynamics_checks(robot),
        progress=progress,
    )


MOST_CURES = 5
"""Faults that are mended one after the other; a file with more of them is not what it is said to be."""


@dataclass(frozen=True, eq=False)
class CuredRecording:
    """A recording that may have been refused at first, and the cures that made it usable.

    Parameters
    ----------
    recording : Recording
        The recording as it was read at last.
    checks : tuple of Check
        Its checks, with a note for each cure.
    revisions : tuple of Revision
        The cures, in the order in which they were applied.
    metadata : RecordingMetadata
        How the file was read at last.
    """

    recording: Recording
    checks: tuple[Check, ...]
    revisions: tuple[Revision, ...]
    metadata: RecordingMetadata


def import_cured(
    robot: Robot,
    source: Path,
    destination: Path,
    metadata: RecordingMetadata,
    progress: Progress = ignore_progress,
    *,
    most: int = MOST_CURES,
) -> CuredRecording:
    """Import a file; where it is refused with a cure, read it again with that cure.

    A warning stays one: nothing is changed that could be used as it is.

    Parameters
    ----------
    robot : Robot
        The robot.
    source, destination : Path
        The user's file, and the Parquet file to write.
    metadata : RecordingMetadata
        How the file is to be read.
    progress : Progress
        Called with the fraction done and a message.
    most : int
        Largest number of cures, one after the other; none with 0.

    Returns
    -------
    CuredRecording
        The recording, its checks, and the cures.

    Raises
    ------
    RecordingError
        For a file that cannot be used and whose checks know no cure, or too many.
    """
    done: list[Revision] = []
    while True:
        try:
            recording, checks = import_for_robot(robot, source, destination, metadata, progress)
        except RecordingError as error:
            # One cure at a time: the next reading tells whether the other errors were only its consequence.
            cure = next(
                (check.apply for check in error.checks if check.status == "error" and check.apply is not None), None
            )
            # Without a cure, or after too many, the user has to see the error itself.
            if cure is None or len(done) == most:
                raise
            done.append(cure)
            metadata = cure.apply_to(metadata)
            continue
        notes = [Check("cure", "warning", f"Read with this correction: {revision}.") for revision in done]
        return CuredRecording(recording, (*checks, *notes), tuple(done), metadata)
