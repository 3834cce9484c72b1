"""Recordings of a UR10 with one effect that the plain model lacks, each written in numpy on Pinocchio's torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from support.oracles import FloatArray, Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import Comparison, compare
from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing, Recording
from dynident.robot import Robot

ROBOT = arm("ur10")
NAMES = ROBOT.joint_names
EFFORT = np.array([joint.limits.effort for joint in ROBOT.joints])
NOISE = 0.005 * EFFORT
BAND = Preprocessing(10.0, 10.0, 5)
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
WITH_OFFSET = (*PLAIN, EffectChoice("offset"))

Hidden = Callable[[Motion, FloatArray], FloatArray]
"""From a motion and its rigid-body torque (m, n) to the torque (m, n) that is added."""


def on_joint(joint: int, law: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]) -> Hidden:
    """Torque law(q, v, load) on one joint."""

    def added(motion: Motion, load: FloatArray) -> FloatArray:
        tau = np.zeros_like(load)
        tau[:, joint] = law(motion.q[:, joint], motion.dq[:, joint], load[:, joint])
        return tau

    return added


def hysteresis(q: FloatArray, slip: float) -> FloatArray:
    z = np.zeros(len(q))
    for k in range(1, len(q)):
        z[k] = min(1.0, max(-1.0, z[k - 1] + (q[k] - q[k - 1]) / slip))
    return z


def tilted(motion: Motion, load: FloatArray) -> FloatArray:
    angle = np.deg2rad(1.5)
    gravity = 9.81 * np.array([np.sin(angle), 0.5 * np.sin(angle), -np.cos(angle)])
    leaning = Robot(ROBOT.name, ROBOT.joints, gravity, ROBOT.drives, ROBOT.description, ROBOT.inertias)
    return pinocchio_torque(leaning, motion.q, motion.dq, motion.ddq) - load


def coupled(motion: Motion, load: FloatArray) -> FloatArray:
    speed = motion.dq[:, 4] + motion.dq[:, 5]
    shared = 2.5 * np.sign(speed) + 1.2 * speed
    tau = np.zeros_like(load)
    tau[:, 4], tau[:, 5] = shared, shared
    return tau


@dataclass(frozen=True)
class Case:
    """What is hidden, where, and the model that lacks it."""

    effect: str
    joint: int | None
    hidden: Hidden
    effects: tuple[EffectChoice, ...] = WITH_OFFSET

    @property
    def joints(self) -> list[int]:
        if self.joint is None:
            return list(range(ROBOT.n))
        return [self.joint, self.joint + 1] if self.effect == "transmission_coupling" else [self.joint]


CASES = {
    case.effect: case
    for case in (
        Case("offset", 1, on_joint(1, lambda q, v, load: 0.02 * EFFORT[1] + 0 * q), PLAIN),
        Case("stribeck", 1, on_joint(1, lambda q, v, load: 9.0 * np.exp(-((v / 0.12) ** 2)) * np.sign(v))),
        Case("viscous_nonlinear", 0, on_joint(0, lambda q, v, load: 9.0 * v * np.abs(v))),
        Case("load_dependent_friction", 2, on_joint(2, lambda q, v, load: 0.09 * np.abs(load) * np.sign(v))),
        Case("presliding", 3, on_joint(3, lambda q, v, load: 4.0 * hysteresis(q, 0.02))),
        Case("joint_spring", 0, on_joint(0, lambda q, v, load: 6.0 * (q + 0.3))),
        Case("torque_ripple", 3, on_joint(3, lambda q, v, load: 0.9 * np.sin(21.0 * q + 0.7))),
        Case("base_tilt", None, tilted),
        Case("transmission_coupling", 4, coupled),
    )
}


@cache
def motions(seed: int) -> tuple[Motion, Motion]:
    """One motion to learn from and another to be tried on."""
    return fourier_motion(ROBOT, 40.0, 200.0, 100 + seed), fourier_motion(ROBOT, 20.0, 200.0, 200 + seed)


def nothing(motion: Motion, load: FloatArray) -> FloatArray:
    return np.zeros_like(load)


def drives(motion: Motion) -> FloatArray:
    """Friction and rotor inertia (m, n) that every recording has."""
    return 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq + 0.002 * EFFORT * motion.ddq


def recorded(motion: Motion, hidden: Hidden, seed: int, name: str) -> Recording:
    load = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    noise = NOISE * np.random.default_rng(seed).normal(size=load.shape)
    return record(ROBOT, motion, load + drives(motion) + hidden(motion, load) + noise, name)


@dataclass(frozen=True)
class Experiment:
    """A plain model and the recordings it was identified from and tried on."""

    identification: Identification
    training: Recording
    validation: Recording


@lru_cache(maxsize=16)
def experiment(hidden: Hidden = nothing, effects: tuple[EffectChoice, ...] = WITH_OFFSET, seed: int = 0) -> Experiment:
    learn, trial = motions(seed)
    training = recorded(learn, hidden, 10 * seed, "training")
    validation = recorded(trial, hidden, 10 * seed + 1, "validation")
    choices = IdentificationChoices(effects, preprocessing=BAND)
    return Experiment(identify(ROBOT, [training], [validation], choices), training, validation)


@cache
def floor(seed: int = 0) -> FloatArray:
    """(n,): held-out rms of the plain model where nothing is hidden: what the noise leaves."""
    clean = experiment(seed=seed).identification.held_out
    assert clean is not None
    return clean.rms


@cache
def compared() -> Comparison:
    """A clean recording beside the plain model."""
    run = experiment()
    return compare(run.identification, run.training)
