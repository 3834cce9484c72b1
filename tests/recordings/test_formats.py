"""What robots and their loggers write comes out as the same recording."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.recording_data import JOINTS, motion

from dynident.recordings import RecordedJoints, RecordingError, RecordingMetadata, import_recording
from dynident.recordings.formats import open_source
from dynident.recordings.formats.multiple_files import JoinedFiles
from dynident.text_encoding import decode_unmarked_text

KINDS = ("q", "tau")


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    return motion()


def wide(columns, kind) -> np.ndarray:
    return np.column_stack([columns[f"{kind}{joint + 1}"] for joint in range(3)])


def imported(path, columns: dict[str, str] | None = None):
    metadata = RecordingMetadata(columns=columns or {})
    recording, _ = import_recording(path, path.with_suffix(".stored"), RecordedJoints(JOINTS), metadata=metadata)
    return pq.read_table(recording.path)


def assert_same(table, columns, rtol=1e-12):
    for kind in KINDS:
        for index, joint in enumerate(JOINTS):
            expected = columns[f"{kind}{index + 1}"]
            assert np.allclose(table[f"{kind}_{joint}"].to_numpy(), expected, rtol=rtol, atol=1e-9), (kind, joint)


def test_numpy_archives_and_arrays_lie_either_way(tmp_path, columns):
    path = tmp_path / "run.npz"
    np.savez(path, t=columns["t"], q=wide(columns, "q").T, tau=wide(columns, "tau"), gains=np.ones(3))
    assert_same(imported(path), columns)


def test_an_array_of_numpy_has_numbered_columns(tmp_path, columns):
    path = tmp_path / "run.npy"
    np.save(path, np.column_stack([columns["t"], wide(columns, "q"), wide(columns, "tau")]))
    names = (
        {"t": "column1"}
        | {f"q{j}": f"column{j + 1}" for j in (1, 2, 3)}
        | {f"tau{j}": f"column{j + 4}" for j in (1, 2, 3)}
    )
    assert_same(imported(path, names), columns)


def test_mat_files_hold_arrays_or_a_structure_of_them(tmp_path, columns):
    savemat = pytest.importorskip("scipy.io").savemat
    arrays = {"t": columns["t"], "q": wide(columns, "q"), "tau": wide(columns, "tau")}
    savemat(tmp_path / "flat.mat", arrays)
    savemat(tmp_path / "deep.mat", {"data": arrays})
    assert_same(imported(tmp_path / "flat.mat"), columns)
    assert_same(imported(tmp_path / "deep.mat"), columns)


def test_hdf5_is_read_in_groups_and_with_the_axes_of_matlab(tmp_path, columns):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        group = file.create_group("log")
        group["t"], group["q"], group["tau"] = columns["t"], wide(columns, "q"), wide(columns, "tau")
    with h5py.File(tmp_path / "run.mat", "w", userblock_size=512) as file:
        file["t"], file["q"], file["tau"] = columns["t"][None], wide(columns, "q").T, wide(columns, "tau").T
    with (tmp_path / "run.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    assert_same(imported(tmp_path / "run.h5"), columns)
    assert_same(imported(tmp_path / "run.mat"), columns)


def test_lists_in_parquet_are_columns(tmp_path, columns):
    path = tmp_path / "episode.parquet"
    state = pa.array(list(np.column_stack([wide(columns, "q"), wide(columns, "tau")])), pa.list_(pa.float64()))
    pq.write_table(pa.table({"timestamp": columns["t"], "observation.state": state}), path)
    names = {"t": "timestamp"}
    names |= {f"q{j}": f"observation.state{j}" for j in (1, 2, 3)}
    names |= {f"tau{j}": f"observation.state{j + 3}" for j in (1, 2, 3)}
    assert_same(imported(path, names), columns)


def test_a_line_of_units_and_prose_above_the_names_are_no_data(tmp_path, columns):
    path = tmp_path / "run.csv"
    names = ["t", *(f"{kind}{j}" for kind in KINDS for j in (1, 2, 3))]
    rows = [";".join(f"{columns[name][k]:.9f}".replace(".", ",") for name in names) for k in range(len(columns["t"]))]
    head = "\ufeff# recorded on a Monday; by hand\n" + ";".join(names) + "\n[s];[rad];[rad];[rad];[Nm];[Nm];[Nm]\n"
    path.write_text(head + "\n".join(rows), encoding="utf-8")
    assert open_source(path, None).units["tau2"] == "Nm"
    assert_same(imported(path), columns, rtol=1e-6)


def test_a_csv_file_without_names_has_numbered_columns(tmp_path, columns):
    path = tmp_path / "run.csv"
    np.savetxt(path, np.column_stack([columns["t"], wide(columns, "q"), wide(columns, "tau")]))
    assert open_source(path, None).names == [f"column{k}" for k in range(1, 8)]
    with pytest.raises(RecordingError, match="no column t"):
        imported(path)


def ros_messages(columns, store):
    """Joint states at the file's rate, and efforts at half of it under another topic."""
    make_header, make_time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    make_state = store.types["sensor_msgs/msg/JointState"]
    nothing = np.empty(0)
    for k, t in enumerate(columns["t"]):
        stamp = round((1000.0 + t) * 1e9)
        header = make_header(stamp=make_time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
        q, tau = (np.array([columns[f"{kind}{j}"][k] for j in (1, 2, 3)]) for kind in KINDS)
        yield "/joint_states", stamp, make_state(header, list(JOINTS), q, nothing, nothing)
        if k % 2 == 0:
            yield "/efforts", stamp, make_state(header, list(JOINTS), nothing, nothing, tau)


def bag_columns() -> dict[str, str]:
    return {f"q_{j}": f"joint_states/position_{j}" for j in JOINTS} | {
        f"tau_{j}": f"efforts/effort_{j}" for j in JOINTS
    }


def test_a_bag_of_ros_2_joins_topics_on_the_time_of_the_positions(tmp_path, columns):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    with rosbag2.Writer(tmp_path / "bag", version=8) as writer:
        topics = {name: writer.add_connection(name, kind, typestore=store) for name in ("/joint_states", "/efforts")}
        for topic, stamp, message in ros_messages(columns, store):
            writer.write(topics[topic], stamp, store.serialize_cdr(message, kind))
    (path,) = (tmp_path / "bag").glob("*.db3")
    table = imported(path, bag_columns())
    joined = dict(columns)
    for j in (1, 2, 3):
        tau = columns[f"tau{j}"]
        joined[f"tau{j}"] = np.interp(columns["t"], columns["t"][::2], tau[::2])
    m = table.num_rows - 1  # the last effort is that of the row before
    assert_same(table.slice(0, m), {name: values[:m] for name, values in joined.items()}, rtol=1e-5)


def test_mcap_gives_the_same_as_the_data_base(tmp_path, columns):
    mcap = pytest.importorskip("mcap.writer")
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    text, _ = store.generate_msgdef(kind, ros_version=2)
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = mcap.Writer(file)
        writer.start()
        schema = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
        channels = {name: writer.register_channel(name, "cdr", schema) for name in ("/joint_states", "/efforts")}
        for topic, stamp, message in ros_messages(columns, store):
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=stamp, data=data, publish_time=stamp)
        writer.finish()
    table = imported(tmp_path / "run.mcap", bag_columns())
    assert np.allclose(table["q_elbow"].to_numpy(), columns["q2"], atol=1e-6)
    assert np.allclose(table["tau_wrist"].to_numpy()[::2], columns["tau3"][::2], rtol=1e-5, atol=1e-6)


def test_a_bag_without_joint_states_says_so(tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(tmp_path / "bag", version=8) as writer:
        topic = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"]("hello")
        writer.write(topic, 1, store.serialize_cdr(message, "std_msgs/msg/String"))
    (path,) = (tmp_path / "bag").glob("*.db3")
    with pytest.raises(RecordingError, match="no joint states"):
        open_source(path, None)
    path.write_bytes(b"SQLite format 3\0 and then nothing")
    with pytest.raises(RecordingError, match="cannot be read as rosbag2"):
        open_source(path, None)


@pytest.mark.parametrize("names", [("arm.csv", "sensor.csv"), ("a/log.csv", "b/log.csv")])
def test_joined_files_are_named_without_folders_where_that_is_enough(tmp_path, names):
    files = []
    for number, name in enumerate(names, start=1):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"t,q{number}\n" + "".join(f"{0.01 * number * row:.2f},{row}\n" for row in range(50)))
        files.append((path.as_posix(), open_source(path, None)))
    (remark,) = JoinedFiles(files).own_remarks
    shown = names if names[0] == "arm.csv" else [file for file, _ in files]
    assert remark == f"The rows are those of {shown[0]}; {shown[1]} interpolated at its times."


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("time,angle_1 [°],torque_1 [‰]", "cp1252"),
        ("Zeit;Größe 1;Größe 2", "cp1252"),
        ("créée_1;créée_2", "cp1252"),
        ("m²·kg;m²·kg", "cp1252"),
        ("“q1” [°];‘tau1’ – Œuvre [€]", "cp1252"),
        ("Момент1, Н·м;Угол1, °", "cp1251"),
        ("время (s);угол 1 [deg]", "cp1251"),
        ("時間(s),J1位置(deg),J1トルク(Nm)", "cp932"),
        ("J1角度[°],J2角度[°]", "cp932"),
        ("时间(秒),关节1角度(度),关节1力矩(牛·米)", "gb18030"),
        ("시간,각도1(도),전류1", "cp949"),
    ],
)
def test_text_of_older_code_pages_is_decoded_by_its_words(text, encoding):
    assert decode_unmarked_text(text.encode(encoding)) == (text, encoding)
