"""Recordings of an arm that rests between its moves, where friction holds whatever torque it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
from support.oracles import Motion, pinocchio_torque

from dynident.robot import Robot

PERIOD, MOVES = 4.0, 2.8
"""s: every so often the arm begins a move, which lasts so long; it rests in between."""
COULOMB, VISCOUS, NOISE = 3.0, 2.0, 0.1


def resting_motion(robot: Robot, duration: float, rate: float, seed: int) -> Motion:
    """Sines over a time that stops again and again."""
    random = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    phase = np.minimum(t % PERIOD, MOVES)
    turn = 2 * np.pi / MOVES
    u = np.floor(t / PERIOD) * MOVES + phase - np.sin(turn * phase) / turn
    du, ddu = 1 - np.cos(turn * phase), turn * np.sin(turn * phase)
    q, dq, ddq = np.zeros((len(t), robot.n)), np.zeros((len(t), robot.n)), np.zeros((len(t), robot.n))
    for k in range(1, 4):
        w, a = 0.55 * k, random.uniform(0.2, 0.5, robot.n) / k
        angle = w * u[:, None] + random.uniform(0, 2 * np.pi, robot.n)
        q += a * np.sin(angle)
        along, across = a * w * np.cos(angle), -a * w**2 * np.sin(angle)
        dq += along * du[:, None]
        ddq += across * du[:, None] ** 2 + along * ddu[:, None]
    ranges = np.array([joint.limits.position or (-2.0, 2.0) for joint in robot.joints])
    scale = np.minimum(1.0, 0.45 * np.diff(ranges)[:, 0] / np.abs(q).max(axis=0))
    return Motion(t, ranges.mean(axis=1) + scale * q, scale * dq, scale * ddq)


def resting_torque(robot: Robot, motion: Motion, seed: int) -> np.ndarray:
    """Coulomb and viscous friction while a joint moves; at rest anything up to the Coulomb friction, drawn anew."""
    random = np.random.default_rng(100 + seed)
    rests = motion.t % PERIOD >= MOVES
    which = np.floor(motion.t / PERIOD).astype(int)
    held = random.uniform(-0.9, 0.9, (which[-1] + 1, robot.n)) * COULOMB
    friction = np.where(rests[:, None], held[which], COULOMB * np.sign(motion.dq) + VISCOUS * motion.dq)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + friction
    return np.asarray(tau + random.normal(0.0, NOISE, tau.shape))


def write_resting_run(robot: Robot, path: Path, seed: int, duration: float = 32.0, rate: float = 100.0) -> Path:
    """The recording as a CSV file of t, q1 … and tau1 …."""
    motion = resting_motion(robot, duration, rate, seed)
    tau = resting_torque(robot, motion, seed)
    columns = {"t": motion.t}
    for j in range(robot.n):
        columns |= {f"q{j + 1}": motion.q[:, j], f"tau{j + 1}": tau[:, j]}
    pacsv.write_csv(pa.table(columns), path)
    return path
