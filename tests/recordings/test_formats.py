"""What robots and their loggers write comes out as the same recording."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.recording_data import JOINTS, motion

from dynident.identification.column_inference.file_inspection import read_sample
from dynident.recordings import (
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    cells_without_numbers,
    import_recording,
)
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


def write_columns(path: Path, names: list[str], values: np.ndarray) -> Path:
    np.savetxt(path, values, "%.9g", ",", header=",".join(names), comments="")
    return path


def _write_and_read(path, text: str):
    path.write_text(text)
    return read_sample(path)


def test_lines_with_labelled_numbers_behind_the_level_of_a_log_are_a_table(tmp_path):
    levels = ["WARN" if row % 50 == 7 else "INFO" for row in range(200)]
    text = "".join(f"{level}: t={0.01 * row:.2f} q1={row} tau1={2 * row}\n" for row, level in enumerate(levels))
    sample = _write_and_read(tmp_path / "run.log", text)
    assert (list(sample.names), len(sample.values)) == (["t", "q1", "tau1"], 200)


def test_rows_of_numbers_below_names_with_values_are_a_table(tmp_path):
    head = "Channel: A\nUnit: rad\nChannel: B\nUnit: Nm\n  t, q1, tau1\n"
    rows = "".join(f"  {0.01 * k:.2f}, {k}, {2 * k}\n" for k in range(200))
    sample = _write_and_read(tmp_path / "run.csv", head + rows)
    assert (list(sample.names), sample.values.shape) == (["t", "q1", "tau1"], (200, 3))


def test_printed_dictionaries_may_have_arrays_over_several_lines_with_whole_numbers(tmp_path):
    rows = np.linspace(-1.0, 1.0, 60)[:, None] * np.arange(12)
    records = [{"t": 0.01 * k, "arm1.q": np.round(row, 5), "tau": np.arange(3.0)} for k, row in enumerate(rows)]
    text = "".join(f"{record}\n" for record in records)
    assert "\n  " in text
    assert "0.," in text
    sample = _write_and_read(tmp_path / "run.txt", text)
    assert len(sample.values) == len(rows)
    np.testing.assert_allclose(sample.values[:, sample.names.index("arm1.q12")], rows[:, 11], atol=1e-5)


def test_a_bracket_within_a_text_opens_no_list(tmp_path):
    text = "".join(
        f"label: {'a[b' if k == 5 else 'ab'}\nt: {0.01 * k:.2f}\nq: [{k},\n  {2 * k}]\n---\n" for k in range(90)
    )
    sample = _write_and_read(tmp_path / "run.txt", text)
    assert len(sample.values) == 90
    assert {"t", "q1", "q2"} <= set(sample.names)


@pytest.mark.parametrize("begin", [0.0, 3599.0], ids=["many", "within"])
def test_minutes_and_seconds_go_on_with_hours(tmp_path, begin):
    t = begin + 0.1 * np.arange(40_000)
    stamps = [(f"{x // 3600:.0f}:{x % 3600 // 60:02.0f}" if x >= 3600 else f"{x // 60:.0f}") for x in t]
    rows = [f"{stamp}:{x % 60:04.1f},{k}\n" for k, (stamp, x) in enumerate(zip(stamps, np.round(t, 1), strict=True))]
    sample = _write_and_read(tmp_path / "run.csv", "time,q1\n" + "".join(rows))
    source = open_source(tmp_path / "run.csv", None)
    read = np.concatenate([np.asarray(batch.column(0)) for batch in source.batches(["time"])])
    assert sample.names[0] == "time"
    np.testing.assert_allclose(read, t, atol=1e-6)


def test_rows_without_names_may_have_a_date_and_a_time_of_day_between_commas(tmp_path):
    text = "".join(f"2025-05-06 10:20:{0.01 * k:06.3f},{k},{2 * k}\n" for k in range(300))
    sample = _write_and_read(tmp_path / "run.csv", text)
    assert sample.values.shape == (300, 3)
    np.testing.assert_allclose(np.diff(sample.values[:, 0]), 0.01, atol=1e-6)


def test_files_are_of_different_clocks_only_if_all_of_their_rows_are(tmp_path):
    t, slow = 0.001 * np.arange(150_000), np.arange(1000.0)
    waves = np.sin(np.outer(t, np.arange(1, 30)))
    robot = write_columns(tmp_path / "robot.csv", ["t", *(f"q{k}" for k in range(1, 30))], np.column_stack([t, waves]))
    files = {
        "temperature.csv": np.column_stack([slow, 20.0 + slow]),
        "later.csv": np.column_stack([t[::10] + 140.0, waves[::10, :1]]),
        "milliseconds.csv": np.column_stack([1e3 * t, waves[:, :1]]),
    }
    for name, values in files.items():
        other = write_columns(tmp_path / name, ["t", "own"], values)
        joined = Path(f"{robot}+{other}")
        if name == "milliseconds.csv":
            with pytest.raises(RecordingError, match="different units"):
                open_source(joined, None)
        else:
            assert "own" in open_source(joined, None).names


def test_columns_beside_names_of_joints_are_read_once(tmp_path, monkeypatch):
    calls = []
    find = cells_without_numbers._find_running_columns
    monkeypatch.setattr(
        cells_without_numbers, "_find_running_columns", lambda *given: calls.append(given) or find(*given)
    )
    rows = "".join(f"{0.01 * (k // 2)},{'ab'[k % 2]},{k % 7},{k % 5},{k % 3}\n" for k in range(400))
    sample = _write_and_read(tmp_path / "run.csv", "t,joint_name,position,velocity,effort\n" + rows)
    assert "position_a" in sample.names
    assert len(calls) <= 2


def test_structures_with_one_label_do_not_take_the_place_of_each_other_or_of_a_variable(tmp_path):
    scipy_io = pytest.importorskip("scipy.io")
    t = 0.01 * np.arange(200)
    values = {name: np.full((200, 1), float(k)) for k, name in enumerate(("q", "wanted", "left", "right", "tau"))}

    def signal(label: str, name: str) -> dict:
        return {"label": label, "values": values[name]}

    scopes = {"A": signal("arm", "left"), "B": signal("arm", "right"), "C": signal("tau", "tau")}
    scipy_io.savemat(tmp_path / "run.mat", {"t": t[:, None], "q": values["q"], "D": signal("q", "wanted"), **scopes})
    source = open_source(tmp_path / "run.mat", None)
    (batch,) = source.batches(list(source.names))
    read = {name: batch.column(k)[0].as_py() for k, name in enumerate(source.names)}
    assert read == {"t": 0.0, "q": 0.0, "D.values": 1.0, "A.values": 2.0, "B.values": 3.0, "tau": 4.0}


def test_names_with_commas_stand_between_the_separators_of_the_rows(tmp_path):
    text = "Time, s;Angle 1, rad;Torque 1, Nm\n" + "".join(f"0,{k:03d};{k},5;-{k},25\n" for k in range(200))
    sample = _write_and_read(tmp_path / "run.csv", text)
    assert list(sample.names) == ["Time, s", "Angle 1, rad", "Torque 1, Nm"]
    np.testing.assert_allclose(sample.values[7], [0.007, 7.5, -7.25])


def test_lines_with_words_before_lists_of_numbers_are_a_table_without_signs_between(tmp_path):
    """Status messages of a controller, which have other words and numbers around the signals."""
    lines = [
        f"BEGIN {k} STATUS TIME {10 * k} MODE joint POS {k}.5 0.25 -1e-3 TRQ {2 * k} 0.0 7 STATE 3 END"
        for k in range(90)
    ]
    sample = _write_and_read(tmp_path / "run.log", "\n".join(lines) + "\n")
    assert len(sample.values) == 90
    row = dict(zip(sample.names, sample.values[4], strict=True))
    assert (row["TIME"], row["POS1"], row["POS3"], row["TRQ1"], row["TRQ3"]) == (40.0, 4.5, -1e-3, 8.0, 7.0)


def test_rows_of_words_and_numbers_between_spaces_stay_a_table(tmp_path):
    text = "t state q1 mode tau1\n" + "".join(f"{0.01 * k:.2f} run {k} auto {2 * k}\n" for k in range(90))
    sample = _write_and_read(tmp_path / "run.txt", text)
    assert {"t", "q1", "tau1"} <= set(sample.names)


@pytest.mark.parametrize(
    ("member", "words"), [("content.xml", "spreadsheet"), ("data/.zgroup", "Zarr"), ("a/zarr.json", "Zarr")]
)
def test_archives_of_other_programs_say_what_to_do(tmp_path, member, words):
    with ZipFile(tmp_path / "run.zip", "w") as archive:
        archive.writestr("mimetype", "application/x")
        archive.writestr(member, "<a>1</a>\n<b>2</b>\n")
    with pytest.raises(RecordingError, match=words):
        open_source(tmp_path / "run.zip", None)


@pytest.mark.parametrize("chunks", [True, False])
def test_messages_that_are_not_those_of_ros_say_how_to_write_them(tmp_path, chunks):
    mcap = pytest.importorskip("mcap.writer")
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = mcap.Writer(file, use_chunking=chunks)
        writer.start()
        schema = writer.register_schema(name="JointStates", encoding="jsonschema", data=b"{}")
        channel = writer.register_channel("/joint_states", "json", schema)
        writer.add_message(channel, log_time=1, data=b'{"q": [0.1]}', publish_time=1)
        writer.finish()
    with pytest.raises(RecordingError, match="mcap cat --json"):
        open_source(tmp_path / "run.mcap", None)


def test_words_in_brackets_are_states_and_no_lists(tmp_path):
    """They have other numbers of words from row to row; names in quotes, or with commas between them, are lists."""
    states = ["[ready]", "[in motion]", "[stage2 reached]"]
    text = "t,state,q1,name\n" + "".join(f"{0.01 * k:.2f},{states[k % 3]},{k},\"['a', 'b']\"\n" for k in range(90))
    sample = _write_and_read(tmp_path / "run.csv", text)
    assert {"t", "q1"} <= set(sample.names)
    np.testing.assert_allclose(sample.values[:, sample.names.index("q1")], np.arange(90))


def test_lists_of_structures_of_joints_are_columns_of_their_parts(tmp_path):
    q, tau = np.random.default_rng(1).normal(size=(2, 60, 3))
    cells = [
        [{"name": f"j{k}", "position": q[row, k], "effort": tau[row, k]} for k in range(3)] if row != 50 else None
        for row in range(60)
    ]
    pq.write_table(pa.table({"t": np.arange(60) * 0.01, "joints": cells}), tmp_path / "run.parquet")
    sample = read_sample(tmp_path / "run.parquet")
    columns = dict(zip(sample.names, sample.values.T, strict=True))
    rows = np.arange(60) != 50
    for k in range(3):
        (position,) = [name for name in columns if "position" in name and name.endswith((f"j{k}", f"position{k + 1}"))]
        np.testing.assert_allclose(columns[position][rows], q[rows, k])
        np.testing.assert_allclose(columns[position.replace("position", "effort")][rows], tau[rows, k])
        assert np.isnan(columns[position][50])
