"""Gears between motor and link that are not rigid; the encoder is on the motor. Joints are counted from 0."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from engine.physics import Act, Hidden, Live, Measured, Plan
from engine.scene import Scene


@dataclass(frozen=True)
class SoftJoint(Hidden):
    """The gear is a spring of `stiffness` N m/rad with little `damping`; the link can vibrate on it."""

    joint: int
    stiffness: float
    damping: float

    def build(self, scene: Scene, plan: Plan) -> None:
        stiffness, damping = float(self.stiffness), float(self.damping)
        scene.soft[self.joint] = f'stiffness="{stiffness!r}" damping="{damping!r}"'

    def start(self, live: Live) -> Act | None:
        k = _gear(live, self.joint)
        live.q[k] = -live.data.qfrc_bias[k] / self.stiffness
        return None


@dataclass(frozen=True)
class Backlash(Hidden):
    """The link is free to move by `gap` (rad) behind the motor, between hard stops."""

    joint: int
    gap: float
    damping: float

    def build(self, scene: Scene, plan: Plan) -> None:
        half, damping = float(self.gap) / 2, float(self.damping)
        scene.soft[self.joint] = (
            f'limited="true" range="{-half!r} {half!r}" damping="{damping!r}" '
            f'solreflimit="{4 * scene.step!r} 1" solimplimit="0.999 0.9999 1e-5 0.5 2"'
        )

    def start(self, live: Live) -> Act | None:
        k = _gear(live, self.joint)
        live.q[k] = -np.sign(live.data.qfrc_bias[k]) * self.gap / 2
        return None


@dataclass(frozen=True)
class Sag(Hidden):
    """The motor is ahead of a link that follows at once.

    It is ahead by `compliance` (rad per N m) times the load, and by half of the `gap` (rad) on the side of the load,
    over a load of `width` N m.
    """

    joint: int
    compliance: float = 0.0
    gap: float = 0.0
    width: float = 1.0

    def start(self, live: Live) -> Act:
        loads = live.notes.setdefault(f"load {self.joint}", [])

        def act(_: int) -> None:
            loads.append(live.load(self.joint))

        return act

    def measure(self, measured: Measured, plan: Plan) -> None:
        # Every load is that of the step before.
        load = np.array(measured.notes[f"load {self.joint}"])
        load = np.append(load[1:], load[-1])
        measured.q[:, self.joint] += self.compliance * load + 0.5 * self.gap * np.tanh(load / self.width)


def _gear(live: Live, joint: int) -> int:
    """The degree of freedom behind a motor, in an arm at its first posture."""
    mujoco.mj_forward(live.model, live.data)
    return int(live.model.joint(f"e{joint}").dofadr[0])
