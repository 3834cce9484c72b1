"""Messages are read many at once, and give what each gives by itself; those of an MCAP file come by their time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynident.recordings.formats import bags
from dynident.recordings.formats.bags import TopicSamples, read_topic_samples
from dynident.recordings.recording_metadata import RecordingError

pytest.importorskip("rosbags")

ARM, HAND = ["shoulder", "elbow", "wrist"], ["left finger", "right finger"]
JOINT, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
NOTHING = np.empty(0)


def stores() -> tuple[Any, Any]:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)


def spoken(store: Any, count: int = 400) -> Iterator[tuple[str, str, int, Any]]:
    """An arm and a hand that share a topic, one of them without stamps now and then; a force; other lengths."""
    rng = np.random.default_rng(7)
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]

    def header(stamp: int, frame: str) -> Any:
        parts = {"stamp": types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)}
        sequence = {"seq": int(stamp // 10**6)} if any(n == "seq" for n, _ in store.fielddefs[HEADER][1]) else {}
        return types[HEADER](**sequence, **parts, frame_id=frame)

    for k in range(count):
        stamp = 5 * 10**9 + k * 10**7
        frame = "base" if k % 50 else "another base"
        names = ARM if k % 7 else ARM[::-1]
        yield "/joints", JOINT, stamp, types[JOINT](header(stamp, frame), names, *rng.normal(size=(3, 3)))
        if k % 3 == 0:
            fingers = types[JOINT](header(stamp if k % 2 else 0, ""), HAND, rng.normal(size=2), NOTHING, NOTHING)
            yield "/joints", JOINT, stamp + 10**6, fingers
        force = types["geometry_msgs/msg/Wrench"](vector(*rng.normal(size=3)), vector(*np.zeros(3)))
        yield "/force", WRENCH, stamp, types[WRENCH](header(stamp, "tool"), force)


HEADER = "std_msgs/msg/Header"


def as_mcap(path: Path, order: Any = None) -> Path:
    writer_module = pytest.importorskip("mcap.writer")
    _, store = stores()
    with path.open("wb") as file:
        writer = writer_module.Writer(file, chunk_size=4096)
        writer.start()
        channels = {}
        every = list(spoken(store))
        for k in range(len(every)) if order is None else order(len(every)):
            topic, kind, stamp, message = every[k]
            if topic not in channels:
                text, _ = store.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=stamp, data=data, publish_time=stamp)
        writer.finish()
    return path


def as_ros1(path: Path) -> Path:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    store, _ = stores()
    with rosbag1.Writer(path) as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in (("/joints", JOINT), ("/force", WRENCH))
        }
        for topic, kind, stamp, message in spoken(store):
            writer.write(topics[topic], stamp, store.serialize_ros1(message, kind))
    return path


def whole(path: Path, name: str) -> dict[str, dict[str, np.ndarray]]:
    """Of every topic the time and the columns of all samples."""
    found: dict[str, list[TopicSamples]] = {}
    for samples in read_topic_samples(path, name):
        found.setdefault(samples.topic, []).append(samples)
    result = {}
    for topic, parts in found.items():
        names = sorted({name for one in parts for name in one.names})
        columns = {"t": np.concatenate([one.times for one in parts])}
        for name in names:
            columns[name] = np.concatenate(
                [
                    one.values[:, one.names.index(name)] if name in one.names else np.full(len(one.times), np.nan)
                    for one in parts
                ]
            )
        result[topic] = columns
    return result


@pytest.mark.parametrize(("name", "write"), [("mcap", as_mcap), ("rosbag", as_ros1)])
def test_messages_that_are_read_many_at_once_say_what_each_says_by_itself(tmp_path, monkeypatch, name, write):
    path = write(tmp_path / "run")
    unpacked = []
    by_package = bags._MessageUnpacker._unpack_message
    monkeypatch.setattr(
        bags._MessageUnpacker, "_unpack_message", lambda self, one: unpacked.append(one) or by_package(self, one)
    )
    many = whole(path, name)
    few = len(unpacked)
    unpacked.clear()
    monkeypatch.setattr(bags, "learn_layout", lambda *_: None)
    each = whole(path, name)
    assert few < 0.2 * len(unpacked)  # the package unpacks what has another layout, and one of each
    assert many.keys() == each.keys() == {"joints", "force"}
    for topic, columns in each.items():
        assert many[topic].keys() == columns.keys()
        for column, values in columns.items():
            assert np.array_equal(many[topic][column], values, equal_nan=True), (topic, column)
    joints = many["joints"]
    fingers = np.isfinite(joints["position_left finger"])
    assert fingers.sum() == 134
    assert np.isnan(joints["effort_elbow"][fingers]).all()
    assert joints["t"].min() > 4.9  # a stamp that is not filled in is not 1970


def test_messages_that_cannot_be_packed_again_are_read_one_by_one(tmp_path, monkeypatch):
    path = as_mcap(tmp_path / "run")
    known = whole(path, "mcap")

    def fails(*_: object) -> None:
        raise KeyError("a type that the package does not write")

    monkeypatch.setattr(bags, "learn_layout", fails)
    found = whole(path, "mcap")
    assert np.array_equal(found["force"]["force_x"], known["force"]["force_x"])


def test_an_mcap_file_that_is_out_of_order_is_read_by_its_time(tmp_path):
    def mixed(count: int) -> list[int]:
        # Halves of the recording by turns, so that all chunks overlap.
        return [k for pair in zip(range(count // 2), range(count // 2, 2 * (count // 2)), strict=True) for k in pair]

    straight, other = as_mcap(tmp_path / "a.mcap"), as_mcap(tmp_path / "b.mcap", mixed)
    one, two = whole(straight, "mcap"), whole(other, "mcap")
    assert (np.diff(two["force"]["t"]) > 0).all()
    assert np.array_equal(one["force"]["force_x"][: len(two["force"]["t"])], two["force"]["force_x"])


@pytest.mark.parametrize("kind", ["geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"])
def test_a_bag_without_signals_of_joints_says_what_it_holds(tmp_path: Path, kind: str) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    store, _ = stores()
    axes = 4 if kind.endswith("Quaternion") else 3
    with rosbag1.Writer(tmp_path / "run.bag") as writer:
        topic = writer.add_connection("/controller/state", kind, typestore=store)
        for k in range(5):
            message = store.types[kind](*np.arange(float(axes)))
            writer.write(topic, 10**9 + k, store.serialize_ros1(message, kind))
    with pytest.raises(RecordingError, match=f"no joint states, but /controller/state .{kind}.") as refused:
        list(read_topic_samples(tmp_path / "run.bag", "rosbag"))
    assert "rostopic echo -b run.bag -p TOPIC" in str(refused.value)
