"""Whether an effect shows in a recording at all, told without the program under test.

The plain model (links, rotors, Coulomb, viscous) is fitted with Pinocchio's regressor and SciPy's filters to the
arm with the effect and to its clean twin: same motion, same noise. What the effect leaves beyond the twin's residual
is what anybody could see of it: on all rows, or on those in which the joint moves, to which alone the model is then
fitted, since joints that stick leave many times the noise on any arm.
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
from hiding.moving import BoolArray, moving, rate_of
from hiding.recorded import Recorded, recorded

CUTOFF, WORKING_RATE, ROW_RATE, MARGIN = 8.0, 125.0, 31.25, 0.6
SHOWS = 0.4
"""An effect shows where it leaves at least this share of the twin's residual on a joint beside it (in quadrature):
there the residual is larger by 8 %.
"""


@dataclass(frozen=True, eq=False)
class PlainResidual:
    """Residual rms (2, n) of the plain model, on all rows and on moving ones: fitted runs, and those held out."""

    training: FloatArray
    held_out: FloatArray


def excess(data: Recorded, folder: Path | None) -> FloatArray:
    """(n,): what the hidden effect adds to the residual, over the clean arm's residual, joint by joint.

    The largest of fitted and held-out runs (a push in one fitted run shows there), of all rows and of moving ones.
    """
    mine, twin = plain_residual(data), _twin(data.case.clean, folder)
    return np.asarray(
        np.maximum(_beyond(mine.training, twin.training), _beyond(mine.held_out, twin.held_out)).max(axis=0)
    )


def _beyond(mine: FloatArray, twin: FloatArray) -> FloatArray:
    """NaN, of a joint without a row that moves, is nothing."""
    return np.nan_to_num(np.sqrt(np.maximum(mine**2 - twin**2, 0.0)) / twin)


@lru_cache(maxsize=64)
def _twin(case: Case, folder: Path | None) -> PlainResidual:
    return plain_residual(recorded(case, folder))


def plain_residual(data: Recorded) -> PlainResidual:
    """Fit the plain model to the runs of a case: to all rows, and to moving ones."""
    robot, noise = arm_by_name(data.case.arm), data.runs[0].noise
    fitted, others = (_joined([_rows(robot, run) for run in runs]) for runs in (data.training, data.held_out))
    every, moving_ones = np.ones_like(fitted.moving), fitted.moving
    models = [_fitted(fitted, used, noise) for used in (every, moving_ones)]
    return PlainResidual(*(_residual(rows, models) for rows in (fitted, others)))


def shown_beside(robot: Robot, runs: Sequence[Run], twins: Sequence[Run]) -> FloatArray:
    """(n,): what these runs leave beyond their clean twins when one plain model is fitted to all of them."""
    mine, other = (_fitted_to(robot, each) for each in (runs, twins))
    return np.asarray(_beyond(mine, other).max(axis=0))


def _fitted_to(robot: Robot, runs: Sequence[Run]) -> FloatArray:
    rows, noise = _joined([_rows(robot, run) for run in runs]), runs[0].noise
    return _residual(rows, [_fitted(rows, used, noise) for used in (np.ones_like(rows.moving), rows.moving)])


@dataclass(frozen=True, eq=False)
class _Rows:
    """W (m, n, 13 n) and Y (m, n), filtered and decimated, and which rows of a joint are clear of its standstills."""

    w: FloatArray
    y: FloatArray
    moving: BoolArray


def _joined(parts: Sequence[_Rows]) -> _Rows:
    return _Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("w", "y", "moving")))


def _fitted(rows: _Rows, used: BoolArray, noise: FloatArray) -> FloatArray:
    w, y = (rows.w / noise[:, None])[used], (rows.y / noise)[used]
    scale = np.linalg.norm(w, axis=0) + 1e-300
    return np.asarray(np.linalg.lstsq(w / scale, y, rcond=1e-9)[0] / scale)


def _residual(rows: _Rows, models: Sequence[FloatArray]) -> FloatArray:
    """(2, n): of the first model on all rows, of the second on moving ones; NaN where a joint has none."""
    squares = [(rows.y - rows.w @ chi) ** 2 for chi in models]
    count = rows.moving.sum(axis=0)
    of_moving = np.divide(
        (squares[1] * rows.moving).sum(axis=0), count, out=np.full(len(count), np.nan), where=count > 0
    )
    return np.sqrt(np.stack([squares[0].mean(axis=0), of_moving]))


def _rows(robot: Robot, run: Run) -> _Rows:
    rate = rate_of(run)
    clear = moving(run, robot, CUTOFF)
    b, a = signal.butter(4, CUTOFF / (rate / 2))
    q = signal.filtfilt(b, a, run.q, axis=0)
    dq = np.gradient(q, 1 / rate, axis=0)
    ddq = np.gradient(dq, 1 / rate, axis=0)
    tau = signal.filtfilt(b, a, run.tau, axis=0)
    every = max(1, round(rate / WORKING_RATE))
    q, dq, ddq, tau = (x[::every] for x in (q, dq, ddq, tau))
    working = rate / every
    w = signal.filtfilt(*signal.butter(4, CUTOFF / (working / 2)), _plain_columns(robot, q, dq, ddq), axis=0)
    margin, step = round(MARGIN * working), round(working / ROW_RATE)
    return _Rows(*(x[margin:-margin:step] for x in (w, tau, clear[::every])))


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
