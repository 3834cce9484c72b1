"""Search the column faults without which the dynamics explain the torque clearly better.

Holds how much better (levels), and the limits.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.identification.recording_faults.column_faults import (
    BESIDE_OFFSETS,
    SCALED,
    TURNS,
    ColumnFault,
    Motion,
    compose_swaps,
    list_chain_orders,
    list_possible_faults,
    silence_others,
)
from dynident.identification.recording_faults.description_fit import DescriptionFit
from dynident.identification.recording_faults.joint_angle_faults import (
    ANGLE_FAULTS,
    estimate_zeros,
    find_parallel_axes,
    list_angle_faults,
    list_mirrors,
    refine_zero_by_masses,
)
from dynident.identification.recording_faults.rows_for_fault_search import (
    HeldOutFits,
    filter_for_search,
    has_enough_rows,
    thin_out,
)
from dynident.identification.recording_faults.torque_scale import (
    are_nearer_to_others,
    compute_described_load,
    find_driving_joints,
    find_excess_friction,
    find_heavy_joints,
    find_joints_of_right_size,
    find_revolute_joints,
    is_nearer_to_masses,
    refine_factor_by_masses,
)
from dynident.identification.recording_faults.tree_fit import find_moving_joints, list_chains
from dynident.identification.recording_faults.unexplained_torque import (
    CERTAIN,
    CERTAIN_OF_JOINTS,
    CLEARLY_IN_ALL_BLOCKS,
    SOUND,
    HeldOutFit,
    UnexplainedTorque,
    find_drives_off,
    find_joints_with_friction,
    is_proved_by_friction,
)
from dynident.recordings import Recording
from dynident.robot.robot_model import Robot

MOST_JOINTS = 12  # longer chains have too many pairs to be tried while somebody waits
CLEARLY_AGREES = 0.05
"""Mean over the joints of that logarithm by which other gains of some joints have to explain more, for the joints not
to be in one unit: at most 0.04 with twice or half of it, on the open recordings."""
ALIKE = 0.02  # causes without which that mean falls as much, to this, cannot be told from each other
_APART = 0.75
"""Share of what is explained without a fault that its joints may explain by themselves, apart from the others: where
it is more, they do not go with the others, for whatever reason. Of right short motions it was 0.9 and more where an
order or a sign looked wrong, with what was planted at most 0.5. What comes of it is among the short motions of
`benchmarks/gross_mistakes.py`."""
CURED = 0.3
"""Of what is left without a fault on an average joint: where it is more, something else is wrong."""
WORST_EXPLAINED = 0.15
"""Share of the torque of the joint that is explained worst, below which nothing else about the robot is looked for."""
_MOST_FAULTS = 3


@dataclass(frozen=True)
class DetectedFault:
    """A fault that was found, and the unexplained shares with it and without.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    alike : tuple of ColumnFault
        Faults that it cannot be told from.
    left_with : float
        Unexplained share of an average joint's torque as the columns are.
    left_without : float
        The same without the fault.
    certain : bool
        False where another cause may look the same.
    left_by_masses : (float, float), optional
        What the masses of the description leave with the fault and without, where they alone tell it.
    """

    fault: ColumnFault
    alike: tuple[ColumnFault, ...]
    left_with: float
    left_without: float
    certain: bool
    left_by_masses: tuple[float, float] | None = None


def find_recording_faults(robot: Robot, recording: Recording) -> tuple[tuple[DetectedFault, ...], float] | None:
    """Find the gross faults in a recording, the one that explains most first.

    One after the other is mended, until no further one makes the torque clearly better explained.

    Parameters
    ----------
    robot : Robot
        The robot.
    recording : Recording
        The recording.

    Returns
    -------
    tuple of findings and float, or None
        The faults, and the share of an average joint's torque that is unexplained without them; None where the
        recording is too short, or the robot has too many joints.
    """
    judges = HeldOutFits(robot)
    bands = filter_for_search(recording, judges) if robot.n <= MOST_JOINTS else []
    band_search = search_bands(robot, bands, judges)
    return None if band_search is None else (band_search[1], band_search[2].average_share)


def search_bands(
    robot: Robot, bands: Sequence[tuple[Motion, float]], judges: HeldOutFits
) -> tuple[int, tuple[DetectedFault, ...], UnexplainedTorque] | None:
    """Find the faults in the first band that shows any.

    Parameters
    ----------
    robot : Robot
        The robot.
    bands : sequence of Motion and float
        Rows of the recording by cut-offs, from `filter_for_search`.
    judges : HeldOutFits

    Returns
    -------
    tuple or None
        Number of the band, the first where none shows a fault, and what `search_faults` returns of it.
    """
    first = None
    for band, (motion, _) in enumerate(bands):
        search_result = search_faults(robot, thin_out(motion), judges)
        if search_result is not None and (first is None or search_result[0]):
            first = (band, *search_result)
        if first is None or first[1]:
            break
    return first


def search_faults(
    robot: Robot, motion: Motion, judges: HeldOutFits | None = None
) -> tuple[tuple[DetectedFault, ...], UnexplainedTorque] | None:
    """Find the faults in filtered rows, and what is unexplained without them; None where the rows are too few.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    judges : HeldOutFits, optional
        Those of the robot, if they exist already.
    """
    judges = judges or HeldOutFits(robot)
    judge = judges.plain_fit
    if not has_enough_rows(motion, judge):
        return None
    findings: list[DetectedFault] = []
    now = judge.measure_unexplained(motion)
    # Mend the clearest fault, then look again: several hide each other, and the first one's cure changes the rest.
    while len(findings) < _MOST_FAULTS:
        step = _find_best_fault(judge, robot, motion, now)
        if step is None:
            break
        mended = step.fault.mend(motion)
        if judge is judges.plain_fit and not step.is_borne_out:
            before, after = (judges.offset_fit.measure_unexplained(rows) for rows in (motion, mended))
            if before.score - after.score < BESIDE_OFFSETS * (now.score - step.unexplained.score):
                # A constant torque explains the same, so the search goes on with constant torques in the model. The
                # description, which has them as well, may tell the fault apart from them.
                judge, now = judges.offset_fit, before
                continue
        certain = _is_certain(step, now, *(judge.measure_frictions(rows) for rows in (motion, mended)))
        left_with, left_without = now.average_share, step.unexplained.average_share
        finding = DetectedFault(step.fault, step.alike, left_with, left_without, certain, step.left_by_masses)
        # An exchange of columns that were exchanged before is one order with both: who maps columns knows the file's.
        joined = _join_exchanges(findings[-1], finding) if findings else None
        findings = [*findings[:-1], joined] if joined else [*findings, finding]
        motion, now = mended, step.unexplained
    return tuple(findings), now


def _join_exchanges(first: DetectedFault, second: DetectedFault) -> DetectedFault | None:
    if (fault := compose_swaps(first.fault, second.fault)) is None:
        return None
    alike = tuple(compose_swaps(first.fault, twin) or twin for twin in second.alike)
    return replace(second, fault=fault, alike=alike, left_with=first.left_with)


_Trial = tuple[ColumnFault, UnexplainedTorque]


class _FaultStep(NamedTuple):
    """A fault, those that cannot be told from it, and what is unexplained without it.

    And whether the description bears it out, or alone tells it: then by what it leaves with the fault and without.
    """

    fault: ColumnFault
    alike: tuple[ColumnFault, ...]
    unexplained: UnexplainedTorque
    is_borne_out: bool
    left_by_masses: tuple[float, float] | None = None


def _is_certain(step: _FaultStep, now: UnexplainedTorque, frictions: FloatArray, mended: FloatArray) -> bool:
    """Tell whether a fault is certain: what is left without it is small, and much less, or friction proves a sign.

    `frictions` (blocks, n) are those of the torque as it is, `mended` those without the fault.
    """
    fault, fall = step.fault, now.compute_fall_to(step.unexplained) * float(now.moving.sum())
    # One scaled torque is never certain: a drive that is coupled with its neighbour looks like a wrong gain. Of
    # several joints at once this is not so. The zero of a joint may be what the description has wrong.
    may_be_sure = fault.kind != "joint zero" and (fault.kind not in SCALED or len(fault.joints) > 1)
    by_friction = now.against > step.unexplained.against and is_proved_by_friction(fault, frictions, mended)
    is_clear = by_friction or fall >= (CERTAIN_OF_JOINTS if fault.is_of_whole_joints else CERTAIN)
    # A joint of which held-out rows are explained worse than by nothing shows that the motion determines no model.
    is_sound = step.unexplained.average_share <= SOUND and step.unexplained.worst_share < 1.0
    return may_be_sure and is_clear and is_sound


def _find_best_fault(judge: HeldOutFit, robot: Robot, motion: Motion, now: UnexplainedTorque) -> _FaultStep | None:
    """Return the fault without which least of a motion is unexplained; None where no fault is clear."""
    frictions = judge.measure_frictions(motion)
    sizes = _TorqueEvidence(
        compute_described_load(robot, motion),
        frictions,
        find_excess_of_motion(robot, motion, judge),
        # Work comes back from gravity in motions that do not end where they began: friction, which is fitted, does not.
        find_driving_joints(motion) | find_joints_with_friction(frictions),
    )
    # A torque that never changes was not recorded, so nobody exchanged it.
    has_torque = np.ptp(motion.tau, axis=0) > 0
    among = [
        *list_chain_orders(
            list_chains(robot), lambda fault: judge.measure_unexplained(fault.mend(motion)).joints, now.moving
        ),
        *list_possible_faults(now.moving, find_parallel_axes(robot), has_torque, find_revolute_joints(robot)),
        *list_angle_faults(robot, motion, judge, now),
        *list_mirrors(robot, now.moving),
    ]
    off = find_drives_off(sizes.frictions)
    possible = [
        fault
        for fault in among
        if _is_possible_fault(fault, robot, motion, sizes)
        # Little friction may be that of a small joint, or of a wrong position: mended, its torque is explained much
        # better.
        and (fault.own_joints not in off or now.is_much_above(judge.measure_unexplained(fault.mend(motion)), fault))
    ]
    # A fit of all parameters may explain a short motion by chance. The description's masses, a few numbers, cannot.
    described = DescriptionFit(robot, motion, now)
    # Masses tell most of an angle that is counted otherwise, and are quickly asked.
    tried = [fault for fault in possible if fault.kind not in ANGLE_FAULTS or described.may_demand(fault)]
    trials = _Trials(judge, motion, tried, most=now.score + ALIKE)
    for best, unexplained in trials.iterate_below(now.score - CLEARLY_IN_ALL_BLOCKS / max(int(now.moving.sum()), 1)):
        # Sorted by score: where the best one is not clear, the others are not looked at.
        # Friction tells a sign whatever else is wrong.
        is_by_friction = now.against > unexplained.against and best.kind in TURNS
        # Of anything else friction that has another sign tells nothing by itself.
        has_less_driven = unexplained.against < now.against and best.kind not in TURNS
        if has_less_driven and not now.is_surely_above(unexplained, by_friction=False):
            continue
        if not now.is_surely_above(unexplained) or (unexplained.average_share > CURED and not is_by_friction):
            break
        # Scale the torques of these joints down until they have no say in the parameters of the others. Where that
        # explains nearly as much as mending the fault, the joints only do not go with the others, for whatever reason:
        # the fault is not proved.
        if best.kind != "torque scaled" and unexplained.against >= now.against and len(best.joints) < robot.n:
            unexplained_alone = judge.measure_unexplained(silence_others(motion, best.joints))
            if now.compute_fall_to(unexplained_alone) > _APART * now.compute_fall_to(unexplained):
                return None
        if described.refutes(best):
            continue
        # Columns that look alike but for a constant may be exchanged, or one of them has another zero.
        tried_joints = range(robot.n) if best.is_of_positions else ()
        zeros = estimate_zeros(robot, motion, judge, tried_joints, is_wide=True)
        possible_zeros = [zero for zero in zeros if not described.refutes(zero)]
        lowest, near = trials.find_alike((best, unexplained), possible_zeros)
        best, unexplained = _choose_among_alike(lowest, near, described)
        alike = [fault for fault, _ in near if fault != best and not _is_same_angle(fault, best)]
        is_turned = best.kind == "joint turned" and len(best.joints) < 3
        pair = _find_turned_pair(best, unexplained, judge, motion, described) if is_turned else None
        if pair is not None and not described.refutes(pair[0]):
            return _FaultStep(pair[0], (), pair[1], described.bears_out(*pair))
        if best.kind == "torque scaled":
            # A power of ten was tried; the masses may say a gain in between.
            best = replace(best, factor=refine_factor_by_masses(robot, motion, best.joints, best.factor))
            # The masses say that the size is right, so that another joint's torque has to be wrong.
            if best.factor == 1.0:
                continue
            unexplained = judge.measure_unexplained(best.mend(motion))
        undecided = (fault for fault in alike if not (described.refutes(fault) or described.prefers(best, fault)))
        return _FaultStep(best, tuple(undecided), unexplained, described.bears_out(best, unexplained))
    return _find_fault_by_masses(trials, now, described)


class _Trials:
    """Faults that are tried, in the order of the least that may be left without them; what is left is lazily measured.

    Faults without which no less than `most` may be left are dropped.
    """

    def __init__(self, judge: HeldOutFit, motion: Motion, faults: Sequence[ColumnFault], most: float) -> None:
        self._judge, self._motion = judge, motion
        self._least = {fault: judge.estimate_score(fault.mend(motion)) for fault in faults}
        self.faults = sorted((fault for fault in faults if self._least[fault] < most), key=self._least.__getitem__)
        self._unexplained: dict[ColumnFault, UnexplainedTorque] = {}

    def measure(self, fault: ColumnFault) -> UnexplainedTorque:
        """Return what is unexplained without a fault."""
        if fault not in self._unexplained:
            self._unexplained[fault] = self._judge.measure_unexplained(fault.mend(self._motion))
        return self._unexplained[fault]

    def measure_below(self, score: float) -> list[_Trial]:
        """Return the faults without which the score is below another."""
        trials = [(fault, self.measure(fault)) for fault in self.faults if self._least[fault] < score]
        return [trial for trial in trials if trial[1].score < score]

    def find_alike(self, best: _Trial, others: Sequence[ColumnFault]) -> tuple[_Trial, list[_Trial]]:
        """Return the best fault, of others as well, and those without which about as little is left."""
        more = [(fault, self.measure(fault)) for fault in others]
        # A zero that is nearly right may leave as good as nothing, too.
        lowest = min([best, *more], key=lambda trial: (trial[1].against, trial[1].fine.mean()))
        most = lowest[1].score + ALIKE
        below = dict(self.measure_below(most))
        return lowest, [*below.items(), *(trial for trial in more if trial[1].score < most and trial[0] not in below)]

    def iterate_below(self, score: float) -> Iterator[_Trial]:
        """Yield the faults without which the score is below another, the lowest first."""
        waiting = [fault for fault in self.faults if self._least[fault] < score]
        measured: list[_Trial] = []
        while waiting or measured:
            best = min(measured, key=lambda trial: trial[1].score, default=None)
            if waiting and (best is None or self._least[waiting[0]] < best[1].score):
                measured.append((waiting[0], self.measure(waiting.pop(0))))
            elif best is not None:
                measured.remove(best)
                yield best


def _find_fault_by_masses(trials: _Trials, now: UnexplainedTorque, described: DescriptionFit) -> _FaultStep | None:
    """Return the fault without which the masses of the description explain most; None where none is clear.

    A fit of all parameters finds other ones for a mirrored joint, or for an arm of few joints; the description does
    not.
    """
    estimates = [(described.estimate_left(fault), fault) for fault in trials.faults if fault.kind not in SCALED]
    known = sorted(((left, fault) for left, fault in estimates if left is not None), key=lambda pair: pair[0])
    for lowest, fault in known:
        if not described.may_demand(fault):
            return None
        unexplained = trials.measure(fault)
        if unexplained.score >= now.score + ALIKE:
            continue
        # What the fit still leaves unexplained has another cause, which may have misled the masses too.
        if unexplained.average_share > CURED or not described.surely_demands(fault):
            return None
        near = (other for left, other in known if other != fault and lowest <= left < lowest + ALIKE)
        alike = tuple(other for other in near if trials.measure(other).score < now.score + ALIKE)
        if fault.kind == "joint zero" and len(fault.joints) == 1:
            fault = refine_zero_by_masses(fault, described)
            unexplained = trials.measure(fault)
        return _FaultStep(fault, alike, unexplained, True, described.compute_shares(fault))
    return None


def _find_turned_pair(
    single: ColumnFault, left: UnexplainedTorque, judge: HeldOutFit, motion: Motion, described: DescriptionFit
) -> _Trial | None:
    """Return two turned joints that explain clearly more than a single one: of two, a third may seem to be turned.

    Where they explain hardly more the masses of the description decide, as of joints turned in turn of one plane.
    """
    faults = [ColumnFault(single.kind, pair) for pair in combinations(np.flatnonzero(left.moving).tolist(), 2)]
    pair = next(_Trials(judge, motion, faults, most=left.score).iterate_below(left.score), None)
    is_better = pair is not None and (left.is_surely_above(pair[1]) or described.prefers(pair[0], single))
    return pair if is_better else None


def _choose_among_alike(best: _Trial, near: Sequence[_Trial], described: DescriptionFit) -> _Trial:
    """Return which of the faults that a fit cannot tell apart to name: always the same one of the same cause.

    The masses of the description may tell them apart. Torques and positions of the same joints that are exchanged are
    one cause, but for what the joints are called. Exchanged torques are named then, so that all recordings of a robot
    get the same cure, and joints keep the names of their positions.
    """
    chosen = best
    # The description has no opinion on the size of a torque.
    for trial in near:
        if trial[0].kind != "torque scaled" and described.prefers(trial[0], chosen[0]):
            chosen = trial
    same = (
        trial
        for trial in near
        if trial[0].kind == "torques swapped"
        and set(trial[0].joints) == set(chosen[0].joints)
        and not described.refutes(trial[0])
        and not described.prefers(chosen[0], trial[0])
    )
    return next(same, chosen) if chosen[0].kind == "positions swapped" else chosen


def _is_same_angle(fault: ColumnFault, other: ColumnFault) -> bool:
    """Tell whether two faults are one by nearly the same value."""
    return fault.kind in ("joint zero", "position scaled") and (fault.kind, fault.joints) == (other.kind, other.joints)


@dataclass(frozen=True, eq=False)
class _TorqueEvidence:
    """Evidence of a torque's size.

    The load (m, n) of the masses, frictions (blocks, n), the joints with too much friction, and whether each joint's
    torque does work (n,).
    """

    load: FloatArray | None
    frictions: FloatArray
    excess: Collection[int]
    driving: BoolArray


def _is_possible_fault(fault: ColumnFault, robot: Robot, motion: Motion, sizes: _TorqueEvidence) -> bool:
    """Tell whether neither masses nor friction nor limits refute a fault; too much friction is of a scaled torque."""
    # Limits tell a unit. Of signs and zeros they say nothing: it may be the description that has others.
    if fault.kind == "position scaled" and _leaves_limits(robot, motion.q, fault.mend(motion).q):
        return False
    if fault.kind == "torques swapped":
        # Joints at rest hold a load against gravity as others move it, but no friction.
        has_friction = find_joints_with_friction(sizes.frictions) | find_joints_with_friction(-sizes.frictions)
        joints = list(fault.joints)
        return bool(find_moving_joints(motion)[joints].all()) or not bool(has_friction[joints].any())
    if fault.kind != "torque scaled":
        return True
    # A torque that is too small still drives its joint, unless the motor is off.
    if fault.factor > 1.0 and not sizes.driving[list(fault.joints)].all():
        return False
    if sizes.excess and (not set(sizes.excess) <= set(fault.joints) or fault.factor > 1.0):
        return False
    return are_nearer_to_others(robot, sizes.frictions, fault.joints, fault.factor) and all(
        is_nearer_to_masses(sizes.load, motion, joint, fault.factor) for joint in fault.joints
    )


def _leaves_limits(robot: Robot, q: FloatArray, mended: FloatArray) -> bool:
    """Tell whether a joint is within its limits all the time as recorded, and mostly out of them once mended."""
    for joint, recorded, otherwise in zip(robot.joints, q.T, mended.T, strict=True):
        low, high = joint.reach or (np.nan, np.nan)
        if low <= recorded.min() <= recorded.max() <= high and not low <= np.median(otherwise) <= high:
            return True
    return False


def find_excess_of_motion(robot: Robot, motion: Motion, judge: HeldOutFit | None = None) -> dict[int, float]:
    """Return the joints whose friction is too large for the robot, and how many times.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    judge : HeldOutFit, optional
        Fit of the robot, if it exists already.

    Returns
    -------
    dict of int to float
        Joint (from 0), and how many times its friction is too large.
    """
    frictions = (judge or HeldOutFit(robot)).measure_frictions(motion)
    excess = find_excess_friction(robot, frictions, find_heavy_joints(robot, motion))
    right = find_joints_of_right_size(robot, motion)
    return {joint: times for joint, times in excess.items() if joint not in right}
