"""The messages of a bag that hold signals of joints, as samples: a topic, times, names and values."""

from __future__ import annotations

import sqlite3
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from dynident.arrays import FloatArray, IntArray
from dynident.recordings.formats.layouts import Content, Layout, learned
from dynident.recordings.types import RecordingError

_JOINT_STATES = "sensor_msgs/msg/JointState"
_WRENCHES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
_DYNAMIC = "control_msgs/msg/DynamicJointState"
_CONTROLLER = (
    "control_msgs/msg/JointTrajectoryControllerState",
    "control_msgs/msg/JointControllerState",
)
_JOINT_FIELDS = ("position", "velocity", "effort")
_LBR = {
    "measured_joint_position": "position",
    "measured_torque": "torque",
    "commanded_joint_position": "commanded_position",
    "commanded_torque": "commanded_torque",
    "external_torque": "external_torque",
}
_ARRAYS: dict[str, dict[str, str]] = {
    "franka_msgs/msg/FrankaState": {
        "q": "position",
        "dq": "velocity",
        "tau_J": "torque",
        "q_d": "commanded_position",
        "tau_J_d": "commanded_torque",
        "tau_ext_hat_filtered": "external_torque",
    },
    "lbr_fri_msgs/msg/LBRState": _LBR,
    "lbr_fri_idl/msg/LBRState": _LBR,
}
"""Fields with a number a joint, and what they are called here, of messages that name no joints."""
_FRANKA_ROBOT = "franka_msgs/msg/FrankaRobotState"
_FRANKA_PARTS = {"measured_joint_state": "", "desired_joint_state": "commanded_", "tau_ext_hat_filtered": "external_"}
"""Its joint states: their efforts are torques of sensors in the joints, those commanded, and those of contacts."""
KNOWN = (_JOINT_STATES, *_WRENCHES, _DYNAMIC, *_CONTROLLER, *_ARRAYS, _FRANKA_ROBOT)


_TOGETHER = 1024
"""Messages that are unpacked at once, from all topics."""


class Samples(NamedTuple):
    """What messages of one topic say: times (m,) in s, and values (m, c) by field and joint; NaN where one has none."""

    topic: str
    times: FloatArray
    names: tuple[str, ...]
    values: FloatArray


class _Packed(NamedTuple):
    """A message as it is stored; `definition` is the text of its type where the file gives it."""

    topic: str
    type: str
    definition: str
    stamp: int
    data: bytes


def samples_of(path: Path, name: str) -> Iterator[Samples]:
    """Read the messages that hold signals of joints, in the order of the file but for those of other topics.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    read = {"rosbag": _ros1, "rosbag2": _ros2, "mcap": _mcap}[name]
    unpack = _Unpacker(ros1=name == "rosbag")
    undefined: dict[str, None] = {}
    any_read = False
    messages = read(path)
    try:
        while together := list(islice(messages, _TOGETHER)):
            topics: dict[str, list[_Packed]] = {}
            for packed in together:
                if unpack.knows(packed):
                    topics.setdefault(packed.topic, []).append(packed)
                else:
                    undefined[packed.type] = None
            any_read = any_read or bool(topics)
            yield from (samples for one in topics.values() if (samples := unpack(one)).names)
    except (ModuleNotFoundError, RecordingError):
        raise
    except Exception as error:  # the readers' own kinds of error are many, and are all about the file
        raise RecordingError(f"The file cannot be read as {name}: {error}", title="Unreadable file") from error
    if undefined and not any_read:
        raise RecordingError(
            f"The bag does not say how its messages of {', '.join(undefined)} are built: record it as MCAP, or convert "
            "it where that package is installed (ros2 bag convert).",
            title="Unreadable file",
        )


def _plain(type_name: str) -> str:
    """sensor_msgs/JointState, as ROS 1 writes it, is sensor_msgs/msg/JointState."""
    return type_name if "/msg/" in type_name else type_name.replace("/", "/msg/", 1)


def _ros1(path: Path) -> Iterator[_Packed]:
    from rosbags.rosbag1 import Reader

    with Reader(path) as reader:
        wanted = [one for one in reader.connections if _plain(one.msgtype) in KNOWN]
        if not wanted:
            return
        for connection, stamp, data in reader.messages(connections=wanted):
            text = connection.msgdef.data
            yield _Packed(connection.topic, _plain(connection.msgtype), text, stamp, bytes(data))


def _ros2(path: Path) -> Iterator[_Packed]:
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        topics = {key: (name, kind) for key, name, kind in base.execute("SELECT id, name, type FROM topics")}
        tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master")}
        texts: dict[str, str] = {}
        if "message_definitions" in tables:
            rows = base.execute("SELECT topic_type, encoded_message_definition FROM message_definitions")
            texts = dict(rows.fetchall())
        wanted = [key for key, (_, kind) in topics.items() if kind in KNOWN]
        marks = ",".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp"
        for key, stamp, data in base.execute(query, wanted):
            topic, kind = topics[key]
            yield _Packed(topic, kind, texts.get(kind, ""), stamp, data)


def _mcap(path: Path) -> Iterator[_Packed]:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None or not summary.chunk_indexes:
            stored: Iterator[tuple[Any, Any, Any]] = reader.iter_messages()
        else:
            stored = _in_order(file, summary)
        for schema, channel, message in stored:
            if schema is None or _plain(schema.name) not in KNOWN or channel.message_encoding != "cdr":
                continue
            text = schema.data.decode(errors="replace") if schema.encoding == "ros2msg" else ""
            yield _Packed(channel.topic, _plain(schema.name), text, message.log_time, message.data)


def _in_order(file: BinaryIO, summary: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Read the known messages of an MCAP file by their time, chunk by chunk.

    The package's own reader puts every message into a heap, which takes longer than to unpack it, and those of other
    topics, images among them. Here what is of no later time than all later chunks is given, whole chunks mostly.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk, Message
    from mcap.stream_reader import breakup_chunk

    schemas = {key: schema for key, schema in summary.schemas.items() if _plain(schema.name) in KNOWN}
    channels = {key: one for key, one in summary.channels.items() if one.schema_id in schemas}
    chunks = sorted(summary.chunk_indexes, key=lambda one: (one.message_start_time, one.chunk_start_offset))
    # A file without indices of messages does not say which channels are in a chunk.
    chunks = [one for one in chunks if not one.message_index_offsets or channels.keys() & one.message_index_offsets]
    kept: list[Any] = []
    for chunk, following in zip(chunks, [*chunks[1:], None], strict=True):
        file.seek(chunk.chunk_start_offset + 9)  # behind the code and the length of the record
        records = breakup_chunk(Chunk.read(ReadDataStream(file)))
        kept += [one for one in records if isinstance(one, Message) and one.channel_id in channels]
        kept.sort(key=lambda one: one.log_time)
        until = len(kept)
        if following is not None:
            until = bisect_right(kept, following.message_start_time, key=lambda one: one.log_time)
        for message in kept[:until]:
            channel = channels[message.channel_id]
            yield schemas[channel.schema_id], channel, message
        del kept[:until]


class _Unpacker:
    """Unpacks messages, with the types that the file defines beside those that ROS brings."""

    def __init__(self, *, ros1: bool) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        self._unpack = self._store.deserialize_ros1 if ros1 else self._store.deserialize_cdr
        self._pack = self._store.serialize_ros1 if ros1 else self._store.serialize_cdr
        self._layouts: dict[tuple[str, int], Layout | None] = {}

    def knows(self, packed: _Packed) -> bool:
        """Whether ROS or the file says how a message is built."""
        return bool(packed.definition) or packed.type in self._store.types

    def __call__(self, messages: Sequence[_Packed]) -> Samples:
        """Unpack messages of one topic."""
        parts: list[tuple[IntArray, FloatArray, tuple[str, ...], FloatArray]] = []
        sizes = np.array([len(one.data) for one in messages])
        stamps = np.array([one.stamp for one in messages]) * 1e-9
        for size in dict.fromkeys(sizes.tolist()):
            at = np.flatnonzero(sizes == size)
            group = [messages[int(k)] for k in at]
            layout = self._layout_of(group[0])
            if layout is not None:
                alike, times, values = layout.read([one.data for one in group])
                parts.append((at[alike], times, layout.names, values))
                at = at[~alike]
            for k in at.tolist():
                names, numbers, stamp = _read(messages[k].type, self._message(messages[k]))
                time = 0.0 if stamp is None else stamp[0] + stamp[1] * 1e-9
                parts.append((np.array([k]), np.array([time]), tuple(names), np.asarray(numbers, dtype=np.float64)))
        columns = {name: place for place, name in enumerate(dict.fromkeys(name for part in parts for name in part[2]))}
        whole, read = np.full((len(messages), len(columns)), np.nan), np.zeros(len(messages), dtype=bool)
        for at, times, names, values in parts:
            whole[at[:, None], [columns[name] for name in names]] = values
            # A stamp that nobody filled in is 0.
            stamps[at] = np.where(times == 0.0, stamps[at], times)
            read[at] = bool(names)
        return Samples(messages[0].topic.strip("/"), stamps[read], tuple(columns), whole[read])

    def _layout_of(self, packed: _Packed) -> Layout | None:
        """How messages of a topic and of this length are laid out; None where one by one has to be unpacked."""
        key = (packed.topic, len(packed.data))
        if key not in self._layouts:
            message = self._message(packed)
            self._layouts[key] = None
            with suppress(Exception):  # what can be unpacked and not packed again is unpacked one by one
                self._layouts[key] = learned(
                    packed.data,
                    message,
                    lambda kind: self._store.get_msgdef(kind).fields,
                    lambda one: bytes(self._pack(one, packed.type)),
                    lambda one: _read(packed.type, one),
                )
        return self._layouts[key]

    def _message(self, packed: _Packed) -> Any:
        if packed.type not in self._store.types and packed.definition:
            self._learn(packed)
        return self._unpack(packed.data, packed.type)

    def _learn(self, packed: _Packed) -> None:
        from rosbags.typesys import get_types_from_msg

        first, *others = packed.definition.split("=" * 80 + "\n")
        self._store.register(get_types_from_msg(first, packed.type))
        for other in others:
            head, _, text = other.partition("\n")
            name = _plain(head.removeprefix("MSG: ").strip())
            if name not in self._store.types:
                self._store.register(get_types_from_msg(text, name))


def _read(kind: str, message: Any) -> Content:
    """Names and values of a message, and the time that it is stamped with, if it is."""
    names, values = _content(kind, message)
    header = getattr(message, "header", None)
    if header is not None:
        return names, values, (header.stamp.sec, header.stamp.nanosec)
    if hasattr(message, "time_stamp_nano_sec"):
        return names, values, (message.time_stamp_sec, message.time_stamp_nano_sec)
    return names, values, None


def _content(kind: str, message: Any) -> tuple[Sequence[str], Sequence[float] | FloatArray]:
    if kind == _JOINT_STATES:
        return _of_joints(message.name, message)
    if kind in _WRENCHES:
        wrench = getattr(message, "wrench", message)
        parts = [
            (f"{part}_{axis}", getattr(getattr(wrench, part), axis)) for part in ("force", "torque") for axis in "xyz"
        ]
        return [name for name, _ in parts], [float(value) for _, value in parts]
    names: list[str] = []
    values: list[float] = []
    if kind in _ARRAYS:
        # Not every version of a message has all fields.
        numbers = [getattr(message, field, np.empty(0)) for field in _ARRAYS[kind]]
        return _counted(kind, tuple(len(part) for part in numbers)), np.concatenate(numbers)
    if kind == _FRANKA_ROBOT:
        for part, ours in _FRANKA_PARTS.items():
            state = getattr(message, part)
            for field, own in zip(_JOINT_FIELDS, ("position", "velocity", "torque"), strict=True):
                numbers = getattr(state, field)
                names += [f"{ours}{own}_{joint}" for joint, _ in zip(state.name, numbers, strict=False)]
                values += [float(value) for _, value in zip(state.name, numbers, strict=False)]
        return names, values
    if kind == _DYNAMIC:
        for joint, interface in zip(message.joint_names, message.interface_values, strict=True):
            names += [f"{field}_{joint}" for field in interface.interface_names]
            values += [float(value) for value in interface.values]
        return names, values
    joints = getattr(message, "joint_names", [])
    for part, ours in (("actual", ""), ("feedback", ""), ("desired", "commanded_"), ("reference", "commanded_")):
        point = getattr(message, part, None)
        if point is not None and hasattr(point, "positions"):
            for field, own in (("positions", "position"), ("velocities", "velocity"), ("effort", "effort")):
                for joint, value in zip(joints, getattr(point, field, ()), strict=False):
                    names.append(f"{ours}{own}_{joint}")
                    values.append(float(value))
    return names, values


def _of_joints(joints: Any, message: Any) -> tuple[Sequence[str], FloatArray]:
    fields = [(field, values) for field in _JOINT_FIELDS if len(values := getattr(message, field))]
    # A field may be left empty; it is never shorter otherwise.
    counts = tuple((field, min(len(joints), len(values))) for field, values in fields)
    values = [values[:count] for (_, values), (_, count) in zip(fields, counts, strict=True)]
    return _names_of(tuple(joints), counts), np.concatenate(values) if values else np.empty(0)


@lru_cache(maxsize=64)
def _names_of(joints: tuple[str, ...], counts: tuple[tuple[str, int], ...]) -> tuple[str, ...]:
    """One and the same for all messages of a topic, which are many."""
    return tuple(f"{field}_{joint}" for field, count in counts for joint in joints[:count])


@lru_cache(maxsize=64)
def _counted(kind: str, counts: tuple[int, ...]) -> tuple[str, ...]:
    fields = zip(_ARRAYS[kind].values(), counts, strict=True)
    return tuple(f"{field}_{joint + 1}" for field, count in fields for joint in range(count))
