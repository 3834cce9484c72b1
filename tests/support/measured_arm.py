"""A well-known arm with friction, measured along two motions by a robot whose torque Pinocchio made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.identification import Identification
from dynident.recordings import Preprocessing, Recording

ROBOT = arm("ur10")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
BAND = Preprocessing(10.0, 8.0, 3)
RATE = 100.0
IA, FC, FV = (np.linspace(a, b, ROBOT.n) for a, b in ((2.0, 0.5), (8.0, 1.5), (15.0, 2.0)))
NOISE = np.array([2.0, 2.0, 1.0, 0.5, 0.5, 0.5])


def torque_of(motion: Motion) -> np.ndarray:
    rigid = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    return rigid + IA * motion.ddq + FC * np.sign(motion.dq) + FV * motion.dq


def recorded(seed: int, duration: float, name: str, noise: float = 1.0, encoder: float = 0.0) -> Recording:
    motion = fourier_motion(ROBOT, duration, RATE, seed)
    rng = np.random.default_rng(seed)
    tau = torque_of(motion) + noise * NOISE * rng.normal(size=motion.q.shape)
    motion.q[:] += encoder * rng.normal(size=motion.q.shape)
    return record(ROBOT, motion, tau, name)


def with_values(identified: Identification, values: FloatArray) -> Identification:
    """The same model with other estimates."""
    solution = replace(identified.estimate.solution, values=values)
    return replace(identified, estimate=replace(identified.estimate, solution=solution, standard=None))
