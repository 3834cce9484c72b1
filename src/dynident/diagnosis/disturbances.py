"""Find spans of time with a disturbance from outside, such as a push, and leave them out of a diagnosis.

Holds how much a delay of the clock must explain, and how the ends of a span are found.

A push of a few seconds shifts all parameters, and the resulting errors everywhere else look like friction. So spans
that stand out are found by leaving each out (`estimation.outlying_spans`), a push on one of the links is tried on them,
and everything else is looked for in the other rows alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis.candidates.candidate_pool import Pool, build_pool_of_choices
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, compare
from dynident.diagnosis.diagnosis_result import UnknownPattern
from dynident.diagnosis.search.contacts_and_loads import find_contacts
from dynident.diagnosis.search.search_state import Finding, gather_state
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, OutlyingSpan, Reduction, concatenate_reductions, find_outlying_spans
from dynident.identification import Identification
from dynident.identification.identified_models.add_effects import extend_at_once
from dynident.identification.identified_models.fit_model import identify_model
from dynident.identification.identified_models.other_conditions import OtherLoad, find_other_load
from dynident.progress import ignore_progress
from dynident.recordings import Recording
from dynident.recordings.pose_recordings import has_poses
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.observation_matrix import RegressorInputs

PUSH = next(effect.id for effect in CATALOGUE.values() if effect.is_transient)
"""The effect that acts for a while."""

_SILENT = 0.1
"""Share of its changes, predicted and usual, below which the torque of a drive hardly changes: it is off, or braked."""

_DELAYS = np.concatenate([np.arange(-0.3, 0.0, 0.01), np.arange(0.01, 0.301, 0.01)])
"""s; clocks that jump do so by a buffer or a few, of 10 ms and more. What is less passes as a push or stays unnamed."""

_EXPLAINED = 0.7
"""Share of the squared residual that one delay of all joints must explain, as much as a push has to."""

_SMOOTH = 0.1
"""s over which the squared residual is averaged before the ends of a span are looked for."""

_STRONGEST = 0.9
"""Quantile of the squared residual over a span that counts as the disturbance, which fills at least a tenth of it.

`benchmarks/outlying_spans.py` shows what this finds and leaves.
"""

_SLOWEST = 10.0
"""Hz; a filter smears a disturbance over a period of its cut-off to either side, and over no less than one of these."""


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A span of time in which something outside the model acts.

    Parameters
    ----------
    recording : int
        Number of the recording.
    run : str
        Label of the run.
    start : float
        Start, s.
    end : float
        End, s.
    steps : tuple of (float, float)
        Start and end of a disturbance that begins and ends at once, s.
    ratio : float
        Ratio of the residual to that of the other rows.
    share : (n,)
        Share of each joint's squared residual that is in it.
    cause : str
        What explains it better than a push, in words; "" where nothing does.
    contact : Finding, optional
        The push that explains it; None where none does.
    force : (3,), optional
        Force of the push at its middle along the axes of the base, N.
    load : OtherLoad, optional
        Another load that explains it as well as the push.
    """

    recording: int
    run: str
    start: float
    end: float
    steps: tuple[float, float]
    ratio: float
    share: FloatArray
    cause: str = ""
    contact: Finding | None = None
    force: FloatArray | None = None
    load: OtherLoad | None = None


@dataclass(frozen=True, eq=False)
class UndisturbedData:
    """Recordings without disturbed seconds, and the model identified from them.

    Parameters
    ----------
    identification : Identification
        The model, identified without the disturbed seconds.
    recordings : tuple of Recording
        The recordings without these seconds.
    disturbances : tuple of Disturbance
        The disturbances.
    """

    identification: Identification
    recordings: tuple[Recording, ...]
    disturbances: tuple[Disturbance, ...]

    @property
    def contacts(self) -> tuple[Finding, ...]:
        """Pushes that explain disturbances."""
        return tuple(disturbance.contact for disturbance in self.disturbances if disturbance.contact is not None)

    @property
    def unexplained_patterns(self) -> tuple[UnknownPattern, ...]:
        """Disturbances that no push explains, as dependences on time of the joint that shows them most."""
        names = self.identification.model.robot.joint_names
        return tuple(
            UnknownPattern(names[int(np.argmax(disturbance.share))], "time", float(disturbance.share.max()))
            for disturbance in self.disturbances
            if disturbance.contact is None
        )

    @property
    def sentences(self) -> list[str]:
        """One sentence for each disturbance."""
        return [_word_disturbance(disturbance, self.identification) for disturbance in self.disturbances]


def leave_out_disturbances(identification: Identification, recordings: Sequence[Recording]) -> UndisturbedData:
    """Find the spans of time that stand out, try a push on each, and leave them out."""
    model, preprocessing = identification.model, identification.preprocessing
    reference = identification.estimate.next_reference()
    disturbances, windowed = _cut_disturbances(identification, recordings)
    if not disturbances:
        return UndisturbedData(identification, tuple(recordings), ())
    try:
        reidentified = identify_model(
            model, windowed, (), identification.choices, preprocessing, reference, ignore_progress
        )
    except EstimationError:
        # A joint moves in these spans alone: without them there is no model, and nothing to hold them against.
        return UndisturbedData(identification, tuple(recordings), ())
    explained = [
        disturbance if disturbance.cause else _explain(disturbance, reidentified, recordings[disturbance.recording])
        for disturbance in disturbances
    ]
    pushes = [
        disturbance.contact.judged.candidate.choice for disturbance in explained if disturbance.contact is not None
    ]
    # A contact that cannot be added to the model is no finding; its sentence remains as a cause.
    if pushes and not _can_be_added(identification, pushes, recordings):
        explained = [
            replace(disturbance, contact=None, cause=_word_push(disturbance, reidentified)) for disturbance in explained
        ]
    return UndisturbedData(reidentified, windowed, tuple(explained))


def select_comparable(
    identification: Identification, recordings: Sequence[Recording], validation: Sequence[Recording]
) -> tuple[tuple[Recording, ...], list[str]]:
    """Select the held-out recordings that show what those of the fit show, without their disturbed seconds.

    Poses show no motion, commands no torque, and those with another load than stated for the fit another robot.

    Parameters
    ----------
    identification : Identification
        The model, identified without disturbed seconds.
    recordings, validation : sequence of Recording
        The recordings of the fit, and held-out ones.

    Returns
    -------
    tuple
        These recordings, and a sentence for each of the spans that were cut out.
    """
    loads = [recording.payload or None for recording in recordings]
    needs_temperature = any(get_effect(choice.effect).needs_temperature for choice in identification.choices.effects)
    alike = [
        recording
        for recording in validation
        if not has_poses(recording)
        and not recording.torque_from_commands
        and (recording.payload or None) in loads
        and (recording.has_temperature or not needs_temperature)
    ]
    if not alike:
        return (), []
    disturbances, windowed = _cut_disturbances(identification, alike, identification.data.training)
    return windowed, [_word_cut(disturbance) for disturbance in disturbances]


def _cut_disturbances(
    identification: Identification, recordings: Sequence[Recording], beside: Reduction | None = None
) -> tuple[list[Disturbance], tuple[Recording, ...]]:
    """Find the spans of time that stand out in recordings, beside other data if any; return these also without them."""
    model, preprocessing = identification.model, identification.preprocessing
    reference = identification.estimate.next_reference()
    parts = [
        reduce_recordings(model.observation, RegressorInputs([recording], preprocessing, reference))
        for recording in recordings
    ]
    outlying = find_outlying_spans(concatenate_reductions([*parts, *([] if beside is None else [beside])]))
    # `last` holds the number of blocks up to the end of each recording.
    last = np.cumsum([part.n_blocks for part in parts])
    own = [span for span in outlying.spans if span.first < last[-1]]
    if not own:
        return [], tuple(recordings)
    solution = replace(identification.estimate.solution, values=outlying.values)
    # The residual of each span is taken from the parameters that were fitted without all of them.
    undisturbed = replace(identification, estimate=replace(identification.estimate, solution=solution))
    disturbances: list[Disturbance] = []
    for span in own:
        number = int(np.searchsorted(last, span.first, side="right"))
        disturbances.append(
            _build_disturbance(span, number, recordings[number], compare(undisturbed, recordings[number]))
        )
    width = _compute_filter_width(identification)
    windowed = tuple(
        _cut_out(recording, [disturbance for disturbance in disturbances if disturbance.recording == number], width)
        for number, recording in enumerate(recordings)
    )
    return disturbances, windowed


def _build_disturbance(span: OutlyingSpan, number: int, recording: Recording, comparison: Comparison) -> Disturbance:
    """Return a span as a disturbance, with its ends where the residual rises and falls."""
    residual = np.where(comparison.counted_rows, comparison.residual, 0.0)
    inside = (comparison.t >= span.start) & (comparison.t <= span.end)
    segment = comparison.segment[int(np.flatnonzero(inside)[0])] if inside.any() else 0
    # A span may reach over a pause; the disturbance is sought in the segment where it begins.
    inside &= comparison.segment == segment
    # Joints are made comparable by their usual residual outside of the span.
    usual = _compute_median_sizes(residual, comparison.counted_rows & ~inside[:, None])
    power = ((residual / usual) ** 2).sum(axis=1)
    period = float(np.median(np.diff(comparison.t)))
    width = max(1, round(_SMOOTH / period))
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    rows = np.flatnonzero(inside)
    # Halfway, in decades, between what is usual outside and the disturbance at its strongest, which may last for a
    # small part of the span; single rows on the other side do not end it.
    level = np.sqrt(np.median(smooth[~inside]) * np.quantile(smooth[rows], _STRONGEST))
    smallest = np.finfo(float).tiny
    first, last = _find_richest_interval(np.log(np.maximum(smooth[rows], smallest) / max(level, smallest)))
    start, end = float(comparison.t[rows[first]]), float(comparison.t[rows[last]])
    steps = _find_half_heights(comparison.t, np.sqrt(power), int(rows[first]), int(rows[last]))
    own = inside & (comparison.t >= start) & (comparison.t <= end)
    squares = (residual**2).sum(axis=0)
    share = np.divide((residual[own] ** 2).sum(axis=0), squares, out=np.zeros_like(squares), where=squares > 0)
    cause = _find_cause(comparison, own, usual)
    return Disturbance(number, recording.name_segment(int(segment)), start, end, steps, span.ratio, share, cause)


def _find_cause(comparison: Comparison, rows: BoolArray, usual: FloatArray) -> str:
    """Word what explains a disturbance with fewer numbers than a push: a drive without torque, or a clock."""
    measured, predicted = comparison.measured[rows], comparison.predicted[rows]
    # At both ends the filter mixes in what was before and after.
    middle = slice(len(measured) // 4, max(len(measured) - len(measured) // 4, 1))
    # Judged by changes: a brake may hold any constant torque.
    k = max(len(measured[middle]), 1)
    elsewhere = comparison.measured[: len(comparison.measured) // k * k].reshape(-1, k, measured.shape[1])
    # Where a position jumps, the prediction changes far more than any torque does in so short a time. The mean, as most
    # of a motion from point to point may be standstill.
    usual_changes = np.minimum(predicted[middle].std(axis=0), elsewhere.std(axis=1).mean(axis=0))
    silent = measured[middle].std(axis=0) < _SILENT * usual_changes
    off = [name for name, is_off in zip(comparison.joint_names, silent, strict=True) if is_off]
    if off:
        return f"the torque of {', '.join(off)} hardly changes: the drives were off, or the brakes were engaged"
    t = comparison.t[rows]
    before = float((((measured - predicted) / usual) ** 2).sum())
    # One delay for all joints: what jumps is a clock, which all of them share.
    unexplained = {}
    for delay in _DELAYS:
        moved = np.column_stack([np.interp(t - delay, comparison.t, column) for column in comparison.predicted.T])
        unexplained[float(delay)] = float((((measured - moved) / usual) ** 2).sum())
    best = min(unexplained, key=lambda delay: unexplained[delay])
    if unexplained[best] < (1.0 - _EXPLAINED) * before:
        return f"the torque is {abs(best) * 1e3:.0f} ms {'late' if best > 0 else 'early'}: a clock jumped"
    return ""


def _compute_median_sizes(residual: FloatArray, rows: BoolArray) -> FloatArray:
    """Return (n,): the median size of the residual (m, n) on some rows (m, n) of each joint."""
    sizes = [np.abs(residual[own, j]) for j, own in enumerate(rows.T)]
    medians = np.array([float(np.median(own)) if len(own) else 0.0 for own in sizes])
    # A joint without such rows, or without any residual, gets the largest of the others: it then hardly counts.
    largest = float(medians.max(initial=0.0))
    return np.where(medians > 0.0, medians, largest if largest > 0.0 else 1.0)


def _find_richest_interval(values: FloatArray) -> tuple[int, int]:
    """Return the first and last index of the interval with the largest sum (Kadane's algorithm)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    # The sum of an interval is the difference of two cumulative sums: the largest one ends where the sum is most above
    # its least value so far.
    gains = sums - np.minimum.accumulate(sums)
    last = max(int(np.argmax(gains)), 1)
    return int(np.argmin(sums[:last])), last - 1


def _find_half_heights(t: FloatArray, size: FloatArray, first: int, last: int) -> tuple[float, float]:
    """Return the times near rows `first` and `last` where the residual's size (m,) rises to half its height and falls.

    A filter without phase turns a step into a ramp that is at half its height where the step is. The height is that of
    the
    tenth of the span beside the end: what a force does to the joints changes with the posture.
    """
    edge_rows = max(2, (last - first) // 10)
    ends = []
    for edge, step in ((first, 1), (last, -1)):
        half = 0.5 * float(np.median(size[edge + step * edge_rows : edge + 2 * step * edge_rows : step]))
        k = edge
        while k != edge + step * edge_rows and size[k] < half:
            k += step
        before = k - step
        if 0 <= before < len(t) and size[before] < half < size[k] and abs(t[k] - t[before]) < _SMOOTH:
            share = (size[k] - half) / (size[k] - size[before])
            ends.append(float(t[k] + share * (t[before] - t[k])))
        else:
            ends.append(float(t[k]))
    return (ends[0], ends[1]) if ends[0] < ends[1] else (float(t[first]), float(t[last]))


def _compute_filter_width(identification: Identification) -> float:
    """Return the seconds over which the filters smear a disturbance."""
    cutoffs = [
        c for c in (identification.preprocessing.position_cutoff, identification.preprocessing.torque_cutoff) if c
    ]
    return 1.0 / min([*cutoffs, _SLOWEST])


def _cut_out(recording: Recording, disturbances: Sequence[Disturbance], margin: float) -> Recording:
    """Return the recording without the seconds of these disturbances, by windows of t."""
    if not disturbances:
        return recording
    first = min(segment.start_time for segment in recording.segments)
    last = max(segment.start_time + segment.length * recording.period for segment in recording.segments)
    windows = list(recording.windows) or [(first, last)]
    for disturbance in disturbances:
        start, end = disturbance.start - margin, disturbance.end + margin
        # Of every window what lies before and what lies after; parts without length drop out below.
        cut = [(low, min(high, start)) for low, high in windows] + [(max(low, end), high) for low, high in windows]
        windows = sorted((low, high) for low, high in cut if high > low)
    return recording.with_windows(tuple(windows))


def _explain(disturbance: Disturbance, identification: Identification, recording: Recording) -> Disturbance:
    """Return the disturbance with the push that explains it best, tried on all links, or with another load.

    In a short span, or in one posture, a force does what a load does: then it stays a push.
    """
    model = identification.model
    robot = model.robot
    links = range(robot.tree.n) if robot.linkage is None else (robot.tree.n - 1,)
    # Both guesses of the ends are tried: where the residual rises and falls, and where a sudden force would begin and
    # end.
    windows = ((disturbance.start, disturbance.end), disturbance.steps)
    shapes = [
        {"t0": start, "t1": end} | ({"link": k + 1.0} if k + 1 < robot.tree.n else {})
        for start, end in dict.fromkeys(windows)
        for k in links
    ]
    choices = [EffectChoice(PUSH, (), tuple(sorted(shape.items())), (disturbance.run,)) for shape in shapes]
    inputs = RegressorInputs([recording], identification.preprocessing, identification.estimate.next_reference())
    state = gather_state(model, build_pool_of_choices(model, choices), inputs, identification.noise)
    contacts = [
        contact
        for start in dict.fromkeys(window[0] for window in windows)
        for contact in find_contacts(
            replace(state, pool=_select_window(state.pool, start)), identification.preprocessing
        )
    ]
    best = max(contacts, key=lambda contact: contact.judged.t, default=None)
    load = _find_load(disturbance, identification, inputs, best)
    if load is not None and load.is_clear:
        cause = f"the robot carried {load} than in the other seconds: a load was picked up or put down"
        return replace(disturbance, cause=cause)
    if best is None:
        return disturbance
    names = [state.pool.observation.columns[k].parameter for k in best.judged.candidate.columns]
    amplitudes = dict(zip(names, best.judged.amplitudes.tolist(), strict=True))
    force = np.array([amplitudes.get(f"f{axis}", 0.0) + amplitudes.get(f"f{axis}h", 0.0) for axis in "xyz"])
    window = dict(best.judged.candidate.shape)
    start, end = float(window["t0"]), float(window["t1"])
    return replace(disturbance, start=start, end=end, contact=best, force=force, load=load)


def _find_load(
    disturbance: Disturbance, identification: Identification, inputs: RegressorInputs, push: Finding | None
) -> OtherLoad | None:
    """Return the load that explains a disturbance, and whether it explains more than a push; None where none does."""
    model, width = identification.model, _compute_filter_width(identification)
    window = (disturbance.start + width, disturbance.end - width)
    if window[0] >= window[1]:
        return None
    pool = build_pool_of_choices(model, [] if push is None else [push.judged.candidate.choice])
    inside = replace(inputs, recordings=[inputs.recordings[0].with_windows((window,))])
    rival = range(pool.n_base, len(pool.observation.columns))
    return find_other_load(identification, reduce_recordings(pool.observation, inside), rival)


def _select_window(pool: Pool, start: float) -> Pool:
    """Return the pool with the candidates of one window alone."""
    return replace(
        pool, candidates=tuple(candidate for candidate in pool.candidates if dict(candidate.shape)["t0"] == start)
    )


def _word_disturbance(disturbance: Disturbance, identification: Identification) -> str:
    robot = identification.model.robot
    when = f"From {disturbance.start:.1f} to {disturbance.end:.1f} s of {disturbance.run}"
    advice = "The diagnosis uses only the other seconds."
    if disturbance.cause:
        return f"{when} {disturbance.cause}. Leave these seconds out of the identification. {advice}"
    if disturbance.contact is None or disturbance.force is None:
        worst = robot.joint_names[int(np.argmax(disturbance.share))]
        return (
            f"{when} the residual is {np.sqrt(disturbance.ratio):.0f} times that of all other rows, largest on "
            f"{worst}, and no force on one link explains it: it may be a collision, a load that was picked up, a "
            f"brake, or a drive that was off. Leave these seconds out of the identification. {advice}"
        )
    push = _word_push(disturbance, identification)
    return f"{when} {push}: leave these seconds out of the identification, or add the contact. {advice}"


def _word_cut(disturbance: Disturbance) -> str:
    return (
        f"From {disturbance.start:.1f} to {disturbance.end:.1f} s of {disturbance.run}, which is held out, the "
        f"residual is {np.sqrt(disturbance.ratio):.0f} times that of all other rows: these seconds do not judge what "
        "was found."
    )


def _word_push(disturbance: Disturbance, identification: Identification) -> str:
    """Word what the push of a disturbance may have been; return its cause where there is no push."""
    if disturbance.contact is None or disturbance.force is None:
        return disturbance.cause
    robot = identification.model.robot
    link = int(dict(disturbance.contact.judged.candidate.shape).get("link", 0.0))
    # In a short span a force does what a load does.
    either = "" if disturbance.load is None else f", or the robot carried {disturbance.load}"
    # Where along the arm it is pushed, a few seconds hardly tell: a force farther out may do the same.
    if link:
        joint = robot.tree.joint_names[link - 1]
        return f"an external force acted on the link of {joint}, or on a link beyond it{either}"
    return f"an external force of about {np.linalg.norm(disturbance.force):.2g} N acted on the last link{either}"


def _can_be_added(
    identification: Identification, pushes: Sequence[EffectChoice], recordings: Sequence[Recording]
) -> bool:
    """Return whether the recordings determine a model with the pushes in it."""
    try:
        extend_at_once(identification, pushes, recordings)
    except DynidentError:
        return False
    return True
