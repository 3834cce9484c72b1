"""Friction of every kind, on the motor's side of a joint. Joints are counted from 0; sizes in N m (N), rad (m), s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.physics import Act, Hidden, Live, Measured, Plan
from engine.scene import FloatArray
from engine.temperature import Warming


@dataclass(frozen=True)
class AsymmetricCoulomb(Hidden):
    """Dry friction that is larger by `excess` forward and smaller by as much backward."""

    joint: int
    excess: float

    def start(self, live: Live) -> Act:
        applied, k = live.applied, live.dof[self.joint]

        def act(_: int) -> None:
            applied[k] -= self.excess

        return act


@dataclass(frozen=True)
class AsymmetricViscous(Hidden):
    """`size` abs(v)."""

    joint: int
    size: float

    def start(self, live: Live) -> Act:
        applied, v, k = live.applied, live.v, live.dof[self.joint]

        def act(_: int) -> None:
            applied[k] -= self.size * abs(v[k])

        return act


@dataclass(frozen=True)
class Stribeck(Hidden):
    """`excess` exp(-abs(v/speed)^exponent) beside the Coulomb friction."""

    joint: int
    excess: float
    speed: float
    exponent: float = 2.0

    def start(self, live: Live) -> Act:
        loss, v, k = live.loss, live.v, live.dof[self.joint]

        def act(_: int) -> None:
            loss[k] += self.excess * np.exp(-(abs(v[k] / self.speed) ** self.exponent))

        return act


@dataclass(frozen=True)
class PowerViscous(Hidden):
    """`size` abs(v)^power against the motion."""

    joint: int
    size: float
    power: float

    def start(self, live: Live) -> Act:
        loss, v, k = live.loss, live.v, live.dof[self.joint]

        def act(_: int) -> None:
            loss[k] += self.size * abs(v[k]) ** self.power

        return act


@dataclass(frozen=True)
class LoadFriction(Hidden):
    """(`coulomb` + `viscous` abs(v)) abs(load): gear friction that grows with what the gear carries."""

    joint: int
    coulomb: float
    viscous: float = 0.0

    def start(self, live: Live) -> Act:
        loss, v, k = live.loss, live.v, live.dof[self.joint]

        def act(_: int) -> None:
            loss[k] += (self.coulomb + self.viscous * abs(v[k])) * abs(live.load(self.joint))

        return act


@dataclass(frozen=True)
class PositionFriction(Hidden):
    """The joint's dry friction times 1 + `share` sin(cycles q + phase)."""

    joint: int
    share: float
    cycles: float
    phase: float

    def start(self, live: Live) -> Act:
        loss, q, k = live.loss, live.q, live.dof[self.joint]
        size = self.share * live.coulomb[self.joint]

        def act(_: int) -> None:
            loss[k] += size * np.sin(self.cycles * q[k] + self.phase)

        return act


@dataclass(frozen=True)
class TemperatureFriction(Hidden):
    """Friction that changes by `viscous` v + `coulomb` sign(v) a kelvin above 25 degC, as far as it stays friction."""

    joint: int
    viscous: float
    coulomb: float
    warming: Warming

    def start(self, live: Live) -> Act:
        loss, v, k = live.loss, live.v, live.dof[self.joint]
        step_size, n = live.arm.step, live.arm.robot.n
        start, index = live.plan.start, live.plan.index
        # Temperatures change slowly: one value every 0.1 s.
        every = round(0.1 / step_size)
        table = self.warming.at(start + 0.1 * np.arange(6000, dtype=np.float64), start, index, n)[:, self.joint] - 25.0

        def act(step: int) -> None:
            loss[k] += table[step // every] * (self.coulomb + self.viscous * abs(v[k]))

        return act

    def measure(self, measured: Measured, plan: Plan) -> None:
        measured.temperature = self.warming.at(measured.t, plan.start, plan.index, measured.q.shape[1])


@dataclass(frozen=True)
class WarmUpFriction(Hidden):
    """exp(-t / `time`) (`viscous` v + `coulomb` sign(v)), t the session's time."""

    joint: int
    viscous: float
    coulomb: float
    time: float

    def start(self, live: Live) -> Act:
        loss, v, k, start, step_size = live.loss, live.v, live.dof[self.joint], live.plan.start, live.arm.step

        def act(step: int) -> None:
            decay = np.exp(-(start + step * step_size) / self.time)
            loss[k] += decay * (self.coulomb + self.viscous * abs(v[k]))

        return act


@dataclass(frozen=True)
class Dahl(Hidden):
    """The joint's dry friction follows Dahl's law with the distance `slip`."""

    joint: int
    slip: float

    def start(self, live: Live) -> Act:
        loss, applied, v, k = live.loss, live.applied, live.v, live.dof[self.joint]
        size, span, state = live.coulomb[self.joint], live.arm.step / self.slip, 0.0

        def act(_: int) -> None:
            nonlocal state
            speed = v[k]
            if speed:
                # Exact over a step of constant velocity.
                direction = 1.0 if speed > 0 else -1.0
                state = direction - (direction - state) * np.exp(-abs(speed) * span)
            loss[k] = 1e-9
            applied[k] -= size * state

        return act


@dataclass(frozen=True)
class MaxwellSlip(Hidden):
    """The joint's dry friction is that of springs in parallel, each of which slips after its own distance.

    `shares` of the friction add up to 1.
    """

    joint: int
    slips: tuple[float, ...]
    shares: tuple[float, ...]

    def start(self, live: Live) -> Act:
        loss, applied, v, k = live.loss, live.applied, live.v, live.dof[self.joint]
        pull: FloatArray = live.coulomb[self.joint] * np.array(self.shares)
        pace: FloatArray = live.arm.step / np.array(self.slips)
        state = np.zeros(len(pull))

        def act(_: int) -> None:
            state[:] = np.minimum(np.maximum(state + v[k] * pace, -1.0), 1.0)
            loss[k] = 1e-9
            applied[k] -= pull @ state

        return act
