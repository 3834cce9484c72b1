"""The run: feedforward of the level, rigid, frictionless arm, and a controller at every joint, in the engine."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.rollout import rollout

from dynident.robot import Robot
from engine.drives import Drives
from engine.instruments import Instruments, seen
from engine.motions import Motion
from engine.physics import Live, Measured, Plan
from engine.scene import Arm, FloatArray, Run, Scene, dof_of

_FEEDFORWARD_EVERY = 4
_FARTHEST = 0.3


def record(
    arm: Arm, motion: Motion, instruments: Instruments | None = None, seed: int = 0, plan: Plan | None = None
) -> Run:
    """Follow a motion under joint control and record it; `seed` is that of the torque noise."""
    return seen(measured(arm, motion, plan or Plan()), arm, instruments or Instruments(), seed)


def measured(arm: Arm, motion: Motion, plan: Plan) -> Measured:
    """Follow a motion: what perfect instruments see at every step.

    Raises
    ------
    RuntimeError
        Where the arm does not follow.
    """
    scene = Scene.of(arm.robot, arm.drives, arm.step)
    for effect in arm.hidden:
        effect.build(scene, plan)
    model, data = scene.engine()
    stiffness, damping, feedforward = _controller(arm, motion)
    limit = np.array([joint.limits.effort for joint in arm.robot.joints], dtype=np.float64)
    model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -stiffness, -damping
    model.actuator_forcelimited[:] = 1
    model.actuator_forcerange[:] = np.column_stack([-limit, limit])
    command = feedforward + stiffness * motion.q + damping * motion.dq
    live = Live.of(arm, plan, model, data)
    data.qpos[live.dof], data.qvel[live.dof] = motion.q[0], motion.dq[0]
    q, v = _moved(arm, live, command)
    if not np.abs(q - motion.q).max() < _FARTHEST:
        raise RuntimeError(f"the arm did not follow: {np.abs(q - motion.q).max(axis=0)}")
    tau = np.clip(command - stiffness * q - damping * v, -limit, limit)
    result = Measured(motion.t + plan.start, q, tau, notes=live.notes)
    for effect in arm.hidden:
        effect.measure(result, plan)
    return result


def _moved(arm: Arm, live: Live, command: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities (m, n) of the motors before every step."""
    acts = [act for act in (effect.start(live) for effect in arm.hidden) if act is not None]
    model, data, dof = live.model, live.data, live.dof
    first = np.concatenate([data.qpos, data.qvel])
    if not acts:
        state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        states, _ = rollout(model, data, state, command[:-1])
        both = np.vstack([first, states[0, :, 1 : 1 + 2 * model.nv]])
        return both[:, dof], both[:, model.nv + dof]
    positions, velocities = np.empty_like(command), np.empty_like(command)
    loss, applied, control = live.loss, live.applied, data.ctrl
    usual = loss.copy()
    plain = np.array_equal(dof, np.arange(model.nv))
    for k in range(len(command)):
        positions[k], velocities[k] = (data.qpos, data.qvel) if plain else (data.qpos[dof], data.qvel[dof])
        loss[:], applied[:] = usual, 0.0
        for act in acts:
            act(k)
        control[:] = command[k]
        mujoco.mj_step(model, data)
    return positions, velocities


def _controller(arm: Arm, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stiffness and damping (n,), feedforward (m, n): the controller knows links and rotors on a level base."""
    n, drives = arm.robot.n, arm.drives
    nothing = np.zeros(n)
    scene = Scene.of(arm.robot, type(drives)(drives.rotor, nothing, nothing), arm.step)
    model, data = scene.engine()
    model.dof_frictionloss[:] = 0.0
    dof = np.array([dof_of(model, j) for j in range(n)])
    data.qpos[dof] = motion.q[len(motion.q) // 3]
    mujoco.mj_forward(model, data)
    inertia, column = np.empty(n), np.empty(n)
    for j in range(n):
        mujoco.mj_mulM(model, data, column, np.eye(n)[dof[j]])
        inertia[j] = column[dof[j]]
    friction = drives.coulomb + drives.viscous * np.abs(motion.dq).max(axis=0)
    rate = arm.servo.rate(inertia, friction)
    samples = np.append(np.arange(0, len(motion.t) - 1, _FEEDFORWARD_EVERY), len(motion.t) - 1)
    torques = np.empty((len(samples), n))
    for row, k in enumerate(samples):
        data.qpos[dof], data.qvel[dof], data.qacc[dof] = motion.q[k], motion.dq[k], motion.ddq[k]
        mujoco.mj_inverse(model, data)
        torques[row] = data.qfrc_inverse[dof]
    feedforward = np.column_stack([np.interp(motion.t, motion.t[samples], torques[:, j]) for j in range(n)])
    return inertia * rate**2, 2 * arm.servo.damping * inertia * rate, feedforward


def typical_torque(robot: Robot, seed: int, samples: int = 300) -> FloatArray:
    """(n,): the torque (95 % of the time) that links and no rotors ask for at random states within the limits."""
    nothing = np.zeros(robot.n)
    model, data = Scene.of(robot, Drives(nothing, nothing, nothing), 1e-3).engine()
    model.dof_frictionloss[:] = 0.0
    rng = np.random.default_rng(seed)
    torques = np.empty((samples, robot.n))
    dof = [dof_of(model, j) for j in range(robot.n)]
    for row in torques:
        for k, joint in zip(dof, robot.joints, strict=True):
            low, high = joint.limits.position or (-np.pi, np.pi)
            data.qpos[k] = rng.uniform(low, high)
            data.qvel[k] = 0.5 * (joint.limits.velocity or 2.0) * rng.uniform(-1, 1)
            data.qacc[k] = 0.5 * (joint.limits.acceleration or 8.0) * rng.uniform(-1, 1)
        mujoco.mj_inverse(model, data)
        row[:] = data.qfrc_inverse[dof]
    return np.asarray(np.quantile(np.abs(torques), 0.95, axis=0))
