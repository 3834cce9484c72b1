"""What the robot's own dynamics leave of the torque when the columns are taken in one way or another."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.identification.mistakes.bands import motion_of
from dynident.identification.mistakes.search import left_of
from dynident.identification.mistakes.swaps import Motion
from dynident.identification.study.poses import left_at_rest
from dynident.recordings import Check, JointLimits, RecordedJoints, Recording, recording_from_arrays
from dynident.recordings.importing import condition_arrays
from dynident.recordings.restarts import RestartLabels
from dynident.robot import Robot

FEWEST_ROWS = 200
FEWEST_POSES = 10
"""A six-axis arm has ten parameters of gravity that six torques a pose tell."""


class Fits:
    """Fits a robot to the columns of a sample: t (m,) in s."""

    def __init__(self, robot: Robot, t: FloatArray, segment: FloatArray | None = None) -> None:
        self.robot = robot
        self._t = t
        self._segment = RestartLabels().label(0, t) if segment is None else segment.astype(np.int64)

    def recording(self, q: FloatArray, tau: FloatArray) -> Recording | None:
        """The sample as a recording of positions (m, n) in rad or m, torques (m, n); None where it is too short."""
        if len(self._t) < FEWEST_ROWS:
            return None
        try:
            q, tau, _ = self.condition(q, tau)
            good = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
            segment = self._segment[good]
            return recording_from_arrays(
                self._t[good], q[good], tau[good], joint_names=self.robot.joint_names, segment=segment
            )
        except DynidentError:
            return None

    def condition(self, q: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray, tuple[Check, ...]]:
        """Put right what an import puts right in positions (m, n) in rad or m and torques (m, n), and say what."""
        limits = [
            JointLimits(joint.kind, joint.limits.position, joint.limits.velocity, joint.limits.effort)
            for joint in self.robot.joints
        ]
        return condition_arrays(self._t, q, tau, RecordedJoints(self.robot.joint_names, limits), self._segment)

    def motion(self, q: FloatArray, tau: FloatArray) -> Motion | None:
        """Filtered rows of positions (m, n) in rad or m, torques (m, n) in any unit; None where there are too few."""
        recording = self.recording(q, tau)
        return None if recording is None else motion_of(recording)

    def left(self, q: FloatArray, tau: FloatArray) -> float | None:
        """Share of an average joint's torque that is not explained; None where it cannot be told."""
        motion = self.motion(q, tau)
        if motion is None or not len(motion.q) or not (np.ptp(motion.q, axis=0) > 0).any():
            return None
        found = left_of(self.robot, motion)
        return found if np.isfinite(found) else None


class PoseFits(Fits):
    """Fits a robot to poses at which it stands, a row each."""

    def recording(self, q: FloatArray, tau: FloatArray) -> Recording | None:
        """None: there is no motion."""
        return None

    def left(self, q: FloatArray, tau: FloatArray) -> float | None:
        """Share of the torque that gravity and constant torques do not explain; None where rows are too few to tell."""
        good = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
        if good.sum() < FEWEST_POSES:
            return None
        return left_at_rest(self.robot, q[good], tau[good])
