"""Checks of positions: units, limits, quantisation, joints that never moved, agreement with velocities.

Holds their thresholds, such as the fewest encoder steps (100).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import chain
from math import pi

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import Remedy
from dynident.number_format import format_percent
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_source import RawSample
from dynident.recordings.joint_phases import phase_shares
from dynident.recordings.recording import JointKind, JointLimits, Recording
from dynident.recordings.recording_metadata import Check, Revision, Status
from dynident.recordings.signal_spectra import find_step
from dynident.recordings.units import explain_velocity_ratio, find_common_ratio, format_time

DEGREE = pi / 180.0
MOVED = {"revolute": 2e-3, "prismatic": 5e-4}
"""A joint whose position spans less (rad or m) has not moved."""

TOLD = 0.005
"""Share of its time that a joint has to stand to be told of: turning round alone takes about as much."""

FASTEST = 25.0
"""No joint of an arm turns faster, in rad/s (240 rpm)."""

WHOLE = 0.99
"""Share of positions that are whole numbers where they are counts; others are put in where samples lack."""

MOST_TURNS = 20.0 * pi
"""rad, ten turns: more than joints with limits make; and as times a joint's limits more than degrees are of radians."""

JUMP, AROUND, MOST_JUMPS = 0.005, 10, 3
"""rad or m, rows around it, and so many in a recording: what a position that is counted anew jumps by."""

ISOLATED, UNUSUAL = 5.0, 30.0
"""Times the largest change from step to step around it, and times the usual one, that such a jump has at least: the
speed of a joint does not change at once and back."""

STEPS_NEEDED = 100
STEPS_WANTED = 1000


def check_motion(
    recording: Recording, sample: RawSample, layout: Layout, limits: tuple[JointLimits, ...]
) -> list[Check]:
    """Check the positions of the rows inside the windows, as they were measured.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    sample : RawSample
        Raw rows from all over the recording.
    layout : Layout
        The columns of the file, matched with the joints.
    limits : tuple of JointLimits
        Limits of the n joints, as far as they are known.

    Returns
    -------
    list of Check
        One check or more of each kind, in a fixed order.
    """
    if sample.used.sum() < 2:
        return [Check("length", "error", "The windows contain fewer than 2 rows; give wider windows.", layout.t.source)]
    positions = _MeasuredPositions(sample, limits)
    return [
        _check_length(recording, layout),
        _check_standstill(recording, positions, layout),
        _check_moving_joints(recording, positions, layout),
        _check_position_unit(recording, positions, layout, limits),
        _check_quantisation(recording, positions, layout),
        *_check_velocity(positions, layout),
        *_check_jumps(positions, layout),
    ]


class _MeasuredPositions:
    """Positions of the used rows, with their ranges and spans."""

    def __init__(self, sample: RawSample, limits: tuple[JointLimits, ...]) -> None:
        used = sample.used
        self.row, self.t, self.q = sample.row[used], sample.t[used], sample.q[used]
        self.dq = None if sample.dq is None else sample.dq[used]
        # Rows next to each other in the sample may be far apart in the file: no difference is taken across.
        self.joined = sample.joined[used] & np.concatenate([[False], np.diff(self.row) == 1])
        self.low, self.high = self.q.min(axis=0), self.q.max(axis=0)
        self.span = self.high - self.low
        kinds = np.array([MOVED[limit.kind] for limit in limits])
        self.moved: BoolArray = self.span > kinds

    def differentiate(self) -> tuple[FloatArray, BoolArray]:
        """Return central differences (m, n), and which rows (m,) have both neighbours."""
        inner = np.zeros(len(self.t), dtype=bool)
        inner[1:-1] = self.joined[1:-1] & self.joined[2:]
        speed = np.zeros_like(self.q)
        step = np.ones(len(self.t))
        step[1:-1] = np.where(inner[1:-1], self.t[2:] - self.t[:-2], 1.0)
        speed[1:-1] = (self.q[2:] - self.q[:-2]) / step[1:-1, None]
        return speed, inner


def _check_jumps(positions: _MeasuredPositions, layout: Layout) -> list[Check]:
    """Warn of a position that jumps between two rows and stays there, while the other joints go on."""
    steps = np.diff(positions.q, axis=0)
    # Four rows in a row: of what was left out between two of them nothing is known.
    passed = np.diff(positions.t)
    joined = positions.joined[1:] & (passed < 1.5 * np.median(passed))
    inner = np.flatnonzero(joined[:-2] & joined[1:-1] & joined[2:]) + 1
    if len(inner) < 2 * AROUND:
        return []
    # A joint that stops at once changes its step, too, but on one side of it alone.
    changes = np.minimum(np.abs(steps[inner] - steps[inner - 1]), np.abs(steps[inner] - steps[inner + 1]))
    resolution = np.where(steps != 0.0, np.abs(steps), np.inf).min(axis=0)
    usual = np.maximum(np.quantile(changes, 0.99, axis=0), np.where(np.isfinite(resolution), resolution, 0.0))
    jumps = changes > np.maximum(JUMP, UNUSUAL * usual)
    places = [
        [int(place) for place in np.flatnonzero(own) if _is_isolated(change, int(place))]
        for own, change in zip(jumps.T, changes.T, strict=True)
    ]
    checks = []

    def warn(joints: Sequence[int], row: int, how: str, why: str) -> None:
        sources = ", ".join(layout.q[joint].source for joint in joints)
        detail = (
            f"{sources} {how} between rows {positions.row[row]} and {positions.row[row + 1]} "
            f"(t = {format_time(positions.t[row + 1])} s) and stay{'s' * (len(joints) == 1)} there, {why}. Use "
            "the seconds on "
            "one side alone (windows), or give them as two recordings."
        )
        where = int(positions.row[row + 1]), float(positions.t[row + 1])
        checks.append(Check("position_jump", "warning", detail, layout.q[joints[0]].source, *where))

    for joint, own in enumerate(places):
        rows = inner[own]
        # What goes and comes back is a corrupted interval, and no other zero.
        others = np.delete(jumps, joint, axis=1)[own]
        if not 1 <= len(rows) <= MOST_JUMPS or others.any() or np.ptp(np.sign(steps[rows, joint])) > 0:
            continue
        around = 0.5 * (steps[rows[0] - 1, joint] + steps[rows[0] + 1, joint])
        size = steps[rows[0], joint] - around
        # A time that was counted from the rows does not show those that were lost.
        why = (
            "while the other joints continue to move: the encoder was set to zero again, or lost counts, or rows were "
            "lost there while the other joints moved little"
        )
        warn([joint], int(rows[0]), f"jumps by {size:.3g}", why)
    counts = Counter(chain(*places))
    together = [place for place, count in counts.items() if 2 * count > len(places) > 1]
    if 1 <= len(together) <= MOST_JUMPS:
        row = int(inner[min(together)])
        joints = [joint for joint, own in enumerate(places) if min(together) in own]
        around_all = 0.5 * (steps[row - 1, joints] + steps[row + 1, joints])
        ratios = (steps[row, joints] - around_all) / np.where(around_all != 0.0, around_all, np.inf)
        # Over lost rows all joints go on as they move, each for the same time.
        if not 0.0 < ratios.max() < _ALIKE * ratios.min():
            why = "farther than they move from row to row: all were set to zero again, or rows were lost there"
            warn(joints, row, "jump together", why)
    return checks


_ALIKE = 4.0
"""Times by which joints go on farther than others over lost rows, measured by their speed before and behind them."""


def _is_isolated(changes: FloatArray, place: int) -> bool:
    """Tell whether a change is far larger than those around it."""
    around = np.concatenate([changes[max(place - AROUND, 0) : max(place - 1, 0)], changes[place + 2 : place + AROUND]])
    return bool(changes[place] >= ISOLATED * around.max(initial=0.0))


def _check_length(recording: Recording, layout: Layout) -> Check:
    seconds = recording.n_samples * recording.period
    if recording.windows:
        seconds = min(seconds, sum(end - start for start, end in recording.windows))
    if seconds < 2.0:
        return Check(
            "length",
            "warning",
            f"Only {seconds:.2g} s are used. Record an exciting trajectory of 10 s or more, repeated: it separates "
            "the parameters and gives reliable standard deviations.",
            layout.t.source,
        )
    return Check("length", "ok", f"{seconds:.4g} s in {len(recording.segments)} segment(s).")


def _check_standstill(recording: Recording, positions: _MeasuredPositions, layout: Layout) -> Check:
    """Report how much of its time every joint stands; its rows there are left out anyway."""
    if not positions.moved.any():
        return Check(
            "standstill",
            "error",
            f"No joint moves between t = {format_time(positions.t[0])} and {format_time(positions.t[-1])} s (rows "
            f"{positions.row[0]} to "
            f"{positions.row[-1]}). Choose windows that contain the motion.",
            layout.q[0].source,
            int(positions.row[0]),
            float(positions.t[0]),
        )
    shares = phase_shares(recording).standing
    stands = [
        f"{name} {format_percent(float(shares[j]), 2)}"
        for j, name in enumerate(recording.joint_names)
        if shares[j] >= TOLD
    ]
    if not stands:
        return Check("standstill", "ok", "Every joint moves nearly all the time.")
    return Check(
        "standstill",
        "ok",
        f"Share of the time at standstill: {', '.join(stands)}. These rows of the joint are not used, because static "
        "friction balances any torque there. No windows are needed for this.",
    )


def _check_moving_joints(recording: Recording, positions: _MeasuredPositions, layout: Layout) -> Check:
    resting = np.flatnonzero(~positions.moved)
    if not len(resting):
        return Check("joint_motion", "ok", "Every joint moves.")
    names = ", ".join(recording.joint_names[joint] for joint in resting)
    columns = ", ".join(layout.q[joint].source for joint in resting)
    status: Status = "ok" if recording.role == "friction" else "warning"
    detail = (
        f"Joint{'s' if len(resting) > 1 else ''} {names} never moved ({columns} spans less than {MOVED['revolute']:g} "
        f"from row {positions.row[0]}, t = {format_time(positions.t[0])} s, to row {positions.row[-1]}): this "
        "recording alone "
        "shows neither friction nor inertia of such a joint. Identify together with recordings in which the joint "
        "moves, or lock the joint in the robot's description (locked_joints); a test of single joints has the role "
        '"friction".'
    )
    return Check(
        "joint_motion", status, detail, layout.q[resting[0]].source, int(positions.row[0]), float(positions.t[0])
    )


def _check_position_unit(
    recording: Recording, positions: _MeasuredPositions, layout: Layout, limits: tuple[JointLimits, ...]
) -> Check:
    speed, inner = positions.differentiate()
    # Not the maximum: a single corrupted sample would make any joint too fast.
    fastest = np.percentile(np.abs(speed[inner]), 99.0, axis=0) if inner.any() else np.zeros(recording.n)
    doubtful: Check | None = None
    # A base walks, drives and turns as far as it likes: only its speed tells the unit.
    roaming = [k for k in range(layout.n_base) if recording.joint_names[k] not in ("base_pitch", "base_roll")]
    for joint, limit in enumerate(limits):
        column = layout.q[joint].source
        row = int(np.abs(positions.q[:, joint]).argmax())
        low, high, rate = float(positions.low[joint]), float(positions.high[joint]), float(fastest[joint])
        small, unit, ours = (DEGREE, "deg", "rad") if limit.kind == "revolute" else (1e-3, "mm", "m")
        where = int(positions.row[row]), float(positions.t[row])
        if is_counted(limit, low, high) and (limit.position or rate > _get_fastest(limit.kind, limit.velocity)):
            remedy = Remedy("units", {"q": "counts:4096"})
            return Check(
                "position_unit",
                "error",
                f"{column} runs from {low:.6g} to {high:.6g} {ours} (farthest in row {where[0]}, t = "
                f"{format_time(where[1])} "
                "s). In no unit of angles is this the range of a joint: the values look like encoder counts. Say how "
                f"many counts make a turn, {remedy}, and after an @ the count at zero if it is not 0: "
                '"counts:4096@2048".',
                column,
                *where,
                remedies=(remedy,),
            )
        if has_other_unit(limit, low, high, rate, small):
            # Of whole numbers a unit that fits is not enough to be taken unasked.
            counts = limit.kind == "revolute" and bool(
                (positions.q[:, joint] == np.rint(positions.q[:, joint])).mean() > WHOLE
            )
            same, unclear = _split_by_unit(positions, limits, limit, fastest, small)
            keys = {k: _name_unit(k, layout, recording) for k in same}
            same_kind = _unit_of_same_kind("q", unit, limit, limits[layout.n_base :])
            if joint < layout.n_base:
                # The pose of a base has a unit of its own.
                same_kind = {key: unit for k, key in keys.items() if k < layout.n_base}
            remedy = Remedy(
                "units",
                {keys[k]: unit for k in same} if unclear else same_kind if layout.n_base else {"q": unit},
            )
            also = ' Whole numbers can also be encoder counts: "counts:4096" means 4096 a turn.' if counts else ""
            if unclear:
                also += (
                    f" {', '.join(layout.q[k].source for k in unclear)} may be in {ours} or in {unit}: if all are in "
                    f"{unit}, state {Remedy('units', {'q': unit})}. dynident inspect decides by the dynamics."
                )
            return Check(
                "position_unit",
                "error",
                f"{column} runs from {low:.4g} to {high:.4g} {ours} at up to {rate:.3g} {ours}/s (farthest in row "
                f"{where[0]}, t = {format_time(where[1])} s); the values look like {unit}. State {remedy}.{also}",
                column,
                *where,
                None if counts or unclear else Revision(units=same_kind),
                remedies=(remedy,),
            )
        is_unlimited = joint not in roaming and is_far_without_limits(limit, low, high)
        if is_unlimited and doubtful is None:
            remedy = Remedy("units", {_name_unit(joint, layout, recording): unit})
            detail = (
                f"{column} runs from {low:.4g} to {high:.4g} {ours}, and the description does not limit the position "
                f"of {recording.joint_names[joint]}. If the values are in {unit}, state {remedy}."
            )
            doubtful = Check("position_unit", "warning", detail, column, *where, remedies=(remedy,))
        if limit.position is not None and doubtful is None:
            # Encoders and stated limits do not agree to the last degree.
            slack = 0.02 * (limit.position[1] - limit.position[0])
            if low < limit.position[0] - slack or high > limit.position[1] + slack:
                doubtful = Check(
                    "position_unit",
                    "warning",
                    f"{column} runs from {low:.4g} to {high:.4g} {ours}, beyond the limits of "
                    f"{recording.joint_names[joint]} ({limit.position[0]:.4g} to {limit.position[1]:.4g}), in row "
                    f"{where[0]}. Check the zero of the encoder and the limits.",
                    column,
                    *where,
                )
    return doubtful or Check(
        "position_unit", "ok", "Positions and speeds are plausible for a joint in rad (m if prismatic)."
    )


def _name_unit(joint: int, layout: Layout, recording: Recording) -> str:
    """Return the key by which the unit of one position is stated."""
    return recording.joint_names[joint] if joint < layout.n_base else f"q{joint + 1 - layout.n_base}"


def _split_by_unit(
    positions: _MeasuredPositions,
    limits: tuple[JointLimits, ...],
    limit: JointLimits,
    fastest: FloatArray,
    small: float,
) -> tuple[list[int], list[int]]:
    """Return the joints of one kind that are in the smaller unit, and those that make sense in either."""
    same, unclear = [], []
    for joint, other in enumerate(limits):
        low, high = float(positions.low[joint]), float(positions.high[joint])
        if other.kind != limit.kind:
            continue
        if has_other_unit(other, low, high, float(fastest[joint]), small):
            same.append(joint)
        elif other.kind == "revolute" and high - low > SURELY_MOVED and max(abs(low), abs(high)) < 2.0 * pi:
            unclear.append(joint)
    return same, unclear


SURELY_MOVED = 0.5
"""rad, or deg: a joint whose number moves by more may be in either unit."""


def _unit_of_same_kind(kind: str, unit: str, limit: JointLimits, limits: tuple[JointLimits, ...]) -> dict[str, str]:
    """Return the units of a signal of all joints of one kind."""
    if all(other.kind == limit.kind for other in limits):
        return {kind: unit}
    return {f"{kind}{k + 1}": unit for k, other in enumerate(limits) if other.kind == limit.kind}


def has_other_unit(limit: JointLimits, low: float, high: float, rate: float, small: float) -> bool:
    """Return whether a position makes sense in degrees (millimetres), and none in radians (metres).

    Parameters
    ----------
    limit : JointLimits
        Limits of the joint, rad or m, and their rates.
    low, high : float
        Range of the position as it is stated.
    rate : float
        Speed that the position reaches, in its unit per second.
    small : float
        Radians in a degree, or metres in a millimetre.

    Returns
    -------
    bool
    """
    if limit.position is not None:
        lower, upper = limit.position
        slack = 0.1 * (upper - lower)
        # With limits: beyond them as given, inside them in the other unit, and by more than limits that are a little
        # wrong would explain, or a zero that is elsewhere on the turn.
        beyond = low < lower - slack or high > upper + slack
        inside = lower - slack <= low * small and high * small <= upper + slack
        widest, turn = max(abs(lower), abs(upper)), 2.0 * pi if limit.kind == "revolute" else 0.0
        return beyond and inside and max(abs(low), abs(high)) > widest + max(widest, turn)
    # Without limits a wheel, a rail or a base goes as far as it likes: only a speed that no joint has tells.
    return rate > _get_fastest(limit.kind, limit.velocity)


def _get_fastest(kind: JointKind, velocity: float | None) -> float:
    """Return a speed in rad/s, or m/s, that no joint of a kind, or of a stated largest velocity, reaches."""
    return 3.0 * velocity if velocity is not None else FASTEST if kind == "revolute" else 20.0


def is_far_without_limits(limit: JointLimits, low: float, high: float) -> bool:
    """Return whether a joint without limits moves through several turns, or 20 m, which few do."""
    widest = 8.0 * pi if limit.kind == "revolute" else 20.0
    return limit.position is None and max(abs(low), abs(high)) > widest and high - low > widest


def is_counted(limit: JointLimits, low: float, high: float) -> bool:
    """Return whether an angle, with its range, is far from any that a joint takes, in degrees as well."""
    if limit.kind != "revolute":
        return False
    farthest = max(abs(low), abs(high))
    if limit.position is None:
        return farthest * DEGREE > MOST_TURNS
    return farthest > MOST_TURNS and farthest > MOST_TURNS * max(map(abs, limit.position))


def _check_quantisation(recording: Recording, positions: _MeasuredPositions, layout: Layout) -> Check:
    # A joint that hardly moves passes few steps of any encoder: that says nothing of the log.
    counting = positions.moved & (positions.span > 0.05 * positions.span.max())
    steps = [find_step(positions.q[:, joint]) if counting[joint] else 0.0 for joint in range(recording.n)]
    levels = [positions.span[joint] / step if step else np.inf for joint, step in enumerate(steps)]
    worst = int(np.argmin(levels))
    if not steps[worst]:
        return Check("quantisation", "ok", "Positions show no visible quantisation steps.")
    status: Status = "ok"
    if levels[worst] < STEPS_WANTED:
        status = "error" if levels[worst] < STEPS_NEEDED else "warning"
    advice = (
        ""
        if status == "ok"
        else " Log all digits of the encoder, or move farther: steps become errors of acceleration."
    )
    changes = np.flatnonzero(np.diff(positions.q[:, worst]) != 0)
    row = int(changes[0]) + 1 if len(changes) else 0
    return Check(
        "quantisation",
        status,
        f"{layout.q[worst].source} has quantisation steps of {steps[worst]:.3g}, {levels[worst]:.3g} of them over its "
        f"motion (the first in row {positions.row[row]}).{advice}",
        layout.q[worst].source,
        int(positions.row[row]),
        float(positions.t[row]),
    )


def _check_velocity(positions: _MeasuredPositions, layout: Layout) -> list[Check]:
    if positions.dq is None:
        return []
    speed, inner = positions.differentiate()
    # The mean velocity over the same rows (Simpson's rule): of fast motions the one in the middle is larger.
    mean = positions.dq.copy()
    mean[1:-1] = (positions.dq[:-2] + 4.0 * positions.dq[1:-1] + positions.dq[2:]) / 6.0
    ratios = dict[int, float]()
    likeness = 1.0
    for joint in np.flatnonzero(positions.moved).tolist():
        logged, derivative = mean[inner, joint], speed[inner, joint]
        if not np.isfinite(logged).all() or not logged.any() or not derivative.any():
            continue
        # The correlation of the logged velocity with the derivative, without means: both are 0 at rest.
        alike = float(logged @ derivative / np.sqrt((logged @ logged) * (derivative @ derivative)))
        # A column that goes another way than the derivative is another signal, whose unit nobody can tell from it.
        if abs(alike) < 0.7:
            continue
        ratios[joint] = float(np.copysign(np.sqrt((logged @ logged) / (derivative @ derivative)), alike))
        likeness = min(likeness, alike)
    # A clock that is wrong comes first: by a large factor it looks like a velocity of the motor's side.
    if common := find_common_ratio(list(ratios.values()), likeness):
        rate = float(f"{common / np.median(np.diff(positions.t)[positions.joined[1:]]):.4g}")
        remedy = Remedy("rate", rate)
        detail = (
            f"The velocities of all joints are {common:.3g} times the derivatives of the positions: the time seems to "
            f"be counted with a wrong step. If the velocities are right, state the rate of the rows: {remedy}."
        )
        return [Check("clock_rate", "warning", detail, remedies=(remedy,))]
    for joint, ratio in ratios.items():
        mismatch = explain_velocity_ratio(layout.dq[joint].source, layout.q[joint].source, ratio)
        if mismatch is None:
            continue
        row = int(np.flatnonzero(inner)[np.abs(positions.dq[inner, joint]).argmax()])
        status, detail, units = mismatch
        remedies = (Remedy("units", units),) if units else ()
        say = "".join(f". State {remedy}" for remedy in remedies)
        return [
            Check(
                "velocity_unit",
                status,
                f"{detail}{say} (fastest in row {positions.row[row]}).",
                layout.dq[joint].source,
                int(positions.row[row]),
                float(positions.t[row]),
                Revision(units=units) if units else None,
                remedies=remedies,
            )
        ]
    return [Check("velocity_unit", "ok", "The velocity columns are the derivatives of the positions.")]
