"""Recordings of drawn arms, clean ones and spoilt ones: t (m,), values (m, 2 n)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

N = 4
NOISES: dict[str, Callable[[np.random.Generator, tuple[int, ...]], FloatArray]] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "t5": lambda rng, shape: rng.standard_t(5, shape),
    "t3": lambda rng, shape: rng.standard_t(3, shape),
    "laplace": lambda rng, shape: rng.laplace(size=shape),
}
KINDS = ("zero", "largest", "stuck", "spike")


def arm_signals(
    seed: int,
    rate: float = 200.0,
    seconds: float = 20.0,
    *,
    point_to_point: bool = False,
    noise: str = "normal",
    level: float = 0.005,
    count: float = 1e-5,
) -> tuple[FloatArray, FloatArray]:
    """Positions in counts of an encoder, and torques with inertia, gravity, Coulomb friction and noise, of one arm."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(rate * seconds)) / rate
    velocity = _moves(rng, t, rate) if point_to_point else _harmonics(rng, t)
    q = np.cumsum(velocity, axis=0) / rate
    acceleration = np.gradient(velocity, t, axis=0)
    tau = rng.uniform(1, 8, N) * acceleration + rng.uniform(5, 50, N) * np.cos(np.cumsum(q, axis=1))
    tau += rng.uniform(2, 10, N) * np.sign(velocity) + rng.uniform(2, 8, N) * velocity
    tau += level * tau.std(axis=0) * NOISES[noise](rng, tau.shape)
    return t, np.column_stack([np.round(q / count) * count, tau])


def _harmonics(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    velocity = np.zeros((len(t), N))
    for harmonic in range(1, 6):
        w = 2 * np.pi * 0.1 * harmonic * rng.uniform(0.8, 1.5)
        velocity += w * rng.uniform(0.1, 0.5, N) / harmonic * np.cos(w * t[:, None] + rng.uniform(0, 6.28, N))
    return velocity


def _moves(rng: np.random.Generator, t: FloatArray, rate: float) -> FloatArray:
    """Trapezoidal moves with rests between them."""
    velocity = np.zeros((len(t), N))
    for joint in range(N):
        at = 0
        while at < len(t):
            ramp = max(3, int(rate * rng.uniform(0.05, 0.3)))
            speed = rng.uniform(-1.5, 1.5)
            up = np.linspace(0.0, speed, ramp)
            cruise, rest = (
                np.full(int(rate * rng.uniform(0.3, 1.5)), speed),
                np.zeros(int(rate * rng.uniform(0.15, 1))),
            )
            move = np.concatenate([up, cruise, up[::-1], rest])[: len(t) - at]
            velocity[at : at + len(move), joint] = move
            at += len(move)
    return velocity


def corrupt(
    values: FloatArray, seed: int, share: float, kind: str, longest: int = 1, columns: tuple[int, ...] | None = None
) -> tuple[FloatArray, BoolArray]:
    """Spoil about a share of the samples of every column, in bursts of up to `longest`, and say which."""
    rng = np.random.default_rng(seed)
    spoilt, planted = values.copy(), np.zeros(values.shape, dtype=bool)
    for column in range(values.shape[1]) if columns is None else columns:
        x = values[:, column]
        for start in rng.integers(8, len(x) - 8 - longest, max(1, round(2 * share * len(x) / (1 + longest)))):
            length = int(rng.integers(1, longest + 1))
            if planted[start - 1 : start + length + 1, column].any():
                continue
            burst = slice(start, start + length)
            new = {
                "zero": 0.0,
                "largest": 1.5 * np.abs(x).max(),
                "stuck": -1.2 * np.abs(x).max(),
                "spike": x[start] + rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 3.0) * x.std(),
            }[kind]
            if np.abs(new - x[burst]).min() < 0.1 * x.std():
                # What stands where the signal is anyway cannot be told, and does no harm.
                continue
            spoilt[burst, column] = new
            planted[burst, column] = True
    return spoilt, planted


def file_columns(t: FloatArray, values: FloatArray) -> dict[str, FloatArray]:
    """Columns of a file."""
    n = values.shape[1] // 2
    columns = {"t": t}
    columns |= {f"q{j + 1}": values[:, j] for j in range(n)}
    columns |= {f"tau{j + 1}": values[:, n + j] for j in range(n)}
    return columns
