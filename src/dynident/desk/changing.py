"""The changes of a robot between two sets of recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

from dynident.advice import AdvisedDiagnosis, advise
from dynident.desk.diagnosing import check_some
from dynident.desk.figure import Figure, figure_of
from dynident.desk.frames import Columns, Framed, columns_of
from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import Recordings, SomeRecordings, as_recordings
from dynident.desk.texts import text_table
from dynident.diagnosis import Change, examine
from dynident.errors import DynidentError
from dynident.html import block, folded, listed, paragraph, table
from dynident.identification import Identification
from dynident.progress import Progress, silent
from dynident.reports.change_rows import COLUMNS, FRICTION_COLUMNS, change_rows, friction_row
from dynident.reports.words import hidden_text, place_text

_FRAME_COLUMNS = (
    "effect", "joint", "parameter", "before", "difference", "interval_low", "interval_high", "unit", "p_value",
    "evidence",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Changes(Sequence[Change], Framed):
    """What differs between two sets of recordings of one robot; empty where nothing does.

    `to_frame` has a row for each number that differs, with the columns

    * effect (its id), joint, parameter,
    * before (missing where the model does not have the parameter), difference, interval_low and interval_high (of the
      difference, 95 %), unit (of all four),
    * p_value (of the change, in the row of its main number; missing in its other rows), evidence.

    Attributes
    ----------
    model : Model
    before, after : Recordings
    diagnosis : AdvisedDiagnosis
        It also says what the model lacks before and after.
    """

    model: Model
    before: Recordings
    after: Recordings
    diagnosis: AdvisedDiagnosis

    @property
    def summary(self) -> str:
        """What has changed, in a few sentences."""
        return self.diagnosis.summary

    @property
    def items(self) -> tuple[Change, ...]:
        """The changes, each with its values, intervals and evidence."""
        return self.diagnosis.changes or ()

    def _columns(self) -> Columns:
        rows = [
            (
                change.choice.effect,
                place_text(change.choice.joints, self.model.robot.joint_names),
                parameter_change.parameter,
                parameter_change.before,
                parameter_change.value,
                *parameter_change.interval,
                parameter_change.unit,
                change.p_value if parameter_change is change.main else None,
                change.evidence,
            )
            for change in self.items
            for parameter_change in (change.main, *change.more)
        ]
        return columns_of(_FRAME_COLUMNS, rows)

    def plot(self) -> Figure:
        """Draw every change, and how much the friction of each joint differs, with their 95 % intervals.

        Raises
        ------
        DynidentError
            Where nothing has changed and no joint's friction is known.
        """
        from dynident.reports.figures.changes import changes_figure
        from dynident.reports.figures.friction_since import friction_figure

        change_figure = changes_figure(self.items) if self.items else None
        figures = [figure for figure in (change_figure, friction_figure(self.diagnosis.friction)) if figure]
        if not figures:
            raise DynidentError(f"there is no change to draw: {self.summary}")
        return figure_of(figures, "what has changed, with intervals of 95 %")

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Change]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int) -> Change: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Change, ...]: ...
    def __getitem__(self, index: int | slice) -> Change | tuple[Change, ...]:
        return self.items[index]

    def __repr__(self) -> str:
        head = f"Changes({len(self.items)}): {self.summary}"
        rows = [row for change in self.items for row in change_rows(change, self.model.robot)]
        text = text_table(head, COLUMNS, rows, len(rows), right_from=3) if rows else head
        friction = [friction_row(change) for change in self.diagnosis.friction]
        return text_table(text, FRICTION_COLUMNS, friction, len(friction), right_from=1) if friction else text

    def _repr_html_(self) -> str:
        rows = [row for item in self.items for row in change_rows(item, self.model.robot)]
        invisible = hidden_text(self.diagnosis, self.model.robot)
        return block(
            paragraph(self.summary, strong=True),
            table(COLUMNS, rows, right_from=3) if rows else "",
            table(FRICTION_COLUMNS, [friction_row(item) for item in self.diagnosis.friction], right_from=1),
            folded("evidence", listed(item.evidence for item in self.items)) if self.items else "",
            paragraph(f"These motions could not have shown: {invisible}.") if invisible else "",
        )


def changes(
    model: Model | Identification,
    *,
    before: SomeRecordings,
    after: SomeRecordings,
    candidates: Sequence[str] | None = None,
    progress: Progress = silent,
) -> Changes:
    """Find what has changed in a robot between two sets of recordings, whose motions may differ.

    Parameters
    ----------
    model : Model
        Of this robot; its effects are identified again on both sets.
    before, after : recordings
    candidates : effect ids, optional
        Only these are tried; the whole catalogue otherwise.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Changes

    Raises
    ------
    DynidentError
        Where one of the two is empty, or the same recording is in both.
    """
    desk_model, earlier, later = as_model(model), as_recordings(before), as_recordings(after)
    check_some(earlier, "before")
    check_some(later, "after")
    diagnosis = examine(
        desk_model.identification,
        later.recordings,
        baseline=earlier.recordings,
        candidates=candidates,
        progress=progress,
    )
    return Changes(desk_model, earlier, later, advise(diagnosis))
