"""The changes of a robot over many days."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

from dynident.desk.diagnosing import check_not_empty
from dynident.desk.figure import Figure, join_figures
from dynident.desk.frames import Columns, Framed, build_columns
from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import SomeRecordings, as_recordings
from dynident.desk.texts import format_text_table
from dynident.html import join_html, render_details, render_list, render_paragraph, render_table
from dynident.identification import Identification
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.reports.change_rows import CHANGE_COLUMNS, format_change

if TYPE_CHECKING:
    from dynident.diagnosis.series import Day, Measure, Series, SeriesChange


_SERIES_COLUMNS = ("from", *CHANGE_COLUMNS)


@dataclass(frozen=True, eq=False)
class FollowedRobot(Sequence["SeriesChange"], Framed):
    """The changes of a robot over many days, each with the day it began on; empty where nothing changed.

    `to_frame` has a row for each parameter and day: parameter, effect, joint, unit, day, value, and lower and upper,
    the ends of its 95 % interval.

    Attributes
    ----------
    model : Model
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
    def summary(self) -> str:
        """What has changed, in a few sentences."""
        return self.series.summary

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
        """
        return _extend_series(self.model, self.measure, self.days, days, progress)

    def _columns(self) -> Columns:
        rows = [
            (track.parameter, track.effect, track.joint, track.unit, day, track.values[k], *track.intervals[k])
            for track in self.series.courses
            for k, day in enumerate(self.series.days)
        ]
        names = ("parameter", "effect", "joint", "unit", "day", "value", "lower", "upper")
        return build_columns(names, rows)

    def plot(self) -> Figure:
        """Draw every parameter that may vary, day by day, with its intervals."""
        from dynident.reports.figures.courses import draw_parameter_tracks

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
        rows = self._rows()
        return format_text_table(head, _SERIES_COLUMNS, rows, len(rows), right_from=4) if rows else head

    def _repr_html_(self) -> str:
        rows = self._rows()
        return join_html(
            render_paragraph(self.summary, strong=True),
            render_table(_SERIES_COLUMNS, rows, right_from=4) if rows else "",
            render_details("evidence", render_list(item.change.evidence for item in self.items)) if rows else "",
            self.plot()._repr_html_(),
        )

    def _rows(self) -> list[tuple[str, ...]]:
        robot, days = self.model.robot, self.series.days
        return [(days[item.since], *row) for item in self.items for row in format_change(item.change, robot)]


def series(
    model: Model | Identification,
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    *,
    progress: Progress = ignore_progress,
) -> FollowedRobot:
    """Find what has changed in a robot over many days, from which day on, and the values of every parameter.

    Parameters
    ----------
    model : Model
        Of this robot, with its effects.
    days : recordings of each day
        In their order; the first is what the others are compared with. A mapping names the days, else each has the name
        of its first recording. Motions may differ.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    FollowedRobot

    Raises
    ------
    DynidentError
        Where there are fewer than two days, one has no recordings, or the model has effects of single runs.
    """
    from dynident.diagnosis.series import build_measure

    desk_model = as_model(model)
    named_days = _name_days(days)
    # Temperature can explain differences between days only where every day recorded it.
    has_temperatures = bool(named_days) and all(
        recording.has_temperature
        for _, day_recordings in named_days
        for recording in as_recordings(day_recordings).recordings
    )
    return _extend_series(
        desk_model, build_measure(desk_model.identification, with_temperature=has_temperatures), (), days, progress
    )


def _extend_series(
    model: Model,
    measure: Measure,
    before: Sequence[Day],
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    progress: Progress,
) -> FollowedRobot:
    from dynident.diagnosis.series import find_free_name, reduce_day
    from dynident.diagnosis.series import monitor_days as series_of

    known_days, named_days = list(before), _name_days(days)
    for index, (name, day_recordings) in enumerate(named_days):
        recordings = as_recordings(day_recordings)
        check_not_empty(recordings, f"days[{index}]" if name is None else f"days[{name!r}]")
        # Reading and reducing the days counts as half of the work, the comparison as the other half.
        day_progress = scale_progress(progress, 0.5 * index / len(named_days), 0.5 * (index + 1) / len(named_days))
        day_name = find_free_name(recordings.names[0], known_days) if name is None else name
        known_days.append(reduce_day(measure, day_name, recordings.recordings, day_progress))
    return FollowedRobot(
        model, measure, tuple(known_days), series_of(measure, known_days, scale_progress(progress, 0.5, 1.0))
    )


def _name_days(
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
) -> list[tuple[str | None, SomeRecordings]]:
    if isinstance(days, Mapping):
        return [(str(name), day_recordings) for name, day_recordings in days.items()]
    return [(None, day_recordings) for day_recordings in days]
