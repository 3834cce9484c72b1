"""Commands as a user runs them, and recordings of a small arm to run them on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
from support.oracles import arm, fourier_motion, pinocchio_torque
from typer.testing import CliRunner

from dynident_cli.program_and_exit_codes import app

ROBOT = arm("scara")


@dataclass(frozen=True)
class Answer:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        return json.loads(self.out)


def dynident(*arguments: object) -> Answer:
    """Run one command as a user would."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="dynident")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Answer(result.exit_code, result.stdout, result.stderr)


def write_run(path: Path, seed: int, *, stribeck: float = 8.0) -> Path:
    """A recording with Coulomb and viscous friction, and Stribeck friction on the first joint."""
    motion = fourier_motion(ROBOT, 20.0, 100.0, seed)
    v = motion.dq
    tau = pinocchio_torque(ROBOT, motion.q, v, motion.ddq) + 3 * np.sign(v) + 2 * v
    tau[:, 0] += stribeck * np.exp(-((v[:, 0] / 0.2) ** 2)) * np.sign(v[:, 0])
    tau += np.random.default_rng(seed).normal(0.0, 0.15, tau.shape)
    columns = {"t": motion.t}
    for j in range(ROBOT.n):
        columns |= {f"q{j + 1}": motion.q[:, j], f"tau{j + 1}": tau[:, j]}
    pacsv.write_csv(pa.table(columns), path)
    return path
