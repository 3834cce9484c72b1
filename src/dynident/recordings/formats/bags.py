"""ROS 1, ROS 2 and MCAP bags as columns: which topics are read, and how their rates are joined.

Messages that hold signals of joints become samples: a topic, times, names and values. The package that reads messages
turns the definition of a type into a program, with arrays of fixed length written out. Here nothing but names of fields
and their types gets there, and no type that holds itself or is larger than a message.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray, IntArray
from dynident.recordings.arrow_tables import batch_from_arrays
from dynident.recordings.file_size_limits import (
    BLOCK_VALUES,
    DEEPEST,
    LARGEST_DEFINITION,
    LARGEST_MESSAGE,
    MOST_COLUMNS,
    TITLE,
    check_columns,
    choose_block_rows,
    make_damaged_error,
)
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats.packed_messages import (
    ARRAYS,
    DYNAMIC_STATES,
    FRANKA_ROBOT,
    JOINT_STATES,
    WRENCHES,
    Content,
    Layout,
    PackedMessage,
    learn_layout,
    normalise_type,
)
from dynident.recordings.formats.ros_bags import read_mcap_messages, read_ros1_messages, read_ros2_messages
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.sample_series_join import JoinedSamples, SampleSeries, TimeJoin

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

_BETWEEN = "=" * 80 + "\n"


def parse_definition(definition: str, type_name: str, known: Typesdict) -> Typesdict:
    """Parse the types of a definition that are not known yet.

    Parameters
    ----------
    definition : str
        That of a type, with those of its parts behind it.
    type_name : str
        Name of the type.
    known : mapping
        Types that need no definition.

    Returns
    -------
    mapping
        Of the names of types to their fields.

    Raises
    ------
    ValueError
        The text is too long, or a type holds itself or more numbers than a recording has columns.
    """
    from rosbags.typesys import get_types_from_msg

    if len(definition) > LARGEST_DEFINITION:
        raise ValueError(f"the definition of {type_name} has {len(definition)} characters")
    first, *others = definition.split(_BETWEEN)
    parsed = get_types_from_msg(first, type_name)
    for other in others:
        head, _, text = other.partition("\n")
        parsed |= get_types_from_msg(text, normalise_type(head.removeprefix("MSG: ").strip()))
    # Constants say nothing of how a message is stored.
    types: Typesdict = {name: ([], fields) for name, (_, fields) in parsed.items() if name not in known}
    _TypeSizes({**known, **types}).measure_type(type_name, ())
    return types


class _TypeSizes:
    """Counts the numbers in a message of a type, without those in sequences."""

    def __init__(self, types: Typesdict) -> None:
        self._types = types
        self._sizes: dict[str, int] = {}

    def measure_type(self, name: str, within: tuple[str, ...]) -> int:
        if name in within or len(within) > DEEPEST:
            raise ValueError(f"the type {name} contains itself, or nests types more than {DEEPEST} levels deep")
        if name not in self._types:
            raise ValueError(f"the type {name} is not defined")
        if name not in self._sizes:
            fields = self._types[name][1]
            # An array of an empty type costs, too: every type counts as one number at least.
            size = max(1, sum(self._measure_field(kind, (*within, name)) for _, kind in fields))
            if size > MOST_COLUMNS:
                raise ValueError(f"the type {name} contains {size} numbers; at most {MOST_COLUMNS} are read")
            self._sizes[name] = size
        return self._sizes[name]

    def _measure_field(self, kind: Any, within: tuple[str, ...]) -> int:
        node, inner = kind
        if node.name == "BASE":
            return 1
        if node.name == "NAME":
            return self.measure_type(inner, within)
        element = self._measure_field(inner[0], within)
        return element * max(int(inner[1]), 1) if node.name == "ARRAY" else element


_JOINT_FIELDS = ("position", "velocity", "effort")
_FRANKA_PARTS = {"measured_joint_state": "", "desired_joint_state": "commanded_", "tau_ext_hat_filtered": "external_"}
"""Its joint states: their efforts are torques of sensors in the joints, those commanded, and those of contacts."""

_TOGETHER = 1024
_TOGETHER_BYTES = 2**24
"""Messages that are unpacked at once, from all topics, and their bytes."""
_MOST_LAYOUTS, _MOST_NAMES = 256, 1000
"""Topics and lengths of messages whose layout is learned, and names in one: to learn takes the square of them. Files
with more are made to fill a memory, or are read one message after another."""


class TopicSamples(NamedTuple):
    """Samples of one topic: times (m,) in s, and values (m, c) by field and joint; NaN if a message lacks one."""

    topic: str
    times: FloatArray
    names: tuple[str, ...]
    values: FloatArray


def read_topic_samples(path: Path, name: str) -> Iterator[TopicSamples]:
    """Read the messages that hold signals of joints, topic by topic in parts, otherwise in the order of the file.

    Parameters
    ----------
    path : path
        Where the file lies.
    name : "rosbag", "rosbag2" or "mcap"
        Format of the file.

    Yields
    ------
    TopicSamples
        Samples of one topic.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    read_messages = {"rosbag": read_ros1_messages, "rosbag2": read_ros2_messages, "mcap": read_mcap_messages}[name]
    unpack = _MessageUnpacker(ros1=name == "rosbag")
    undefined: dict[str, None] = {}
    any_read = False
    try:
        for together in _group_messages(read_messages(path)):
            topics: dict[str, list[PackedMessage]] = {}
            for packed in together:
                if unpack.is_known(packed):
                    topics.setdefault(packed.topic, []).append(packed)
                else:
                    undefined[packed.type] = None
            any_read = any_read or bool(topics)
            yield from (samples for topic_messages in topics.values() if (samples := unpack(topic_messages)).names)
    except (ModuleNotFoundError, RecordingError):
        raise
    except Exception as error:  # the readers' own kinds of error are many, and are all about the file
        raise make_damaged_error(name, error) from error
    if undefined and not any_read:
        raise RecordingError(
            f"The bag does not contain the definition of its messages of the type {', '.join(undefined)}. Record it "
            "as MCAP, or convert it (ros2 bag convert) on a computer on which the package of that type is installed.",
            title=TITLE,
        )


def _group_messages(messages: Iterator[PackedMessage]) -> Iterator[list[PackedMessage]]:
    """Yield the messages in lists, none of many messages or many bytes."""
    part: list[PackedMessage] = []
    size = 0
    for message in messages:
        part.append(message)
        length = len(message.data)
        if length > LARGEST_MESSAGE:
            raise RecordingError(
                f"A message of {message.topic} has {length} bytes; messages with joint signals have at most "
                f"{LARGEST_MESSAGE >> 20} MB.",
                pointer=message.topic,
                title=TITLE,
            )
        size += length
        if len(part) == _TOGETHER or size > _TOGETHER_BYTES:
            yield part
            part, size = [], 0
    if part:
        yield part


class _MessageUnpacker:
    """Unpacks messages, with the types that the file defines and those that ROS brings."""

    def __init__(self, *, ros1: bool) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        self._unpack = self._store.deserialize_ros1 if ros1 else self._store.deserialize_cdr
        self._pack = self._store.serialize_ros1 if ros1 else self._store.serialize_cdr
        self._layouts: dict[tuple[str, int], Layout | None] = {}

    def is_known(self, packed: PackedMessage) -> bool:
        """Return whether ROS or the file defines the type of a message."""
        return bool(packed.definition) or packed.type in self._store.types

    def __call__(self, messages: Sequence[PackedMessage]) -> TopicSamples:
        """Unpack messages of one topic."""
        parts: list[tuple[IntArray, FloatArray, tuple[str, ...], FloatArray]] = []
        sizes = np.array([len(message.data) for message in messages])
        stamps = np.array([message.stamp for message in messages]) * 1e-9
        # Messages of one length are mostly laid out alike, and read at once.
        for size in dict.fromkeys(sizes.tolist()):
            at = np.flatnonzero(sizes == size)
            group = [messages[int(k)] for k in at]
            layout = self._find_layout(group[0])
            if layout is not None:
                alike, times, values = layout.read([message.data for message in group])
                parts.append((at[alike], times, layout.names, values))
                at = at[~alike]
            for k in at.tolist():
                names, numbers, stamp = _read_message(messages[k].type, self._unpack_message(messages[k]))
                time = 0.0 if stamp is None else stamp[0] + stamp[1] * 1e-9
                parts.append((np.array([k]), np.array([time]), tuple(names), np.asarray(numbers, dtype=np.float64)))
        columns = {name: place for place, name in enumerate(dict.fromkeys(name for part in parts for name in part[2]))}
        check_columns(len(columns))
        whole, has_values = np.full((len(messages), len(columns)), np.nan), np.zeros(len(messages), dtype=bool)
        for at, times, names, values in parts:
            whole[at[:, None], [columns[name] for name in names]] = values
            # A stamp that nobody filled in is 0.
            stamps[at] = np.where(times == 0.0, stamps[at], times)
            has_values[at] = bool(names)
        return TopicSamples(messages[0].topic.strip("/"), stamps[has_values], tuple(columns), whole[has_values])

    def _find_layout(self, packed: PackedMessage) -> Layout | None:
        """Return the layout of messages of this topic and length; None if each has to be unpacked."""
        key = (packed.topic, len(packed.data))
        if key not in self._layouts:
            message = self._unpack_message(packed)
            # Stays so if nothing can be learned: no message of this kind is tried twice.
            self._layouts[key] = None
            if len(self._layouts) > _MOST_LAYOUTS or len(_read_message(packed.type, message)[0]) > _MOST_NAMES:
                return None
            with suppress(Exception):  # what can be unpacked and not packed again is unpacked one by one
                self._layouts[key] = learn_layout(
                    packed.data,
                    message,
                    lambda kind: self._store.get_msgdef(kind).fields,
                    lambda content: bytes(self._pack(content, packed.type)),
                    lambda content: _read_message(packed.type, content),
                )
        return self._layouts[key]

    def _unpack_message(self, packed: PackedMessage) -> Any:
        if packed.type not in self._store.types and packed.definition:
            self._store.register(parse_definition(packed.definition, packed.type, self._store.fielddefs))
        return self._unpack(packed.data, packed.type)


def _read_message(kind: str, message: Any) -> Content:
    """Return names and values of a message, and its stamp, if it has one."""
    names, values = _read_content(kind, message)
    header = getattr(message, "header", None)
    if header is not None:
        return names, values, (header.stamp.sec, header.stamp.nanosec)
    # KUKA's LBR messages carry their time in two fields of their own.
    if hasattr(message, "time_stamp_nano_sec"):
        return names, values, (message.time_stamp_sec, message.time_stamp_nano_sec)
    return names, values, None


def _read_content(kind: str, message: Any) -> tuple[Sequence[str], Sequence[float] | FloatArray]:
    if kind == JOINT_STATES:
        return _read_joint_state(message.name, message)
    if kind in ARRAYS:
        # Not every version of a message has all fields.
        numbers = [getattr(message, field, np.empty(0)) for field in ARRAYS[kind]]
        return _name_counted_columns(kind, tuple(len(part) for part in numbers)), np.concatenate(numbers)
    if kind == DYNAMIC_STATES:
        return _read_interface_values(message)
    if kind in WRENCHES:
        named_values = _list_wrench(message)
    elif kind == FRANKA_ROBOT:
        named_values = _list_franka_state(message)
    else:
        named_values = _list_trajectory_points(message)
    columns = [(name, float(value)) for name, value in named_values]
    return [name for name, _ in columns], [value for _, value in columns]


def _list_wrench(message: Any) -> Iterator[tuple[str, Any]]:
    wrench = getattr(message, "wrench", message)
    for part in ("force", "torque"):
        for axis in "xyz":
            yield f"{part}_{axis}", getattr(getattr(wrench, part), axis)


def _list_franka_state(message: Any) -> Iterator[tuple[str, Any]]:
    for part, ours in _FRANKA_PARTS.items():
        state = getattr(message, part)
        for field, own in zip(_JOINT_FIELDS, ("position", "velocity", "torque"), strict=True):
            for joint, value in zip(state.name, getattr(state, field), strict=False):
                yield f"{ours}{own}_{joint}", value


def _read_interface_values(message: Any) -> tuple[list[str], list[float]]:
    names: list[str] = []
    values: list[float] = []
    for joint, interface in zip(message.joint_names, message.interface_values, strict=True):
        names += [f"{field}_{joint}" for field in interface.interface_names]
        values += [float(value) for value in interface.values]
    return names, values


def _list_trajectory_points(message: Any) -> Iterator[tuple[str, Any]]:
    joints = getattr(message, "joint_names", [])
    for part, ours in (("actual", ""), ("feedback", ""), ("desired", "commanded_"), ("reference", "commanded_")):
        point = getattr(message, part, None)
        if point is not None and hasattr(point, "positions"):
            for field, own in (("positions", "position"), ("velocities", "velocity"), ("effort", "effort")):
                for joint, value in zip(joints, getattr(point, field, ()), strict=False):
                    yield f"{ours}{own}_{joint}", value


def _read_joint_state(joints: Any, message: Any) -> tuple[Sequence[str], FloatArray]:
    fields = [(field, values) for field in _JOINT_FIELDS if len(values := getattr(message, field))]
    # A field may be left empty; it is never shorter otherwise.
    counts = tuple((field, min(len(joints), len(values))) for field, values in fields)
    values = [values[:count] for (_, values), (_, count) in zip(fields, counts, strict=True)]
    return _name_joint_columns(tuple(joints), counts), np.concatenate(values) if values else np.empty(0)


@lru_cache(maxsize=64)
def _name_joint_columns(joints: tuple[str, ...], counts: tuple[tuple[str, int], ...]) -> tuple[str, ...]:
    """Return the column names; the same object for all messages of a topic, which are many."""
    return tuple(f"{field}_{joint}" for field, count in counts for joint in joints[:count])


@lru_cache(maxsize=64)
def _name_counted_columns(kind: str, counts: tuple[int, ...]) -> tuple[str, ...]:
    fields = zip(ARRAYS[kind].values(), counts, strict=True)
    return tuple(f"{field}_{joint + 1}" for field, count in fields for joint in range(count))


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
