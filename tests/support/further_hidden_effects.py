"""More effects that a plain model lacks, in numpy on Pinocchio's torque: of the whole robot, its drives, its base."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from support.hidden_effects import EFFORT, ROBOT, Case, Hidden, drives, on_joint
from support.oracles import FloatArray, Motion, pinocchio_torque

from dynident.robot import Robot, to_pinocchio

DELAY, FREQUENCY = 0.008, 4.3
CONTACT = (12.0, 13.5)
PAYLOAD = 2.5


def compensating(q: FloatArray, v: FloatArray, load: FloatArray) -> FloatArray:
    """k a b sin x (l - l0) / l of a spring on a crank."""
    x, a, b = q - 0.4, 0.3, 0.25
    length = np.sqrt(a * a + b * b + 2 * a * b * np.cos(x))
    return 4000.0 * a * b * np.sin(x) * (length - 0.1) / length


def late(motion: Motion, load: FloatArray) -> FloatArray:
    whole = load + drives(motion)
    return np.column_stack([np.interp(motion.t - DELAY, motion.t, one) for one in whole.T]) - whole


def in_gravity(motion: Motion, gravity: FloatArray) -> FloatArray:
    robot = Robot(ROBOT.name, ROBOT.joints, gravity, ROBOT.drives, ROBOT.description, ROBOT.inertias)
    return pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)


def shaking(motion: Motion, load: FloatArray) -> FloatArray:
    pushed = in_gravity(motion, ROBOT.gravity + np.array([0.4, -0.2, 0.1])) - load
    return pushed * np.sin(2 * np.pi * FREQUENCY * motion.t + 0.5)[:, None]


def scaled(motion: Motion, load: FloatArray) -> FloatArray:
    return 0.08 * (load + drives(motion)) * np.eye(6)[1]


def saturated(motion: Motion, load: FloatArray) -> FloatArray:
    motor = (load + drives(motion)) * np.eye(6)[1]
    return 0.4 * motor * np.abs(motor) / EFFORT[1]


def tied(motion: Motion, load: FloatArray) -> FloatArray:
    pull = 12.0 * (motion.q[:, 3] + 0.7 * motion.q[:, 4] - 0.2)
    return np.outer(pull, np.eye(6)[3]) + 0.7 * np.outer(pull, np.eye(6)[4])


def touched(motion: Motion, load: FloatArray) -> FloatArray:
    """A force of 45 N on the last link for a moment, by Pinocchio's Jacobian."""
    model = to_pinocchio(ROBOT)
    data, force = model.createData(), np.array([30.0, -20.0, 25.0])
    inside = (motion.t >= CONTACT[0]) & (motion.t <= CONTACT[1])
    tau = np.zeros_like(load)
    for k in np.flatnonzero(inside):
        full = pin.computeJointJacobians(model, data, motion.q[k])
        assert full is not None
        jacobian = pin.getJointJacobian(model, data, model.njoints - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        tau[k] = -jacobian[:3].T @ force
    return tau


def loaded_on(link: int, centre: tuple[float, float, float], mass: float = PAYLOAD) -> Hidden:
    """A point mass on a link."""
    x, y, z = centre
    inertia = mass * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    inertias = ROBOT.inertias.copy()
    inertias[link] += np.concatenate([inertia, mass * np.array(centre), [mass]])
    heavy = Robot(ROBOT.name, ROBOT.joints, ROBOT.gravity, ROBOT.drives, ROBOT.description, inertias)
    return lambda motion, load: pinocchio_torque(heavy, motion.q, motion.dq, motion.ddq) - load


loaded = loaded_on(-1, (0.02, -0.03, 0.08))


def _whole(effect: str, hidden: Hidden) -> Case:
    return Case(effect, None, hidden)


MORE = {
    case.effect: case
    for case in (
        Case("position_dependent_friction", 2, on_joint(2, lambda q, v, load: 5.0 * np.cos(2 * q + 0.5) * np.sign(v))),
        Case("gravity_compensator", 1, on_joint(1, compensating)),
        Case("drive_gain_error", 1, scaled),
        Case("drive_gain_saturation", 1, saturated),
        Case("cable_force", 3, tied),
        _whole("torque_delay", late),
        _whole("base_vibration", shaking),
    )
}
