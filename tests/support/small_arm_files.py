"""Recordings of a small arm with one hidden effect, as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
from support.oracles import arm, fourier_motion, pinocchio_torque

ARM = arm("scara")


def write_run(path: Path, seed: int, *, coulomb: float = 3.0, stribeck: float = 8.0) -> None:
    """A recording with Coulomb and viscous friction, and Stribeck friction on the first joint."""
    motion = fourier_motion(ARM, 20.0, 100.0, seed)
    v = motion.dq
    tau = pinocchio_torque(ARM, motion.q, v, motion.ddq) + 3 * np.sign(v) + 2 * v
    tau[:, 0] += stribeck * np.exp(-((v[:, 0] / 0.2) ** 2)) * np.sign(v[:, 0])
    tau[:, 1] += (coulomb - 3.0) * np.sign(v[:, 1])
    tau += np.random.default_rng(seed).normal(0.0, 0.15, tau.shape)
    columns = {"t": motion.t}
    for j in range(ARM.n):
        columns |= {f"q{j + 1}": motion.q[:, j], f"tau{j + 1}": tau[:, j]}
    pacsv.write_csv(pa.table(columns), path)
