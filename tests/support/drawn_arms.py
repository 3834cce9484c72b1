"""Arms that are drawn, what is measured on them, and mistakes that can be planted in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from support.oracles import Motion, crooked_urdf, fourier_motion, record

from dynident.recordings import Recording
from dynident.robot import Robot, robot_from_urdf
from dynident.robot.pinocchio_conversion import compute_described_torque

FloatArray = NDArray[np.float64]
LOAD = 3.0
_CENTRE = np.array([0.05, 0.0, 0.1])
_RATE = 200.0


@dataclass(frozen=True, eq=False)
class DrawnArm:
    """A serial arm, and the friction and noise (n,) of its joints in N m or N; `noise` white, of the measured torque.

    `rotors` (n,) are inertias behind the gears; `dry` gives the shape of Coulomb friction along a motion (m, n),
    between -1 and 1.
    """

    robot: Robot
    rotors: FloatArray
    coulomb: FloatArray
    viscous: FloatArray
    noise: FloatArray
    dry: Callable[[Motion], FloatArray] = lambda motion: np.sign(motion.dq)

    def torque(self, motion: Motion, robot: Robot | None = None) -> FloatArray:
        links = compute_described_torque(robot or self.robot, motion.q, motion.dq, motion.ddq, self.rotors)
        return links + self.coulomb * self.dry(motion) + self.viscous * motion.dq

    def measure(self, name: str, seed: int, tau: FloatArray | None = None, motion: Motion | None = None) -> Recording:
        """The arm along a motion of its own, with noise; `tau` (m, n) where it is another torque."""
        motion = self.motion(seed) if motion is None else motion
        clean = self.torque(motion) if tau is None else tau
        rng = np.random.default_rng([seed, 1])
        return record(self.robot, motion, clean + self.noise * rng.normal(size=clean.shape), name=name)

    def measure_loaded(self, seed: int, *, gain: float = 1.0, stated: float = LOAD) -> Recording:
        """A run with a load of `LOAD` kg on the last link, which is stated to be so heavy."""
        motion = self.motion(seed)
        loaded = self.measure("loaded", seed, gain * self.torque(motion, carrying(self.robot, LOAD)), motion)
        return replace(loaded, payload={"mass": stated})

    def motion(self, seed: int) -> Motion:
        return fourier_motion(self.robot, 20.0, _RATE, seed, fastest=0.9)


def draw_arm(seed: int) -> DrawnArm:
    """An arm of 3 to 6 joints, every fourth with a sliding one, with friction of 4 to 8 % of what gravity asks for."""
    n = 3 + seed % 4
    sliding = (1,) if seed % 4 == 3 else ()
    rng = np.random.default_rng([seed, 7])
    robot = robot_from_urdf(f"drawn{seed}", crooked_urdf(n, 100 + seed, sliding=sliding))
    robot = replace(robot, inertias=np.array([_lump(rng) for _ in range(n)]))
    motion = fourier_motion(robot, 10.0, 50.0, 1)
    size = np.sqrt((compute_described_torque(robot, motion.q, motion.dq, motion.ddq) ** 2).mean(axis=0))
    return DrawnArm(
        robot,
        rng.uniform(0.05, 0.2, n),
        rng.uniform(0.04, 0.08, n) * size,
        rng.uniform(0.03, 0.06, n) * size,
        rng.uniform(0.01, 0.02, n) * size,
    )


def carrying(robot: Robot, mass: float) -> Robot:
    """The robot with a point of some kg on its last link."""
    inertias = np.array(robot.inertias)
    inertias[-1] += point(mass, _CENTRE)
    return replace(robot, inertias=inertias)


def point(mass: float, place: FloatArray) -> FloatArray:
    """Inertial parameters (10,) of a point."""
    x, y, z = place
    return mass * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y, x, y, z, 1.0])


def _lump(rng: np.random.Generator) -> FloatArray:
    """Inertial parameters (10,) of a link: points in a box, which some body has for sure."""
    middle, masses = rng.uniform(-0.1, 0.1, 3), rng.uniform(0.2, 1.0, 8)
    places = middle + rng.uniform(-0.2, 0.2, (8, 3))
    return np.sum([point(mass, place) for mass, place in zip(masses, places, strict=True)], axis=0)


def dahl(motion: Motion, way: float = 0.15) -> FloatArray:
    """Friction that remembers (Dahl 1968): it is whole only `way` rad behind a reversal."""
    steps = np.diff(motion.q, axis=0, prepend=motion.q[:1])
    force, out = np.zeros(motion.q.shape[1]), np.zeros_like(motion.q)
    for k, step in enumerate(steps):
        force = force + 3.0 / way * (step - np.abs(step) * force)
        out[k] = force
    return np.clip(out, -1.0, 1.0)
