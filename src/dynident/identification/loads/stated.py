"""The drive gains that recorded torque was computed with: what is stated, where the true ones are in question."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.robot import Robot


def stated_gains(robot: Robot, stated: Sequence[float] | None) -> FloatArray:
    """(n,): the gains that are given; those of the robot's drives where none are, 1 where it states none either.

    Raises
    ------
    DynidentError
        Where what is given is not one number other than 0 a joint.
    """
    if stated is None:
        return np.array([1.0 if drive.gain is None else drive.gain for drive in robot.drives])
    given = np.asarray(stated, dtype=np.float64)
    if given.shape != (robot.n,) or not np.all(np.isfinite(given) & (given != 0)):
        raise DynidentError(
            f"the stated gains are {list(stated)}; give one number other than 0 for each of the {robot.n} joints",
            pointer="/gains",
        )
    return given


def refuse_coupled_drives(robot: Robot, what: str) -> None:
    """Raise where a motor acts on several joints: no joint's torque is then its own current times a gain."""
    coupled = [name for name, drive in zip(robot.joint_names, robot.drives, strict=True) if drive.coupling]
    if coupled:
        raise DynidentError(
            f"the motors of {', '.join(coupled)} act on several joints; {what} motors of one joint each",
            pointer=f"/drives/{coupled[0]}/coupling",
            title="Coupled drives",
        )
