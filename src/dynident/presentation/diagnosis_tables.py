"""Tables of a diagnosis and of changes: conclusion, candidates, changes, limits, worst places, parameters over days."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynident.number_format import format_number, format_p_value, format_percent, format_range
from dynident.presentation.labels import format_joints, format_shape_constants, get_effect_title
from dynident.presentation.tables import Cell, ReportedTable, make_number_cell, make_percent_cell, make_text_cells
from dynident.robot.joint import MANY_NAMES

if TYPE_CHECKING:
    # For type checkers alone: the tables of a model are printed without any diagnosis, and a diagnosis needs nothing of
    # what is only for series over days.
    from dynident.diagnosis import Change, Diagnosis, FrictionDifference, RankedEffect
    from dynident.diagnosis.diagnosis_result import ChangedValue, DetectionLimit, FailureSpot
    from dynident.diagnosis.monitoring import ParameterTrack, Series

EVIDENCE = ("p", "separable", "evidence")
"""Columns that are too wide for a terminal; files, reports and the page have them."""


_HEADLINES = {
    "adequate": "These data show no missing effect.",
    "missing_effect": "Effects are missing, and the diagnosis names them.",
    "unexplained": "Something is missing that no effect of the catalogue explains.",
    "cannot_tell": "These data cannot tell whether something is missing.",
}


def build_conclusion_table(diagnosis: Diagnosis, joints: Sequence[str]) -> ReportedTable:
    """Return the recommended effects under the headline of a diagnosis; its notes are the summary and the next step."""
    # Where nothing was found, the conclusion says what that is worth.
    conclusion, is_adequate = diagnosis.conclusion, diagnosis.verdict == "adequate"
    title = conclusion.headline if conclusion is not None and is_adequate else _HEADLINES[diagnosis.verdict]
    summary = diagnosis.summary.removeprefix(title).lstrip()
    notes = [*([summary] if summary else []), *([] if conclusion is None else [f"Next: {conclusion.next_step}"])]
    rows = tuple(
        tuple(
            make_text_cells(
                diagnosis.get_title(choice), format_joints(choice.joints, joints), format_shape_constants(choice)
            )
        )
        for choice in diagnosis.recommended
    )
    columns = ("Recommended, in this order", "on", "shape constants")
    return ReportedTable(title, columns, rows, numbers_from=3, notes=tuple(notes), name="conclusion")


LEFT_OUT = ", with relative errors on blocks left out of the fit"
"""What errors in a table of candidates are of: not of the recordings that are held out."""


def build_candidate_table(
    ranked: Iterable[RankedEffect], joints: Sequence[str], title: str = f"Ranked effects{LEFT_OUT}"
) -> ReportedTable:
    """Return a table of ranked candidates.

    Parameters
    ----------
    ranked : iterable of RankedEffect
        Best first; findings are marked.
    joints : sequence of str
        Names of all joints of the robot.
    title : str
        Heading of the table.
    """
    columns = (
        "rank",
        "effect",
        "joints",
        "error before",
        "after",
        "drop",
        *EVIDENCE[:2],
        "why, or why not",
        EVIDENCE[2],
    )
    notes = (
        "Errors are relative, of the given joints, on blocks of time that the fit leaves out; the model already "
        "contains everything that ranks above the effect. Separable: the share of the effect's columns that the model "
        "does not explain; near zero, these data cannot distinguish the effect from the model.",
    )
    ranked = tuple(ranked)
    rows = tuple(
        (
            Cell(str(item.rank)),
            Cell(
                item.title if item.question else get_effect_title(item.effect),
                note=format_shape_constants(item.choice),
            ),
            Cell(format_joints(item.joints, joints)),
            make_percent_cell(item.error_before),
            make_percent_cell(item.error_after),
            make_percent_cell(item.error_drop, 2),
            Cell(format_p_value(item.p_value), item.p_value),
            make_percent_cell(item.separability, 2),
            Cell(format_reason(item)),
            Cell(item.evidence),
        )
        for item in ranked
    )
    marked_rows = tuple(k for k, item in enumerate(ranked) if item.significant)
    return ReportedTable(title, columns, rows, numbers_from=3, notes=notes, name="candidates", marked_rows=marked_rows)


def format_reason(candidate: RankedEffect) -> str:
    """Return why a candidate is a finding or not, in a few words."""
    if candidate.reason is not None:
        return candidate.reason.brief
    # A diagnosis of an earlier version holds no reasons.
    return "accepted" if candidate.significant else "not accepted"


def describe_rivals(equivalent: Sequence[str]) -> str:
    """Return the sentence that names what data cannot tell an effect from, with a space before it; "" for nothing."""
    names = ", ".join(map(get_effect_title, equivalent))
    return f" These data cannot distinguish it from: {names}." if names else ""


def build_change_table(
    title: str, changes: Sequence[Change], joints: Sequence[str], since: Sequence[str] = ()
) -> ReportedTable:
    """Return a table of the numbers that differ, the main one of each change first."""
    first = ("since",) if since else ()
    columns = (*first, "changed", "joint", "parameter", "before", "difference", "95 % interval", "unit", *EVIDENCE[::2])
    rows = [
        (
            *([Cell(since[k] if value is change.main else "")] if since else []),
            *_build_change_row(change, value, joints),
        )
        for k, change in enumerate(changes)
        for value in (change.main, *change.more)
    ]
    return ReportedTable(title, columns, tuple(rows), numbers_from=3 + len(first), name="changes")


def _build_change_row(change: Change, value: ChangedValue, joints: Sequence[str]) -> tuple[Cell, ...]:
    # The test is one of the whole change, not of each of its parameters.
    is_main = value is change.main
    place = change.carrier or format_joints(change.choice.joints, joints)
    words = (get_effect_title(change.choice.effect), place) if is_main else ("", "")
    return (
        *make_text_cells(*words, value.parameter),
        make_number_cell(value.before),
        Cell(_format_signed(value.value), value.value),
        _make_difference_interval(value.interval),
        Cell("" if value.unit == "-" else value.unit),
        Cell(format_p_value(change.p_value), change.p_value) if is_main else Cell(""),
        Cell(f"{change.evidence}{describe_rivals(change.equivalent)}" if is_main else ""),
    )


def build_friction_table(differences: Sequence[FrictionDifference]) -> ReportedTable:
    """Return a table of how the friction of each joint that moves differs, significant or not."""
    rows = tuple(
        (
            Cell(item.joint),
            make_number_cell(item.speed, unit="m/s" if item.unit == "N" else "rad/s"),
            make_number_cell(item.before),
            Cell(_format_signed(item.value), item.value),
            _make_difference_interval(item.interval),
            Cell(item.unit),
            _make_share_cell(item),
        )
        for item in differences
    )
    columns = ("friction of", "at a speed of", "before", "difference", "95 % interval", "unit", "relative to before")
    title = "Friction of each joint since the baseline, whether it is a finding or not"
    return ReportedTable(title, columns, rows, name="friction")


def _make_share_cell(difference: FrictionDifference) -> Cell:
    if difference.before <= 0.0:
        return Cell("–")
    share = difference.value / difference.before
    return Cell(f"{'+' if share > 0 else ''}{format_percent(share, 2)}", share)


def _make_difference_interval(ends: Sequence[float]) -> Cell:
    return Cell(" to ".join(format_number(end) for end in ends), is_figures=True)


def _format_signed(value: float) -> str:
    return f"{'+' if value > 0 else ''}{format_number(value)}"


def build_diagnosis_tables(
    diagnosis: Diagnosis, joints: Sequence[str], units: Sequence[str]
) -> Iterator[ReportedTable]:
    """Yield the tables of a diagnosis, as far as it has such content.

    Their names: conclusion, candidates, changes, friction, unknown, limits, limits_map, hidden, worst_places, outcomes.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    joints, units : sequence of str
        Names of all joints of the robot; the unit of each one's torque or force.
    """
    yield build_conclusion_table(diagnosis, joints)
    if diagnosis.candidates:
        yield build_candidate_table(diagnosis.candidates, joints)
    if diagnosis.changes:
        yield build_change_table("Changes since the baseline", diagnosis.changes, joints)
    if diagnosis.friction:
        yield build_friction_table(diagnosis.friction)
    if diagnosis.unknown:
        from dynident.diagnosis.diagnosis_summary import group_patterns

        rows = tuple(
            (*make_text_cells(on, variable), Cell(shares, is_figures=True))
            for variable, on, shares in group_patterns(diagnosis.unknown, joints)
        )
        title = "With all recommended effects, the residual still depends on"
        yield ReportedTable(title, ("joints", "over", "share of their variance"), rows, 2, name="unknown")
    if diagnosis.detection_limits:
        yield build_limit_table(diagnosis, joints)
        yield _build_limit_map(diagnosis, joints)
    if diagnosis.not_visible:
        yield _build_hidden_table(diagnosis, joints)
    if diagnosis.failure_map:
        yield _build_worst_places_table(diagnosis.failure_map, joints, units)
    if diagnosis.outcomes:
        yield _build_outcome_table(diagnosis, joints)


def _build_worst_places_table(
    spots: Sequence[FailureSpot], joints: Sequence[str], units: Sequence[str]
) -> ReportedTable:
    rows = tuple(
        (
            *make_text_cells(spot.joint, spot.variable),
            Cell(format_range(spot.low, spot.high, spot.unit), is_figures=True),
            make_number_cell(spot.rms, unit=units[joints.index(spot.joint)]),
            make_number_cell(spot.ratio, 2),
        )
        for spot in spots
    )
    columns = ("joint", "over", "where", "rms there", "times the joint's own rms")
    title = "Where the residual of the diagnosed model is largest"
    return ReportedTable(title, columns, rows, numbers_from=2, name="worst_places")


def _build_outcome_table(diagnosis: Diagnosis, joints: Sequence[str]) -> ReportedTable:
    """Return what became of every effect on every joint, in the order of the outcomes."""
    rows = tuple(
        (
            Cell(format_joints(outcome.choice.joints, joints)),
            make_percent_cell(outcome.error_drop, 2),
            Cell(outcome.reason.text),
        )
        for outcome in diagnosis.outcomes
    )
    groups = tuple(get_effect_title(outcome.choice.effect) for outcome in diagnosis.outcomes)
    columns = ("joints", "drop on left-out blocks", "why, or why not")
    return ReportedTable("Every effect on every joint", columns, rows, groups=groups, name="outcomes")


_MOST_REASONS = 4


def _build_hidden_table(diagnosis: Diagnosis, joints: Sequence[str]) -> ReportedTable:
    """Return a table of the effects that the data could not have shown, one row each with all its joints."""
    rows = []
    for effect in dict.fromkeys(item.effect for item in diagnosis.not_visible):
        items = [item for item in diagnosis.not_visible if item.effect == effect]
        places = tuple(dict.fromkeys(name for item in items for name in item.joints))
        reasons = list(dict.fromkeys(item.brief or item.reason for item in items))
        # A robot with many joints has a reason for each.
        if len(reasons) > _MOST_REASONS:
            more = f"and {len(reasons) - _MOST_REASONS + 1} more, as in the table of limits"
            reasons = [*reasons[: _MOST_REASONS - 1], more]
        rows.append(make_text_cells(get_effect_title(effect), format_joints(places, joints), ", ".join(reasons)))
    notes = (
        "The robot may have these effects: these data cannot show them at their usual size. “From a on (usual: b)”: "
        "the parameter would have shown from a on, and an arm with this effect has about b. “x % left”: only this "
        "share of its column is independent of the model. “Undetermined”: the data do not determine it together with "
        "the model and the findings.",
    )
    columns = ("effect", "where", "why")
    return ReportedTable("Not visible in these data", columns, tuple(map(tuple, rows)), 3, notes=notes, name="hidden")


def _format_first_day(since: str, earliest: str, latest: str) -> str:
    """Return the day from which something differs, with the days that the data cannot tell from it."""
    return since if earliest == latest else f"{since} ({earliest} to {latest})"


def build_series_tables(series: Series, joints: Sequence[str]) -> Iterator[ReportedTable]:
    """Yield the changes over the days, and day by day the parameters that change; nothing where nothing does.

    Parameters
    ----------
    series : Series
        A robot over many days.
    joints : sequence of str
        Names of all joints of the robot.
    """
    if not series.changes:
        return
    days = series.days
    since = [_format_first_day(days[c.since], days[c.earliest], days[c.latest]) for c in series.changes]
    yield build_change_table("Changes over the days", [change.change for change in series.changes], joints, since)
    # An effect without joints is of the whole robot; its parameters have an empty joint.
    changed = {
        (change.change.choice.effect, joint)
        for change in series.changes
        for joint in change.change.choice.joints or ("",)
    }
    tracks = [track for track in series.courses if (track.effect, track.joint) in changed]
    if tracks:
        rows = tuple(
            (Cell(day), *(_make_track_cell(track, k) for track in tracks)) for k, day in enumerate(series.days)
        )
        names = (f"{track.parameter}, {track.unit}" for track in tracks)
        yield ReportedTable("Day by day, ± half of the 95 % interval", ("day", *names), rows, name="tracks")


def _make_track_cell(track: ParameterTrack, day: int) -> Cell:
    value, upper = float(track.values[day]), float(track.intervals[day][1])
    if not np.isfinite(value):
        return Cell("not determined")
    return Cell(f"{format_number(value)} ± {format_number(upper - value)}", value)


def _note_common_effects(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the note that limits are only of common effects, where they are."""
    return () if diagnosis.changes is None else ("With a baseline, only effects that arms often have are listed.",)


def build_limit_table(diagnosis: Diagnosis, joints: Sequence[str]) -> ReportedTable:
    """Return a table of detection limits with one row for each effect, whatever the number of joints."""
    rows, limits = [], diagnosis.detection_limits
    for effect in dict.fromkeys(limit.effect for limit in limits):
        own = [limit for limit in limits if limit.effect == effect]
        blind = [name for limit in own if limit.share > 1.0 for name in limit.joints or ("",)]
        where = "" if not blind else "the whole robot" if blind == [""] else format_joints(blind, joints, MANY_NAMES)
        sizes = (_format_sizes(own), _format_range([limit.share for limit in own]))
        rows.append(
            (Cell(get_effect_title(effect)), *(Cell(text, is_figures=True) for text in sizes), Cell(where or "–"))
        )
    columns = ("effect", "smallest size that shows", "over the usual size", "the usual size does not show on")
    notes = _note_common_effects(diagnosis)
    return ReportedTable("What these data would have shown", columns, tuple(rows), notes=notes, name="limits")


def build_limits_by_joint_table(diagnosis: Diagnosis) -> ReportedTable:
    """Return a table of detection limits with one row for each effect on each joint."""
    rows = tuple(
        (
            *make_text_cells(
                get_effect_title(limit.effect), ", ".join(limit.joints) or "the whole robot", limit.parameter
            ),
            make_number_cell(
                limit.size if math.isfinite(limit.size) else None, unit="" if limit.unit == "-" else limit.unit
            ),
            Cell(format_share(limit.share), limit.share if math.isfinite(limit.share) else None),
        )
        for limit in diagnosis.detection_limits
    )
    columns = ("effect", "joint", "parameter", "smallest size that shows", "over the usual size")
    title = "What these data would have shown in 95 of 100 cases"
    notes = _note_common_effects(diagnosis)
    return ReportedTable(title, columns, rows, numbers_from=3, notes=notes, name="limits_by_joint")


def _build_limit_map(diagnosis: Diagnosis, joints: Sequence[str]) -> ReportedTable:
    """Return the detection limits as a map of effects and joints, in shares of the usual size."""
    limits = diagnosis.detection_limits
    places = [joint for joint in joints if any(joint in limit.joints for limit in limits)]
    places += ["the whole robot"] * any(not limit.joints for limit in limits)
    cells = {(limit.effect, (limit.joints or places[-1:])[0]): _make_limit_cell(limit) for limit in limits}
    effects = dict.fromkeys(limit.effect for limit in limits)
    rows = tuple(
        (Cell(get_effect_title(effect)), *(cells.get((effect, place), Cell("")) for place in places))
        for effect in effects
    )
    seen = sum(limit.share <= 1.0 for limit in limits)
    note = (
        f"The smallest size of each effect that these recordings would have shown with {format_percent(0.95, 2)}, over "
        "the size that it has on arms that have it. Blue: the usual size would have shown. Grey: no size would. Blank: "
        "found, in the model, or not possible on that joint."
    )
    title = f"Detection limits ({seen} of {len(limits)} would have shown at their usual size)"
    notes = (note, *_note_common_effects(diagnosis))
    return ReportedTable(title, ("effect", *places), rows, notes=notes, name="limits_map")


def _make_limit_cell(limit: DetectionLimit) -> Cell:
    unit = "" if limit.unit == "-" else f" {limit.unit}"
    is_finite = math.isfinite(limit.size)
    shows = f"from {format_number(limit.size)}{unit} on" if is_finite else "no size would have shown"
    note = f"{limit.parameter}: {shows}; usually {format_number(limit.usual)}{unit}"
    return Cell(format_share(limit.share), limit.share if is_finite else None, note=note)


def format_share(share: float) -> str:
    """Return a limit over the usual size as a percentage or a factor; "–" where no size would have shown."""
    if not math.isfinite(share):
        return "–"
    return format_percent(share, 2) if share < 0.995 else f"{share:.2g} ×" if share < 10.0 else f"{share:.0f} ×"


def _format_range(shares: Sequence[float]) -> str:
    low, high = format_share(min(shares)), format_share(max(shares))
    if not math.isfinite(max(shares)):
        return f"{low}, or no size shows" if math.isfinite(min(shares)) else "no size shows"
    return low if low == high else f"{low} to {high}"


def _format_sizes(limits: Sequence[DetectionLimit]) -> str:
    """Return the smallest and the largest limit with their unit; units of joints of other kinds follow each other."""
    texts = []
    for unit in dict.fromkeys(limit.unit for limit in limits):
        sizes = [limit.size for limit in limits if limit.unit == unit and math.isfinite(limit.size)]
        words = "" if unit == "-" else f" {unit}"
        if sizes:
            low, high = format_number(min(sizes), 2), format_number(max(sizes), 2)
            texts.append(f"{low}{words}" if low == high else f"{low} to {high}{words}")
    return ", ".join(texts) or "–"
