"""Whether an effect shows in a recording at all, told without the program under test.

The plain model (links, rotors, Coulomb, viscous) is fitted with Pinocchio's regressor and SciPy's filters to the
arm with the effect and to its clean twin: same motion, same noise. What the effect leaves beyond the twin's residual
is what anybody could see of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio
from engine import FloatArray, Run
from engine.robots import arm_by_name
from scipy import signal

from dynident.robot import Robot, to_pinocchio
from hiding.case import Case
from hiding.recorded import Recorded, recorded

CUTOFF, WORKING_RATE, ROW_RATE, MARGIN = 8.0, 125.0, 31.25, 0.6
SHOWS = 0.4
"""An effect shows where it leaves at least this share of the twin's residual on a joint beside it (in quadrature):
there the residual is larger by 8 %.
"""


@dataclass(frozen=True, eq=False)
class PlainResidual:
    """Residual rms (n,) of the plain model on the runs it was fitted to and on those held out."""

    training: FloatArray
    held_out: FloatArray


def excess(data: Recorded, folder: Path | None) -> FloatArray:
    """(n,): what the hidden effect adds to the residual, over the clean arm's residual, joint by joint.

    The larger of the fitted and the held-out runs: a push in one fitted run shows there.
    """
    mine, twin = plain_residual(data), _twin(data.case.clean, folder)
    return np.asarray(
        np.maximum(
            np.sqrt(np.maximum(mine.training**2 - twin.training**2, 0.0)) / twin.training,
            np.sqrt(np.maximum(mine.held_out**2 - twin.held_out**2, 0.0)) / twin.held_out,
        )
    )


@lru_cache(maxsize=64)
def _twin(case: Case, folder: Path | None) -> PlainResidual:
    return plain_residual(recorded(case, folder))


def plain_residual(data: Recorded) -> PlainResidual:
    """Fit the plain model to the runs of a case."""
    robot = arm_by_name(data.case.arm)
    noise = data.runs[0].noise
    fitted = [_rows(robot, run) for run in data.training]
    others = [_rows(robot, run) for run in data.held_out]
    w = np.concatenate([w for w, _ in fitted]) / noise[:, None]
    y = np.concatenate([y for _, y in fitted]) / noise
    flat = w.reshape(-1, w.shape[2])
    scale = np.linalg.norm(flat, axis=0) + 1e-300
    chi = np.linalg.lstsq(flat / scale, y.reshape(-1), rcond=1e-9)[0] / scale
    return PlainResidual(_rms(fitted, chi), _rms(others, chi))


def _rms(parts: Sequence[tuple[FloatArray, FloatArray]], chi: FloatArray) -> FloatArray:
    rest = np.concatenate([y - w @ chi for w, y in parts])
    return np.asarray(np.sqrt((rest**2).mean(axis=0)))


def _rows(robot: Robot, run: Run) -> tuple[FloatArray, FloatArray]:
    """W (m, n, 13 n) and Y (m, n), filtered and decimated."""
    rate = (len(run.t) - 1) / float(run.t[-1] - run.t[0])
    b, a = signal.butter(4, CUTOFF / (rate / 2))
    q = signal.filtfilt(b, a, run.q, axis=0)
    dq = np.gradient(q, 1 / rate, axis=0)
    ddq = np.gradient(dq, 1 / rate, axis=0)
    tau = signal.filtfilt(b, a, run.tau, axis=0)
    every = round(rate / WORKING_RATE)
    q, dq, ddq, tau = (x[::every] for x in (q, dq, ddq, tau))
    w = signal.filtfilt(*signal.butter(4, CUTOFF / (WORKING_RATE / 2)), _plain_columns(robot, q, dq, ddq), axis=0)
    margin, step = round(MARGIN * WORKING_RATE), round(WORKING_RATE / ROW_RATE)
    return w[margin:-margin:step], tau[margin:-margin:step]


def _plain_columns(robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    model = to_pinocchio(robot)
    data, n = model.createData(), robot.n
    w = np.zeros((len(q), n, 13 * n))
    for k in range(len(q)):
        w[k, :, : 10 * n] = pinocchio.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
    joints = np.arange(n)
    for place, values in enumerate((ddq, np.sign(dq), dq)):
        w[:, joints, (10 + place) * n + joints] = values
    return w
