"""A small robot whose base floats, and recordings of it, simulated with Pinocchio's free-flyer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray

_INERTIAL = """<inertial><origin xyz="{x}"/><mass value="{mass}"/>
<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0.001" ixz="0" iyz="-0.002"/></inertial>"""
_LINKS = {
    "trunk": {"x": "0.02 0.01 0.1", "mass": 8.0, "ixx": 0.12, "iyy": 0.1, "izz": 0.06},
    "thigh": {"x": "0 0.01 -0.15", "mass": 2.0, "ixx": 0.03, "iyy": 0.03, "izz": 0.01},
    "shin": {"x": "0.01 0 -0.2", "mass": 1.2, "ixx": 0.02, "iyy": 0.02, "izz": 0.008},
    "arm": {"x": "0.1 0 0.05", "mass": 1.5, "ixx": 0.01, "iyy": 0.03, "izz": 0.03},
}
_JOINTS = (
    ("hip", "revolute", "trunk", "thigh", "0 0.1 -0.2", "0.3 0 0", "0 1 0"),
    ("knee", "revolute", "thigh", "shin", "0.02 0 -0.4", "0 0 0", "0 0.8 0.6"),
    ("shoulder", "revolute", "trunk", "arm", "0 -0.1 0.3", "0 0 0", "1 0 0"),
)
WALKER = "".join(
    [
        '<robot name="walker">',
        *(f'<link name="{name}">{_INERTIAL.format(**values)}</link>' for name, values in _LINKS.items()),
        *(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="9" effort="90"/></joint>'
            for name, kind, parent, child, xyz, rpy, axis in _JOINTS
        ),
        "</robot>",
    ]
)
"""A trunk with a leg of two joints and an arm of one."""
MASS = sum(float(values["mass"]) for values in _LINKS.values())  # type: ignore[arg-type]
N_JOINTS = len(_JOINTS)
COULOMB, VISCOUS, ROTOR = np.array([0.8, 0.5, 0.3]), np.array([0.4, 0.3, 0.2]), np.array([0.05, 0.03, 0.02])
"""Of the joints; the trunk has none."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Configurations (m, 10), velocities and accelerations (m, 9) of the free-flyer model, at times (m,)."""

    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray


def build_model() -> pin.Model:
    """Return Pinocchio's model of the walker with a free-flyer."""
    return pin.buildModelFromXML(WALKER, pin.JointModelFreeFlyer())


def draw_motion(seed: int, duration: float = 20.0, rate: float = 200.0, tilt: float = 0.4) -> Motion:
    """Return a smooth motion of the base and the joints: sums of sines; `tilt` rad is the size of the base's turns."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, duration, 1.0 / rate)
    sizes = np.array([0.15, 0.15, 0.15, tilt, tilt, tilt, 0.7, 0.7, 0.7])
    frequencies = np.array([0.23, 0.41, 0.67, 0.97, 1.31])
    phases = rng.uniform(0, 2 * np.pi, (9, 5))
    shares = sizes[:, None] * rng.uniform(0.5, 1.0, (9, 5)) / (1.0 + np.arange(5))
    angles = 2 * np.pi * t[:, None, None] * frequencies + phases
    x = (shares * np.sin(angles)).sum(axis=2)
    dx = (shares * 2 * np.pi * frequencies * np.cos(angles)).sum(axis=2)
    ddx = -(shares * (2 * np.pi * frequencies) ** 2 * np.sin(angles)).sum(axis=2)
    q, v, a = np.zeros((len(t), 10)), dx.copy(), ddx.copy()
    q[:, 7:] = x[:, 6:]
    for k in range(len(t)):
        # A rotation vector in place of angles: nothing here repeats the coordinates of the code under test.
        turn = pin.exp3(x[k, 3:6])
        q[k, :3], q[k, 3:7] = x[k, :3], pin.Quaternion(turn).coeffs()
        v[k, :3] = turn.T @ dx[k, :3]
        v[k, 3:6] = pin.Jexp3(x[k, 3:6]) @ dx[k, 3:6]
    # The rate of the twist by differences of five points: smooth, and exact to 1e-8 here.
    a[:, :6] = np.gradient(v[:, :6], 1.0 / rate, axis=0, edge_order=2)
    a[2:-2, :6] = (8 * (v[3:-1, :6] - v[1:-3, :6]) - (v[4:, :6] - v[:-4, :6])) * rate / 12.0
    return Motion(t, q, v, a)


def fly(seed: int, duration: float = 10.0, rate: float = 1000.0) -> tuple[Motion, FloatArray]:
    """Return a motion in flight under joint torques that swing the limbs, and these torques (m, 3) with friction."""
    rng, model = np.random.default_rng(seed), build_model()
    data, t = model.createData(), np.arange(0.0, duration, 1.0 / rate)
    phases, q = rng.uniform(0, 2 * np.pi, (3, 3)), pin.neutral(model)
    v, motion = np.zeros(9), Motion(t, np.zeros((len(t), 10)), np.zeros((len(t), 9)), np.zeros((len(t), 9)))
    v[2] = 0.5 * 9.81 * duration
    torque = np.zeros((len(t), 3))
    model.armature[6:] = ROTOR

    def wanted(time: float) -> FloatArray:
        return 0.5 * np.sin(2 * np.pi * np.array([[0.6, 1.1, 1.7]]) * time + phases).sum(axis=1)

    def push(time: float, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        motor = np.array([60.0, 30.0, 20.0]) * (wanted(time) - q[7:]) - np.array([6.0, 3.0, 2.0]) * v[6:]
        total = np.zeros(9)
        total[6:] = motor - COULOMB * np.tanh(v[6:] / 0.01) - VISCOUS * v[6:]
        return pin.aba(model, data, q, v, total), motor

    step = 1.0 / rate
    for k, time in enumerate(t):
        acceleration, motor = push(time, q, v)
        motion.q[k], motion.v[k], motion.a[k], torque[k] = q, v, acceleration, motor
        # Heun's method on the configuration space.
        after_v = v + step * acceleration
        after_q = pin.integrate(model, q, step * v)
        next_acceleration, _ = push(time + step, after_q, after_v)
        q = pin.integrate(model, q, 0.5 * step * (v + after_v))
        v = v + 0.5 * step * (acceleration + next_acceleration)
    return motion, torque


def compute_motor_torque(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Return motor torques (m, 3) with friction, and the wrench (m, 6) on the trunk in its own frame that holds it."""
    model = build_model()
    data = model.createData()
    total = np.array([pin.rnea(model, data, *state) for state in zip(motion.q, motion.v, motion.a, strict=True)])
    speed = motion.v[:, 6:]
    friction = COULOMB * np.sign(speed) + VISCOUS * speed + ROTOR * motion.a[:, 6:]
    return total[:, 6:] + friction, total[:, :6]


def write_log(
    path: Path,
    motion: Motion,
    torque: FloatArray,
    wrenches: dict[str, FloatArray] | None = None,
    *,
    noise: float = 0.0,
    seed: int = 0,
    pose: tuple[str, ...] = ("base_x", "base_y", "base_z", "base_qx", "base_qy", "base_qz", "base_qw"),
) -> Path:
    """Write a CSV with the pose of the base, the joints and wrenches (m, 6) by the beginning of their columns.

    `noise` is the standard deviation of torques and forces as a share of their size.
    """
    rng = np.random.default_rng(seed)
    columns = {"t": motion.t, **{name: motion.q[:, k] for k, name in enumerate(pose)}}
    for k in range(N_JOINTS):
        columns[f"q{k + 1}"] = motion.q[:, 7 + k]
        columns[f"tau{k + 1}"] = torque[:, k] + noise * torque[:, k].std() * rng.normal(size=len(motion.t))
    for name, wrench in (wrenches or {}).items():
        for k, component in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
            size = noise * wrench[:, k].std()
            columns[f"{name}_{component}"] = wrench[:, k] + size * rng.normal(size=len(motion.t))
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.10g")
    return path


def stand_on_shin(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Return motor torques (m, 3) of the walker whose shin carries it, and the wrench (m, 6) of the ground on it."""
    model = build_model()
    data = model.createData()
    torque, wrench = compute_motor_torque(motion)
    force = np.zeros_like(wrench)
    for k in range(len(motion.t)):
        jacobian = pin.computeFrameJacobian(model, data, motion.q[k], model.getFrameId("shin"), pin.LOCAL)
        force[k] = np.linalg.solve(jacobian[:, :6].T, wrench[k])
        torque[k] -= jacobian[:, 6:].T @ force[k]
    return torque, force
