"""Tables of validations, and of the verdict on the uses of a model with the drift of its simulation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from dynident.number_format import format_count, format_number, format_percent
from dynident.presentation.labels import MarkedText
from dynident.presentation.tables import Cell, ReportedTable, make_number_cell, make_percent_cell, make_text_cells
from dynident.validation import ValidationOutcome, Verdict
from dynident.verdict import ModelVerdict, State

VALIDATION_WORDS: Mapping[Verdict, MarkedText] = {
    "pass": MarkedText("✓ pass", "ok"),
    "fail": MarkedText("✕ fail", "error"),
    "not_evaluated": MarkedText("– not evaluated", "warning"),
}
"""Words and mark for the verdict of a validation."""

STATE_WORDS: Mapping[State, MarkedText] = {
    "yes": MarkedText("✓ fit", "ok"),
    "limited": MarkedText("! within limits", "warning"),
    "no": MarkedText("✕ not fit", "error"),
    "not_judged": MarkedText("? not judged", "warning"),
}
"""Words and mark for how fit a model is for a use."""


def build_validation_table(validations: Iterable[tuple[str, ValidationOutcome]]) -> ReportedTable:
    """Return validations, each with its title, as a table of their verdicts and reasons."""
    rows = tuple(
        (Cell(title), _make_cell(VALIDATION_WORDS[judged.verdict]), Cell(judged.reason))
        for title, judged in validations
    )
    return ReportedTable("Validations", ("validation", "verdict", "why"), rows, numbers_from=3)


def _make_cell(marked: MarkedText) -> Cell:
    return Cell(marked.words, mark=marked.mark)


def build_verdict_tables(verdict: ModelVerdict) -> Iterator[ReportedTable]:
    """Yield the uses that a model is fit for, and the drift of its simulation; nothing after a gross fault."""
    if verdict.stop is not None:
        return
    rows = tuple(
        (Cell(use.words), _make_cell(STATE_WORDS[use.state]), *make_text_cells(use.reason, use.next_step))
        for use in verdict.uses
    )
    title = "Uses that the model is fit for, by a test of each use"
    yield ReportedTable(title, ("use", "fit", "why", "what next"), rows, numbers_from=4, name="uses")
    if verdict.drift is not None:
        drift = verdict.drift
        yield build_drift_table(drift.joint_names, drift.after, drift.share.T.tolist(), drift.starts)


def build_drift_table(
    joints: Sequence[str], after: Sequence[float], shares: Sequence[Sequence[float | None]], starts: int
) -> ReportedTable:
    """Return how far a simulation drifts: of each joint `shares` of its travel, after each time in s."""
    rows = tuple(
        (Cell(joint), *(make_percent_cell(share, 2) for share in own))
        for joint, own in zip(joints, shares, strict=True)
    )
    title = (
        "Drift of an open-loop simulation under the measured torque, relative to the joint's travel "
        f"({format_count(starts, 'start')} on held-out data)"
    )
    return ReportedTable(title, ("joint", *(f"after {time:g} s" for time in after)), rows, name="drift")


def build_drift_tables(
    joints: Sequence[str],
    after: Sequence[float],
    drifts: Iterable[tuple[str, Sequence[Sequence[float | None]], Sequence[Sequence[float | None]] | None]],
    starts: int,
) -> Iterator[ReportedTable]:
    """Yield a table of each drift: the quantity with its unit, the drift (h, n) and its share of the travel, if any.

    Times that no recording reaches have no row; a diverged simulation has one.
    """
    for quantity, distances, shares in drifts:
        rows = []
        for time, row, own in zip(after, distances, shares or [[None] * len(joints)] * len(after), strict=True):
            if time == after[0] or any(distance is not None for distance in row):
                cells = (make_drift_cell(distance, share) for distance, share in zip(row, own, strict=True))
                rows.append((make_number_cell(time, unit="s"), *cells))
        title = f"Drift of the {quantity} under the measured torque ({format_count(starts, 'start')})"
        yield ReportedTable(title, ("after", *joints), tuple(rows))


def make_drift_cell(distance: float | None, share: float | None) -> Cell:
    """Return a drift, with its share of the joint's travel where there is one."""
    if distance is None:
        return Cell("diverged", mark="warning")
    text = format_number(distance, 2)
    return Cell(text if share is None else f"{text} ({format_percent(share, decimals=0)})", distance)
