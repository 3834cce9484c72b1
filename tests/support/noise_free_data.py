"""Data without noise and without differences: torque of Pinocchio on exact derivatives, reduced as recordings are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from support.oracles import Motion, pinocchio_torque, random_states

from dynident.effects import ReferenceParameters
from dynident.estimation import FactorAccumulator, concatenate_reductions
from dynident.identification.equations.reduced_recordings import Data
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import Model
from dynident.robot import Robot

FloatArray = np.ndarray

DRIVES = ("Ia", "Fc", "Fv", "b")


def drawn_standard(robot: Robot, seed: int = 0) -> FloatArray:
    """Inertias of the description and random Ia, Fc, Fv, b of all joints, behind one another."""
    drawn = np.random.default_rng(seed).uniform(0.5, 5.0, (len(DRIVES), robot.n))
    return np.concatenate([robot.inertias.reshape(-1), drawn.ravel()])


def torque_of(robot: Robot, motion: Motion, standard: FloatArray) -> FloatArray:
    """(m, n): the torque of standard parameters as `drawn_standard` orders them."""
    ia, fc, fv, b = standard[10 * robot.n :].reshape(4, robot.n)
    rigid = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    return rigid + ia * motion.ddq + fc * np.sign(motion.dq) + fv * motion.dq + b


def states(robot: Robot, count: int = 400, seed: int = 0, still: Sequence[int] = ()) -> Motion:
    """Random states; the joints in `still` do not move."""
    q, dq, ddq = random_states(robot, count, seed)
    for joint in still:
        q[:, joint], dq[:, joint], ddq[:, joint] = q[0, joint], 0.0, 0.0
    return Motion(np.arange(count) / 100.0, q, dq, ddq)


def reduced_states(model: Model, runs: Sequence[tuple[Motion, FloatArray]]) -> Data:
    """Motions and torques as the data of an identification, without any filter."""
    observation = model.observation
    layout = [observation.joint_entries(joint) for joint in range(model.robot.n)]
    parts = []
    for motion, tau in runs:
        accumulator = FactorAccumulator([columns for _, columns in layout], observation.n_columns, 0.5)
        entries = observation.evaluate(
            motion.q,
            motion.dq,
            motion.ddq,
            reference=ReferenceParameters.massless(model.robot),
            memory=np.zeros((len(motion.t), observation.n_memory)),
        )
        rows = [np.column_stack([entries[:, picked], tau[:, j]]) for j, (picked, _) in enumerate(layout)]
        for j in np.flatnonzero(~motion.dq.any(axis=0)):
            rows[j][:] = 0.0  # what stiction and brakes leave of a locked joint's torque is no equation
        accumulator.push(motion.t, rows)
        parts.append(accumulator.finish())
    whole = concatenate_reductions(parts)
    return Data(whole, whole, (), Preprocessing(None, None), ReferenceParameters.massless(model.robot))
