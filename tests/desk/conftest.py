"""A small arm with one hidden effect, as the files that a user has beside a notebook."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pytest
from oracles import arm, fourier_motion, pinocchio_torque

import dynident as dy
from dynident.robot import urdf_from_robot

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


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the robot's URDF, two recordings, and one of another day."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "arm.urdf").write_text(urdf_from_robot(ARM), encoding="utf-8")
    write_run(folder / "run1.csv", 1)
    write_run(folder / "run2.csv", 2)
    write_run(folder / "today.csv", 3, coulomb=4.5)
    return folder


@pytest.fixture(scope="session")
def robot(desk: Path) -> dy.Robot:
    return dy.load_robot(desk / "arm.urdf")


@pytest.fixture(scope="session")
def runs(desk: Path, robot: dy.Robot) -> dy.Recordings:
    return dy.read_recordings(desk / "run1.csv", desk / "run2.csv", robot=robot)


@pytest.fixture(scope="session")
def model(robot: dy.Robot, runs: dy.Recordings) -> dy.Model:
    """Without the Stribeck friction that the arm has."""
    return dy.identify(robot, runs[:1], validation=runs[1:])


@pytest.fixture(scope="session")
def found(model: dy.Model) -> dy.DiagnosedModel:
    return dy.diagnose(model)


@pytest.fixture(scope="session")
def better(model: dy.Model, found: dy.DiagnosedModel) -> dy.Model:
    return model.extend(found)
