"""What comes from outside, and what the drives and sensors make of the torque. Joints are counted from 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.physics import Act, Hidden, Live, Measured, Plan


@dataclass(frozen=True)
class Offset(Hidden):
    """The torque sensor reads so much too much."""

    joint: int
    size: float

    def measure(self, measured: Measured, plan: Plan) -> None:
        measured.tau[:, self.joint] += self.size


@dataclass(frozen=True)
class GainError(Hidden):
    """The measured torque is 1 + `share` times the true one."""

    joint: int
    share: float

    def measure(self, measured: Measured, plan: Plan) -> None:
        measured.tau[:, self.joint] *= 1.0 + self.share


@dataclass(frozen=True)
class Saturation(Hidden):
    """The drive's gain falls with the torque: measured = τ (1 + `share` abs(τ) / `peak`)."""

    joint: int
    share: float
    peak: float

    def measure(self, measured: Measured, plan: Plan) -> None:
        tau = measured.tau[:, self.joint]
        measured.tau[:, self.joint] = tau * (1.0 + self.share * np.abs(tau) / self.peak)


@dataclass(frozen=True)
class Delay(Hidden):
    """The torque is recorded so late, s."""

    time: float

    def measure(self, measured: Measured, plan: Plan) -> None:
        t = measured.t
        for j in range(measured.tau.shape[1]):
            measured.tau[:, j] = np.interp(t - self.time, t, measured.tau[:, j])


@dataclass(frozen=True)
class ZeroError(Hidden):
    """The encoder reads so much too much, rad."""

    joint: int
    angle: float

    def measure(self, measured: Measured, plan: Plan) -> None:
        measured.q[:, self.joint] += self.angle


@dataclass(frozen=True)
class Contact(Hidden):
    """A force on the last link, N in the base frame at a point of the link, in a window of some runs' time."""

    force: tuple[float, float, float]
    point: tuple[float, float, float]
    runs: tuple[int, ...]
    begin: float
    end: float

    def start(self, live: Live) -> Act | None:
        if live.plan.index not in self.runs:
            return None
        body, n = int(live.model.body(f"b{live.arm.robot.n - 1}").id), round(0.1 / live.arm.step)
        first, last = round(self.begin / live.arm.step), round(self.end / live.arm.step)
        data, force, point = live.data, np.array(self.force), np.array(self.point)

        def act(step: int) -> None:
            if not first <= step <= last:
                if step == last + 1:
                    data.xfrc_applied[body] = 0.0
                return
            # Nobody pushes from one moment to the next.
            share = min(1.0, (step - first) / n, (last - step) / n)
            lever = data.xmat[body].reshape(3, 3) @ point + data.xpos[body] - data.xipos[body]
            data.xfrc_applied[body, :3] = share * force
            data.xfrc_applied[body, 3:] = np.cross(lever, share * force)

        return act


@dataclass(frozen=True)
class Vibration(Hidden):
    """The base shakes: an acceleration (m/s²) at one frequency (Hz), with a phase of the session's time in each run."""

    acceleration: tuple[float, float, float]
    frequency: float
    phases: tuple[float, ...]

    def start(self, live: Live) -> Act:
        gravity, usual = live.model.opt.gravity, live.model.opt.gravity.copy()
        shake = np.array(self.acceleration)
        rate, step_size = 2 * np.pi * self.frequency, live.arm.step
        start, phase = live.plan.start, self.phases[live.plan.index]

        def act(step: int) -> None:
            gravity[:] = usual - np.sin(rate * (start + step * step_size) + phase) * shake

        return act
