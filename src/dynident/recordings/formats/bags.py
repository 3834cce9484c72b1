"""Bags of ROS 1 and ROS 2 and MCAP files as columns: topics of several rates joined on the time of one of them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np
import pyarrow as pa

from dynident.arrays import FloatArray
from dynident.recordings.arrow import from_numbers
from dynident.recordings.formats.messages import Sample, samples_of
from dynident.recordings.raw import FileSource
from dynident.recordings.types import RecordingError

BLOCK_SAMPLES = 8192
_LOOKED_AT = 20_001
_LONGEST_STEP = 10.0
"""Usual steps of a topic beyond which it is not read between its samples."""


class BagSource(FileSource):
    """The samples of a bag: `t` in s from its first message, and topic/field_joint.

    The rows are the samples of the topic with most positions a second; others are read between their samples, in a
    straight line.
    """

    sample_rows = 16_000
    """Messages are unpacked one by one: of more rows a look would take seconds."""

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._format = path, name
        # What was looked at is not unpacked again by the first who reads.
        self._ahead: Iterator[Sample] | None = None
        self._topics, self._main, self._start, self._steps = self._look()
        columns = [f"{topic}/{field}" for topic, fields in self._topics.items() for field in fields]
        super().__init__(["t", *columns])

    def _look(self) -> tuple[dict[str, tuple[str, ...]], str, float, dict[str, float]]:
        """Find topics, their columns, the topic that gives the rows, the time of the first sample, and usual steps."""
        fields: dict[str, dict[str, None]] = {}
        times: dict[str, list[float]] = {}
        stream = samples_of(self._path, self._format)
        seen = list(islice(stream, _LOOKED_AT))
        for sample in seen:
            fields.setdefault(sample.topic, {}).update(dict.fromkeys(sample.names))
            times.setdefault(sample.topic, []).append(sample.time)
        self._ahead = chain(seen, stream)
        if not fields:
            raise RecordingError(
                "The bag holds no joint states: messages of sensor_msgs/JointState are needed, with position and "
                "effort.",
                title="Unreadable file",
            )

        def worth(topic: str) -> tuple[bool, int]:
            return any(name.startswith("position") for name in fields[topic]), len(times[topic])

        main = max(fields, key=worth)
        steps = {
            topic: float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0 for topic, stamps in times.items()
        }
        topics = {topic: tuple(names) for topic, names in sorted(fields.items(), key=lambda pair: pair[0] != main)}
        return topics, main, min(min(stamps) for stamps in times.values()), steps

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        series = {topic: _Series(names, self._steps[topic]) for topic, names in self._topics.items()}
        main = series[self._main]
        samples, self._ahead = self._ahead or samples_of(self._path, self._format), None
        for sample in samples:
            one = series.get(sample.topic)
            if one is None:
                continue
            one.add(sample, self._start)
            if len(main) >= BLOCK_SAMPLES and one is main:
                yield from self._joined(series, columns, last=False)
        yield from self._joined(series, columns, last=True)

    def _joined(self, series: dict[str, _Series], columns: list[str], *, last: bool) -> Iterator[pa.RecordBatch]:
        """Give the rows that every topic has reached, and forget them."""
        main = series[self._main]
        until = np.inf if last else min(one.latest for one in series.values() if len(one))
        stalled = len(main) >= 8 * BLOCK_SAMPLES  # a topic that has fallen silent is not waited for
        stamps, rows = main.taken(np.inf if stalled else until)
        if not len(stamps):
            return
        values = {"t": stamps}
        for topic, one in series.items():
            table = rows if one is main else one.at(stamps)
            values.update({f"{topic}/{name}": table[:, index] for index, name in enumerate(one.names)})
            if one is not main:
                one.forget(float(stamps[-1]))
        yield pa.RecordBatch.from_arrays(
            [from_numbers(np.ascontiguousarray(values[name], dtype=np.float64)) for name in columns], names=columns
        )


class _Series:
    """The samples of one topic that are still needed."""

    def __init__(self, names: tuple[str, ...], step: float) -> None:
        self.names, self._step = names, step
        self._places = {name: index for index, name in enumerate(names)}
        self._times: list[float] = []
        self._rows: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._times)

    @property
    def latest(self) -> float:
        return self._times[-1]

    def add(self, sample: Sample, start: float) -> None:
        row = sample.values
        if sample.names != self.names:
            row = np.full(len(self.names), np.nan)
            for name, value in zip(sample.names, sample.values, strict=True):
                place = self._places.get(name)
                if place is not None:
                    row[place] = value
        self._times.append(sample.time - start)
        self._rows.append(row)

    def taken(self, until: float) -> tuple[FloatArray, FloatArray]:
        """Give the samples up to a time, and forget them."""
        count = int(np.searchsorted(np.maximum.accumulate(np.array([-np.inf, *self._times]))[1:], until, side="right"))
        times, rows = np.array(self._times[:count]), self._rows[:count]
        del self._times[:count], self._rows[:count]
        return times, np.array(rows).reshape(len(times), len(self.names))

    def at(self, stamps: FloatArray) -> FloatArray:
        """(m, columns): between the samples in a straight line; NaN where there are none near."""
        result = np.full((len(stamps), len(self.names)), np.nan)
        if not self._times:
            return result
        times, rows = np.array(self._times), np.array(self._rows)
        order = np.argsort(times, kind="stable")
        times, rows = times[order], rows[order]
        after = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
        before = np.maximum(after - 1, 0)
        longest = _LONGEST_STEP * max(self._step, 1e-9)
        near = np.where(
            stamps > times[-1],
            stamps - times[-1],
            np.where(stamps < times[0], times[0] - stamps, times[after] - times[before]),
        )
        for index in range(len(self.names)):
            result[:, index] = np.interp(stamps, times, rows[:, index])
        result[near > longest] = np.nan
        return result

    def forget(self, before: float) -> None:
        """Keep the last sample before a time, and what follows it."""
        count = int(np.searchsorted(np.array(self._times), before, side="right")) - 1
        if count > 0:
            del self._times[:count], self._rows[:count]


def bag_source(path: Path, name: str) -> BagSource:
    """Open a bag of ROS 1 ("rosbag"), the data base of a bag of ROS 2 ("rosbag2"), or an MCAP file ("mcap").

    Raises
    ------
    RecordingError
        For a bag that cannot be read, or that holds no joint states.
    """
    return BagSource(path, name)
