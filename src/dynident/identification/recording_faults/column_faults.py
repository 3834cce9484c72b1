"""The faults that are tried (swapped, reversed or scaled columns), each with its cure; holds the factors of scales."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Literal, Protocol

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.recording_metadata import Axis, Revision

BESIDE_OFFSETS = 0.1
"""Share of what falls without a fault that has to fall beside constant torques as well, which a robot may have. In
short right motions of one that has them it was mostly less than nothing, and at most 0.09; of what can be planted in
two recordings of a KR300, where most of it has a small share, one in twenty gave less. What comes of it is among the
short motions of `benchmarks/gross_mistakes.py`."""

LATEST, EARLIEST = 0.017, -0.005
"""s between which the delay of a correct log lies: filters of drives delay the torque by up to 14 ms on the open
recordings, and nothing makes it come before its cause (`benchmarks/gross_mistakes.py`)."""

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
    "position scaled",
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
SCALED: tuple[FaultKind, ...] = ("torque scaled", "position scaled")
TURNS: tuple[FaultKind, ...] = ("torque turned", "position turned", "joint turned")
_OF_POSITION = (
    "positions swapped", "joints swapped", "position turned", "joint turned", "joint coupled", "joints mixed",
    "joint zero", "position scaled",
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
        It mends torques, or positions, that are scaled. Of two joints that are coupled, the first is counted from the
        second: its position is that of the column less `factor` times the second's. Of joints with other zeros, see
        `zeros`.
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
            sign[list(self.joints)] = self.factor if self.kind in SCALED else -1.0
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
    if revolute is not None and (revolute & moving).sum() > 1:
        # Limits of speed do not tell degrees of a slow motion.
        yield ColumnFault("position scaled", tuple(np.flatnonzero(revolute).tolist()), float(np.deg2rad(1.0)))
    yield from _list_reversed_order(moving)
    yield from _list_rings(moving)
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


def _list_rings(moving: BoolArray) -> Iterator[ColumnFault]:
    """Yield all orders of the columns of a few joints but exchanges of one pair, and the reversed one."""
    joints = tuple(np.flatnonzero(moving).tolist())
    for order in permutations(joints) if len(moving) <= _FEW else ():
        elsewhere = [(joint, source) for joint, source in zip(joints, order, strict=True) if joint != source]
        if len(elsewhere) > 2 and order != joints[::-1]:
            own, other = zip(*elsewhere, strict=True)
            yield from (ColumnFault(kind, own, sources=other) for kind in _SWAPS[:2])


_FEW = 4
"""Joints whose columns are tried in all orders, 23 besides the right one; of more joints, exchanges of pairs add up."""


def compose_swaps(first: ColumnFault, second: ColumnFault) -> ColumnFault | None:
    """Return two exchanges as one, which a file with both needs; None where they are not of the same columns.

    Parameters
    ----------
    first, second : ColumnFault
        The second is one of the columns without the first.
    """
    shared = set(first.joints) & set(second.joints)
    if not (first.is_swap and first.kind == second.kind and shared):
        return None
    sources = dict(first.places)
    order = sources | {joint: sources.get(source, source) for joint, source in second.places}
    elsewhere = sorted((joint, source) for joint, source in order.items() if joint != source)
    if not elsewhere:
        return None
    own, other = zip(*elsewhere, strict=True)
    return ColumnFault(first.kind, own, sources=other)


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


def build_revision(fault: ColumnFault, n: int) -> Revision | None:
    """Return the correction of a file's metadata that mends a fault; None where no metadata can.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    n : int
        Number of joints.
    """
    if fault.kind in ("joint coupled", "joints mixed"):
        return None
    sides: tuple[tuple[Axis, bool], ...] = (("q", fault.is_of_positions), ("tau", fault.is_of_torques))
    kinds = [kind for kind, is_wrong in sides if is_wrong]
    if fault.kind in SCALED:
        return Revision(scale={f"{kind}{joint + 1}": fault.factor for kind in kinds for joint in fault.joints})
    if fault.kind == "joint zero":
        return Revision(zeros=list_zeros(fault))
    if not fault.is_swap:
        return Revision(signs={f"{kind}{joint + 1}": -1.0 for kind in kinds for joint in fault.joints})
    # Permutations of a request count from one.
    order = list(range(1, n + 1))
    for joint, source in fault.places:
        order[joint] = source + 1
    return Revision(permutation=dict.fromkeys(kinds, tuple(order)))


def list_zeros(fault: ColumnFault) -> dict[str, float]:
    """Return the zeros of joints as metadata state them, in rad by our names of columns."""
    return {f"q{joint + 1}": float(f"{zero:.8g}") for joint, zero in fault.zeros.items()}


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


def average_shares(unexplained: Sequence[UnexplainedShares]) -> FloatArray:
    """Return the same for each of several trials."""
    return np.array([average_share(trial) for trial in unexplained])


def average_share(unexplained: UnexplainedShares) -> float:
    """Return the mean logarithm of the shares held out."""
    return float(unexplained.fine.mean())


def is_possible_delay(seconds: float) -> bool:
    """Tell whether drives delay a torque by so many seconds."""
    return EARLIEST <= seconds <= LATEST


def find_lowest(delays: FloatArray, unexplained: FloatArray) -> float:
    """Return the delay with the smallest unexplained share, by a parabola through the best that was tried."""
    best = int(np.argmin(unexplained))
    if best in (0, len(delays) - 1):
        return float(delays[best])
    x, y = (values[best - 1 : best + 2] for values in (delays, unexplained))
    # A parabola through the best point and its neighbours; it only has a lowest point where it opens upwards. Squared
    # shares grow with the square of the distance, where their logarithms have a corner.
    a, b, _ = np.polyfit(x, np.exp(2.0 * (y - y.min())), 2)
    return float(np.clip(-0.5 * b / a, x[0], x[-1])) if a > 0 else float(x[1])
