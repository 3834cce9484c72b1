"""Recordings of drawn arms as columns of a file, which tests then change as strangers' loggers do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from support.oracles import arm, fourier_motion, pinocchio_torque

from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.metadata_proposal import Proposal
from dynident.identification.robot_recording_import import CuredRecording, import_cured
from dynident.recordings import RecordingMetadata
from dynident.robot import Robot, robot_from_urdf

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Log:
    """What a log holds: t (m,) in s, q and tau (m, n) in SI."""

    robot: Robot
    t: FloatArray
    q: FloatArray
    tau: FloatArray

    def columns(self, q: FloatArray | None = None, tau: FloatArray | None = None) -> dict[str, FloatArray]:
        """Columns t, q1, …, tau1, …, with other positions or torques."""
        found = {"t": self.t}
        for kind, values in (("q", self.q if q is None else q), ("tau", self.tau if tau is None else tau)):
            found |= {f"{kind}{joint + 1}": values[:, joint] for joint in range(self.robot.n)}
        return found


@cache
def log(name: str = "ur10", seed: int = 3, rate: float = 100.0, duration: float = 20.0) -> Log:
    """A Fourier motion of a well-known arm with Coulomb and viscous friction, and noise."""
    return log_of(arm(name), seed, rate, duration)


def log_of(robot: Robot, seed: int = 3, rate: float = 100.0, duration: float = 20.0) -> Log:
    """The same of any robot."""
    motion = fourier_motion(robot, duration, rate, seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    size = np.maximum(np.abs(tau).max(axis=0), 0.02 * np.abs(tau).max())
    speed = np.abs(motion.dq).max(axis=0)
    rng = np.random.default_rng(seed)
    tau = tau + 0.1 * size * np.sign(motion.dq) + 0.1 * size * motion.dq / speed
    q = motion.q + 1e-5 * rng.normal(size=tau.shape)
    return Log(robot, motion.t, q, tau + 0.005 * size * rng.normal(size=tau.shape))


def write(path: Path, columns: dict[str, FloatArray]) -> Path:
    """A file of the columns."""
    pq.write_table(pa.table(columns), path)
    return path


def read(
    robot: Robot, folder: Path, columns: dict[str, FloatArray], /, cures: int = 0, **said: object
) -> CuredRecording:
    """Read columns as a file of a robot."""
    path = write(folder / "log.parquet", columns)
    return import_cured(robot, path, folder / "read.parquet", RecordingMetadata(**said), most=cures)  # type: ignore[arg-type]


def guess(robot: Robot, columns: dict[str, FloatArray]) -> Proposal:
    """What is proposed for columns."""
    return propose(Sample(tuple(columns), np.column_stack(list(columns.values())), {}), robot)


def signals(found: CuredRecording) -> tuple[FloatArray, FloatArray]:
    """Positions and torques of a recording that was read."""
    rows = list(found.recording.source.rows(0, found.recording.n_samples, 1 << 16))
    return np.concatenate([one.q for one in rows]), np.concatenate([one.tau for one in rows])


def legged(legs: int, joints: int = 3, seed: int = 0) -> Robot:
    """Legs of three joints, like one another but for where they are, on one trunk that stands."""
    rng = np.random.default_rng(seed)
    masses, lengths = rng.uniform(0.5, 2.0, joints), rng.uniform(0.1, 0.3, joints)
    parts = ['<robot name="legged"><link name="trunk"/>']
    for leg in range(legs):
        side, front = (1 if leg % 2 else -1), (1 if leg < 2 else -1)
        for k in range(joints):
            mass, length = float(masses[k]), float(lengths[k])
            inertia = mass * length**2 / 12.0
            place = f"{0.3 * front if k == 0 else 0} {0.1 * side if k < 2 else 0} {0 if k == 0 else -length}"
            centre = f"{0.02 * front} {0.03 * side} {-0.5 * length}"
            parts.append(
                f'<link name="leg{leg}_{k}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
                f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{0.3 * inertia}"/></inertial>'
                f'</link><joint name="leg{leg}_joint{k}" type="revolute">'
                f'<parent link="{f"leg{leg}_{k - 1}" if k else "trunk"}"/><child link="leg{leg}_{k}"/>'
                f'<origin xyz="{place}"/><axis xyz="{"1 0 0" if k == 0 else "0 1 0"}"/>'
                '<limit lower="-2" upper="2" velocity="10" effort="60"/></joint>'
            )
    return robot_from_urdf("legged", "".join(parts) + "</robot>")
