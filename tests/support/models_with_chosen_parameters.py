"""Identified models with parameters that a test chose, and their prediction by the package's own evaluation of W."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters, count_reference_parameters
from dynident.effects.hysteresis_states import MemoryStates
from dynident.estimation import EquationFactors, Reduction, Solution, Statistics
from dynident.identification import Estimate, Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import FurtherSignals
from dynident.robot import Robot
from dynident.robot.pseudo_inertia import inertial_parameters

FloatArray = NDArray[np.float64]

PLAIN = ("rigid_body", "rotor_inertia", "coulomb", "viscous")


@cache
def measured(
    name: str = "scara", noise: float = 0.05, duration: float = 15.0, estimator: str = "wls"
) -> Identification:
    """An arm with friction and rotors, identified from one recording."""
    robot = arm(name)
    motion = fourier_motion(robot, duration, 100.0, 1)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = tau + 2 * np.sign(motion.dq) + 1.5 * motion.dq + 0.05 * motion.ddq
    tau += np.random.default_rng(1).normal(0.0, noise, tau.shape)
    choices = IdentificationChoices(
        tuple(EffectChoice(effect) for effect in PLAIN), estimator=estimator, preprocessing=Preprocessing(10.0, 8.0, 3)
    )
    return identify(robot, [record(robot, motion, tau)], [], choices)


def made_up(
    robot: Robot, effects: Sequence[EffectChoice | str], values: FloatArray | None = None, seed: int = 0
) -> Identification:
    """A model of these effects with these base parameters, or with any."""
    chosen = tuple(EffectChoice(one) if isinstance(one, str) else one for one in effects)
    model = build_model(robot, chosen)
    rng = np.random.default_rng(seed)
    if values is None:
        values = rng.uniform(0.2, 2.0, model.n_parameters) * rng.choice([-1.0, 1.0], model.n_parameters)
    known = measured()
    count = model.n_parameters
    factor = np.eye(count + 1)
    factor[:count, -1], factor[-1, -1] = values, 1e-3
    rows = EquationFactors(np.arange(count), factor[None], np.array([1000]))
    reduction = Reduction(count, (rows,) * robot.n, np.array([[0.0, 1.0]]))
    data = replace(known.data, equations=reduction, training=reduction)
    estimate = Estimate.from_solution(
        model,
        data,
        ReferenceParameters.from_vector(rng.uniform(0.2, 1.5, count_reference_parameters(robot)), robot),
        Solution(np.asarray(values), np.ones(robot.n), np.eye(count)),
        Statistics(1e-6 * np.eye(count), np.ones(robot.n), np.ones(robot.n), np.full(count, np.inf)),
    )
    return replace(known, estimate=estimate, choices=replace(known.choices, effects=chosen), data=data)


def from_standard(
    robot: Robot, standard: dict[str, float] | None = None, effects: Sequence[str] = PLAIN
) -> Identification:
    """A model with the description's inertias, and with parameters by name ("Ia1", "Fc2") beside them."""
    model = build_model(robot, [EffectChoice(effect) for effect in effects])
    names = [column.name for column in model.columns]
    full = np.zeros(len(names))
    for k, column in enumerate(model.columns):
        if column.effect == "rigid_body":
            place = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M").index(column.parameter)
            full[k] = robot.inertias[robot.joint_names.index(column.link), place]
    for name, value in (standard or {}).items():
        full[names.index(name)] = value
    return made_up(robot, effects, model.base.grouping @ full)


def with_bodies(robot: Robot, seed: int = 0) -> Robot:
    """The robot with links that can exist, drawn by lot: a few points of mass each."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([rng.uniform(-0.3, 0.3, (robot.n, 6, 3)), np.ones((robot.n, 6, 1))], axis=2)
    masses = rng.uniform(0.1, 1.5, (robot.n, 6))
    matrices = np.einsum("np,npi,npj->nij", masses, points, points)
    return replace(robot, inertias=inertial_parameters(matrices))


def measured_like(model: Identification, noise: float = 1e-3) -> Identification:
    """The model's effects, identified from a recording that was made with its parameters."""
    robot = model.model.robot
    motion = fourier_motion(robot, 20.0, 100.0, 2)
    tau = predicted(model, motion)
    tau = tau + np.random.default_rng(2).normal(0.0, noise, tau.shape)
    return identify(robot, [record(robot, motion, tau)], [], replace(model.choices, estimator="wls"))


def drives(robot: Robot, seed: int = 0) -> dict[str, float]:
    """Friction and rotors that nature allows, by name."""
    rng = np.random.default_rng(seed)
    return {f"{name}{j + 1}": float(rng.uniform(0.1, 2.0)) for name in ("Ia", "Fc", "Fv") for j in range(robot.n)}


def path(robot: Robot, count: int = 200, seed: int = 3) -> Motion:
    """A motion of all joints at 100 Hz, with reversals."""
    return fourier_motion(robot, count / 100.0, 100.0, seed, base_frequency=0.5)


def signals(robot: Robot, count: int, seed: int = 5) -> dict[str, FloatArray]:
    """Everything beside the motion that an effect may ask for."""
    rng = np.random.default_rng(seed)
    return {
        "dddq": rng.uniform(-20, 20, (count, robot.n)),
        "ddddq": rng.uniform(-80, 80, (count, robot.n)),
        "time": np.sort(rng.uniform(0, 3.0, count)),
        "temperature": rng.uniform(15, 45, (count, robot.n)),
    }


def predicted(identification: Identification, motion: Motion, runs: FloatArray | None = None) -> FloatArray:
    """(m, n): W χ along a motion, with the extra signals of `signals` and hysteresis states carried along."""
    observation = identification.model.observation
    entries = observation.evaluate(
        motion.q,
        motion.dq,
        motion.ddq,
        reference=identification.estimate.reference,
        memory=MemoryStates(observation.memory).push(motion.q),
        further=FurtherSignals(runs=runs, period=0.01, **signals(identification.model.robot, len(motion.q))),
    )
    return observation.compute_torque(entries, identification.values)
