"""Run all checks of a recording without a robot's dynamics, and decide whether it can be used, or is to be stopped.

Holds when a run is too slow for its design (half the speed), and by how much limits may be exceeded (5 %).
Reports what acts on a base that moves, and external axes that the robot has no joint for.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import Remedy
from dynident.number_format import format_percent
from dynident.recordings.base_motion import Reaction
from dynident.recordings.columns_to_signals import Column, Layout
from dynident.recordings.file_source import FileSource, RawSample
from dynident.recordings.metadata_revisions import adapt_cures
from dynident.recordings.position_checks import MOVED, check_motion
from dynident.recordings.recording import JointLimits, ModelChecks, RecordedJoints, Recording, Segment
from dynident.recordings.recording_metadata import Check, RecordingError, RecordingMetadata
from dynident.recordings.sampling_clock import EDGES
from dynident.recordings.torque_checks import check_torque


def run_checks(
    recording: Recording,
    sample: RawSample,
    layout: Layout,
    limits: tuple[JointLimits, ...],
    earlier_checks: tuple[Check, ...],
    metadata: RecordingMetadata,
    against: ModelChecks | None = None,
) -> tuple[Check, ...]:
    """Run the checks of motion and torque, and take them together with those made while reading.

    Findings of checks that the user has accepted by name count as warnings, and are marked.

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
    earlier_checks : tuple of Check
        Made while the file was read: time, columns, conditioning.
    metadata : RecordingMetadata
        What the user says of the file.
    against : ModelChecks, optional
        What a model of the robot says of order and signs of the columns.

    Returns
    -------
    tuple of Check
        All checks, the earlier ones first.

    Raises
    ------
    RecordingError
        For the first finding that makes the file unusable; its `checks` hold all of them.
    """
    accept = metadata.accept
    checks = list(earlier_checks)
    checks += check_motion(recording, sample, layout, limits)
    # Wrong units would only make the evidence of torque against motion misleading.
    if not any(check.status == "error" for check in _mark_accepted(checks, accept)):
        checks += check_torque(recording, sample, layout, limits, against)
        checks += _report_dead_zones(recording, sample, layout, limits)
    # Positions beyond limits are what other zeros, or an exchange, look like, and positions far behind their commands
    # what other units look like: what is known of those goes first.
    late = [("position_unit", "warning"), ("full_duty", "error")]
    checks.sort(key=lambda check: (check.name, check.status) in late)
    # A check sees the recording as it was read: its cure is put in terms of the file, whose order and signs may be
    # stated already.
    final_checks = adapt_cures(_mark_accepted(checks, accept), metadata, recording.joint_names)
    wrong = [check for check in final_checks if check.status == "error"]
    if wrong:
        first, remedy = wrong[0], Remedy("accept", (wrong[0].name,))
        raise RecordingError(
            f"{first.detail} If the recording is right, state {remedy}.",
            pointer=first.column,
            title=first.name.replace("_", " ").capitalize(),
            row=first.row,
            time=first.time,
            checks=final_checks,
            remedies=(*first.remedies, remedy),
        )
    return final_checks


def _report_dead_zones(
    recording: Recording, sample: RawSample, layout: Layout, limits: tuple[JointLimits, ...]
) -> list[Check]:
    """Report torques that are 0 below a threshold."""
    zones = {joint: low for joint, (low, high) in enumerate(recording.torque_ranges) if low > high}
    columns = {joint: layout.tau[joint].source for joint in zones}
    parts = [
        f"{columns[joint]} ({format_percent(float((sample.tau[sample.used, joint] == 0.0).mean()), 2)} of the rows, "
        f"below {size:.3g} {limits[joint].torque_unit})"
        for joint, size in zones.items()
    ]
    if not parts:
        return []
    detail = (
        f"{', '.join(parts)} {'is' if len(parts) == 1 else 'are'} exactly 0 where torque is small: a dead zone of the "
        "driver, of the log, or of the controller. These rows are left out of the joint's equation and of its errors. "
        "Record the torque as it is measured, without a threshold."
    )
    return [Check("dead_zone", "warning", detail, next(iter(columns.values())))]


def _mark_accepted(checks: list[Check], accept: tuple[str, ...]) -> tuple[Check, ...]:
    return tuple(
        replace(check, status="warning", detail=f"{check.detail} (Accepted.)", is_accepted=True)
        if check.status != "ok" and check.name in accept and not check.is_accepted
        else check
        for check in checks
    )


def has_only_pauses(recording: Recording, sample: RawSample) -> bool:
    """Return whether the robot stands before and after every gap, and no gap is short: as between two motions."""
    if len(recording.segments) < 2:
        return False
    rows = max(2, round(_AT_GAP * recording.sampling_rate))
    steps = np.abs(sample.q[rows - 1 :] - sample.q[: 1 - rows])
    # Rows of the sample that are far apart in the file, or on both sides of a gap, are no step.
    lasted = sample.t[rows - 1 :] - sample.t[: 1 - rows]
    steps = steps[(lasted > 0) & (lasted < 2 * _AT_GAP)]
    if not len(steps):
        return False
    # A joint that rests has noise alone, in pauses as elsewhere.
    is_moving = np.ptp(sample.q, axis=0) > min(MOVED.values())
    slow = np.where(is_moving, _STANDING * np.percentile(steps, 95, axis=0), np.inf)

    def moves(segment: Segment, first: int) -> bool:
        q = np.concatenate([block.q for block in recording.source.rows(segment.first_row + first, rows, rows)])
        return bool((np.ptp(q, axis=0) > slow).any())

    for before, after in pairwise(recording.segments):
        pause = after.start_time - before.start_time - before.length / recording.sampling_rate
        is_short = min(before.length, after.length) < rows or pause < EDGES
        if is_short or moves(before, before.length - rows) or moves(after, 0):
            return False
    return True


StopCode = Literal[
    "saturation", "torque_sign", "torque_order", "position_limit", "velocity_limit", "too_slow", "contact"
]

_AT_GAP, _STANDING = 0.05, 0.1
"""s before and after a gap, and the share of its fast steps in as many s that no joint of a robot that pauses moves by:
in the middle of a motion all joints are hardly so slow at once. A motion may begin or end with the recording."""

_FATAL: tuple[StopCode, ...] = ("saturation", "torque_sign", "torque_order")
"""Checks whose findings no further second of the same run can heal."""
_EXCEEDED = 1.05
"""Share of a limit that a robot may reach: its own controller stops it soon after."""
_SLOW, _LEAST_SECONDS, _LEAST_TRAVEL = 0.5, 3.0, 0.02
"""Share of the planned travel below which a run is too slow, after so many seconds of motion; travel, in rad or m, at
which the motion has begun."""


@dataclass(frozen=True)
class StopReason:
    """Why a run is not worth going on with.

    Parameters
    ----------
    code : str
        What is wrong.
    joint : str
        The joint; "" for the whole recording.
    detail : str
        A sentence with the figures.
    """

    code: StopCode
    joint: str
    detail: str


def list_fatal_findings(checks: Sequence[Check]) -> list[StopReason]:
    """Return the findings of a recording under way, or of one that was refused, which more rows cannot heal.

    Parameters
    ----------
    checks : sequence of Check
        Its checks so far.

    Returns
    -------
    list of StopReason
        One for each finding.
    """
    return [
        StopReason(code, "", check.detail)
        for check in checks
        for code in _FATAL
        if check.name == code and check.status != "ok" and not check.is_accepted
    ]


def find_stop_reasons(
    recording: Recording,
    checks: Sequence[Check],
    limits: Sequence[JointLimits],
    planned: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[StopReason, ...]:
    """Return why a run that is under way is to be stopped; nothing where it is sound so far.

    Parameters
    ----------
    recording : Recording
        The recording so far.
    checks : sequence of Check
        Its checks so far. Of these, saturated torques and wrong signs or orders count.
    limits : sequence of JointLimits
        Limits of the n joints.
    planned : tuple of (m,) and (m, n), optional
        Times, s, and positions of the motion that is recorded: a run at less than half of its speed is too slow. Not
        compared with a recording that has gaps.

    Returns
    -------
    tuple of StopReason
        One for each finding.
    """
    reasons = list_fatal_findings(checks)
    exceeded: dict[tuple[str, str], StopReason] = {}
    for segment in recording.segments:
        rows = [block.q for block in recording.source.rows(segment.first_row, segment.length, segment.length)]
        q = np.concatenate(rows)
        for j, (name, limit) in enumerate(zip(recording.joint_names, limits, strict=True)):
            for reason in _find_exceeded(name, q[:, j], recording.sampling_rate, limit):
                exceeded.setdefault((name, reason.code), reason)
        # After a gap nobody knows at which place of the plan the motion is.
        if planned is not None and len(recording.segments) == 1:
            reasons += _find_slowness(q, recording.sampling_rate, *planned)
    return (*reasons, *exceeded.values())


def _find_exceeded(name: str, q: FloatArray, rate: float, limit: JointLimits) -> list[StopReason]:
    unit = "rad" if limit.kind == "revolute" else "m"
    reasons = []
    if limit.position is not None:
        low, high = limit.position
        slack = (_EXCEEDED - 1.0) * (high - low)
        worst = float(q[np.argmax(np.maximum(low - q, q - high))])
        if not low - slack <= worst <= high + slack:
            detail = f"{name} is at {worst:.4g} {unit}; its limits are {low:.4g} and {high:.4g} {unit}."
            reasons.append(StopReason("position_limit", name, detail))
    # Over a tenth of a second: the noise of the positions is no speed.
    reach = max(1, round(0.1 * rate))
    if limit.velocity is not None and len(q) > reach:
        fastest = float(np.abs(q[reach:] - q[:-reach]).max()) * rate / reach
        if fastest > _EXCEEDED * limit.velocity:
            detail = f"{name} moves at {fastest:.4g} {unit}/s; its limit is {limit.velocity:.4g} {unit}/s."
            reasons.append(StopReason("velocity_limit", name, detail))
    return reasons


def _find_slowness(q: FloatArray, rate: float, t: FloatArray, planned: FloatArray) -> list[StopReason]:
    own, intended = _measure_travel(q), _measure_travel(planned)
    if len(own) < 2 or len(intended) < 2:
        return []
    seconds = len(own) / rate
    step = float(t[1] - t[0])
    count = min(int(seconds / step), len(intended))
    if seconds < _LEAST_SECONDS or not count:
        return []
    # A run that has ended is not slower than one that stands still at its end.
    share = float(own[min(int(count * step * rate), len(own)) - 1] / intended[count - 1])
    if share >= _SLOW:
        return []
    detail = f"In {seconds:.3g} s the joints moved {100 * share:.0f} % of the way that the design moves them."
    return [StopReason("too_slow", "", detail)]


def _measure_travel(q: FloatArray) -> FloatArray:
    """Return the way (k,) that all joints together have moved, from where the motion begins; noise counts little."""
    begun = np.flatnonzero(np.abs(q - q[0]).max(axis=1) > _LEAST_TRAVEL)
    if not len(begun):
        return np.zeros(0)
    # A hundredth of the samples: noise from one sample to the next would add up.
    moving = q[begun[0] :]
    stride = max(1, len(moving) // 400)
    way = np.cumsum(np.abs(np.diff(moving[::stride], axis=0)).sum(axis=1))
    if not len(way):
        return np.zeros(len(moving))
    return np.asarray(np.interp(np.arange(len(moving)), np.arange(1, len(way) + 1) * stride, way))


_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_EXTERNAL_AXIS = re.compile(r"\b(?:ext(?:ernal)? ?(?:axis|axes|joints?)|ei pos|rail|track|linear (?:unit|axis))\b")
"""What loggers call an axis that carries a robot, in words of small letters; EIPos is KUKA's."""
_NUMBERED_AXIS = re.compile(r"(?<![^\W_])E[1-6](?![^\W_])")
"""What controllers call it beside joints A1, A2, … or J1, J2, …; e1, e2, … are the errors of a controller."""
_NO_AXIS_POSITION = frozenset(
    {"torque", "torques", "trq", "tau", "effort", "force", "moment", "load", "current", "cur", "temperature", "temp"}
    | {"error", "errors", "err", "velocity", "vel", "speed", "acceleration", "acc"}
)
_MOVES = 20.0
"""Steps from row to row that an axis at rest stays within."""


def _find_external_axes(names: Sequence[str], layout: Layout) -> list[str]:
    """Return the columns that are positions of external axes by their names, and that no joint uses."""
    used = {column.source for column in (*layout.q, *layout.tau)}
    words = {name: [word.casefold() for word in _WORD.findall(name)] for name in {*names, *used}}
    is_named = {name: _EXTERNAL_AXIS.search(" ".join(own)) is not None for name, own in words.items()}
    # Where a joint of the robot is such an axis, further columns of that name are other signals of it.
    has_axis = any(is_named[column.source] for column in layout.q)
    axes = []
    for name in names:
        if name in used or _NO_AXIS_POSITION & set(words[name]):
            continue
        place = _NUMBERED_AXIS.search(name)
        joint = place and re.compile(re.escape(name[: place.start()]) + r"[AJ]\d")
        if (is_named[name] and not has_axis) or (joint and any(joint.match(column.source) for column in layout.q)):
            axes.append(name)
    return axes


def report_external_axes(file: FileSource, layout: Layout) -> tuple[Check, ...]:
    """Return a warning of the external axes in the file that move, and that the robot has no joint for."""
    names = _find_external_axes(file.names, layout)
    if not names:
        return ()
    axes = Layout(layout.t, None, tuple(Column(name) for name in names), ())
    columns = np.concatenate([rows.values for rows in file.rows(axes)]).T
    travels = {}
    for name, column in zip(names, columns, strict=True):
        values = column[np.isfinite(column)]
        if len(values) > 1 and np.ptp(values) > _MOVES * np.sqrt(np.mean(np.diff(values) ** 2)):
            travels[name] = f"{name} moves by {np.ptp(values):.4g} {file.units.get(name, 'in its own unit')}"
    if not travels:
        return ()
    detail = (
        f"{', '.join(travels.values())}, and the description has no such joint. If it carries the robot, its "
        "acceleration acts on all joints and no effect of the arm explains it: put a sliding joint under the base of "
        "the description, or record with that axis at rest."
    )
    return (Check("joint_columns", "warning", detail, column=next(iter(travels))),)


def report_base(joints: RecordedJoints, reactions: Sequence[Reaction]) -> tuple[Check, ...]:
    """Return what acts on the base by the columns of the file; nothing for a fixed base."""
    if not joints.n_base:
        return ()
    if joints.project_contacts is not None:
        detail = "The unknown forces of the contacts are eliminated: torques and equations are projected."
        return (Check("base_forces", "ok", detail),)
    if not reactions:
        detail = (
            "The file has no wrench of the surroundings on a link (columns <link>_fx … <link>_mz): it is read as that "
            "of a robot that nothing touches."
        )
        return (Check("base_forces", "ok", detail),)
    parts = (f"{reaction.link} ({'world' if reaction.in_world else 'link'} frame)" for reaction in reactions)
    sentence = f"The surroundings act on {', '.join(parts)}, as measured, and on nothing else."
    links = [reaction.link for reaction in reactions]
    twice = sorted({link for link in links if links.count(link) > 1})
    if twice:
        sentence += (
            f" The file has several wrenches on {', '.join(twice)}, and their sum is taken: if they are the same one, "
            "such as in another frame, leave it out."
        )
    return (Check("base_forces", "warning" if twice else "ok", sentence),)
