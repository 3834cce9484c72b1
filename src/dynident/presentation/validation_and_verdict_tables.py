"""Tables of validations, and of the verdict on the uses of a model with the drift of its simulation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Protocol

from dynident.number_format import format_count, format_number, format_percent
from dynident.presentation.labels import MarkedText
from dynident.presentation.tables import Cell, ReportedTable, make_percent_cell, make_text_cells
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


class DriftFigures(Protocol):
    """Drift of a simulation after each of h times, of n joints; None where it diverged or nothing is that long."""

    @property
    def joint_names(self) -> Sequence[str]:
        """Names of the joints."""

    @property
    def after(self) -> Sequence[float]:
        """The times, s."""

    @property
    def distance(self) -> Sequence[Sequence[float | None]]:
        """Drift of the position (h, n), rad or m."""

    @property
    def speed(self) -> Sequence[Sequence[float | None]]:
        """Drift of the velocity (h, n), rad/s or m/s; empty where it is unknown."""

    @property
    def share(self) -> Sequence[Sequence[float | None]]:
        """Drift of the position over the joint's travel in that time (h, n), a fraction."""

    @property
    def starts(self) -> int:
        """How many starts the figures are of."""


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


def build_drift_tables(drift: DriftFigures, where: str = "") -> Iterator[ReportedTable]:
    """Yield the drift of the positions and, where it is known, of the velocities: joints by times.

    Times that no recording reaches have no column; a diverged simulation has one.

    Parameters
    ----------
    drift : DriftFigures
        The drift.
    where : str
        The recording, where each has tables of its own.
    """
    kinds = [("position", "rad or m, and relative to the joint's travel", drift.distance, drift.share)]
    if drift.speed:
        kinds.append(("velocity", "rad/s or m/s", drift.speed, [[None] * len(drift.joint_names)] * len(drift.after)))
    for quantity, unit, distances, shares in kinds:
        reached = [k for k, row in enumerate(distances) if k == 0 or any(value is not None for value in row)]
        rows = tuple(
            (Cell(joint), *(_make_drift_cell(distances[k][j], shares[k][j]) for k in reached))
            for j, joint in enumerate(drift.joint_names)
        )
        place = f" on {where}" if where else ""
        starts = format_count(drift.starts, "start")
        title = f"Drift of the {quantity} under the measured torque{place}, in {unit} ({starts})"
        yield ReportedTable(title, ("joint", *(f"after {drift.after[k]:g} s" for k in reached)), rows)


def _make_drift_cell(distance: float | None, share: float | None) -> Cell:
    if distance is None:
        return Cell("diverged", mark="warning")
    text = format_number(distance, 2)
    return Cell(text if share is None else f"{text} ({format_percent(share, 2)})", distance)
