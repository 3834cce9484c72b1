"""The changes of a robot over many days."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

from dynident.desk.diagnosing import check_some
from dynident.desk.figure import Figure, figure_of
from dynident.desk.frames import Columns, Framed, columns_of
from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import SomeRecordings, as_recordings
from dynident.desk.texts import text_table
from dynident.html import block, folded, listed, paragraph, table
from dynident.identification import Identification
from dynident.progress import Progress, part, silent
from dynident.reports.change_rows import COLUMNS, change_rows

if TYPE_CHECKING:
    from dynident.diagnosis.series import Day, Measure, Series, SeriesChange


_COLUMNS = ("from", *COLUMNS)


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
        self, days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings], progress: Progress = silent
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
        return _followed(self.model, self.measure, self.days, days, progress)

    def _columns(self) -> Columns:
        rows = [
            (track.parameter, track.effect, track.joint, track.unit, day, track.values[k], *track.intervals[k])
            for track in self.series.courses
            for k, day in enumerate(self.series.days)
        ]
        names = ("parameter", "effect", "joint", "unit", "day", "value", "lower", "upper")
        return columns_of(names, rows)

    def plot(self) -> Figure:
        """Draw every parameter that may vary, day by day, with its intervals."""
        from dynident.reports.figures.courses import courses_figure

        return figure_of([courses_figure(self.series)], f"{len(self.days)} days of {self.model.robot.name}")

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
        return text_table(head, _COLUMNS, rows, len(rows), right_from=4) if rows else head

    def _repr_html_(self) -> str:
        rows = self._rows()
        return block(
            paragraph(self.summary, strong=True),
            table(_COLUMNS, rows, right_from=4) if rows else "",
            folded("evidence", listed(item.change.evidence for item in self.items)) if rows else "",
            self.plot()._repr_html_(),
        )

    def _rows(self) -> list[tuple[str, ...]]:
        robot, days = self.model.robot, self.series.days
        return [(days[item.since], *row) for item in self.items for row in change_rows(item.change, robot)]


def series(
    model: Model | Identification,
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    *,
    progress: Progress = silent,
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
    from dynident.diagnosis.series import what_may_change

    desk_model = as_model(model)
    named_days = _named(days)
    # Temperature can explain differences between days only where every day recorded it.
    has_temperatures = bool(named_days) and all(
        recording.has_temperature
        for _, day_recordings in named_days
        for recording in as_recordings(day_recordings).recordings
    )
    return _followed(
        desk_model, what_may_change(desk_model.identification, with_temperature=has_temperatures), (), days, progress
    )


def _followed(
    model: Model,
    measure: Measure,
    before: Sequence[Day],
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    progress: Progress,
) -> FollowedRobot:
    from dynident.diagnosis.series import free_name, measured
    from dynident.diagnosis.series import series as series_of

    known_days, named_days = list(before), _named(days)
    for index, (name, day_recordings) in enumerate(named_days):
        recordings = as_recordings(day_recordings)
        check_some(recordings, f"days[{index}]" if name is None else f"days[{name!r}]")
        # Reading and reducing the days counts as half of the work, the comparison as the other half.
        day_progress = part(progress, 0.5 * index / len(named_days), 0.5 * (index + 1) / len(named_days))
        day_name = free_name(recordings.names[0], known_days) if name is None else name
        known_days.append(measured(measure, day_name, recordings.recordings, day_progress))
    return FollowedRobot(model, measure, tuple(known_days), series_of(measure, known_days, part(progress, 0.5, 1.0)))


def _named(
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
) -> list[tuple[str | None, SomeRecordings]]:
    if isinstance(days, Mapping):
        return [(str(name), day_recordings) for name, day_recordings in days.items()]
    return [(None, day_recordings) for day_recordings in days]
