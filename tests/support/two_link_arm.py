"""An arm whose torque is known in closed form, with a spring that no model is told of; nothing of dynident is used."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LENGTH, GRAVITY = 0.5, 9.81
MASS, CENTRE, INERTIA = (4.0, 3.0), (0.25, 0.2), (0.12, 0.08)
COULOMB, VISCOUS = (3.0, 2.0), (1.5, 1.0)
SPRING, REST = 9.0, 0.4
"""N m/rad and rad: the physics that is hidden, on the elbow."""
NOISE = 0.05

URDF = """<robot name="two_links">
 <link name="base"/>
 <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" velocity="6" effort="150"/></joint>
 <link name="upper"/>
 <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
  <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" velocity="6" effort="80"/></joint>
 <link name="fore"/>
</robot>
"""


def write_recording(path: Path, seed: int, duration: float = 30.0, rate: float = 200.0, load: float = 0.0) -> Path:
    """A CSV file of t, q and tau of a motion drawn at random, with a load of so many kg at the end of the fore arm."""
    random = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    q, dq, ddq = _motion(t, random)
    tau = _torque(q, dq, ddq, load) + random.normal(0.0, NOISE, q.shape)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q_shoulder", "q_elbow", "tau_shoulder", "tau_elbow"])
        writer.writerows(np.column_stack([t, q, tau]).round(7).tolist())
    return path


def _motion(t: FloatArray, random: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sums of sines, position (m, 2) and derivatives."""
    harmonics = 2.0 * np.pi * 0.1 * np.arange(1, 7)
    amplitudes = random.uniform(0.15, 0.45, (6, 2)) / np.sqrt(np.arange(1, 7))[:, None]
    phases = random.uniform(0.0, 2.0 * np.pi, (6, 2))
    angle = t[:, None, None] * harmonics[:, None] + phases
    rates = harmonics[:, None]
    q = (amplitudes * np.sin(angle)).sum(axis=1)
    dq = (amplitudes * rates * np.cos(angle)).sum(axis=1)
    return q, dq, (-amplitudes * rates**2 * np.sin(angle)).sum(axis=1)


def _torque(q: FloatArray, dq: FloatArray, ddq: FloatArray, load: float = 0.0) -> FloatArray:
    """The textbook's two-link arm in the vertical plane; turning about +y lowers what points along +x."""
    (m1, m2), (c1, c2), (i1, i2) = MASS, CENTRE, INERTIA
    # The load is a point on the fore arm, as far out as the upper arm is long.
    c2, i2 = (m2 * c2 + load * LENGTH) / (m2 + load), i2 + m2 * load / (m2 + load) * (LENGTH - c2) ** 2
    m2 += load
    cos2, sin2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    shared = m2 * LENGTH * c2
    a11 = i1 + i2 + m1 * c1**2 + m2 * (LENGTH**2 + c2**2) + 2.0 * shared * cos2
    a12 = i2 + m2 * c2**2 + shared * cos2
    a22 = i2 + m2 * c2**2
    fore = m2 * GRAVITY * c2 * np.cos(q[:, 0] + q[:, 1])
    upper = (m1 * c1 + m2 * LENGTH) * GRAVITY * np.cos(q[:, 0])
    shoulder = a11 * ddq[:, 0] + a12 * ddq[:, 1] - shared * sin2 * dq[:, 1] * (2.0 * dq[:, 0] + dq[:, 1]) - upper - fore
    elbow = a12 * ddq[:, 0] + a22 * ddq[:, 1] + shared * sin2 * dq[:, 0] ** 2 - fore
    friction = np.sign(dq) * COULOMB + dq * VISCOUS
    spring = np.column_stack([np.zeros(len(q)), SPRING * (q[:, 1] - REST)])
    return np.column_stack([shoulder, elbow]) + friction + spring
