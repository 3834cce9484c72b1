"""What an effect may do to an arm: change what it is built of, act on it while it moves, change what is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from engine.scene import Arm, FloatArray, Scene, dof_of

Act = Callable[[int], None]
"""Called before every step of the engine with the step's number."""


@dataclass(frozen=True)
class Plan:
    """One run of a session: its number, counted from 0, and the session's time when it starts, in s."""

    index: int = 0
    start: float = 0.0


@dataclass(frozen=True, eq=False)
class Live:
    """An arm that moves. `dof` (n,) are the addresses of the motors; `coulomb` (n,) their dry friction.

    Effects add to `loss` (dry friction that the engine is to apply) and `applied` (torque on the dof), which are set
    anew before every step, and read `q`, `v`, `acceleration` of the engine's degrees of freedom. What they note of
    every step under a name of their own in `notes` they find again when it is measured.
    """

    arm: Arm
    plan: Plan
    model: mujoco.MjModel
    data: mujoco.MjData
    dof: NDArray[np.intp]
    loss: FloatArray
    applied: FloatArray
    q: FloatArray
    v: FloatArray
    acceleration: FloatArray
    coulomb: FloatArray
    notes: dict[str, list[float]]
    _inertial: FloatArray = field(repr=False)

    @classmethod
    def of(cls, arm: Arm, plan: Plan, model: mujoco.MjModel, data: mujoco.MjData) -> Live:
        """The views of an engine."""
        dof = np.array([dof_of(model, j) for j in range(arm.robot.n)])
        return cls(
            arm, plan, model, data, dof, model.dof_frictionloss, data.qfrc_applied, data.qpos, data.qvel, data.qacc,
            arm.drives.coulomb, {}, np.zeros(model.nv),
        )  # fmt: skip

    def load(self, joint: int) -> float:
        """The torque that the links ask of a joint, without its rotor and friction, a step ago."""
        k = self.dof[joint]
        mujoco.mj_mulM(self.model, self.data, self._inertial, self.acceleration)
        rotor = self.model.dof_armature[k] * self.acceleration[k]
        return float(self._inertial[k] - rotor + self.data.qfrc_bias[k])


@dataclass(eq=False)
class Measured:
    """What the instruments see at every step of the engine, before noise: t (m,), q, tau (m, n), temperature."""

    t: FloatArray
    q: FloatArray
    tau: FloatArray
    temperature: FloatArray | None = None
    notes: dict[str, list[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Hidden:
    """An effect. Joints are counted from 0. What it does not override it leaves alone."""

    def build(self, scene: Scene, plan: Plan) -> None:
        """Change what the arm is built of in this run."""

    def start(self, live: Live) -> Act | None:
        """What acts on the arm while it moves."""
        return None

    def measure(self, measured: Measured, plan: Plan) -> None:
        """Change what the instruments see."""
