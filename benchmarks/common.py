"""What the benchmarks share: an arm, its motion, the rival script, timing.

The rival is what a robotics engineer writes in an afternoon: SciPy's filters, a Python loop over Pinocchio's
joint-torque regressor, numpy's least squares. It solves the same problem with the same filters and the same columns.
"""

from __future__ import annotations

import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray
from scipy import signal
from scipy.linalg import qr
from threadpoolctl import threadpool_limits

FloatArray = NDArray[np.float64]

# Both sides get one thread: small factorisations are slower, and jitter, with several.
threadpool_limits(limits=1)

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Recordings of real robots, where there are any beside the project; the benchmarks run without them too."""


@dataclass(frozen=True)
class Samples:
    """A motion and its torque: t (m,), q and tau (m, n), all in SI units."""

    t: FloatArray
    q: FloatArray
    tau: FloatArray
    source: str

    @property
    def rate(self) -> float:
        return (len(self.t) - 1) / float(self.t[-1] - self.t[0])


@dataclass(frozen=True)
class PlainResult:
    """The rival's answer: base parameters (b,), their standard deviations (b,), relative residual."""

    values: FloatArray
    deviations: FloatArray
    relative_error: float


def simulated_samples(model: pinocchio.Model, n_samples: int, rate: float, *, seed: int = 0) -> Samples:
    """A smooth random motion of all joints, and the torque of the model's own inertia with friction and noise.

    Slow sums of sines with incommensurable frequencies: every stretch of the recording is a new piece of motion.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(n_samples) / rate
    frequency = rng.uniform(0.05, 0.5, (5, model.nv))
    phase = rng.uniform(0, 2 * np.pi, (5, model.nv))
    q = np.zeros((n_samples, model.nv))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for f, p in zip(2 * np.pi * frequency, phase, strict=True):
        wave = np.outer(t, f) + p
        q += 0.5 * np.sin(wave)
        dq += 0.5 * f * np.cos(wave)
        ddq -= 0.5 * f**2 * np.sin(wave)
    data = model.createData()
    tau = np.array([pinocchio.rnea(model, data, *rows) for rows in zip(q, dq, ddq, strict=True)])
    tau += 8.0 * dq + 5.0 * np.sign(dq)
    tau += 0.01 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    return Samples(t, q + 1e-5 * rng.standard_normal(q.shape), tau, "simulated")


def independent_columns(model: pinocchio.Model, seed: int = 0) -> NDArray[np.intp]:
    """Base columns of the rival's W by QR with pivoting at random states: inertia, Coulomb, viscous, offset."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-2, 2, (3, 100, model.nv))
    w = plain_observation(model, *states).reshape(100 * model.nv, -1)
    norms = np.linalg.norm(w, axis=0)
    # Rounded right angles in a URDF leave columns that are almost, not quite, dependent.
    used = np.flatnonzero(norms > 1e-8 * norms.max())
    r, order = qr(w[:, used] / norms[used], mode="r", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diag(r)) > 2e-5 * abs(r[0, 0])))
    return np.sort(used[order[:rank]])


def plain_observation(model: pinocchio.Model, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """W (m, n, 14 n): ten inertial parameters a link, rotor inertia, Coulomb, viscous, offset, sample by sample."""
    m, n = q.shape
    data = model.createData()
    w = np.zeros((m, n, 14 * n))
    for k in range(m):
        w[k, :, : 10 * n] = pinocchio.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
    joints = np.arange(n)
    for place, values in enumerate((ddq, np.sign(dq), dq, np.ones_like(dq))):
        w[:, joints, (10 + place) * n + joints] = values
    return w


def plain_identification(
    model: pinocchio.Model,
    samples: Samples,
    columns: NDArray[np.intp],
    *,
    cutoff: float,
    decimation: int,
    weighted: bool = True,
) -> PlainResult:
    """Filter, differentiate, build W in a loop, filter and decimate W and Y, solve, deviations [12.5]-[12.9]."""
    rate = samples.rate
    b, a = signal.butter(4, cutoff / (rate / 2))
    q = signal.filtfilt(b, a, samples.q, axis=0)
    dq = (q[2:] - q[:-2]) * (rate / 2)
    ddq = (q[2:] - 2 * q[1:-1] + q[:-2]) * rate**2
    q, tau = q[1:-1], samples.tau[1:-1]
    w = plain_observation(model, q, dq, ddq)[:, :, columns]
    margin = max(1, int(rate / cutoff))
    w = signal.filtfilt(b, a, w, axis=0)[margin:-margin:decimation]
    y = signal.filtfilt(b, a, tau, axis=0)[margin:-margin:decimation]
    m, n, c = w.shape
    noise = np.ones(n)
    for _ in range(2 if weighted else 1):
        ww = (w / noise[:, None]).reshape(m * n, c)
        yy = (y / noise).reshape(m * n)
        values = np.linalg.lstsq(ww, yy, rcond=None)[0]
        residual = y - w @ values
        noise = np.sqrt((residual**2).sum(axis=0) / (m * (1 - c / (m * n))))
    variance = float(((yy - ww @ values) ** 2).sum()) / (m * n - c)
    deviations = np.sqrt(variance * np.diag(np.linalg.inv(ww.T @ ww)))
    return PlainResult(values, deviations, float(np.linalg.norm(residual) / np.linalg.norm(y)))


def median_time(function: Callable[[], object], repeats: int) -> float:
    """Median processor time of a call in s, after one that warms up: what others do on the machine counts less."""
    function()
    durations = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        durations.append(time.process_time() - start)
    return statistics.median(durations)


def peak_memory() -> float:
    """Largest resident memory of this process so far, in MB."""
    status = Path("/proc/self/status")
    if status.exists():  # a child's ru_maxrss starts from its parent's
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1e3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def show(title: str, rows: Iterable[Sequence[str]]) -> None:
    """Print a table with aligned columns."""
    table = [list(row) for row in rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    print(f"\n{title}")
    for row in table:
        cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        print("  " + "  ".join(cells))
