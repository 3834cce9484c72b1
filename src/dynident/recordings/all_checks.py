"""Run all checks of a recording without a robot's dynamics, and decide whether it can be used."""

from __future__ import annotations

from dataclasses import replace

from dynident.errors import Remedy
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_source import RawSample
from dynident.recordings.metadata_revisions import adapt_cures
from dynident.recordings.position_checks import check_motion
from dynident.recordings.recording import JointLimits, ModelChecks, Recording
from dynident.recordings.recording_metadata import ACCEPTED, Check, RecordingError, RecordingMetadata
from dynident.recordings.torque_checks import check_torque


def run_checks(
    recording: Recording,
    sample: RawSample,
    layout: Layout,
    limits: tuple[JointLimits, ...],
    earlier_checks: tuple[Check, ...],
    metadata: RecordingMetadata,
    against: ModelChecks | None = None,
) -> tuple[Check, ...]:
    """Run the checks of motion and torque, and take them together with those made while reading.

    Findings of checks that the user has accepted by name count as warnings, and are marked.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    sample : RawSample
        Raw rows from all over the recording.
    layout : Layout
        The columns of the file, matched with the joints.
    limits : tuple of JointLimits
        Limits of the n joints, as far as they are known.
    earlier_checks : tuple of Check
        Made while the file was read: time, columns, conditioning.
    metadata : RecordingMetadata
        What the user says of the file.
    against : ModelChecks, optional
        What a model of the robot says of order and signs of the columns.

    Returns
    -------
    tuple of Check
        All checks, the earlier ones first.

    Raises
    ------
    RecordingError
        For the first finding that makes the file unusable; its `checks` hold all of them.
    """
    accept = metadata.accept
    checks = list(earlier_checks)
    checks += check_motion(recording, sample, layout, limits)
    # Wrong units would only make the evidence of torque against motion misleading.
    if not any(check.status == "error" for check in _mark_accepted(checks, accept)):
        checks += check_torque(recording, sample, layout, limits, against)
    # Positions beyond limits are what other zeros, or an exchange, look like: what is known of them goes first.
    checks.sort(key=lambda check: (check.name, check.status) == ("position_unit", "warning"))
    # A check sees the recording as it was read: its cure is put in terms of the file, whose order and signs may be
    # stated already.
    final_checks = adapt_cures(_mark_accepted(checks, accept), metadata, recording.joint_names)
    wrong = [check for check in final_checks if check.status == "error"]
    if wrong:
        first, remedy = wrong[0], Remedy("accept", (wrong[0].name,))
        raise RecordingError(
            f"{first.detail} If the recording is right, say {remedy}.",
            pointer=first.column,
            title=first.name.replace("_", " ").capitalize(),
            row=first.row,
            time=first.time,
            checks=final_checks,
            remedies=(*first.remedies, remedy),
        )
    return final_checks


def _mark_accepted(checks: list[Check], accept: tuple[str, ...]) -> tuple[Check, ...]:
    return tuple(
        replace(check, status="warning", detail=f"{check.detail}{ACCEPTED}")
        if check.status != "ok" and check.name in accept and not check.is_accepted
        else check
        for check in checks
    )
