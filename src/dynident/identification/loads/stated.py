"""The drive gains that recorded torque was computed with, where the true ones are in question."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.robot import Robot


def get_stated_gains(robot: Robot, stated: Sequence[float] | None) -> FloatArray:
    """Return the stated gains (n,): those given, else those of the robot's drives, else 1.

    Parameters
    ----------
    robot : Robot
    stated : sequence of float, optional

    Raises
    ------
    DynidentError
        Where what is given is not one number other than 0 a joint.
    """
    if stated is None:
        return np.array([1.0 if drive.gain is None else drive.gain for drive in robot.drives])
    gains = np.asarray(stated, dtype=np.float64)
    # A gain of zero would make every torque zero; a negative one is a matter of signs, and allowed.
    if gains.shape != (robot.n,) or not np.all(np.isfinite(gains) & (gains != 0)):
        raise DynidentError(
            f"the stated gains are {list(stated)}; give one number other than 0 for each of the {robot.n} joints",
            pointer="/gains",
        )
    return gains


def refuse_coupled_drives(robot: Robot, what: str) -> None:
    """Raise where a motor acts on several joints: no joint's torque is then its own current times a gain.

    Raises
    ------
    DynidentError
    """
    coupled = [name for name, drive in zip(robot.joint_names, robot.drives, strict=True) if drive.coupling]
    if coupled:
        raise DynidentError(
            f"the motors of {', '.join(coupled)} act on several joints; {what} motors of one joint each",
            pointer=f"/drives/{coupled[0]}/coupling",
            title="Coupled drives",
        )
