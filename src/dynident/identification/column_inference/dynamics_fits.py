"""Fit a robot's dynamics to the columns of a sample, and check them as the import of the whole file will."""

from __future__ import annotations

import re

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.identification.column_inference.column_groups import ColumnGroup
from dynident.identification.column_inference.column_statistics import Sample, fill_gaps
from dynident.identification.column_inference.proposal import Guess
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.fault_search import measure_unexplained_share
from dynident.identification.recording_faults.filtered_motion import filter_motion
from dynident.identification.study.poses import measure_unexplained_at_rest
from dynident.recordings import Check, JointLimits, RecordedJoints, Recording, recording_from_arrays
from dynident.recordings.importing import condition_arrays
from dynident.recordings.metadata import RecordingError
from dynident.recordings.time_columns import RunLabels
from dynident.robot import Robot


def condition_sample(
    fits: DynamicsFits, rows: Sample, position: ColumnGroup, effort: ColumnGroup, q: FloatArray
) -> tuple[FloatArray, list[Guess]]:
    """Correct positions as an import will, and report the corrections.

    Parameters
    ----------
    fits : DynamicsFits
        Fits of the robot to the sample.
    rows : Sample
        The rows with a time.
    position, effort : ColumnGroup
        Columns of the positions, and of the torques or currents.
    q : (m, n)
        Positions in rad or m.

    Returns
    -------
    tuple of array (m, n) and guesses
    """
    positions, efforts = list(position.columns), list(effort.columns)
    known = np.where(np.isfinite(rows.values[:, positions]), q, np.nan)
    try:
        right, _, checks = fits.condition_signals(known, rows.values[:, efforts])
    except RecordingError:
        # An error here is about the time, which is asked about elsewhere.
        return q, []
    joints = fits.robot.joint_names
    names = dict(zip((f"q_{name}" for name in joints), positions, strict=True))
    names |= dict(zip((f"tau_{name}" for name in joints), efforts, strict=True))
    put_right = []
    for check in checks:
        if check.status != "ok":
            detail = check.detail
            for ours, column in names.items():
                # The checks use the names of a stored recording; the user knows only the file's.
                detail = re.sub(rf"(?<!\w){re.escape(ours)}(?!\w)", rows.names[column], detail)
            put_right.append(Guess(f"rows/{check.name}", "corrected", 0.95, detail))
    return fill_gaps(right), put_right


FEWEST_ROWS = 200
"""Rows below which a motion is too short to be filtered and fitted."""
FEWEST_POSES = 10
"""Poses below which gravity is not fitted: a six-axis arm has ten parameters of gravity, and six torques a pose."""


class DynamicsFits:
    """Fits of a robot to the columns of a sample with the times t (m,) in s."""

    def __init__(self, robot: Robot, t: FloatArray, segment: FloatArray | None = None) -> None:
        self.robot = robot
        self._t = t
        self._segment = RunLabels().label_rows(0, t) if segment is None else segment.astype(np.int64)

    def to_recording(self, q: FloatArray, tau: FloatArray) -> Recording | None:
        """Return the sample as a recording; None where it is too short.

        Parameters
        ----------
        q, tau : (m, n)
            Positions in rad or m, and torques in any unit.
        """
        if len(self._t) < FEWEST_ROWS:
            return None
        try:
            q, tau, _ = self.condition_signals(q, tau)
            good = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
            segment = self._segment[good]
            return recording_from_arrays(
                self._t[good], q[good], tau[good], joint_names=self.robot.joint_names, segment=segment
            )
        except DynidentError:
            return None

    def condition_signals(self, q: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray, tuple[Check, ...]]:
        """Correct positions (m, n) in rad or m and torques (m, n) as an import does, and return the checks about it."""
        limits = [
            JointLimits(joint.kind, joint.limits.position, joint.limits.velocity, joint.limits.effort)
            for joint in self.robot.joints
        ]
        return condition_arrays(self._t, q, tau, RecordedJoints(self.robot.joint_names, limits), self._segment)

    def to_motion(self, q: FloatArray, tau: FloatArray) -> Motion | None:
        """Return the filtered rows of positions (m, n) in rad or m and torques (m, n); None where there are too few.

        Parameters
        ----------
        q : (m, n)
            Positions in rad or m.
        tau : (m, n)
            Torques in any unit.
        """
        recording = self.to_recording(q, tau)
        return None if recording is None else filter_motion(recording)

    def measure_unexplained(self, q: FloatArray, tau: FloatArray) -> float | None:
        """Return the unexplained share of an average joint's torque; None where it cannot be told.

        Parameters
        ----------
        q, tau : (m, n)
            Positions in rad or m, and torques in any unit.
        """
        motion = self.to_motion(q, tau)
        # A sample in which nothing moves explains any torque by constants.
        if motion is None or not len(motion.q) or not (np.ptp(motion.q, axis=0) > 0).any():
            return None
        unexplained = measure_unexplained_share(self.robot, motion)
        return unexplained if np.isfinite(unexplained) else None


class PoseFits(DynamicsFits):
    """Fits of a robot to poses at which it stands, a row each."""

    def to_recording(self, q: FloatArray, tau: FloatArray) -> Recording | None:
        """Return None: there is no motion."""
        return None

    def measure_unexplained(self, q: FloatArray, tau: FloatArray) -> float | None:
        """Return the share of the torque that gravity and constant torques leave; None where rows are too few."""
        good = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
        if good.sum() < FEWEST_POSES:
            return None
        return measure_unexplained_at_rest(self.robot, q[good], tau[good])
