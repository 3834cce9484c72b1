"""An arm as MuJoCo is told of it, and what comes out of a run.

What is needed for friction to be friction in MuJoCo: its friction loss is a soft constraint that by default smears
Coulomb friction over some 0.1 rad/s; a time constant of two steps and an impedance of 0.9999 make it sharp. A changed
armature counts only after mj_setConst.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from dynident.robot import Robot
from engine.drives import Drives
from engine.servos import Lag, Servo

if TYPE_CHECKING:
    from engine.physics import Hidden

FloatArray = NDArray[np.float64]

FRICTION = "0.9999 0.9999 0.001 0.5 2"
_SMALLEST_LOSS = 1e-9


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot with drives, hidden effects and a controller. `step` is the engine's, in s."""

    robot: Robot
    drives: Drives
    hidden: tuple[Hidden, ...] = ()
    servo: Servo = field(default_factory=Lag)
    step: float = 0.5e-3


@dataclass(frozen=True, eq=False)
class Run:
    """A recording.

    t (m,), q and tau (m, n) as measured; the torque without noise; the noise (n,); temperature (m, n) in degC or None.
    """

    t: FloatArray
    q: FloatArray
    tau: FloatArray
    exact_tau: FloatArray
    noise: FloatArray
    temperature: FloatArray | None = None


@dataclass
class Scene:
    """An arm as it is being put together: effects add to it before it is written as MJCF.

    placements (n, 4, 4); inertias (n, 10) as in `Robot`; gravity (3,). `soft` gives a joint's gear an attribute text
    of its own: the link then hangs on a second joint behind the motor's. `joint` are further attributes of the
    motor's joint; `sites` further elements of a link (-1: the base); `tendons` and `rest` whole elements.
    """

    robot: Robot
    drives: Drives
    step: float
    placements: FloatArray
    inertias: FloatArray
    gravity: FloatArray
    soft: dict[int, str] = field(default_factory=dict)
    joint: dict[int, str] = field(default_factory=dict)
    sites: dict[int, list[str]] = field(default_factory=dict)
    tendons: list[str] = field(default_factory=list)
    rest: list[str] = field(default_factory=list)
    rotor: FloatArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, robot: Robot, drives: Drives, step: float) -> Scene:
        """The arm of a description with its drives, nothing hidden in it."""
        assert robot.inertias is not None
        placements = np.array([joint.placement for joint in robot.joints])
        scene = cls(robot, drives, step, placements, robot.inertias.copy(), robot.gravity.copy())
        scene.rotor = drives.rotor.copy()
        return scene

    def mjcf(self) -> str:
        """The arm as MJCF: one body a joint, its frame the joint's."""
        head = [
            '<mujoco><compiler angle="radian" inertiafromgeom="false" autolimits="false"/>',
            f'<option timestep="{self.step!r}" integrator="Euler" solver="Newton" tolerance="1e-12" iterations="50"',
            f' gravity="{numbers(self.gravity)}"><flag contact="disable"/></option><worldbody>',
            *self.sites.get(-1, []),
        ]
        lines: list[str] = []
        for root in self._children(-1):
            self._write(root, lines)
        motors = [
            f'<general name="m{j}" joint="j{j}" gainprm="1" biastype="affine" biasprm="0 0 0"/>'
            for j in range(self.robot.n)
        ]
        tendons = ["</worldbody><tendon>", *self.tendons, "</tendon>"]
        return "\n".join([*head, *lines, *tendons, "<actuator>", *motors, "</actuator>", *self.rest, "</mujoco>"])

    def engine(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The compiled arm at rest."""
        model = mujoco.MjModel.from_xml_string(self.mjcf())
        for j in range(self.robot.n):
            model.dof_armature[dof_of(model, j)] = self.rotor[j]
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        return model, data

    def _children(self, parent: int) -> list[int]:
        return [index for index, joint in enumerate(self.robot.joints) if joint.parent == parent]

    def _write(self, index: int, lines: list[str]) -> None:
        joint = self.robot.joints[index]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(self.placements[index, :3, :3]).reshape(-1))
        kind = "hinge" if joint.kind == "revolute" else "slide"
        axis = f'type="{kind}" axis="{numbers(joint.axis)}"'
        motor = (
            f'<joint name="j{index}" {axis} damping="{float(self.drives.viscous[index])!r}" '
            f'frictionloss="{float(max(self.drives.coulomb[index], _SMALLEST_LOSS))!r}" '
            f'solreffriction="{2 * self.step!r} 1" solimpfriction="{FRICTION}" {self.joint.get(index, "")}/>'
        )
        place = f'pos="{numbers(self.placements[index, :3, 3])}" quat="{numbers(quaternion)}"'
        if index in self.soft:
            light = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
            lines += [f'<body name="g{index}" {place}>', light, motor]
            place, motor = "", f'<joint name="e{index}" {axis} {self.soft[index]}/>'
        lines += [f'<body name="b{index}" {place}>', inertial(self.inertias[index]), motor]
        lines += self.sites.get(index, [])
        for child in self._children(index):
            self._write(child, lines)
        lines.append("</body>")
        if index in self.soft:
            lines.append("</body>")


def dof_of(model: mujoco.MjModel, joint: int) -> int:
    """The degree of freedom of a joint's motor."""
    return int(model.joint(f"j{joint}").dofadr[0])


def inertial(values: FloatArray) -> str:
    """The inertial element of a link with the parameters (10,), which are about the joint's frame."""
    xx, xy, xz, yy, yz, zz, mx, my, mz, mass = (float(value) for value in values)
    centre = np.array([mx, my, mz]) / mass
    # About the centre of mass (Steiner).
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    full = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    return f'<inertial pos="{numbers(centre)}" mass="{mass!r}" fullinertia="{numbers(full)}"/>'


def numbers(values: Iterable[float] | FloatArray) -> str:
    """Numbers as an attribute's text."""
    return " ".join(repr(float(value)) for value in values)
