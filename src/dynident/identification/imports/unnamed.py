"""Columns whose names say nothing: what they are by what is in them, and of which joint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.identification.imports.facts import SLOPE, roughness, slopes
from dynident.identification.imports.words import Named

_EXPLAINED, _CLEARLY = 0.3, 1.5
_GAP = 3.0
"""Times that the smoothest torque is rougher than the roughest position."""


@dataclass(frozen=True)
class Kinds:
    """Columns (by index) by what they hold, in the order of the file; `rates` are those of the positions."""

    positions: tuple[int, ...]
    rates: tuple[int, ...]
    efforts: tuple[int, ...]
    reason: str


def kinds_of(
    t: FloatArray,
    values: FloatArray,
    columns: Sequence[int],
    n: int,
    left: Callable[[tuple[int, ...], tuple[int, ...]], float],
) -> Kinds | None:
    """Tell positions, velocities and torques of n joints apart.

    `left` says what share of torques is not explained by the motion of positions, given the columns of both. None where
    there are not as many columns as that needs, or they do not differ clearly.
    """
    part = values[:, list(columns)]
    if len(columns) == 3 * n:
        found = _by_slopes(t, part, columns, n)
        if found is None:
            return _three_blocks(t, part, columns, n, np.max)
        if all(is_in_order(one) for one in (found.positions, found.rates, found.efforts)):
            return found
        # A torque may run beside a velocity by chance: blocks side by side of which most joints say the same go first.
        return _three_blocks(t, part, columns, n, np.median) or found
    if len(columns) != 2 * n:
        return None
    rough = roughness(t, part)
    order = np.argsort(rough)
    if rough[order[n]] < _GAP * rough[order[n - 1]]:
        return _two_blocks(columns, n, left)
    smooth = set(order[:n].tolist())
    return Kinds(
        tuple(columns[index] for index in range(2 * n) if index in smooth),
        (),
        tuple(columns[index] for index in range(2 * n) if index not in smooth),
        f"half of the columns are smooth as positions are, the others at least {_GAP:.0f} times rougher",
    )


def _by_slopes(t: FloatArray, part: FloatArray, columns: Sequence[int], n: int) -> Kinds | None:
    correlation, _ = slopes(t, part)
    np.fill_diagonal(correlation, 0.0)
    follower = correlation.argmax(axis=1)
    led = [
        index
        for index in range(len(columns))
        if correlation[index, follower[index]] > SLOPE and correlation[:, follower[index]].argmax() == index
    ]
    pairs = [(index, int(follower[index])) for index in led if follower[index] not in led]
    if len(pairs) != n:
        return None
    taken = {index for pair in pairs for index in pair}
    rest = [index for index in range(len(columns)) if index not in taken]
    return Kinds(
        tuple(columns[first] for first, _ in pairs),
        tuple(columns[second] for _, second in pairs),
        tuple(columns[index] for index in rest),
        "some columns are the slopes of others, and the rest of neither",
    )


def _three_blocks(
    t: FloatArray, part: FloatArray, columns: Sequence[int], n: int, of_joints: Callable[[list[float]], float]
) -> Kinds | None:
    """Three signals of all joints side by side, some of which stand still: told by the joints that move."""
    correlation, _ = slopes(t, part)
    best: tuple[float, tuple[list[int], ...]] | None = None
    for blocks in _layouts(n, 3):
        for first in range(3):
            for second in range(3):
                if first == second:
                    continue
                pairs = [correlation[a, b] for a, b in zip(blocks[first], blocks[second], strict=True)]
                told = float(of_joints(pairs))
                if told > SLOPE and (best is None or told > best[0]):
                    rest = blocks[3 - first - second]
                    best = told, (blocks[first], blocks[second], rest)
    if best is None:
        return None
    q, dq, tau = (tuple(columns[index] for index in block) for block in best[1])
    return Kinds(q, dq, tau, "of the joints that move one block of columns is the slope of another")


def _two_blocks(
    columns: Sequence[int], n: int, left: Callable[[tuple[int, ...], tuple[int, ...]], float]
) -> Kinds | None:
    """Two signals of all joints side by side: as which of them the robot's dynamics explain the torque."""
    tried = []
    for blocks in _layouts(n, 2):
        for first in (0, 1):
            q, tau = (tuple(columns[index] for index in blocks[place]) for place in (first, 1 - first))
            tried.append((left(q, tau), q, tau))
    tried.sort(key=lambda one: one[0])
    if tried[0][0] > _EXPLAINED or tried[1][0] < _CLEARLY * tried[0][0]:
        return None
    share, q, tau = tried[0]
    return Kinds(q, (), tau, f"taken so, the robot's dynamics leave {share:.0%} of the torque; otherwise far more")


def _layouts(n: int, signals: int) -> list[list[list[int]]]:
    """Places of the signals' columns: signal by signal, or joint by joint."""
    by_signal = [list(range(k * n, (k + 1) * n)) for k in range(signals)]
    by_joint = [list(range(k, n * signals, signals)) for k in range(signals)]
    return [by_signal, by_joint]


def whole_signals(columns: Sequence[int], values: FloatArray, alive: BoolArray, n: int) -> list[int]:
    """Columns that change; with those of joints that stand still where it is not whole signals of n joints else."""
    numbers = [index for index in columns if np.isfinite(values[:, index]).all()]
    moving = [index for index in numbers if alive[index]]
    return numbers if len(moving) % n and not len(numbers) % n else moving


def as_counted(named: Sequence[Named], columns: list[int]) -> list[int]:
    """Columns in the order of the number in their names, where that alone tells them apart; else as they are."""
    numbers = [named[index].numbers for index in columns]
    stems = {tuple(word for word in named[index].words if not word.isdigit()) for index in columns}
    if len(stems) != 1 or any(len(one) != 1 for one in numbers) or len(set(numbers)) < len(numbers):
        return columns
    return [columns[place] for place in np.argsort([one[0] for one in numbers])]


def is_in_order(columns: Sequence[int]) -> bool:
    """Whether columns stand side by side in the file, or in even steps."""
    return len(set(np.diff(columns).tolist())) <= 1


def own_torques(t: FloatArray, q: FloatArray, tau: FloatArray) -> tuple[IntArray, float]:
    """Which torque is that of which position, by friction and inertia of the joint itself.

    Returns
    -------
    order (n,), margin : the torque of every position, and by what factor another pairing explains less.
    """
    from scipy.optimize import linear_sum_assignment

    n = q.shape[1]
    rate = np.gradient(q, t, axis=0)
    width = max(1, len(t) // 2000)
    shares = np.zeros((n, n))
    for joint in range(n):
        own = rate[::width, joint]
        rows = np.column_stack([np.tanh(own / (0.05 * own.std() + 1e-12)), own, np.ones(len(own))])
        for other in range(n):
            target = tau[::width, other]
            left = target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]
            shares[joint, other] = 1.0 - left.var() / max(target.var(), 1e-30)
    certainty = np.log(np.clip(shares, 1e-3, 1.0))
    rows_, order = linear_sum_assignment(-certainty)
    best = float(certainty[rows_, order].sum())
    second = -np.inf
    for joint in range(n):
        blocked = certainty.copy()
        blocked[joint, order[joint]] = -50.0
        again = linear_sum_assignment(-blocked)
        second = max(second, float(blocked[again].sum()))
    return order.astype(np.int64), best - second
