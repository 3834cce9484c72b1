"""The changes of a robot between two sets of recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

from dynident.advice import AdvisedDiagnosis, advise
from dynident.desk.diagnosing import check_not_empty
from dynident.desk.figure import Figure, join_figures
from dynident.desk.frames import Columns, Framed, build_columns
from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import Recordings, SomeRecordings, as_recordings
from dynident.desk.texts import format_text_table
from dynident.diagnosis import Change, examine
from dynident.errors import DynidentError
from dynident.html import join_html, render_details, render_list, render_paragraph, render_table
from dynident.identification import Identification
from dynident.progress import Progress, ignore_progress
from dynident.reports.change_rows import CHANGE_COLUMNS, FRICTION_COLUMNS, format_change, format_friction_difference
from dynident.reports.words import format_hidden_effects, format_joints

_CHANGE_FRAME_COLUMNS = (
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
                format_joints(change.choice.joints, self.model.robot.joint_names),
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
        return build_columns(_CHANGE_FRAME_COLUMNS, rows)

    def plot(self) -> Figure:
        """Draw every change, and how much the friction of each joint differs, with their 95 % intervals.

        Raises
        ------
        DynidentError
            Where nothing has changed and no joint's friction is known.
        """
        from dynident.reports.figures.changes import draw_changes
        from dynident.reports.figures.friction_since import draw_friction_differences

        change_figure = draw_changes(self.items) if self.items else None
        figures = [figure for figure in (change_figure, draw_friction_differences(self.diagnosis.friction)) if figure]
        if not figures:
            raise DynidentError(f"there is no change to draw: {self.summary}")
        return join_figures(figures, "what has changed, with intervals of 95 %")

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
        rows = [row for change in self.items for row in format_change(change, self.model.robot)]
        text = format_text_table(head, CHANGE_COLUMNS, rows, len(rows), right_from=3) if rows else head
        friction = [format_friction_difference(change) for change in self.diagnosis.friction]
        return format_text_table(text, FRICTION_COLUMNS, friction, len(friction), right_from=1) if friction else text

    def _repr_html_(self) -> str:
        rows = [row for item in self.items for row in format_change(item, self.model.robot)]
        invisible = format_hidden_effects(self.diagnosis, self.model.robot)
        return join_html(
            render_paragraph(self.summary, strong=True),
            render_table(CHANGE_COLUMNS, rows, right_from=3) if rows else "",
            render_table(
                FRICTION_COLUMNS, [format_friction_difference(item) for item in self.diagnosis.friction], right_from=1
            ),
            render_details("evidence", render_list(item.evidence for item in self.items)) if self.items else "",
            render_paragraph(f"These motions could not have shown: {invisible}.") if invisible else "",
        )


def changes(
    model: Model | Identification,
    *,
    before: SomeRecordings,
    after: SomeRecordings,
    candidates: Sequence[str] | None = None,
    progress: Progress = ignore_progress,
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
    check_not_empty(earlier, "before")
    check_not_empty(later, "after")
    diagnosis = examine(
        desk_model.identification,
        later.recordings,
        baseline=earlier.recordings,
        candidates=candidates,
        progress=progress,
    )
    return Changes(desk_model, earlier, later, advise(diagnosis))
