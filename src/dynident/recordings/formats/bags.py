"""Bags of ROS 1 and ROS 2 and MCAP files as columns: topics of several rates, joined on the time of one of them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow import batch_from_arrays
from dynident.recordings.file_limits import BLOCK_VALUES, TITLE, check_columns, choose_block_rows
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats.messages import TopicSamples, read_topic_samples
from dynident.recordings.metadata import RecordingError
from dynident.recordings.series_join import JoinedSamples, SampleSeries, TimeJoin

BLOCK_SAMPLES = 8192
_LOOKED_AT = 20_001
_LOOKED_AT_VALUES = 2 * BLOCK_VALUES


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
        self._ahead: Iterator[TopicSamples] | None = None
        self._topics, self._main, self._start, self._steps = self._scan_beginning()
        columns = [f"{topic}/{field}" for topic, fields in self._topics.items() for field in fields]
        super().__init__(["t", *columns])
        self._block_samples = min(BLOCK_SAMPLES, choose_block_rows(len(columns)))

    def _scan_beginning(self) -> tuple[dict[str, tuple[str, ...]], str, float, dict[str, float]]:
        """Read the beginning: topics with their columns, the main topic, the time of the first sample, usual steps."""
        fields: dict[str, dict[str, None]] = {}
        parts: dict[str, list[FloatArray]] = {}
        stream = read_topic_samples(self._path, self._format)
        blocks: list[TopicSamples] = []
        rows = values = 0
        while rows < _LOOKED_AT and values < _LOOKED_AT_VALUES and (samples := next(stream, None)):
            blocks.append(samples)
            rows, values = rows + len(samples.times), values + samples.values.size
            fields.setdefault(samples.topic, {}).update(dict.fromkeys(samples.names))
            check_columns(sum(map(len, fields.values())))
            parts.setdefault(samples.topic, []).append(samples.times)
        times = {topic: np.concatenate(stamps) for topic, stamps in parts.items()}
        self._ahead = chain(blocks, stream)
        if not fields:
            raise RecordingError(
                "The bag contains no joint states. Record messages of the type sensor_msgs/JointState, with position "
                "and effort.",
                title=TITLE,
            )

        def rank_topic(topic: str) -> tuple[bool, int]:
            return any(name.startswith("position") for name in fields[topic]), len(times[topic])

        # The topic with most positions gives the rows: they are then used as they are, not interpolated.
        main = max(fields, key=rank_topic)
        steps = {
            topic: float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0 for topic, stamps in times.items()
        }
        topics = {topic: tuple(names) for topic, names in sorted(fields.items(), key=lambda pair: pair[0] != main)}
        return topics, main, float(min(stamps.min() for stamps in times.values())), steps

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        # Topics have clocks and rates of their own: each is read between its samples at the times of the main one.
        series = {topic: SampleSeries(names, self._steps[topic]) for topic, names in self._topics.items()}
        join = TimeJoin(series, self._main, self._block_samples)
        stream, self._ahead = self._ahead or read_topic_samples(self._path, self._format), None
        for samples in stream:
            if samples.topic not in series:
                continue
            join.add(samples.topic, samples.times - self._start, samples.names, samples.values)
            # Only a sample of the main topic can complete a block of rows.
            if join.is_full and samples.topic == self._main:
                yield from self._make_batch(join.rows(), columns)
        yield from self._make_batch(join.rows(last=True), columns)

    def _make_batch(self, joined: JoinedSamples, columns: list[str]) -> Iterator[pa.RecordBatch]:
        if not len(joined.times):
            return
        values = {"t": joined.times}
        for topic, names in self._topics.items():
            values |= {f"{topic}/{name}": joined.values[topic][:, index] for index, name in enumerate(names)}
        yield batch_from_arrays(values, columns)


def open_bag(path: Path, name: str) -> BagSource:
    """Open a bag or an MCAP file.

    Parameters
    ----------
    path : path
        Where the file lies.
    name : "rosbag", "rosbag2" or "mcap"
        A bag of ROS 1, the data base of a bag of ROS 2, or an MCAP file.

    Returns
    -------
    BagSource
        Its columns, topic by topic.

    Raises
    ------
    RecordingError
        For a bag that cannot be read, or that holds no joint states.
    """
    return BagSource(path, name)
