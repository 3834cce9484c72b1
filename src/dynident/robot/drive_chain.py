"""Drive chains whose motors act on several joints, as in the wrists of many arms (§12.3.6, chapter 9)."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.robot.model import Robot


def coupling_matrix(robot: Robot) -> FloatArray | None:
    """C (n, n), so that motor j turns with Σ C_jk q̇_k times its gear ratio; None where every motor moves one joint.

    By the power that the motors give, the torques of the joints are Γ = Cᵀ diag(g) u, with g the drive gains [12.17]
    and u the currents. Its diagonal is one: the gains of [12.17] hold for the motor's own joint.
    """
    if not any(drive.coupling for drive in robot.drives):
        return None
    matrix = np.eye(robot.n)
    for j, drive in enumerate(robot.drives):
        for name, share in drive.coupling.items():
            matrix[j, robot.joint_names.index(name)] = share
    return matrix


def currents_of(robot: Robot, tau: FloatArray) -> FloatArray:
    """Currents (m, n) that give joint torques tau (m, n); not a number where a drive gain is not known."""
    gains = np.array([drive.gain or np.nan for drive in robot.drives])
    matrix = coupling_matrix(robot)
    motors = tau if matrix is None else np.linalg.solve(matrix.T, tau.T).T
    return np.asarray(motors / gains)
