"""Encoders, torque sensors, sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.drives import effort_limits
from engine.physics import Measured
from engine.scene import Arm, Run

# A count of a linear encoder over one of a rotary one, m per rad.
_LINEAR = 0.1


@dataclass(frozen=True)
class Instruments:
    """Encoder counts a turn, torque noise as a share of the effort limit, samples a second."""

    counts: int = 2**19
    noise: float = 0.005
    rate: float = 1000.0

    def every(self, step: float) -> int:
        """Steps of the engine, so many seconds each, between two samples."""
        return round(1 / (self.rate * step))


def seen(exact: Measured, arm: Arm, instruments: Instruments, seed: int) -> Run:
    """What is recorded of a run."""
    every = instruments.every(arm.step)
    rng = np.random.default_rng(seed)
    noise = instruments.noise * effort_limits(arm.robot)
    linear = np.array([joint.kind == "prismatic" for joint in arm.robot.joints])
    count = 2 * np.pi / instruments.counts * np.where(linear, _LINEAR, 1.0)
    q, tau = exact.q[::every], exact.tau[::every]
    temperature = None if exact.temperature is None else np.round(exact.temperature[::every], 1)
    return Run(
        exact.t[::every],
        np.round(q / count) * count,
        tau + noise * rng.standard_normal(tau.shape),
        tau,
        noise,
        temperature,
    )
