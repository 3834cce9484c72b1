"""Physics that no catalogue has. Joints are counted from 0; sizes in N m (N)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.physics import Act, Hidden, Live


@dataclass(frozen=True)
class FrictionOfAnotherPosition(Hidden):
    """The dry friction of a joint varies by `share` with where another joint stands."""

    joint: int
    other: int
    share: float
    cycles: float

    def start(self, live: Live) -> Act:
        loss, q, k, i = live.loss, live.q, live.dof[self.joint], live.dof[self.other]
        size = self.share * live.coulomb[self.joint]

        def act(_: int) -> None:
            loss[k] += size * np.sin(self.cycles * q[i])

        return act


@dataclass(frozen=True)
class RoughSpot(Hidden):
    """A narrow place of the joint's range that needs more torque, whichever way it is passed."""

    joint: int
    size: float
    place: float
    width: float

    def start(self, live: Live) -> Act:
        applied, q, k = live.applied, live.q, live.dof[self.joint]

        def act(_: int) -> None:
            applied[k] -= self.size * np.exp(-(((q[k] - self.place) / self.width) ** 2))

        return act


@dataclass(frozen=True)
class ProductOfAngles(Hidden):
    """`size` sin(2 q_joint) sin(3 q_other) on one joint."""

    joint: int
    other: int
    size: float

    def start(self, live: Live) -> Act:
        applied, q, k, i = live.applied, live.q, live.dof[self.joint], live.dof[self.other]

        def act(_: int) -> None:
            applied[k] -= self.size * np.sin(2.0 * q[k]) * np.sin(3.0 * q[i])

        return act


@dataclass(frozen=True)
class FrictionOfAcceleration(Hidden):
    """Dry friction that is larger while the joint speeds up than while it slows down, by `size` either way."""

    joint: int
    size: float
    scale: float

    def start(self, live: Live) -> Act:
        loss, v, a, k = live.loss, live.v, live.acceleration, live.dof[self.joint]
        held = 0.0

        def act(_: int) -> None:
            nonlocal held
            # The friction film takes some 20 ms to follow.
            held += 0.025 * (np.tanh(a[k] / self.scale) * np.sign(v[k]) - held)
            loss[k] += self.size * held

        return act


@dataclass(frozen=True)
class Bursts(Hidden):
    """Random torque of about `size` in a few stretches of every run: begin and end in s."""

    joint: int
    size: float
    blocks: tuple[tuple[float, float], ...]
    seed: int

    def start(self, live: Live) -> Act:
        applied, k, step_size = live.applied, live.dof[self.joint], live.arm.step
        rng = np.random.default_rng(self.seed + live.plan.index)
        # Below 6 Hz, so that the band of an identification holds it.
        rates = 2 * np.pi * rng.uniform(0.5, 6.0, 12)
        phases, sizes = rng.uniform(0, 2 * np.pi, 12), self.size * np.sqrt(2 / 12) * np.ones(12)

        def act(step: int) -> None:
            t = step * step_size
            for begin, end in self.blocks:
                if begin <= t <= end:
                    applied[k] -= float(sizes @ np.sin(rates * t + phases))

        return act


@dataclass(frozen=True)
class SpeedNotch(Hidden):
    """A narrow range of speeds, either way, at which the joint needs more torque."""

    joint: int
    size: float
    speed: float
    width: float

    def start(self, live: Live) -> Act:
        loss, v, k = live.loss, live.v, live.dof[self.joint]

        def act(_: int) -> None:
            loss[k] += self.size * np.exp(-(((abs(v[k]) - self.speed) / self.width) ** 2))

        return act
