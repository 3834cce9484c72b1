"""The faults that are tried (swapped, reversed, scaled or delayed columns), each with its cure.

Holds the factors of scales, and when a delay is certain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Literal, Protocol

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IntArray

LATEST, EARLIEST = 0.017, -0.005
"""s between which the delay of a correct log lies: filters of drives delay the torque by up to 14 ms on the open
recordings, and nothing makes it come before its cause (`benchmarks/gross_mistakes.py`)."""

CLEARLY, SURELY = 0.004, 1.5
"""Mean logarithm by which the unexplained share of the torque falls with the delay taken out, and over its standard
error among blocks of time. That a delay cannot be decides more than these do."""

SHARP = 50.0
"""1/s²: the same fall over the square of the delay, below which a delay costs so little that none is determined. Of
20 ms planted in the open recordings of arms that are rigid it was 96 and more, of a right elastic arm that looked early
30. This is half way between, in logarithms."""

BESIDE_OFFSETS = 0.1
"""Share of what falls without a fault that has to fall beside constant torques as well, which a robot may have. In
short right motions of one that has them it was mostly less than nothing, and at most 0.09; of what can be planted in
two recordings of a KR300, where most of it has a small share, one in twenty gave less. What comes of it is among the
short motions of `benchmarks/gross_mistakes.py`."""

# Delays in s that are tried, closer together near zero; between them a parabola finds the lowest point.
_CANDIDATES = np.array([-0.045, -0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03, 0.045])
_LONGER = (0.07, 0.1, 0.15, 0.22, 0.3)
"""s: tried one after another where the longest of them explains most, until one explains less."""
_FEW = 8


class UnexplainedShares(Protocol):
    """Unexplained shares of a torque, as mean logarithms: held out in each block (blocks,), and inside the fit.

    They are not cut off where nearly all is explained: a delay shows there, too.
    """

    @property
    def fine(self) -> FloatArray: ...  # noqa: D102

    @property
    def fine_inside(self) -> float: ...  # noqa: D102


@dataclass(frozen=True)
class Delay:
    """Delay of the torque of a motion.

    Parameters
    ----------
    seconds : float
        The delay in s; below zero where the torque is early.
    is_fault : bool
        Whether it is a fault of the log, and more than drives delay.
    left_with : float
        Unexplained share of an average joint's torque as it is.
    left_without : float
        The same with the delay taken out.
    is_at_the_end : bool
        Whether it is the largest delay that was tried: the cause then need not be a delay.
    """

    seconds: float
    is_fault: bool
    left_with: float
    left_without: float
    is_at_the_end: bool


def estimate_delay(
    motion: Motion,
    period: float,
    left_of: Callable[[Motion], UnexplainedShares],
    left_beside: Callable[[Motion], UnexplainedShares],
) -> Delay | None:
    """Find the delay with which the robot explains most; None where the rows are too few.

    Parameters
    ----------
    motion : Motion
        All filtered rows, in their order.
    period : float
        s between rows.
    left_of : function
        Returns the unexplained shares of a motion's torque.
    left_beside : function
        The same beside a constant torque on each joint.

    Returns
    -------
    Delay or None
        The delay, and whether it is a fault; None where the rows are too few.
    """
    if len(motion.q) < _FEW:
        return None
    rows = np.arange(len(motion.q), dtype=np.float64)
    # A delay is no whole number of rows, so the torque is interpolated between them.
    torque = scipy.interpolate.make_interp_spline(rows, motion.tau, k=3)

    def shift_torque(seconds: float) -> Motion:
        return replace(motion, tau=torque(np.clip(rows + seconds / period, 0.0, rows[-1])))

    tried = {float(seconds): left_of(shift_torque(float(seconds))) for seconds in _CANDIDATES}
    for longer in _LONGER:
        best = min(tried, key=lambda delay: float(tried[delay].fine.mean()))
        if best not in (min(tried), max(tried)):
            break
        tried[float(np.copysign(longer, best))] = left_of(shift_torque(float(np.copysign(longer, best))))
    delays = np.array(sorted(tried))
    unexplained = [tried[float(delay)] for delay in delays]
    held_out, inside = _average(unexplained), np.array([trial.fine_inside for trial in unexplained])
    seconds = _find_lowest(delays, held_out)
    now, then = tried[0.0], left_of(shift_torque(seconds))
    fall = now.fine - then.fine
    # A paired comparison over the same blocks.
    error = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    is_fault = (
        float(fall.mean()) >= SURELY * error
        and _is_impossible(delays, held_out, seconds)
        and _is_impossible(delays, inside, seconds)
        # Tested last, as it needs a second model: made only where all others say yes.
        and _is_impossible(delays, _average([left_beside(shift_torque(float(delay))) for delay in delays]), seconds)
    )
    is_at_the_end = seconds in (delays[0], delays[-1])
    return Delay(seconds, is_fault, float(np.exp(now.fine.mean())), float(np.exp(then.fine.mean())), is_at_the_end)


def _average(unexplained: Sequence[UnexplainedShares]) -> FloatArray:
    return np.array([trial.fine.mean() for trial in unexplained])


def _is_impossible(delays: FloatArray, unexplained: FloatArray, seconds: float) -> bool:
    """Tell whether the lowest of the shares (delays,) is clear, and at a delay that no drive has.

    On the side of zero that `seconds` are on. Held out, inside the fit and beside constant torques alike: in short
    motions one of these alone is chance.
    """
    lowest, as_is = _find_lowest(delays, unexplained), float(unexplained[delays == 0.0][0])
    clear = as_is - unexplained.min() >= max(CLEARLY, SHARP * lowest**2)
    return bool(clear) and not is_possible_delay(lowest) and (lowest > 0) == (seconds > 0)


def is_possible_delay(seconds: float) -> bool:
    """Tell whether drives delay a torque by so many seconds."""
    return EARLIEST <= seconds <= LATEST


def _find_lowest(delays: FloatArray, unexplained: FloatArray) -> float:
    """Return the delay with the smallest unexplained share, by a parabola through the best that was tried."""
    best = int(np.argmin(unexplained))
    if best in (0, len(delays) - 1):
        return float(delays[best])
    x, y = (values[best - 1 : best + 2] for values in (delays, unexplained))
    # A parabola through the best point and its neighbours; it only has a lowest point where it opens upwards. Squared
    # shares grow with the square of the distance, where their logarithms have a corner.
    a, b, _ = np.polyfit(x, np.exp(2.0 * (y - y.min())), 2)
    return float(np.clip(-0.5 * b / a, x[0], x[-1])) if a > 0 else float(x[1])


FaultKind = Literal[
    "torques swapped",
    "positions swapped",
    "joints swapped",
    "torque turned",
    "position turned",
    "joint turned",
    "torque scaled",
    "joint coupled",
    "joints mixed",
    "joint zero",
]


@dataclass(frozen=True)
class Mixing:
    """How gears make the positions of two joints of those of their two motors.

    Parameters
    ----------
    scale : float
        Factor of all entries of the matrix.
    signs : (4,) tuple of int
        Its entries, row by row: 1, -1 or 0.
    """

    scale: float
    signs: tuple[int, ...]

    @property
    def matrix(self) -> FloatArray:
        """The matrix (2, 2) that makes joint positions of motor positions."""
        return self.scale * np.array(self.signs, dtype=np.float64).reshape(2, 2)

    @property
    def of_torques(self) -> FloatArray:
        """The matrix (2, 2) that makes joint torques of motor torques: power is the same at motors and joints."""
        return np.asarray(np.linalg.inv(self.matrix).T)


_SWAPS: tuple[FaultKind, ...] = ("torques swapped", "positions swapped", "joints swapped")
TURNS: tuple[FaultKind, ...] = ("torque turned", "position turned", "joint turned")
_OF_POSITION = (
    "positions swapped", "joints swapped", "position turned", "joint turned", "joint coupled", "joints mixed",
    "joint zero",
)  # fmt: skip
_OF_TORQUE = ("torques swapped", "joints swapped", "torque turned", "joint turned", "torque scaled", "joints mixed")
_SMALL = 1e-3
"""Factor that silences a torque: zero would take the joint out of the joints with a torque."""

FACTORS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)
"""Factors that mend a torque: gains and units that are one to three powers of ten off."""

_SUM, _DIFFERENCE = (1, 1), (1, -1)
MIXINGS = tuple(
    Mixing(scale, tuple(sign * entry for sign, row in zip(signs, rows, strict=True) for entry in row))
    for rows in ((_SUM, _DIFFERENCE), (_DIFFERENCE, _SUM))
    for signs in product((1, -1), repeat=2)
    for scale in (0.5, 1.0)
) + tuple(Mixing(1.0, (1, 0, sign, 1)) for sign in (1, -1))
"""Angles of two joints by those of their motors: of a differential half their sum and half their difference, or both
whole where the gear ratio counts for each; of a coupled wrist, the second more or less by the first."""

ZEROS = (0.5 * np.pi, -0.5 * np.pi, np.pi)
"""rad that conventions of a joint's zero differ by: stretched out or upright, Denavit-Hartenberg or the maker's."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Filtered rows of a recording.

    Parameters
    ----------
    q : (m, n)
        Positions in rad or m.
    dq : (m, n)
        Velocities in rad/s or m/s.
    ddq : (m, n)
        Accelerations in rad/s² or m/s².
    tau : (m, n)
        Torques, in the unit of the file where that is not known.
    block : (m,)
        Number of the block of time that each row is in.
    t : (m,)
        Times in s.
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    tau: FloatArray
    block: IntArray
    t: FloatArray


@dataclass(frozen=True)
class ColumnFault:
    """One fault: joints whose columns stand in each other's place, or joints whose sign or size is wrong.

    Parameters
    ----------
    kind : str
        Kind of the fault. Of a joint that is swapped or turned, both position and torque are.
    joints : tuple of int
        Numbers of the joints. Joints that are swapped stand side by side, pair after pair: (0, 3, 1, 4) are 0 with 3,
        and 1 with 4; unless `sources` are given.
    factor : float
        It mends torques that are scaled. Of two joints that are coupled, the first is counted from the second: its
        position is that of the column less `factor` times the second's. Of joints with other zeros, see `zeros`.
    mixing : Mixing, optional
        How gears make the positions of two joints of those of their motors, which the columns are.
    sources : tuple of int
        Of joints whose columns go round in a ring, the joint in whose place each joint's columns stand.
    """

    kind: FaultKind
    joints: tuple[int, ...]
    factor: float = 1.0
    sources: tuple[int, ...] = ()
    mixing: Mixing | None = None

    @property
    def own_joints(self) -> tuple[int, ...]:
        """Joints whose columns are wrong: of two that are coupled, the one that is counted from the other."""
        return self.joints[:1] if self.kind == "joint coupled" else self.joints

    @property
    def zeros(self) -> dict[int, float]:
        """Angles in rad that the columns of joints have too much; of two the second has as much too little."""
        return dict(zip(self.joints, (self.factor, -self.factor), strict=False))

    @property
    def is_swap(self) -> bool:
        """Whether two joints stand in each other's place."""
        return self.kind in _SWAPS

    @property
    def places(self) -> tuple[tuple[int, int], ...]:
        """Joints that stand elsewhere, each with the joint in whose place its columns are."""
        if not self.is_swap:
            return ()
        if self.sources:
            return tuple(zip(self.joints, self.sources, strict=True))
        pairs = zip(self.joints[::2], self.joints[1::2], strict=True)
        return tuple(place for first, second in pairs for place in ((first, second), (second, first)))

    @property
    def is_of_positions(self) -> bool:
        """Whether positions are wrong."""
        return self.kind in _OF_POSITION

    @property
    def is_of_torques(self) -> bool:
        """Whether torques are wrong."""
        return self.kind in _OF_TORQUE

    @property
    def is_of_whole_joints(self) -> bool:
        """Whether positions and torques are wrong alike."""
        return self.is_of_positions and self.is_of_torques

    def mend(self, motion: Motion) -> Motion:
        """Return the motion without the fault, if it is the one that was made.

        Parameters
        ----------
        motion : Motion
            As it was recorded.
        """
        n = motion.q.shape[1]
        order, sign = np.arange(n), np.ones(n)
        if self.is_swap:
            for joint, source in self.places:
                order[joint] = source
        elif self.kind not in ("joint coupled", "joints mixed", "joint zero"):
            sign[list(self.joints)] = self.factor if self.kind == "torque scaled" else -1.0
        q, dq, ddq, tau = motion.q, motion.dq, motion.ddq, motion.tau
        if self.mixing is not None:
            parts = [(signal, self.mixing.matrix) for signal in (q, dq, ddq)] + [(tau, self.mixing.of_torques)]
            q, dq, ddq, tau = (_multiply_columns(signal, self.joints, matrix) for signal, matrix in parts)
            return Motion(q, dq, ddq, tau, motion.block, motion.t)
        if self.kind == "joint coupled":
            q, dq, ddq = (_uncouple(signal, self) for signal in (q, dq, ddq))
        elif self.kind == "joint zero":
            q = q - np.array([self.zeros.get(joint, 0.0) for joint in range(n)])
        elif self.is_of_positions:
            q, dq, ddq = (signal[:, order] * sign for signal in (q, dq, ddq))
        if self.is_of_torques:
            tau = tau[:, order] * sign
        return Motion(q, dq, ddq, tau, motion.block, motion.t)


def _uncouple(signal: FloatArray, fault: ColumnFault) -> FloatArray:
    own, other = fault.joints
    # The signals belong to the motion as it was recorded, which other trials still need.
    changed = signal.copy()
    changed[:, own] -= fault.factor * signal[:, other]
    return changed


def _multiply_columns(signal: FloatArray, joints: tuple[int, ...], matrix: FloatArray) -> FloatArray:
    changed = signal.copy()
    changed[:, list(joints)] = signal[:, list(joints)] @ matrix.T
    return changed


def silence_others(motion: Motion, joints: tuple[int, ...]) -> Motion:
    """Return the motion with some joints' torques so small that they have no say in the parameters of the others.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording.
    joints : tuple of int
        Numbers of the joints, from 0.
    """
    tau = motion.tau.copy()
    tau[:, list(joints)] *= _SMALL
    return replace(motion, tau=tau)


def list_possible_faults(
    moving: BoolArray,
    parallel: BoolArray | None = None,
    has_torque: BoolArray | None = None,
    revolute: BoolArray | None = None,
) -> Iterator[ColumnFault]:
    """Yield all faults that are possible, those of the whole robot first.

    Parameters
    ----------
    moving : (n,)
        Joints that move: the others tell nothing.
    parallel : (n,), optional
        Joints whose axis is parallel to that of the joint before.
    has_torque : (n,), optional
        Joints whose torque changes: nobody has exchanged one that was not recorded.
    revolute : (n,), optional
        Joints that turn: their zeros may be a quarter or half a turn from the description's.
    """
    yield from _list_faults_of_many_joints(moving)
    yield from _list_reversed_order(moving)
    if parallel is not None:
        for index in np.flatnonzero(parallel & moving):
            pair = (int(index), int(index) - 1)
            yield from (ColumnFault("joint coupled", pair, factor) for factor in (1.0, -1.0))
    joints = [int(j) for j in np.flatnonzero(moving)]
    for first, second in combinations(range(len(moving)), 2):
        if moving[first] and moving[second]:
            yield from (ColumnFault(kind, (first, second)) for kind in _SWAPS)
        elif (moving[first] or moving[second]) and (has_torque is None or has_torque[[first, second]].all()):
            # A joint at rest tells only whether its column holds the other joint's torque.
            yield ColumnFault("torques swapped", (first, second))
    for joint in joints:
        yield from (ColumnFault(kind, (joint,)) for kind in TURNS)
        yield from (ColumnFault("torque scaled", (joint,), factor) for factor in FACTORS)
        if revolute is not None and revolute[joint]:
            yield from (ColumnFault("joint zero", (joint,), angle) for angle in ZEROS)


def _list_reversed_order(moving: BoolArray) -> Iterator[ColumnFault]:
    """Yield columns counted from the last joint on."""
    n = len(moving)
    swap = [(k, n - 1 - k) for k in range(n // 2)]
    # Two or three joints counted backwards are exchanges of a pair, which are tried anyway.
    if n > 3 and all(moving[first] or moving[second] for first, second in swap):
        yield from (ColumnFault(kind, tuple(joint for joints in swap for joint in joints)) for kind in _SWAPS)


def list_chain_orders(
    chains: Sequence[Sequence[int]], measure: Callable[[ColumnFault], FloatArray], moving: BoolArray
) -> Iterator[ColumnFault]:
    """Yield the order of the legs, or arms, of a robot in which its torques or positions are explained best.

    Each chain is tried with the columns of every other chain of its length, all of them at once: as many fits as there
    are chains tell the best of all orders, since a chain's torque says little of the other chains.

    Parameters
    ----------
    chains : sequence of joints
        The joints of each arm, or leg, of the robot.
    measure : function
        Returns the unexplained share of each joint's torque (n,) without a fault.
    moving : (n,)
        Joints that move: chains without one tell nothing.
    """
    for length in sorted({len(chain) for chain in chains}):
        alike = [chain for chain in chains if len(chain) == length > 1 and moving[list(chain)].any()]
        if len(alike) < 2:
            continue
        count = len(alike)
        for kind in _SWAPS[:2]:
            left = np.zeros((count, count))
            for shift in range(count):
                sources = [(place + shift) % count for place in range(count)]
                shares = measure(_order_chains(kind, alike, sources))
                # Joints that stand have a share of zero, but explain nothing.
                logs = np.log(np.where(shares > 0.0, np.maximum(shares, _TINY), 1.0))
                left[range(count), sources] = [logs[list(own)].sum() for own in alike]
            _, best = scipy.optimize.linear_sum_assignment(left)
            if (best != np.arange(count)).any():
                yield _order_chains(kind, alike, best.tolist())


_TINY = 1e-6
"""Unexplained share below which a smaller one is no better."""


def _order_chains(kind: FaultKind, chains: Sequence[Sequence[int]], sources: Sequence[int]) -> ColumnFault:
    """Return the fault of which the columns of every chain stand in the place of another."""
    elsewhere = [(place, source) for place, source in enumerate(sources) if place != source]
    if all(sources[source] == place for place, source in elsewhere):
        pairs = [(chains[place], chains[source]) for place, source in elsewhere if place < source]
        joints = (joint for pair in pairs for both in zip(*pair, strict=True) for joint in both)
        return ColumnFault(kind, tuple(joints))
    own, other = (tuple(joint for item in elsewhere for joint in chains[item[side]]) for side in (0, 1))
    return ColumnFault(kind, own, sources=other)


def _list_faults_of_many_joints(moving: BoolArray) -> Iterator[ColumnFault]:
    """Yield signs of all joints, and sizes of the torques of all joints from one on, as of two makes of drives."""
    n = len(moving)
    # Positions and torques both turned round are a mirrored arm on the ceiling, which the direction of gravity tells.
    # Torques of joints at rest tell nothing; their positions do, by the load of the one that moves.
    kinds = TURNS[:2] if moving.sum() > 1 else TURNS[1:2]
    yield from (ColumnFault(kind, tuple(range(n))) for kind in kinds if n > 1)
    for first in range(1, n - 1):
        if moving[first:].sum() > 1:
            yield from (ColumnFault("torque scaled", tuple(range(first, n)), factor) for factor in FACTORS)
