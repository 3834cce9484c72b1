"""Checks of torque without a robot model: saturation, constancy, sign, order, delay; holds their thresholds."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import Remedy
from dynident.number_format import format_percent
from dynident.recordings import nonparametric_fit as against_motion
from dynident.recordings.columns_to_signals import NOT_RECORDED, Layout
from dynident.recordings.conditioning.signed_registers import check_lost_sign
from dynident.recordings.file_source import RawSample
from dynident.recordings.joint_phases import STANDS as STANDING_TRAVEL
from dynident.recordings.joint_phases import find_spans
from dynident.recordings.nonparametric_fit import TorqueEvidence
from dynident.recordings.recording import JointLimits, ModelChecks, Recording, is_inside_windows
from dynident.recordings.recording_metadata import COMMANDED, DELAY, Check, Revision
from dynident.recordings.signal_spectra import find_dead_zone, find_step
from dynident.recordings.units import format_time

SATURATED = 5e-3
"""Torque counts as saturated where it stays within this share of its range at its extreme."""

RUN, SHORTEST = 5, 0.01
"""Rows in a row, and s, at the extreme make a plateau: a smooth peak in whole counts stays there for a few ms."""

WIDER = 0.2
"""Rows that a rounded peak spends one digit below its top, over those at the top: 0.41 of a parabola, half of it where
friction cuts one side off. A torque that is cut off comes there at its own speed."""

STANDS = 0.1
"""Share of its range that a joint may move behind a brake, which gives a little."""

TOGGLES, TOGETHER, SEVERAL = 2, 1.5, 2
"""Digits that a converter at the end of its range changes by; times the rows of plateaus that each has to add; and
plateaus that have to reach the top: one alone may be any constant torque with a digit of noise."""

_SATURATES = (
    "the drive, the sensor, or the log, saturates there. These rows are left out of the joint's equation and of its "
    "errors. To use all rows, move more slowly, or with less payload."
)

AGAINST_DOUBT, AGAINST_CERTAIN = -2.0, -2.8
"""Joint evidence (standard errors) of a torque against its motion."""

AROUND, MOST_INTERVALS = 0.2, 20
"""s left out on either side of a plateau, about what filters smear; and so many intervals at most."""

OWNED, LEAST_OWNED = 2e-3, 1e-3
"""Share of a torque's variance that another joint's friction has to explain to be seen, and what counts as nothing."""

ROUNDED = 0.05
"""Share of a torque's rms that rounding to its steps takes, from which on it is told: as much as good models leave."""

SWAPPED = 4.0
"""How many times better swapped torques have to be explained, in the geometric mean."""

LATE_CERTAIN = 0.02
"""A misalignment of more s spoils every estimate."""


def check_torque(
    recording: Recording,
    sample: RawSample,
    layout: Layout,
    limits: tuple[JointLimits, ...],
    against: ModelChecks | None = None,
) -> list[Check]:
    """Check the torques of the rows inside the windows: by themselves, then against the motion.

    What a model of the robot says (`against`) of order and signs goes before what friction alone tells. The sample are
    raw rows from all over the recording; the layout matches the columns of the file with the joints.
    """
    # In this order: torque by itself first. A torque that was not recorded, or saturates, would only mislead what comes
    # after.
    checks = [
        *_find_impossible_torques(sample, layout),
        _check_saturation(recording, sample, layout, limits),
        _check_resolution(recording, sample, layout, limits),
        _check_constant_torque(recording, sample, layout),
    ]
    if checks[-1].status == "warning":
        # Motors that are off: there is nothing to hold against the motion.
        return checks
    wrong = [check for check in checks if check.status == "error"]
    model_checks = (
        None if wrong and wrong[0].name != "constant_torque" else _run_model_checks(recording, layout, against)
    )
    if wrong and not layout.n_base:
        # A command against gravity has no torque at all where gravity has none: that is then what is wrong.
        return [*(doubt for doubt in model_checks or () if doubt.name == COMMANDED), *checks]
    doubts = {doubt.name for doubt in model_checks or () if doubt.name != DELAY or doubt.status != "ok"}
    if layout.n_base or doubts & {"torque_order", "joint_zero", COMMANDED, DELAY}:
        # By all of the torque, where the corners of friction alone call right recordings early; and not beside another
        # mistake, which looks like a delay as well. Friction knows nothing of what the surroundings do to a base.
        return [*checks, *(model_checks or ())]
    evidence = against_motion.gather_evidence(recording)
    if evidence is None:
        nothing = "The recording is too short, or moves too little, to detect this without a model."
        silent = (Check(name, "ok", nothing) for name in ("torque_order", "torque_sign", DELAY))
        return [*checks, *silent, *(model_checks or ())]
    columns = _check_order_and_sign(recording, evidence, layout, sample)
    return [*checks, *columns, _check_alignment(recording, evidence, layout, sample), *(model_checks or ())]


def _run_model_checks(recording: Recording, layout: Layout, against: ModelChecks | None) -> tuple[Check, ...] | None:
    q, tau = ([column.source for column in columns] for columns in (layout.q, layout.tau))
    return against(recording, q, tau) if against is not None and recording.role != "friction" else None


def _check_order_and_sign(
    recording: Recording, evidence: TorqueEvidence, layout: Layout, sample: RawSample
) -> tuple[Check, ...]:
    """Check whether every torque is that of its joint, and has the right sign, as friction tells."""
    order = _check_order(recording, evidence, layout, sample)
    # A torque of another joint's has no sign to speak of.
    return (order, *(_check_sign(recording, evidence, layout, sample) if order.status == "ok" else ()))


def find_torque_ranges(
    sample: RawSample, layout: Layout, limits: tuple[JointLimits, ...], period: float
) -> tuple[tuple[float, float], ...]:
    """Find the range of each torque's sensor or drive, if the torque stands there.

    Parameters
    ----------
    sample : RawSample
        Raw rows from all over the recording.
    layout : Layout
        The columns of the file, matched with the joints.
    limits : tuple of JointLimits
        Limits of the n joints, as far as they are known.
    period : float
        Sampling period in s.

    Returns
    -------
    n pairs (low, high)
        As a recording has them (`Recording.torque_ranges`), a dead zone if nothing saturates; empty if there is none.
    """
    run, ranges = max(RUN, round(SHORTEST / period)), [(-np.inf, np.inf)] * layout.n_base
    for joint in range(layout.n_base, sample.tau.shape[1]):
        tau, q = sample.tau[sample.used, joint], sample.q[sample.used, joint]
        zone = find_dead_zone(tau, q)
        ends = (_find_upper_end(sign * tau, q, limits[joint].effort, run) for sign in (-1.0, 1.0))
        low, high = (end if abs(end) >= zone else np.inf for end in ends)
        ranges.append((zone, -zone) if zone and min(low, high) == np.inf else (-low, high))
    return tuple(ranges) if np.isfinite(ranges).any() else ()


def _check_saturation(
    recording: Recording, sample: RawSample, layout: Layout, limits: tuple[JointLimits, ...]
) -> Check:
    tau, row, t = sample.tau[sample.used], sample.row[sample.used], sample.t[sample.used]
    plateaus: list[tuple[float, Check]] = []
    for joint, (low, high) in enumerate(recording.torque_ranges):
        flat = (tau[:, joint] <= low) | (tau[:, joint] >= high)
        share = float(flat.mean())
        if low < high and flat.any():
            first, unit = int(np.flatnonzero(flat)[0]), limits[joint].torque_unit
            brake = _find_brake(joint, flat, sample, layout)
            why = _describe_brake(brake) if brake else _SATURATES
            check = Check(
                "saturation",
                "error" if share > 0.2 else "warning",
                f"{layout.tau[joint].source} stays at its extreme value ({tau[first, joint]:.4g} {unit}) for "
                f"{format_percent(share, 2)} of the rows, first in row {row[first]} (t = {format_time(t[first])} "
                f"s): {why}",
                layout.tau[joint].source,
                int(row[first]),
                float(t[first]),
                remedies=brake,
            )
            plateaus.append((share, check))
    if not plateaus:
        return Check("saturation", "ok", "No torque stays at its extreme value.")
    (_, worst), *others = sorted(plateaus, key=lambda pair: -pair[0])
    also = ", ".join(f"{check.column} in {format_percent(share, 2)}" for share, check in others)
    return replace(worst, detail=f"{worst.detail} So do {also} of the rows.") if also else worst


def _find_brake(joint: int, flat: BoolArray, sample: RawSample, layout: Layout) -> tuple[Remedy, ...]:
    """Return how to use the other rows where a torque that stays at 0 while its joint stands was not measured there.

    Nothing where it is not so: a drive that pushes one way only lets its joint coast with a torque of 0.
    """
    tau, q, t = sample.tau[sample.used], sample.q[sample.used, joint], sample.t[sample.used]
    works = tau[:, joint] != 0.0
    if works[flat].any() or not _stands_without_torque(tau[:, joint], q):
        return ()
    places, at = np.flatnonzero(works), t[works]
    # What filters smear splits no interval, and makes none. Rows that are not in the sample say nothing.
    ends = np.append(np.flatnonzero((np.diff(at) > 2.0 * AROUND) & (np.diff(places) > 1)), len(at) - 1)
    spans = zip(at[np.append(0, ends[:-1] + 1)], at[ends], strict=True)
    longest = sorted((float(end - start), float(start), float(end)) for start, end in spans)[-MOST_INTERVALS:]
    windows = tuple(sorted((start, end) for length, start, end in longest if length > 2.0 * AROUND))
    if not windows:
        return ()
    inside = is_inside_windows(t, windows)
    off = [other for other in range(layout.n_base, tau.shape[1]) if not tau[inside, other].any()]
    columns = Remedy("columns", {_name_torque(layout, other): NOT_RECORDED for other in off})
    return (Remedy("windows", windows), *((columns,) if off else ()))


def _stands_without_torque(tau: FloatArray, q: FloatArray) -> bool:
    """Tell whether a joint stays in its place while its torque is exactly 0, as one behind a brake does."""
    return bool(np.ptp(q[tau == 0.0]) <= STANDS * np.ptp(q))


def _name_torque(layout: Layout, joint: int) -> str:
    """Return our name of the torque column of a joint; coordinates of the base have none."""
    return f"tau{joint + 1 - layout.n_base}"


def _describe_brake(remedies: tuple[Remedy, ...]) -> str:
    """Say that a torque was not measured while the brake of its joint was engaged, and how to use the other rows."""
    windows, *columns = remedies
    others = "".join(f", and say that the torques of the others were not recorded there ({each})" for each in columns)
    return (
        "its joint stands there behind its brake, with the drive off, and its load is not in the log. Use the seconds "
        f"in which it works ({windows}){others}; those of another joint are a recording of their own."
    )


def _find_upper_end(tau: FloatArray, q: FloatArray, effort: float | None, run: int) -> float:
    """Return the least torque of the plateaus at a torque's largest value; infinite if none, or if it coasts there."""
    reach, top = float(np.ptp(tau)), float(tau.max(initial=-np.inf))
    if reach == 0.0 or len(tau) < 10 * run:
        return np.inf
    # A joint that stands without load changes its torque by the last digits alone, which is no limit.
    if np.ptp(q) <= STANDING_TRAVEL and len(np.unique(tau)) <= _FEW_LEVELS:
        return np.inf
    end, most = np.inf, 0
    # The values of a torque without digits lie on no grid, however few they are: its peaks have no flat top.
    resolution = find_step(tau) or find_step(tau[tau > top - SATURATED * reach])
    # The same value exactly, or to the last digits of a converter, which come again and again.
    levels, counts = np.unique(tau[tau > top - SATURATED * reach], return_counts=True)
    for level in (top, *levels[(counts >= run) & (levels < top)][: -TOGGLES - 1 : -1]):
        plateaus = [
            last - start + 1
            for start, last in find_spans(tau >= level - 1e-9 * reach)
            if last - start + 1 >= run
            # All plateaus of a range reach its end. A joint that stands has a torque of a few digits as well.
            and (level == top or (tau[start : last + 1].max() == top and np.ptp(q[start : last + 1]) > STANDING_TRAVEL))
            and _is_plateau(tau, start, last + 1, level, resolution)
        ]
        # Further digits belong to the end of the range if it is they that keep its plateaus together.
        if sum(plateaus) > TOGETHER * most and (level == top or len(plateaus) >= SEVERAL):
            end, most = float(level - 1e-9 * reach), sum(plateaus)
    # At a limit that is known, as long as no torque is beyond it.
    if effort is not None and 0.0 < top < (1.0 + SATURATED) * effort:
        at_limit = (1.0 - SATURATED) * effort
        runs = [(start, last + 1) for start, last in find_spans(tau > at_limit) if last - start + 1 >= run]
        if any(_is_plateau(tau, *rows_at, at_limit, resolution) for rows_at in runs):
            end = min(end, at_limit)
    return end


_FEW_LEVELS = 4
"""Values of a torque that are noise of its last digit: nothing between a limit and the rest is among them."""


def _is_plateau(tau: FloatArray, start: int, end: int, level: float, resolution: float) -> bool:
    """Tell whether a run at an extreme is no constant torque, nor a rounded peak, as wide again one digit below."""
    length, deep = end - start, tau[start:end].max() - level
    # Around a plateau the signal changes within a few rows, by more than its last digit's noise; a constant does not.
    sides = (tau[max(0, start - 20) : start], tau[end : end + 20])
    changes = np.concatenate([np.abs(side[RUN:] - side[:-RUN]) > 1.5 * resolution for side in sides])
    if np.count_nonzero(changes) <= 0.5 * len(changes):
        return False
    # As many rows on either side as the run has itself decide it: not the whole torque for every plateau.
    before, after = tau[max(0, start - length) : start][::-1], tau[end : end + length]
    digit = max(resolution, deep / TOGGLES)
    near = sum(int(np.logical_and.accumulate(side >= level - deep - 1.5 * digit).sum()) for side in (before, after))
    return near < WIDER * length


def _find_impossible_torques(sample: RawSample, layout: Layout) -> list[Check]:
    """Return errors for torques that are those of another joint to the last digit, or that have lost their sign."""
    tau, q = sample.tau[sample.used], sample.q[sample.used]
    own = [joint for joint in range(layout.n_base, tau.shape[1]) if np.ptp(tau[:, joint]) > 0.0]
    names = [column.source for column in layout.tau]
    twice = next(
        (
            (first, other)
            for first, other in combinations(own, 2)
            # Fingers that follow one another may share a motor, and its torque.
            if np.array_equal(tau[:, first], tau[:, other]) and not _move_together(q[:, first], q[:, other])
        ),
        None,
    )
    if twice is not None:
        first, other = twice
        detail = (
            f"{names[first]} and {names[other]} have the same numbers in every row, although their joints move "
            "otherwise: one was written in place of the other. Write the torque that was measured; if it was not "
            "recorded, state "
        )
        remedy = Remedy("columns", {_name_torque(layout, other): NOT_RECORDED})
        return [Check("repeated_torque", "error", f"{detail}{remedy}.", names[other], remedies=(remedy,))]
    lost = check_lost_sign(tau[:, own], [names[joint] for joint in own])
    return [] if lost is None else [lost]


def _move_together(first: FloatArray, other: FloatArray) -> bool:
    """Tell whether two positions (m,) are the same, or proportional up to an offset."""
    is_moving = min(np.ptp(first), np.ptp(other)) > 0.0
    return bool(abs(np.corrcoef(first, other)[0, 1]) > 0.999 if is_moving else np.array_equal(first, other))


def _check_resolution(
    recording: Recording, sample: RawSample, layout: Layout, limits: tuple[JointLimits, ...]
) -> Check:
    """Warn of torques in coarse steps: no model explains what rounding took, and no filter gives it back."""
    tau = sample.tau[sample.used]
    sizes = np.sqrt(np.mean(np.nan_to_num(tau) ** 2, axis=0))
    coarse: dict[int, str] = {}
    for joint in range(layout.n_base, tau.shape[1]):
        own = tau[np.isfinite(tau[:, joint]), joint]
        step = find_step(own) if len(own) > 1 and recording.has_torque[joint] else 0.0
        lost = step / np.sqrt(12.0) / max(sizes[joint], np.finfo(float).tiny)  # its errors are spread evenly
        if lost > ROUNDED:
            unit, share = limits[joint].torque_unit, format_percent(lost, decimals=0)
            coarse[joint] = f"{layout.tau[joint].source} (steps of {step:.3g} {unit}, rounding {share} of its rms)"
    if not coarse:
        return Check("torque_resolution", "ok", "No torque comes in coarse steps.")
    detail = (
        f"Torques are rounded coarsely: {', '.join(coarse.values())}. A model cannot explain that, and small effects "
        "on these joints do not show. Log more digits, or another signal of the drive (its current); if it has none, "
        "let these joints carry a load or move faster."
    )
    return Check("torque_resolution", "warning", detail, layout.tau[next(iter(coarse))].source)


def _check_constant_torque(recording: Recording, sample: RawSample, layout: Layout) -> Check:
    tau, q = sample.tau[sample.used], sample.q[sample.used]
    row, time = int(sample.row[first := int(np.flatnonzero(sample.used)[0])]), float(sample.t[first])
    if not tau.any() and (np.ptp(q, axis=0) > 2e-3).any():
        return Check(
            "constant_torque",
            "warning",
            "The torque is 0 in every row while the robot moves: its motors are off, or the torque was not recorded. "
            "From a free swing only ratios can be identified: inertia and friction over gravity.",
            layout.tau[0].source,
            row,
            time,
        )
    varies = np.ptp(tau, axis=0) > 1e-9 * np.maximum(1.0, np.abs(tau).max(axis=0))
    own = np.arange(recording.n) >= layout.n_base
    constant = np.flatnonzero(~varies & (np.ptp(q, axis=0) > 2e-3) & recording.has_torque & own)
    if not len(constant):
        return Check("constant_torque", "ok", "Every torque varies.")
    joint = int(constant[0])
    detail = (
        f"{layout.tau[joint].source} is {tau[0, joint]:.4g} in every row from row {sample.row[first]} on, "
        f"while {layout.q[joint].source} moves: the torque was not recorded."
    )
    cure, remedies = None, tuple[Remedy, ...]()
    if len(constant) < np.count_nonzero(recording.has_torque):
        names = " and ".join(recording.joint_names[k] for k in constant)
        cure = Revision(columns={_name_torque(layout, int(k)): NOT_RECORDED for k in constant})
        remedies = (Remedy("columns", cure.columns),)
        detail += f" To leave out the equation of {names} but use the motion, state {remedies[0]}."
    return Check("constant_torque", "error", detail, layout.tau[joint].source, row, time, cure, remedies=remedies)


def _check_order(recording: Recording, evidence: TorqueEvidence, layout: Layout, sample: RawSample) -> Check:
    shares = against_motion.measure_ownership(evidence)
    n = recording.n
    # By logarithms the best assignment has the largest product of shares. The floor keeps a joint that shows hardly any
    # friction from deciding for all others.
    certainty = np.log(shares + LEAST_OWNED)
    # The order of all torques together that explains them best: joint by joint, one torque could be given away twice.
    owner = scipy.optimize.linear_sum_assignment(-certainty)[1].astype(np.int64)
    swapped = [
        joint
        for joint in range(n)
        if owner[joint] != joint and evidence.moving[joint] and _is_surely_swapped(shares, certainty, owner, joint)
    ]
    if not swapped:
        return Check("torque_order", "ok", "Each torque shows the friction of its own joint.")
    claims = ", ".join(
        f"{layout.tau[i].source} shows the friction of {recording.joint_names[owner[i]]} (not of "
        f"{recording.joint_names[i]})"
        for i in swapped
    )
    first = int(np.flatnonzero(sample.used)[0])
    return Check(
        "torque_order",
        "error",
        f"The torque columns seem to be in a different order from the joints: {claims}, over all rows from row "
        f"{sample.row[first]} on. Map the torque columns by columns.",
        layout.tau[swapped[0]].source,
        int(sample.row[first]),
        float(sample.t[first]),
        _propose_order(owner, swapped),
    )


def _propose_order(owner: IntArray, swapped: list[int]) -> Revision:
    """Return a revision that gives each torque to the joint whose friction it shows, in surely exchanged cycles."""
    order = list(range(1, len(owner) + 1))
    for column in {member for joint in swapped for member in _find_cycle(owner, joint)}:
        order[owner[column]] = column + 1
    return Revision(permutation={"tau": tuple(order)})


def _is_surely_swapped(shares: FloatArray, certainty: FloatArray, owner: IntArray, joint: int) -> bool:
    """Return whether every joint of a cycle explains its new torque clearly better than its old one."""
    cycle = _find_cycle(owner, joint)
    all_better = all(shares[i, owner[i]] >= max(OWNED, 2.0 * shares[i, i]) for i in cycle)
    return all_better and float(np.mean([certainty[i, owner[i]] - certainty[i, i] for i in cycle])) > np.log(SWAPPED)


def _find_cycle(owner: IntArray, joint: int) -> list[int]:
    """Return the joints that change places together with `joint`."""
    cycle = [joint]
    while int(owner[cycle[-1]]) != joint:
        cycle.append(int(owner[cycle[-1]]))
    return cycle


def _check_sign(recording: Recording, evidence: TorqueEvidence, layout: Layout, sample: RawSample) -> list[Check]:
    certain: list[int] = []
    doubtful: list[int] = []
    for joint in np.flatnonzero(evidence.moving):
        friction, inertia = against_motion.measure_direction(evidence, int(joint))
        # Both figures are in standard errors: their sum over √2 is in standard errors again, if they are independent.
        together = (friction + inertia) / np.sqrt(2.0)
        # Both have to be negative, and clearly so together: either alone may be so by chance.
        if friction < 0.0 and inertia < 0.0 and together < AGAINST_DOUBT:
            (certain if together < AGAINST_CERTAIN else doubtful).append(int(joint))
    against = certain + doubtful
    if not against:
        return [Check("torque_sign", "ok", "No torque has the wrong sign for its motion.")]
    named = ", ".join(f"{layout.tau[joint].source} ({recording.joint_names[joint]})" for joint in sorted(against))
    first = int(np.flatnonzero(sample.used)[0])
    return [
        Check(
            "torque_sign",
            "error" if certain else "warning",
            f"The sign of {named} seems to be wrong: friction would drive the joint and its inertia would be "
            f"negative, over all rows from row {sample.row[first]} on. Change the sign of the torque (or of the drive "
            "gain), or of the position, or the joint's axis in the description.",
            layout.tau[against[0]].source,
            int(sample.row[first]),
            float(sample.t[first]),
            Revision(signs={f"tau{joint + 1}": -1.0 for joint in sorted(certain or doubtful)}),
        )
    ]


def _check_alignment(recording: Recording, evidence: TorqueEvidence, layout: Layout, sample: RawSample) -> Check:
    if recording.role == "friction":
        # Friction alone, at constant speeds, has no corners in time but those of presliding.
        return Check(DELAY, "ok", "This check does not apply to a friction test.")
    if recording.torque_from_commands:
        # A motor first crosses the play of its gears: the error from its command changes before the joint turns round.
        return Check(DELAY, "ok", "This check does not apply to a torque that follows from the commands of servos.")
    whole = against_motion.measure_lag(evidence, steady_only=False)
    steady = against_motion.measure_lag(evidence, steady_only=True)
    if whole is None or steady is None:
        return Check(DELAY, "ok", "The delay between torque and position cannot be detected without a model.")
    # Presliding friction delays torque at reversals as well: the rows clear of reversals have to agree.
    certain = (
        whole.seconds * steady.seconds > 0.0
        and abs(whole.seconds) > 4.0 * whole.error
        and abs(steady.seconds) > 3.0 * steady.error
        and min(whole.gain, steady.gain) > 0.01
    )
    if not certain:
        spread = 3.0 * max(whole.error, steady.error, 0.5 * abs(whole.seconds - steady.seconds))
        return Check(
            DELAY,
            "ok",
            f"There is no delay between torque and position that these data can show (about {1e3 * spread:.0f} ms).",
        )
    low, high = sorted((whole.seconds, steady.seconds), key=abs)
    # An error only where even the smaller estimate, less three standard errors, would spoil the parameters.
    least = abs(low) - 3.0 * max(whole.error, steady.error)
    word = "late" if low > 0 else "early"
    first = int(np.flatnonzero(sample.used)[0])
    middle = 0.5 * (whole.seconds + steady.seconds)
    return Check(
        DELAY,
        "error" if least > LATE_CERTAIN else "warning",
        f"The torque is {1e3 * abs(low):.3g} to {1e3 * abs(high):.3g} ms {word} against the position "
        f"({layout.tau[0].source} … {layout.tau[-1].source}, from row {sample.row[first]}, t = "
        f"{format_time(sample.t[first])} "
        f's, on). Log both at the same instant, or correct the delay by "torque_delay": {middle:.2g} (in s).',
        layout.tau[0].source,
        int(sample.row[first]),
        float(sample.t[first]),
        Revision(torque_delay=float(f"{middle:.2g}")),
    )
