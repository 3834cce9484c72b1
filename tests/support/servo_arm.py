"""An SO-101 whose position servos follow commands at 30 Hz, as LeRobot records it: without torque.

Once by inverse dynamics, exactly (`make_exact_log`), and once in MuJoCo, with what real servos have besides.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from support.oracles import fourier_motion, pinocchio_torque

from dynident.array_types import FloatArray
from dynident.known_robots import list_stock_robots
from dynident.robot import Robot

RATE, STEPS = 30.0, 66
"""Rows a second, and steps of the physics a row: about 2 kHz."""

_VOLTAGE, _RESISTANCE, _TORQUE_PER_AMPERE, _VOLTS_PER_SPEED = 12.0, 4.44, 1.09, 2.55
"""A Feetech STS3215 at 12 V: it stalls at 2.9 N m and 2.7 A, and turns at 4.7 rad/s without load."""

_DUTY_PER_RAD, _LARGEST_DUTY = 16 * 0.166, 0.97
"""With the P coefficient of 16 that LeRobot writes; measured by the authors of BAM with an oscilloscope."""

_COUNT = 2.0 * np.pi / 4096.0

GAIN = _TORQUE_PER_AMPERE * _VOLTAGE / _RESISTANCE * _DUTY_PER_RAD
"""N m a rad between command and position, at the supply's own voltage."""

BACK_EMF = _TORQUE_PER_AMPERE * _VOLTS_PER_SPEED / _RESISTANCE
"""N m s/rad by which a motor slows down as the voltage that it generates grows."""

LATENCY = 0.005
"""Seconds from the row in which a command stands to the servo that follows it."""


@dataclass(frozen=True)
class ServoArm:
    """An arm with its true friction.

    Parameters
    ----------
    coulomb, viscous : (n,)
        Friction in N m and N m s/rad.
    rotor : float
        Inertia of the motors behind the gears, kg m².
    play : float
        Backlash of the gears in rad.
    supply : float
        Resistance of the supply in ohm, by which its voltage sags.
    masses : (n,)
        True masses over the described ones, of the bodies that the joints move.
    """

    coulomb: FloatArray
    viscous: FloatArray
    masses: FloatArray
    rotor: float = 0.02
    play: float = np.radians(0.7)
    supply: float = 0.3

    @property
    def speed_torque(self) -> FloatArray:
        """Torque over speed (n,) that the logs show: friction, back-EMF, and commands that come late."""
        return self.viscous + BACK_EMF + GAIN * LATENCY


def draw_arm(seed: int, n: int = 6) -> ServoArm:
    """Draw the friction of an arm, and masses that differ by up to a tenth from the described ones."""
    rng = np.random.default_rng([46, seed])
    return ServoArm(rng.uniform(0.06, 0.14, n), rng.uniform(0.02, 0.08, n), rng.uniform(0.9, 1.1, n))


def build_physics(arm: ServoArm, urdf: Path) -> mujoco.MjModel:
    """Return the arm's physics: each joint has a motor, and behind it play between hard stops."""
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", urdf.read_text(encoding="utf-8"), flags=re.DOTALL)
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = 1.0 / (RATE * STEPS)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    stiff = [2.0 / (RATE * STEPS), 1.0]
    for k, joint in enumerate(list(spec.joints)):
        joint.limited, joint.armature = False, arm.rotor
        joint.frictionloss, joint.damping[0] = float(arm.coulomb[k]), float(arm.viscous[k])
        joint.solref_friction, joint.solimp_friction = stiff, [0.9999, 0.9999, 0.001, 0.5, 2.0]
        play = joint.parent.add_joint(name=f"{joint.name}_play", type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
        play.limited, play.range, play.armature = True, [-0.5 * arm.play, 0.5 * arm.play], 1e-4
        play.damping[0], play.solref_limit = 1e-3, stiff
    physics = spec.compile()
    # Body 0 is the world; fixed links have been joined with the bodies that carry them.
    physics.body_mass[1:] *= arm.masses
    physics.body_inertia[1:] *= arm.masses[:, None]
    mujoco.mj_setConst(physics, mujoco.MjData(physics))
    return physics


def draw_commands(robot_range: FloatArray, duration: float, seed: int) -> FloatArray:
    """Return commands (m, n) in rad: slow sums of sines within 45 % of the ranges (n, 2), from rest."""
    rng = np.random.default_rng([64, seed])
    t = np.arange(round(duration * RATE)) / RATE
    middle, reach = robot_range.mean(axis=1), 0.45 * np.ptp(robot_range, axis=1)
    waves = np.zeros((len(t), len(middle)))
    for frequency in (0.07, 0.13, 0.23, 0.37, 0.55):
        phase = rng.uniform(0.0, 2.0 * np.pi, len(middle))
        waves += (
            rng.uniform(0.3, 1.0, len(middle))
            / (1.0 + 3.0 * frequency)
            * np.sin(2.0 * np.pi * frequency * t[:, None] + phase)
        )
    return middle + reach * waves / np.abs(waves).max(axis=0)


def record(arm: ServoArm, commands: FloatArray, urdf: Path | None = None) -> FloatArray:
    """Return the positions (m, n) in rad that the encoders read while the servos follow commands (m, n).

    The arm begins at the first command; the position of a row is read before its command is sent.
    """
    physics = build_physics(arm, urdf or list_stock_robots()["so101"])
    state = mujoco.MjData(physics)
    motors, plays = np.arange(0, physics.nq, 2), np.arange(1, physics.nq, 2)
    state.qpos[motors] = commands[0]
    goal, late = commands[0], round(LATENCY * RATE * STEPS)
    rows = np.empty_like(commands)
    for row, command in enumerate(commands):
        rows[row] = np.round((state.qpos[motors] + state.qpos[plays]) / _COUNT) * _COUNT
        for step in range(STEPS):
            if step == late:
                goal = np.round(command / _COUNT) * _COUNT
            encoder = np.round((state.qpos[motors] + state.qpos[plays]) / _COUNT) * _COUNT
            duty = np.clip(_DUTY_PER_RAD * (goal - encoder), -_LARGEST_DUTY, _LARGEST_DUTY)
            # The motors' currents through the supply: two steps of a fixed point, as the sag is small.
            voltage = _VOLTAGE
            for _ in range(2):
                current = (voltage * duty - _VOLTS_PER_SPEED * state.qvel[motors]) / _RESISTANCE
                voltage = _VOLTAGE - arm.supply * max(float((duty * current).sum()), 0.0)
            state.qfrc_applied[motors] = _TORQUE_PER_AMPERE * current
            mujoco.mj_step(physics, state)
    return rows


COLUMNS = ("t", *(f"q{k}" for k in range(1, 7)), *(f"q_command{k}" for k in range(1, 7)))


def write_log(path: Path, q: FloatArray, commands: FloatArray) -> Path:
    """Write a log of positions and commands (m, 6) in rad, a row every 1/30 s."""
    rows = np.column_stack([np.arange(len(q)) / RATE, q, commands])
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", comments="", header=",".join(COLUMNS))
    return path


def make_exact_log(robot: Robot, seed: int, gain: float = 8.0, duration: float = 60.0) -> tuple[FloatArray, FloatArray]:
    """Return positions and commands (m, n) of servos that give exactly gain x (command - position).

    The arm has the described masses, a Coulomb friction of 0.1 N m and a viscous one of 0.7 N m s/rad. A command acts
    for a row: it is what is needed in its middle.
    """
    motion = fourier_motion(robot, duration, 2.0 * RATE, seed, amplitude=1.0, fastest=0.12)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 0.1 * np.sign(motion.dq) + 0.7 * motion.dq
    return motion.q[::2], (motion.q + tau / gain)[1::2]
