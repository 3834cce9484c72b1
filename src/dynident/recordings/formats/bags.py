"""Bags of ROS 1 and ROS 2 and MCAP files as columns: topics of several rates joined on the time of one of them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa

from dynident.arrays import FloatArray
from dynident.recordings.arrow import from_numbers
from dynident.recordings.file_limits import BLOCK_VALUES, TITLE, check_columns, rows_of_block
from dynident.recordings.formats.messages import Samples, samples_of
from dynident.recordings.raw import FileSource
from dynident.recordings.types import RecordingError

BLOCK_SAMPLES = 8192
_LOOKED_AT = 20_001
_LOOKED_AT_VALUES = 2 * BLOCK_VALUES
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
        self._ahead: Iterator[Samples] | None = None
        self._topics, self._main, self._start, self._steps = self._look()
        columns = [f"{topic}/{field}" for topic, fields in self._topics.items() for field in fields]
        super().__init__(["t", *columns])
        self._block_samples = min(BLOCK_SAMPLES, rows_of_block(len(columns)))

    def _look(self) -> tuple[dict[str, tuple[str, ...]], str, float, dict[str, float]]:
        """Find topics, their columns, the topic that gives the rows, the time of the first sample, and usual steps."""
        fields: dict[str, dict[str, None]] = {}
        parts: dict[str, list[FloatArray]] = {}
        stream = samples_of(self._path, self._format)
        seen: list[Samples] = []
        rows = values = 0
        while rows < _LOOKED_AT and values < _LOOKED_AT_VALUES and (samples := next(stream, None)):
            seen.append(samples)
            rows, values = rows + len(samples.times), values + samples.values.size
            fields.setdefault(samples.topic, {}).update(dict.fromkeys(samples.names))
            check_columns(sum(map(len, fields.values())))
            parts.setdefault(samples.topic, []).append(samples.times)
        times = {topic: np.concatenate(stamps) for topic, stamps in parts.items()}
        self._ahead = chain(seen, stream)
        if not fields:
            raise RecordingError(
                "The bag holds no joint states: messages of sensor_msgs/JointState are needed, with position and "
                "effort.",
                title=TITLE,
            )

        def worth(topic: str) -> tuple[bool, int]:
            return any(name.startswith("position") for name in fields[topic]), len(times[topic])

        main = max(fields, key=worth)
        steps = {
            topic: float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0 for topic, stamps in times.items()
        }
        topics = {topic: tuple(names) for topic, names in sorted(fields.items(), key=lambda pair: pair[0] != main)}
        return topics, main, float(min(stamps.min() for stamps in times.values())), steps

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        series = {topic: _Series(names, self._steps[topic]) for topic, names in self._topics.items()}
        main = series[self._main]
        stream, self._ahead = self._ahead or samples_of(self._path, self._format), None
        for samples in stream:
            one = series.get(samples.topic)
            if one is None:
                continue
            one.add(samples, self._start)
            if len(main) >= self._block_samples and one is main:
                yield from self._joined(series, columns, last=False)
        yield from self._joined(series, columns, last=True)

    def _joined(self, series: dict[str, _Series], columns: list[str], *, last: bool) -> Iterator[pa.RecordBatch]:
        """Give the rows that every topic has reached, and forget them."""
        main = series[self._main]
        until = np.inf if last else min(one.latest for one in series.values() if len(one))
        stalled = len(main) >= 8 * self._block_samples  # a topic that has fallen silent is not waited for
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
        self._times, self._rows = np.empty(0), np.empty((0, len(names)))

    def __len__(self) -> int:
        return len(self._times)

    @property
    def latest(self) -> float:
        return float(self._times[-1])

    def add(self, samples: Samples, start: float) -> None:
        rows = np.full((len(samples.times), len(self.names)), np.nan)
        known = [index for index, name in enumerate(samples.names) if name in self._places]
        rows[:, [self._places[samples.names[index]] for index in known]] = samples.values[:, known]
        self._times = np.concatenate([self._times, samples.times - start])
        self._rows = np.concatenate([self._rows, rows])

    def taken(self, until: float) -> tuple[FloatArray, FloatArray]:
        """Give the samples up to a time, and forget them."""
        count = int(np.searchsorted(np.maximum.accumulate(self._times), until, side="right"))
        times, rows = self._times[:count], self._rows[:count]
        self._times, self._rows = self._times[count:], self._rows[count:]
        return times, rows

    def at(self, stamps: FloatArray) -> FloatArray:
        """(m, columns): between the samples in a straight line; NaN where there are none near."""
        result = np.full((len(stamps), len(self.names)), np.nan)
        if not len(self):
            return result
        order = np.argsort(self._times, kind="stable")
        times, rows = self._times[order], self._rows[order]
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
        count = int(np.searchsorted(self._times, before, side="right")) - 1
        if count > 0:
            self._times, self._rows = self._times[count:], self._rows[count:]


def bag_source(path: Path, name: str) -> BagSource:
    """Open a bag of ROS 1 ("rosbag"), the data base of a bag of ROS 2 ("rosbag2"), or an MCAP file ("mcap").

    Raises
    ------
    RecordingError
        For a bag that cannot be read, or that holds no joint states.
    """
    return BagSource(path, name)
