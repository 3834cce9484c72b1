"""Identify columns whose names say nothing, by smoothness, slopes and a fit: signal and joint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.identification.column_inference.column_groups import ColumnGroup, infer_by_elimination
from dynident.identification.column_inference.column_names import ColumnName, Signal
from dynident.identification.column_inference.column_statistics import compute_roughness, select_whole_signals
from dynident.identification.column_inference.metadata_proposal import COMMANDED_RANK
from dynident.identification.column_inference.proposal_in_progress import WorkingProposal
from dynident.number_format import format_percent
from dynident.recordings.signal_spectra import SLOPE, correlate_slopes

_EXPLAINED, _CLEARLY = 0.3, 1.5
"""Largest unexplained share of the torque for an order of the columns to be taken, and ratio to the next best order."""
_SAME_FACTOR, _SAME_RISE = 0.02, 0.1
"""Relative differences of the factors of velocities, and of most accelerations, over slopes: by noise and filters."""
_NOISY, _FAR = 0.5, 3.0  # least correlation of accelerations with the velocities' slope, and ratio to that of torques
_STILL = 0.01
"""Spread of a joint that stands, at most, as a share of the largest."""
_ALIKE = 0.99
"""Least correlation of a command with what follows it."""
_GAP = 3.0
"""Ratio of the smoothest torque's roughness to the roughest position's, at least."""
_MOST_BLOCKS = 16
"""Signals of all joints in a file without names: twice those of a drive, measured and commanded. More are not tried."""
MeasureUnexplained = Callable[[tuple[int, ...], tuple[int, ...]], float]
"""The unexplained share of the torque, of columns of positions and of efforts."""


@dataclass(frozen=True)
class UnnamedColumns:
    """Columns by what they hold, in the order of the file.

    Parameters
    ----------
    positions : tuple of int
        Numbers of the columns of positions.
    rates : tuple of int
        Those of the positions' slopes; none where there are none.
    efforts : tuple of int
        Those of torques or currents.
    reason : str
        How they were told apart, as a clause.
    further : tuple of (str, tuple of int)
        More columns that may be one of these signals: "q" or "effort", and the columns.
    """

    positions: tuple[int, ...]
    rates: tuple[int, ...]
    efforts: tuple[int, ...]
    reason: str
    further: tuple[tuple[Signal, tuple[int, ...]], ...] = ()


def identify_unnamed_columns(
    t: FloatArray, values: FloatArray, columns: Sequence[int], n: int, unexplained: MeasureUnexplained
) -> UnnamedColumns | None:
    """Tell positions, velocities and torques of n joints apart.

    Parameters
    ----------
    t : (m,)
        In s.
    values : (m, c)
        Values of all columns.
    columns : sequence of int
        Those in question.
    n : int
        Number of joints.
    unexplained : function
        Returns the share of torques that the motion of positions leaves, given the columns of both.

    Returns
    -------
    UnnamedColumns or None
        None where there are not as many columns as that needs, or they do not differ clearly.
    """
    part = values[:, list(columns)]
    if len(columns) == 3 * n:
        by_slope = _split_by_slopes(t, part, columns, n)
        if by_slope is None:
            return _split_blocks(t, part, columns, n, np.max, unexplained)
        if all(is_in_order(block) for block in (by_slope.positions, by_slope.rates, by_slope.efforts)):
            return by_slope
        # A torque may resemble a velocity by chance. So whole blocks of columns, with the median over the joints, are
        # preferred to single pairs.
        return _split_blocks(t, part, columns, n, np.median, unexplained) or by_slope
    if len(columns) == 4 * n or (n > 1 and 4 * n < len(columns) <= _MOST_BLOCKS * n and len(columns) % n == 0):
        return _split_blocks(t, part, columns, n, np.median, unexplained)
    if len(columns) != 2 * n:
        return None
    if n > 1 and (rates := _split_positions_and_rates(t, part, columns, n)) is not None:
        return rates
    # Positions are integrals of what torques cause, and much smoother.
    rough = compute_roughness(part)
    order = np.argsort(rough)
    if rough[order[n]] < _GAP * rough[order[n - 1]]:
        return _split_two_blocks(columns, n, unexplained)
    smooth = set(order[:n].tolist())
    return UnnamedColumns(
        tuple(columns[index] for index in range(2 * n) if index in smooth),
        (),
        tuple(columns[index] for index in range(2 * n) if index not in smooth),
        f"half of the columns are smooth as positions are, the others at least {_GAP:.0f} times rougher",
    )


def _split_by_slopes(t: FloatArray, part: FloatArray, columns: Sequence[int], n: int) -> UnnamedColumns | None:
    # The velocity is the column that the slope of a position is most like.
    correlation, _ = correlate_slopes(t, part)
    np.fill_diagonal(correlation, 0.0)
    follower = correlation.argmax(axis=1)
    led = [
        index
        for index in range(len(columns))
        if correlation[index, follower[index]] > SLOPE and correlation[:, follower[index]].argmax() == index
    ]
    # Positions lead to velocities. A velocity leads to accelerations, which look like torques, so a follower must not
    # lead.
    pairs = [(index, int(follower[index])) for index in led if follower[index] not in led]
    if len(pairs) != n:
        return None
    firsts, seconds = (tuple(columns[pair[place]] for pair in pairs) for place in (0, 1))
    paired = {index for pair in pairs for index in pair}
    rest = [index for index in range(len(columns)) if index not in paired]
    leader = {int(follower[index]): columns[index] for index in led if index in rest}
    if set(leader) == {first for first, _ in pairs}:
        # These are the derivatives of the positions. One joint's torque may be its acceleration, of a rotor.
        positions = tuple(leader[first] for first, _ in pairs)
        reason = "some columns are first and second derivatives of others"
        return UnnamedColumns(positions, firsts, seconds if n == 1 else (), reason)
    reason = "some columns are the derivatives of others, and the other columns are not"
    return UnnamedColumns(firsts, seconds, tuple(columns[index] for index in rest), reason)


def _split_blocks(
    t: FloatArray,
    part: FloatArray,
    columns: Sequence[int],
    n: int,
    of_joints: Callable[..., FloatArray],
    unexplained: MeasureUnexplained,
) -> UnnamedColumns | None:
    """Find signals of all joints side by side, some of which stand still, by the slopes of the joints that move."""
    correlation, factor = correlate_slopes(t, part)
    best: tuple[float, list[list[int]], list[int]] | None = None
    for layout in _list_layouts(n, len(columns) // n):
        joints = np.transpose(layout)
        rates = of_joints(correlation[joints[:, :, None], joints[:, None, :]], axis=0)
        np.fill_diagonal(rates, 0.0)
        for first, second in np.argwhere(rates > SLOPE).tolist():
            order = [k for k in np.argsort(-rates[second]).tolist() if k not in (first, second)]
            # Derived twice, accelerations are noisy: they are far more like the velocities' slope than the rest is.
            top, *others = rates[second, order].tolist()
            is_rise = bool(others) and (top > SLOPE or (top > _NOISY and top > _FAR * others[0]))
            if best is None or rates[first, second] + is_rise * top > best[0]:
                best = rates[first, second] + is_rise * top, layout, [first, second, *order[:is_rise]]
    if best is None:
        return None
    _, places, (q, dq, *rise) = best
    blocks = [tuple(columns[index] for index in place) for place in places]
    rest = [k for k in range(len(blocks)) if k not in (q, dq)]
    # A command is much like what follows it: which of both was measured is asked, and velocities alike are one signal.
    copies = [k for k in rest if len(rest) > 1 and _are_alike(part, places[k], places[q])]
    left = [k for k in rest if k not in copies and not (len(rest) > 1 and _are_alike(part, places[k], places[dq]))]
    # Accelerations are the slopes of velocities. Torques that resemble these differ by the inertias of the joints.
    derived = [k for k in rise if _have_one_factor(factor[places[dq], places[k]])]
    explained = [k for k in left if len(left) > 1 and unexplained(blocks[q], blocks[k]) < _EXPLAINED]
    # Where the dynamics explain nothing else, what seems to be accelerations may be torques.
    efforts = left if explained == derived else [k for k in explained or left if k not in derived]
    positions = sorted([q, *copies])
    further: list[tuple[Signal, tuple[int, ...]]] = [("q", blocks[k]) for k in positions[1:]]
    further += [("effort", blocks[k]) for k in efforts[1:]]
    return UnnamedColumns(
        blocks[positions[0]],
        blocks[dq],
        blocks[efforts[0]] if efforts else (),
        "for the joints that move, one block of columns is the derivative of another",
        tuple(further),
    )


def _have_one_factor(factors: FloatArray) -> bool:
    """Tell whether most of the joints' factors are alike."""
    middle = float(np.median(factors))
    return float(np.median(np.abs(factors - middle))) <= _SAME_RISE * middle


def _are_alike(part: FloatArray, block: list[int], other: list[int]) -> bool:
    """Tell whether most joints of two blocks move alike: one is the command of the other, or its copy."""
    spread = part.std(axis=0)
    moving = [(k, to) for k, to in zip(block, other, strict=True) if spread[to] > _STILL * spread[other].max()]
    alike = [np.corrcoef(part[:, k], part[:, to])[0, 1] for k, to in moving if spread[k] > 0.0]
    return bool(alike) and float(np.median(alike)) > _ALIKE


def _split_positions_and_rates(
    t: FloatArray, part: FloatArray, columns: Sequence[int], n: int
) -> UnnamedColumns | None:
    """Find positions and velocities without torques: of all joints that move, slopes of one factor, as no torque is."""
    correlation, factor = correlate_slopes(t, part)
    for blocks in _list_layouts(n, 2):
        for first, second in (blocks, blocks[::-1]):
            spread = part[:, first].std(axis=0)
            moving = np.flatnonzero(spread > _STILL * spread.max())
            if len(moving) < 2:
                continue
            pairs = np.array(first)[moving], np.array(second)[moving]
            factors = factor[pairs]
            if correlation[pairs].min() > SLOPE and np.ptp(factors) <= _SAME_FACTOR * factors.max():
                q, dq = (tuple(columns[index] for index in block) for block in (first, second))
                return UnnamedColumns(q, dq, (), "one half of the columns are the derivatives of the other")
    return None


def _split_two_blocks(columns: Sequence[int], n: int, unexplained: MeasureUnexplained) -> UnnamedColumns | None:
    """Find two signals of all joints side by side, by the order with which the dynamics explain the torque."""
    trials = []
    for blocks in _list_layouts(n, 2):
        for first in (0, 1):
            q, tau = (tuple(columns[index] for index in blocks[place]) for place in (first, 1 - first))
            trials.append((unexplained(q, tau), q, tau))
    trials.sort(key=lambda trial: trial[0])
    if trials[0][0] > _EXPLAINED or trials[1][0] < _CLEARLY * trials[0][0]:
        return None
    share, q, tau = trials[0]
    return UnnamedColumns(
        q,
        (),
        tau,
        f"with this choice the robot's dynamics leave {format_percent(share, decimals=0)} of the torque unexplained; "
        "with others far more",
    )


def _list_layouts(n: int, signals: int) -> list[list[list[int]]]:
    """Return the places of the signals' columns: signal by signal, or joint by joint."""
    by_signal = [list(range(k * n, (k + 1) * n)) for k in range(signals)]
    by_joint = [list(range(k, n * signals, signals)) for k in range(signals)]
    return [by_signal, by_joint]


def find_forces(groups: Sequence[ColumnGroup], *, slide: bool) -> list[ColumnGroup]:
    """Return the columns of all joints whose names say force: torques of joints that slide, of others efforts.

    Parameters
    ----------
    groups : sequence of ColumnGroup
        All groups of the file.
    slide : bool
        Whether all joints of the robot slide.
    """
    meaning = "which is the effort of prismatic joints" if slide else "simulators call every effort a force"
    return [
        replace(group, signal="tau" if slide else "effort", reason=f"{group.reason}; {meaning}")
        for group in groups
        if group.signal == "other" and {"force", "forces"} & set(group.named.words)
    ]


def sort_by_number(named: Sequence[ColumnName], columns: list[int]) -> list[int]:
    """Return columns in the order of the number in their names, where that alone tells them apart; else unchanged.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    columns : list of int
        Numbers of the columns in question.
    """
    numbers = [named[index].numbers for index in columns]
    stems = {tuple(word for word in named[index].words if not word.isdecimal()) for index in columns}
    if len(stems) != 1 or any(len(number) != 1 for number in numbers) or len(set(numbers)) < len(numbers):
        return columns
    return [columns[place] for place in np.argsort([number[0] for number in numbers])]


def is_in_order(columns: Sequence[int]) -> bool:
    """Tell whether columns stand side by side in the file, or in even steps."""
    return len(set(np.diff(columns).tolist())) <= 1


def assign_torques(t: FloatArray, q: FloatArray, tau: FloatArray) -> tuple[IntArray, float]:
    """Assign torques to positions, by friction and inertia of the joint itself.

    Parameters
    ----------
    t : (m,)
        Times in s.
    q, tau : (m, n)
        Positions and torques, in any unit.

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
        # A joint's own friction is in no other joint's torque.
        rows = np.column_stack([np.tanh(own / (0.05 * own.std() + 1e-12)), own, np.ones(len(own))])
        for other in range(n):
            target = tau[::width, other]
            remainder = target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]
            shares[joint, other] = 1.0 - remainder.var() / max(target.var(), 1e-30)
    # The assignment with the largest product of shares, by the Hungarian algorithm on their logarithms.
    certainty = np.log(np.clip(shares, 1e-3, 1.0))
    rows_, order = linear_sum_assignment(-certainty)
    best = float(certainty[rows_, order].sum())
    second = -np.inf
    for joint in range(n):
        # Forbid one pair after the other: the best of these assignments is the runner-up.
        blocked = certainty.copy()
        blocked[joint, order[joint]] = -50.0
        again = linear_sum_assignment(-blocked)
        second = max(second, float(blocked[again].sum()))
    return order.astype(np.int64), best - second


_SAME = 0.01
"""Share of its spread by which two topics of one position differ: the slower is interpolated between its samples."""


def hold_same_values(values: FloatArray, groups: Sequence[ColumnGroup], share: float = _SAME) -> bool:
    """Tell whether the columns (m, c) of several groups hold the same numbers, but for interpolation.

    Parameters
    ----------
    values, groups : (m, c), sequence of ColumnGroup
        Values of all columns; the groups to compare, at least one.
    share : float
        Of their spread, by which they may differ.
    """
    first, *others = (values[:, list(group.columns)] for group in groups)
    # A joint that stands has no spread of its own to compare with.
    spread = np.maximum(first.std(axis=0), 0.1 * first.std(axis=0).max())
    return all(bool((np.abs(other - first).mean(axis=0) <= share * spread).all()) for other in others)


def find_plainest_group(groups: Sequence[ColumnGroup]) -> ColumnGroup | None:
    """Return the group whose name has no word but measured that the others lack: torque of torque, torque_raw.

    Parameters
    ----------
    groups : sequence of ColumnGroup
        Groups of one signal and rank, at least one.
    """
    words = [{word for word in group.named.words if not word.isdecimal()} for group in groups]
    shortest = min(
        range(len(groups)), key=lambda place: (len(words[place] - {"measured"}), "measured" not in words[place])
    )
    others = (other for place, other in enumerate(words) if place != shortest)
    return groups[shortest] if all(words[shortest] - {"measured"} < other for other in others) else None


def group_other_names(
    work: WorkingProposal, groups: Sequence[ColumnGroup], rest: Sequence[int], measure: MeasureUnexplained
) -> list[ColumnGroup]:
    """Return signals of joints that the description calls otherwise, such as base_pos and base_torque.

    As many columns as joints, or more (a gripper, a free base), have the same words beside the signal's. The order is
    the file's, if the dynamics do not contradict it. Parameters as of `group_unnamed_columns`.
    """
    named, taken, n = work.column_names, {group.signal for group in groups}, work.robot.n
    members: dict[Signal, list[int]] = {}
    joints: dict[Signal, list[frozenset[str]]] = {}
    for signal in _OF_JOINTS:
        columns = [index for index in rest if named[index].signal == signal and named[index].rank < COMMANDED_RANK]
        words = [frozenset(named[index].words) for index in columns]
        # Of more columns than joints, counted ones beside others are another device's, such as a hand's.
        is_one_device = len(columns) == n or len({not named[index].numbers for index in columns}) == 1
        if len(columns) >= n > 1 and signal not in taken and is_one_device:
            own = [each - frozenset.intersection(*words) for each in words]
            if all(own) and len(set(own)) == len(own):
                members[signal], joints[signal] = columns, own
    own = joints.get("q", [])
    members = {signal: each for signal, each in members.items() if len(each) != len(own) or joints[signal] == own}
    if not own or not (effort := next((signal for signal in _OF_JOINTS[2:] if signal in members), None)):
        return []
    # A free base has more positions than velocities: then the joints come first, or last.
    spare = {signal: len(columns) - n for signal, columns in members.items()}
    is_even = spare["q"] == spare[effort]
    starts = [(k, k) for k in range(spare["q"] + 1)] if is_even else [(0, 0), (spare["q"], spare[effort])]
    q, tau = members["q"], members[effort]
    trials = ((measure(tuple(q[i : i + n]), tuple(tau[k : k + n])), i) for i, k in starts)
    (share, first), *others = sorted(trials)
    if share > _EXPLAINED or (others and others[0][0] < _CLEARLY * share):
        return []
    reason = "as many columns as joints, in the order of the file, as their names are of none of the robot's joints"
    reason = "those of the columns beside each other that the robot's dynamics explain" if others else reason
    start = {signal: further if first == spare["q"] else first for signal, further in spare.items()}
    return [
        ColumnGroup(chosen, signal, named[chosen[0]].unit, named[chosen[0]].rank, named[chosen[0]], reason)
        for signal, columns in members.items()
        if len(chosen := tuple(columns[start[signal] : start[signal] + n])) == n
    ]


_OF_JOINTS: tuple[Signal, ...] = ("q", "dq", "tau", "current", "effort")


def group_unnamed_columns(
    work: WorkingProposal, groups: list[ColumnGroup], rest: list[int], alive: BoolArray, measure: MeasureUnexplained
) -> list[ColumnGroup]:
    """Return groups of the columns whose names say no signal.

    Parameters
    ----------
    work : WorkingProposal
        Gets a question where the order of the joints is not sure.
    groups : list of ColumnGroup
        Those whose names say what they are; groups that only count joints get their signals.
    rest : list of int
        Columns of no group.
    alive : (columns,) of bool
        Which columns change.
    measure : function
        Returns the unexplained share of the torque for columns of positions and of efforts.
    """
    n = work.robot.n
    have = {group.signal for group in groups}
    # The names say enough: content must not overrule them.
    if "q" in have and have & {"tau", "current", "effort"}:
        return []
    silent = [index for group in groups if group.signal is None for index in group.columns]
    # A column whose name says command is no measurement, whatever it holds.
    measured = [index for index in (*rest, *silent) if work.column_names[index].rank < 4]
    pool = sorted({index for index in measured if work.column_names[index].signal is None or index in silent})
    pool = sort_by_number(work.column_names, select_whole_signals(pool, work.values, alive, n))
    # A further axis, which the robot lacks, leaves no whole signals: those that all joints have are left.
    counted = [index for index in pool if index in silent]
    pool = counted if len(pool) % n and len(counted) >= 2 * n else pool
    whole = [group for group in groups if group.signal is None]
    kinds = identify_unnamed_columns(work.t, work.values, pool, n, measure) if pool else None
    if kinds is None:
        return infer_by_elimination(groups, whole, measure)
    groups[:] = [group for group in groups if group.signal is not None]
    by_signal: dict[Signal, Sequence[int]] = {"q": kinds.positions, "dq": kinds.rates, "tau": kinds.efforts}
    for group in whole:
        # The names count the joints, which gives the order; the content gives the signal.
        for signal, columns in by_signal.items():
            # Content does not say again what other names say already.
            if set(group.columns) == set(columns) and signal not in have:
                groups.append(ColumnGroup(group.columns, signal, group.unit, group.rank, group.named, kinds.reason))
    if {group.signal for group in groups} >= {"q", "tau"}:
        return []
    return _order_by_joint(work, kinds, pool, measure)


def _order_by_joint(
    work: WorkingProposal, kinds: UnnamedColumns, pool: list[int], measure: MeasureUnexplained
) -> list[ColumnGroup]:
    """Return unnamed columns of every kind in the robot's order: that of the pool, if nothing contradicts it."""
    named = [work.column_names[columns[0]] for columns in (kinds.positions, kinds.efforts or kinds.positions)]
    positions, efforts = list(kinds.positions), list(kinds.efforts)
    place = {column: k for k, column in enumerate(pool)}
    regular = all(is_in_order([place[column] for column in of_signal]) for of_signal in (positions, efforts))
    counted = pool != sorted(pool)
    reason = f"{kinds.reason}; the joints are in the order of {'their numbers' if counted else 'the file'}"
    if regular and counted and _is_file_order_as_good(kinds, measure):
        work.add_question("columns", "The numbers of the joints and their order in the file differ: which is right?")
    if not regular:
        work.add_question("columns", "Neither the names nor the order of the columns show which joint they belong to.")
        q, tau = work.values[:, positions], work.values[:, efforts]
        order, _ = assign_torques(work.t, q, tau)
        efforts = [efforts[index] for index in order]
    groups = [ColumnGroup(tuple(positions), "q", None, 0, named[0], reason)]
    if efforts and not kinds.rates and measure(kinds.positions, kinds.efforts) > _EXPLAINED:
        detail = "Only how smooth they are tells positions from torques: name them, q1, tau1 and so on."
        work.add_question("columns/q", detail, work.sample.names)
    if efforts:
        groups.append(ColumnGroup(tuple(efforts), "effort", None, 0, named[1], reason))
    if kinds.rates and regular and is_in_order([place[column] for column in kinds.rates]):
        groups.append(ColumnGroup(kinds.rates, "dq", None, 0, work.column_names[kinds.rates[0]], reason))
    names = work.column_names
    return groups + [ColumnGroup(each, signal, None, 0, names[each[0]], reason) for signal, each in kinds.further]


def _is_file_order_as_good(kinds: UnnamedColumns, measure: MeasureUnexplained) -> bool:
    """Tell whether both also stand in order in the file, and the robot's dynamics do not refute that."""
    in_file = tuple(sorted(kinds.positions)), tuple(sorted(kinds.efforts))
    counted = kinds.positions, kinds.efforts
    if in_file == counted or not all(is_in_order(list(columns)) for columns in in_file):
        return False
    return measure(*in_file) < _REFUTED * measure(*counted)


_REFUTED = 1.25
"""Ratio of the unexplained shares above which another order of the columns is refuted."""
