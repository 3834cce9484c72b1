"""A robot over many days."""

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
    """What changed in a robot over many days, and from which on; none where nothing did.

    `series` has every parameter's course; `days` are kept reduced, so that `and_then` reads no recording again.

    `to_frame` has a row a parameter and day: parameter, effect, joint, unit, day, value, and lower and upper, the ends
    of its 95 % interval.
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
        """The same with more days behind these; each costs its own recordings alone."""
        return _followed(self.model, self.measure, self.days, days, progress)

    def _columns(self) -> Columns:
        rows = [
            (one.parameter, one.effect, one.joint, one.unit, day, one.values[k], *one.intervals[k])
            for one in self.series.courses
            for k, day in enumerate(self.series.days)
        ]
        names = ("parameter", "effect", "joint", "unit", "day", "value", "lower", "upper")
        return columns_of(names, rows)

    def plot(self) -> Figure:
        """Draw every parameter that may vary day by day, with its intervals."""
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
            folded("evidence", listed(one.change.evidence for one in self.items)) if rows else "",
            self.plot()._repr_html_(),
        )

    def _rows(self) -> list[tuple[str, ...]]:
        robot, days = self.model.robot, self.series.days
        return [(days[one.since], *row) for one in self.items for row in change_rows(one.change, robot)]


def series(
    model: Model | Identification,
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    *,
    progress: Progress = silent,
) -> FollowedRobot:
    """Say what has changed in a robot over many days, from which day on, and how every parameter went.

    Parameters
    ----------
    model : Model
        Of this robot; it says which effects are there.
    days : recordings of each day
        In their order, the first is what the others are compared with; a mapping names the days, else each is called
        after its first recording. Motions may differ.

    Raises
    ------
    DynidentError
        Where there are fewer than two days, one has no recordings, or the model has effects of single runs.
    """
    from dynident.diagnosis.series import what_may_change

    known = as_model(model)
    named = _named(days)
    warm = bool(named) and all(
        recording.has_temperature for _, one in named for recording in as_recordings(one).recordings
    )
    return _followed(known, what_may_change(known.identification, with_temperature=warm), (), days, progress)


def _followed(
    model: Model,
    measure: Measure,
    before: Sequence[Day],
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
    progress: Progress,
) -> FollowedRobot:
    from dynident.diagnosis.series import free_name, measured
    from dynident.diagnosis.series import series as series_of

    found, named = list(before), _named(days)
    for number_of, (name, one) in enumerate(named):
        recordings = as_recordings(one)
        check_some(recordings, f"days[{number_of}]" if name is None else f"days[{name!r}]")
        told = part(progress, 0.5 * number_of / len(named), 0.5 * (number_of + 1) / len(named))
        called = free_name(recordings.names[0], found) if name is None else name
        found.append(measured(measure, called, recordings.recordings, told))
    return FollowedRobot(model, measure, tuple(found), series_of(measure, found, part(progress, 0.5, 1.0)))


def _named(
    days: Mapping[str, SomeRecordings] | Sequence[SomeRecordings],
) -> list[tuple[str | None, SomeRecordings]]:
    if isinstance(days, Mapping):
        return [(str(name), one) for name, one in days.items()]
    return [(None, one) for one in days]
