"""`dynident.changes` and `dynident.series`: their results as tables and plots.

What counts as a change is decided in diagnosis/.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, overload

from dynident.api.argument_checks import check_arguments
from dynident.api.figure import Figure, join_figures
from dynident.api.model import Model
from dynident.api.model_diagnosis import check_not_empty, list_candidates
from dynident.api.model_identification import as_model
from dynident.api.named_tables import Framed, PlainText, Table, build_columns
from dynident.api.recording_collection import Recordings, SomeRecordings, as_recordings
from dynident.diagnosis import Change, Diagnosis, DiagnosisChoices, diagnose
from dynident.errors import DynidentError
from dynident.file_output import check_folder_exists, write_atomically
from dynident.identification import Identification
from dynident.presentation.diagnosis_tables import EVIDENCE, build_diagnosis_tables, build_series_tables
from dynident.presentation.labels import format_hidden_effects, format_joints
from dynident.presentation.tables import ReportedTable
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.text_and_html_tables import join_html, render_details, render_list, render_paragraph

if TYPE_CHECKING:
    from dynident.diagnosis.monitoring import Day, Measure, Series, SeriesChange


@dataclass(frozen=True, eq=False)
class FollowedRobot(Sequence["SeriesChange"], Framed):
    """The changes of a robot over many days, each with the day it began on; empty where nothing changed.

    `to_frame` has a row for each parameter and day: parameter, effect, joint, unit, day, value, and lower and upper,
    the ends of its 95 % interval.

    Parameters
    ----------
    model : Model
        The model whose parameters are followed.
    measure : Measure
        Which parameters may vary.
    days : tuple of Day
        The data of each day, reduced, so that `and_then` reads no recording again.
    series : Series
        The values of every parameter, and the changes.
    """

    model: Model
    measure: Measure
    days: tuple[Day, ...]
    series: Series

    @property
    def summary(self) -> PlainText:
        """What has changed, in a few sentences."""
        return PlainText(self.series.summary)

    @property
    def items(self) -> tuple[SeriesChange, ...]:
        """The changes, each with its day, values, intervals and evidence."""
        return self.series.changes

    def and_then(
        self, days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings], progress: Progress = ignore_progress
    ) -> FollowedRobot:
        """Return the series with more days behind these; only their recordings are read.

        Parameters
        ----------
        days : recordings of each day
            As `series` takes them.
        progress : function, optional
            Called with the fraction done and a message.

        Returns
        -------
        FollowedRobot
            The changes over all days, the earlier and the new ones.
        """
        return _extend_series(self.model, self.measure, self.days, days, progress)

    def _columns(self) -> Table:
        rows = [
            (track.parameter, track.effect, track.joint, track.unit, day, track.values[k], *track.intervals[k])
            for track in self.series.courses
            for k, day in enumerate(self.series.days)
        ]
        names = ("parameter", "effect", "joint", "unit", "day", "value", "lower", "upper")
        return build_columns(names, rows)

    def plot(self) -> Figure:
        """Draw every parameter that may vary, day by day, with its intervals.

        Returns
        -------
        Figure
            The values of each parameter, day by day.
        """
        from dynident.reports.figures.changes import draw_parameter_tracks

        return join_figures([draw_parameter_tracks(self.series)], f"{len(self.days)} days of {self.model.robot.name}")

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[SeriesChange]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int) -> SeriesChange: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[SeriesChange, ...]: ...
    def __getitem__(self, index: int | slice) -> SeriesChange | tuple[SeriesChange, ...]:
        return self.items[index]

    def __repr__(self) -> str:
        head = f"FollowedRobot({len(self.days)} days): {self.summary}"
        table = self._table()
        return table.to_text(head) if table is not None else head

    def _repr_html_(self) -> str:
        table = self._table()
        return join_html(
            render_paragraph(self.summary, strong=True),
            table.to_html() if table is not None else "",
            render_details("evidence", render_list(item.change.evidence for item in self.items)) if self.items else "",
            self.plot()._repr_html_(),
        )

    def _table(self) -> ReportedTable | None:
        table = next(build_series_tables(self.series, self.model.robot.joint_names), None)
        return None if table is None else table.drop_columns(*EVIDENCE[1:])


@check_arguments
def series(
    model: Model | Identification,
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    *,
    keep: str | Path | None = None,
    progress: Progress = ignore_progress,
) -> FollowedRobot:
    """Find what has changed in a robot over many days, since which day, and the values of every parameter.

    Parameters
    ----------
    model : Model
        Of this robot, with its effects.
    days : recordings of each day
        In their order; the other days are compared with the first one. A mapping gives the days names; otherwise each
        has the name of its first recording. Motions may differ.
    keep : path, optional
        File that stores the days: it is read first, so that days whose files it knows are not computed again, and new
        days are added.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    FollowedRobot
        The changes, each with the day on which it began, and the values of every parameter.

    Raises
    ------
    DynidentError
        If there are fewer than two days, if a day has no recordings, or if the model has effects of single runs.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1], effects=["default", "stribeck@elbow"])
    >>> robot_over_days = dy.series(model, {"monday": runs[0], "tuesday": runs[1]})
    >>> len(robot_over_days)  # nothing has changed
    0
    """
    # Imported here: `import dynident` must not load what only a series over days needs.
    from dynident.diagnosis.monitoring import build_measure, days_to_bytes, load_days

    desk_model, file = as_model(model), None if keep is None else Path(keep)
    if file is not None:
        check_folder_exists(file)
    if file is not None and file.exists():
        measure, stored_days = load_days(desk_model.identification, file.read_bytes())
        followed = _extend_series(desk_model, measure, stored_days, days, progress, leave_out_known=True)
        write_atomically(file, days_to_bytes(measure, followed.days))
        return followed
    named_days = _name_days(days)
    # Temperature can explain differences between days only where every day recorded it.
    has_temperatures = bool(named_days) and all(
        recording.has_temperature
        for _, day_recordings in named_days
        for recording in as_recordings(day_recordings).recordings
    )
    measure = build_measure(desk_model.identification, with_temperature=has_temperatures)
    followed = _extend_series(desk_model, measure, (), days, progress)
    if file is not None:
        write_atomically(file, days_to_bytes(measure, followed.days))
    return followed


def _extend_series(
    model: Model,
    measure: Measure,
    before: Sequence[Day],
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    progress: Progress,
    *,
    leave_out_known: bool = False,
) -> FollowedRobot:
    from dynident.diagnosis.monitoring import find_free_name, reduce_day
    from dynident.diagnosis.monitoring import monitor_days as series_of

    known_days, named_days = list(before), _name_days(days)
    for index, (name, day_recordings) in enumerate(named_days):
        recordings = as_recordings(day_recordings)
        check_not_empty(recordings, f"days[{index}]" if name is None else f"days[{name!r}]")
        # A day is known by the content of its files, whatever they are called now.
        digests = [item.source.sha256 if item.source is not None else "" for item in recordings]
        source = "+".join(digests) if all(digests) else ""
        if leave_out_known and source and any(day.source == source for day in before):
            continue
        # Reading and reducing the days counts as half of the work, the comparison as the other half.
        day_progress = scale_progress(progress, 0.5 * index / len(named_days), 0.5 * (index + 1) / len(named_days))
        # Recordings of two days often have the same name, and days are told apart by name in tables and figures.
        day_name = find_free_name(recordings.names[0], known_days) if name is None else name
        known_days.append(reduce_day(measure, day_name, recordings.recordings, day_progress, source))
    return FollowedRobot(
        model, measure, tuple(known_days), series_of(measure, known_days, scale_progress(progress, 0.5, 1.0))
    )


def _name_days(
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
) -> list[tuple[str | None, SomeRecordings]]:
    if isinstance(days, Mapping):
        return [(str(name), day_recordings) for name, day_recordings in days.items()]
    return [(None, day_recordings) for day_recordings in days]


_CHANGE_FRAME_COLUMNS = (
    "effect", "joint", "parameter", "before", "difference", "interval_low", "interval_high", "unit", "p_value",
    "evidence",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Changes(Sequence[Change], Framed):
    """What differs between two sets of recordings of one robot; empty where nothing does.

    `to_frame` has a row for each number that differs. Its columns are effect (its id), joint and parameter; before
    (missing where the model does not have the parameter), difference, interval_low and interval_high (of the
    difference, 95 %) and unit (of all four); p_value (of the change, in the row of its main number; missing in its
    other rows), and evidence.

    Parameters
    ----------
    model : Model
        The model whose effects were identified on both sets.
    before : Recordings
        The earlier set.
    after : Recordings
        The second set.
    diagnosis : Diagnosis
        It also says what the model lacks before and after.
    """

    model: Model
    before: Recordings
    after: Recordings
    diagnosis: Diagnosis

    @property
    def summary(self) -> PlainText:
        """What has changed, in a few sentences."""
        return PlainText(self.diagnosis.summary)

    @property
    def items(self) -> tuple[Change, ...]:
        """The changes, each with its values, intervals and evidence."""
        return self.diagnosis.changes or ()

    def _columns(self) -> Table:
        rows = [
            (
                change.choice.effect,
                change.carrier or format_joints(change.choice.joints, self.model.robot.joint_names),
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

        Returns
        -------
        Figure
            Changes, and below them the differences of friction.

        Raises
        ------
        DynidentError
            Where nothing has changed and no joint's friction is known.
        """
        from dynident.reports.figures.changes import draw_changes, draw_friction_differences

        # Friction is drawn even where no effect has changed: small differences of it are worth seeing.
        change_figure = draw_changes(self.items) if self.items else None
        figures = [figure for figure in (change_figure, draw_friction_differences(self.diagnosis.friction)) if figure]
        if not figures:
            raise DynidentError(f"nothing to draw, because there are no changes: {self.summary}")
        return join_figures(figures, "changes, with 95 % intervals")

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
        for table in self._tables():
            head = table.to_text(head)
        return head

    def _repr_html_(self) -> str:
        invisible = format_hidden_effects(self.diagnosis, self.model.robot)
        return join_html(
            render_paragraph(self.summary, strong=True),
            *(table.to_html() for table in self._tables()),
            render_details("evidence", render_list(item.evidence for item in self.items)) if self.items else "",
            render_paragraph(f"These motions cannot show: {invisible}.") if invisible else "",
        )

    def _tables(self) -> list[ReportedTable]:
        robot = self.model.robot
        units = [joint.effort_unit for joint in robot.joints]
        tables = build_diagnosis_tables(self.diagnosis, robot.joint_names, units)
        return [table.drop_columns(*EVIDENCE[1:]) for table in tables if table.name in ("changes", "friction")]


@check_arguments
def changes(
    model: Model | Identification,
    *,
    before: SomeRecordings,
    after: SomeRecordings,
    candidates: str | Sequence[str] | None = None,
    progress: Progress = ignore_progress,
) -> Changes:
    """Find what has changed in a robot between two sets of recordings, whose motions may differ.

    Parameters
    ----------
    model : Model
        A model of this robot; its effects are identified again on both sets.
    before : recordings
        The earlier set.
    after : recordings
        The later set, which is compared with the earlier one.
    candidates : effect ids, optional
        Only these are tried, at least one; the whole catalogue where left out.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Changes
        The changes, with 95 % intervals.

    Raises
    ------
    DynidentError
        If one of the two sets is empty, or if the same recording is in both.

    Examples
    --------
    >>> model = dy.identify(robot, runs[:1], effects=["default", "stribeck@elbow"])
    >>> changes = dy.changes(model, before=runs[0], after=runs[1])
    >>> len(changes)  # both were recorded of the same arm in the same state
    0
    """
    desk_model, earlier, later = as_model(model), as_recordings(before), as_recordings(after)
    check_not_empty(earlier, "before")
    check_not_empty(later, "after")
    diagnosis = diagnose(
        desk_model.identification,
        later.recordings,
        DiagnosisChoices(list_candidates(candidates)),
        baseline=earlier.recordings,
        progress=progress,
    )
    return Changes(desk_model, earlier, later, diagnosis)
