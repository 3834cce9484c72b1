"""Recordings of arms that another engine simulates: MuJoCo moves them, numpy adds what is hidden in them.

Nothing here comes from the program under test except the description of a robot (joints, placements, limits, inertial
parameters). Used by tests and benchmarks.

What is needed for friction to be friction in MuJoCo: its friction loss is a soft constraint that by default smears
Coulomb friction over some 0.1 rad/s; a time constant of two steps and an impedance of 0.9999 make it sharp. A changed
armature counts only after mj_setConst.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from dynident.robot import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Drives:
    """Rotor inertia, Coulomb and viscous friction of every joint, each (n,)."""

    rotor: FloatArray
    coulomb: FloatArray
    viscous: FloatArray


@dataclass(frozen=True)
class Hidden:
    """What else is in the arm; zero: not there. Each on one joint, counted from 0, except the tilt.

    offset (joint, N m); stribeck (joint, excess N m, velocity rad/s); bent_viscous (joint, N m (s/rad)², times v|v|);
    load_friction (joint, N m per N m); presliding (joint, slip rad): the joint's Coulomb friction follows Dahl's law;
    spring (joint, N m/rad, rest rad); tilt (about x, about y, rad); ripple (joint, N m, cycles per rad, phase rad).
    """

    offset: tuple[int, float] | None = None
    stribeck: tuple[int, float, float] | None = None
    bent_viscous: tuple[int, float] | None = None
    load_friction: tuple[int, float] | None = None
    presliding: tuple[int, float] | None = None
    spring: tuple[int, float, float] | None = None
    tilt: tuple[float, float] | None = None
    ripple: tuple[int, float, float, float] | None = None


@dataclass(frozen=True)
class Instruments:
    """Encoder counts a turn, torque noise as a share of the effort limit, samples a second."""

    counts: int = 2**19
    noise: float = 0.005
    rate: float = 1000.0


@dataclass(frozen=True)
class Motion:
    """A reference: t (m,), q, dq, ddq (m, n) at the engine's steps."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray


@dataclass(frozen=True)
class Run:
    """A recording: t (m,), q and tau (m, n) as measured; the torque without noise; the noise (n,)."""

    t: FloatArray
    q: FloatArray
    tau: FloatArray
    exact_tau: FloatArray
    noise: FloatArray


@dataclass(frozen=True)
class Arm:
    """A robot with drives and hidden effects. `step` is the engine's, in s."""

    robot: Robot
    drives: Drives
    hidden: Hidden = field(default_factory=Hidden)
    step: float = 0.5e-3

    def record(self, motion: Motion, instruments: Instruments | None = None, seed: int = 0) -> Run:
        """Follow a motion under joint control and record it."""
        instruments = instruments or Instruments()
        t, q, tau = _simulate(self, motion)
        every = round(1 / (instruments.rate * self.step))
        t, q, tau = t[::every], q[::every], tau[::every]
        rng = np.random.default_rng(seed)
        noise = instruments.noise * effort_limits(self.robot)
        count = 2 * np.pi / instruments.counts
        return Run(t, np.round(q / count) * count, tau + noise * rng.standard_normal(tau.shape), tau, noise)


def effort_limits(robot: Robot) -> FloatArray:
    return np.array([joint.limits.effort for joint in robot.joints], dtype=np.float64)


def usual_drives(robot: Robot) -> Drives:
    """Drives of the size that geared arms have: Coulomb 3 %, viscous 5 % of the effort limit at full speed."""
    effort = effort_limits(robot)
    speed = np.array([joint.limits.velocity for joint in robot.joints], dtype=np.float64)
    return Drives(rotor=0.006 * effort, coulomb=0.03 * effort, viscous=0.05 * effort / speed)


def fourier_motion(
    robot: Robot, duration: float, seed: int, step: float = 0.5e-3, harmonics: int = 6, period: float = 12.0
) -> Motion:
    """A Fourier motion of random phases, as large and as fast as the limits let it, swelling from rest over 1 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration / step) + 1) * step
    rates = 2 * np.pi / period * np.arange(1, harmonics + 1)[:, None]
    rise, left = 1.0, np.minimum(t, t[-1] - t)
    s = np.clip(left / rise, 0, 1)
    side = np.where(t < t[-1] / 2, 1.0, -1.0) / rise
    swell = s**3 * (10 - 15 * s + 6 * s**2)
    dswell = side * 30 * s**2 * (1 - s) ** 2
    ddswell = 60 * s * (1 - s) * (1 - 2 * s) / rise**2
    q, dq, ddq = (np.zeros((len(t), robot.n)) for _ in range(3))
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits.position or (-np.pi, np.pi)
        middle, half = (low + high) / 2, min((high - low) / 2, np.pi)
        angle = rates * t + rng.uniform(0, 2 * np.pi, (harmonics, 1))
        size = rng.uniform(0.4, 1.0, (harmonics, 1)) / np.sqrt(rates)
        x, dx, ddx = (
            (size * np.sin(angle)).sum(0),
            (size * rates * np.cos(angle)).sum(0),
            -(size * rates**2 * np.sin(angle)).sum(0),
        )
        x, dx, ddx = (
            swell * x,
            swell * dx + dswell * x,
            swell * ddx + 2 * dswell * dx + ddswell * x,
        )
        speed, strength = joint.limits.velocity or 2.0, joint.limits.acceleration or 8.0
        scale = min(0.85 * half / np.abs(x).max(), 0.7 * speed / np.abs(dx).max(), 0.6 * strength / np.abs(ddx).max())
        q[:, j], dq[:, j], ddq[:, j] = middle + scale * x, scale * dx, scale * ddx
    return Motion(t, q, dq, ddq)


def mjcf(robot: Robot, drives: Drives, hidden: Hidden, step: float) -> str:
    """The arm as MJCF: one body a joint, its frame the joint's."""
    lines = [
        '<mujoco><compiler angle="radian" inertiafromgeom="false" autolimits="false"/>',
        f'<option timestep="{step!r}" integrator="Euler" solver="Newton" tolerance="1e-12" iterations="50"',
        f' gravity="{_numbers(_tilted(robot.gravity, hidden.tilt))}"><flag contact="disable"/></option><worldbody>',
    ]
    children: dict[int, list[int]] = {}
    for index, joint in enumerate(robot.joints):
        children.setdefault(joint.parent, []).append(index)
    for root in children.get(-1, []):
        _body(robot, drives, root, children, step, lines)
    return "\n".join([*lines, "</worldbody></mujoco>"])


def _body(
    robot: Robot, drives: Drives, index: int, children: dict[int, list[int]], step: float, lines: list[str]
) -> None:
    joint = robot.joints[index]
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(joint.placement[:3, :3]).reshape(-1))
    xx, xy, xz, yy, yz, zz, mx, my, mz, mass = robot.inertias[index]
    centre = np.array([mx, my, mz]) / mass
    # About the centre of mass (Steiner); the description's are about the joint's frame.
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    kind = "hinge" if joint.kind == "revolute" else "slide"
    lines += [
        f'<body name="b{index}" pos="{_numbers(joint.placement[:3, 3])}" quat="{_numbers(quaternion)}">',
        f'<inertial pos="{_numbers(centre)}" mass="{float(mass)!r}" fullinertia="{_numbers(full)}"/>',
        f'<joint name="j{index}" type="{kind}" axis="{_numbers(joint.axis)}"',
        f' damping="{float(drives.viscous[index])!r}" frictionloss="{float(max(drives.coulomb[index], 1e-9))!r}"',
        f' solreffriction="{2 * step!r} 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>',
    ]
    for child in children.get(index, []):
        _body(robot, drives, child, children, step, lines)
    lines.append("</body>")


def _simulate(arm: Arm, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (m,), positions and motor torques (m, n) at every step of the engine."""
    n, drives = arm.robot.n, arm.drives
    model, data = _engine(arm)
    data.qpos[:], data.qvel[:] = motion.q[0], motion.dq[0]
    # The controller's model: links and rotors on a level base, no friction.
    nothing = np.zeros(n)
    known, plan = _engine(Arm(arm.robot, Drives(drives.rotor, nothing, nothing), Hidden(), arm.step))
    known.dof_frictionloss[:] = 0.0
    plan.qpos[:] = motion.q[len(motion.q) // 3]
    mujoco.mj_forward(known, plan)
    inertia = _mass_diagonal(known, plan)
    friction = drives.coulomb + drives.viscous * np.abs(motion.dq).max(axis=0)
    rate = np.maximum(2 * np.pi * 15.0, np.sqrt(friction / 1.5e-3 / inertia))
    stiffness, damping = inertia * rate**2, 2 * inertia * rate
    limit = effort_limits(arm.robot)
    extra = _Extra(arm)
    positions, torques = np.empty((len(motion.t), n)), np.empty((len(motion.t), n))
    for k in range(len(motion.t)):
        q, v = data.qpos.copy(), data.qvel.copy()
        plan.qpos[:], plan.qvel[:], plan.qacc[:] = motion.q[k], motion.dq[k], motion.ddq[k]
        mujoco.mj_inverse(known, plan)
        tau = plan.qfrc_inverse + stiffness * (motion.q[k] - q) + damping * (motion.dq[k] - v)
        tau = np.clip(tau, -limit, limit)
        loss, applied = extra.at(model, data, q, v)
        model.dof_frictionloss[:] = loss
        data.qfrc_applied[:] = tau - applied
        positions[k], torques[k] = q, tau
        mujoco.mj_step(model, data)
    if not np.abs(positions - motion.q).max() < 0.3:
        raise RuntimeError(f"the arm did not follow: {np.abs(positions - motion.q).max(axis=0)}")
    return motion.t, positions, torques


def _engine(arm: Arm) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(mjcf(arm.robot, arm.drives, arm.hidden, arm.step))
    data = mujoco.MjData(model)
    model.dof_armature[:] = arm.drives.rotor
    mujoco.mj_setConst(model, data)
    return model, data


def _mass_diagonal(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    column = np.empty(model.nv)
    diagonal = np.empty(model.nv)
    for j, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        diagonal[j] = column[j]
    return diagonal


class _Extra:
    """What is hidden: Coulomb friction (n,) that the engine is to apply now, and torque (n,) that resists the motor."""

    def __init__(self, arm: Arm) -> None:
        self._coulomb = np.maximum(arm.drives.coulomb, 1e-9)
        self._rotor = arm.drives.rotor
        self._hidden = arm.hidden
        self._step = arm.step
        self._deflection = 0.0

    def at(
        self, model: mujoco.MjModel, data: mujoco.MjData, q: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        hidden = self._hidden
        loss, torque = self._coulomb.copy(), np.zeros(len(q))
        if hidden.offset:
            torque[hidden.offset[0]] += hidden.offset[1]
        if hidden.spring:
            j, stiffness, rest = hidden.spring
            torque[j] += stiffness * (q[j] - rest)
        if hidden.ripple:
            j, size, cycles, phase = hidden.ripple
            torque[j] += size * np.sin(cycles * q[j] + phase)
        if hidden.bent_viscous:
            j, size = hidden.bent_viscous
            torque[j] += size * v[j] * abs(v[j])
        if hidden.stribeck:
            j, excess, speed = hidden.stribeck
            loss[j] += excess * np.exp(-((v[j] / speed) ** 2))
        if hidden.load_friction:
            j, share = hidden.load_friction
            inertial = np.empty(len(q))
            mujoco.mj_mulM(model, data, inertial, data.qacc)
            load = inertial[j] - self._rotor[j] * data.qacc[j] + data.qfrc_bias[j]
            loss[j] += share * abs(load)
        if hidden.presliding:
            j, slip = hidden.presliding
            loss[j] = 1e-9
            # Dahl: exact over a step of constant velocity.
            direction = np.sign(v[j])
            gap = direction - self._deflection
            self._deflection = (
                direction - gap * np.exp(-abs(v[j]) * self._step / slip) if direction else self._deflection
            )
            torque[j] += self._coulomb[j] * self._deflection
        return loss, torque


def _tilted(gravity: FloatArray, tilt: tuple[float, float] | None) -> FloatArray:
    """Gravity in the frame of a base that is turned about x, then y."""
    if tilt is None:
        return gravity
    (cx, sx), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in tilt)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_y @ about_x @ gravity


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
