"""Columns whose names say nothing: what they are by what is in them, and of which joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray, IntArray
from dynident.identification.imports.facts import SLOPE, roughness, slopes

_GAP = 3.0
"""Times that the smoothest torque is rougher than the roughest position."""


@dataclass(frozen=True)
class Kinds:
    """Columns (by index) by what they hold, in the order of the file; `rates` are those of the positions."""

    positions: tuple[int, ...]
    rates: tuple[int, ...]
    efforts: tuple[int, ...]
    reason: str


def kinds_of(t: FloatArray, values: FloatArray, columns: Sequence[int], n: int) -> Kinds | None:
    """Tell positions, velocities and torques of n joints apart.

    None where there are not as many columns as that needs, or they do not differ clearly.
    """
    part = values[:, list(columns)]
    if len(columns) == 3 * n:
        correlation, _ = slopes(t, part)
        np.fill_diagonal(correlation, 0.0)
        follower = correlation.argmax(axis=1)
        led = [
            index
            for index in range(len(columns))
            if correlation[index, follower[index]] > SLOPE and correlation[:, follower[index]].argmax() == index
        ]
        pairs = [(index, int(follower[index])) for index in led if follower[index] not in led]
        if len(pairs) == n:
            taken = {index for pair in pairs for index in pair}
            rest = [index for index in range(len(columns)) if index not in taken]
            return Kinds(
                tuple(columns[first] for first, _ in pairs),
                tuple(columns[second] for _, second in pairs),
                tuple(columns[index] for index in rest),
                "some columns are the slopes of others, and the rest of neither",
            )
        return None
    if len(columns) != 2 * n:
        return None
    rough = roughness(t, part)
    order = np.argsort(rough)
    if rough[order[n]] < _GAP * rough[order[n - 1]]:
        return None
    smooth = set(order[:n].tolist())
    return Kinds(
        tuple(columns[index] for index in range(2 * n) if index in smooth),
        (),
        tuple(columns[index] for index in range(2 * n) if index not in smooth),
        f"half of the columns are smooth as positions are, the others at least {_GAP:.0f} times rougher",
    )


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
