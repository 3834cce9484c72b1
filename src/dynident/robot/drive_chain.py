"""Drive chains whose motors act on several joints, as in the wrists of many arms (§12.3.6, chapter 9)."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.robot.model import Robot


def coupling_matrix(robot: Robot) -> FloatArray | None:
    """Return the coupling C of motors and joints: motor j turns with Σ C_jk q̇_k times its gear ratio.

    The power of the motors equals that of the joints, so the joint torques are Γ = Cᵀ diag(g) u, with the drive gains
    g of [12.17] and the currents u. The diagonal is one: the gains of [12.17] hold for the motor's own joint.

    Parameters
    ----------
    robot : Robot

    Returns
    -------
    ndarray (n, n) or None
        None where every motor moves one joint only.
    """
    if not any(drive.coupling for drive in robot.drives):
        return None
    matrix = np.eye(robot.n)
    for j, drive in enumerate(robot.drives):
        for name, share in drive.coupling.items():
            matrix[j, robot.joint_names.index(name)] = share
    return matrix


def compute_currents(robot: Robot, tau: FloatArray) -> FloatArray:
    """Return the currents (m, n) that give joint torques tau (m, n); NaN where a drive gain is not known."""
    gains = np.array([drive.gain or np.nan for drive in robot.drives])
    matrix = coupling_matrix(robot)
    # Γ = Cᵀ diag(g) u, solved for u.
    motors = tau if matrix is None else np.linalg.solve(matrix.T, tau.T).T
    return np.asarray(motors / gains)
