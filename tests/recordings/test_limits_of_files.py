"""What is decided about a file before it is read leaves honest files as they are."""

from __future__ import annotations

import sqlite3
import time
import zlib

import numpy as np
import pytest
from support.file_mutations import JOINT_STATE, mcap_file, rosbag2_file, written

from dynident.recordings import RecordingError, file_size_limits
from dynident.recordings.formats import open_source


def columns_of(path):
    source = open_source(path, None)
    return dict(zip(source.names, np.concatenate(list(source.blocks())).T, strict=True))


def test_a_file_of_many_columns_is_read_in_blocks_of_few_rows(tmp_path):
    path = tmp_path / "run.npy"
    values = np.arange(5000 * 3000, dtype=np.float32).reshape(5000, 3000)
    np.save(path, values)
    blocks = list(open_source(path, None).blocks())
    assert max(map(len, blocks)) == file_size_limits.choose_block_rows(3000) < 2000
    assert np.array_equal(np.concatenate(blocks), values)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("lying", [False, True])
def test_arrays_are_read_in_parts_whichever_way_they_lie(tmp_path, order, lying):
    values = np.random.default_rng(1).normal(size=(3, 70_000) if lying else (70_000, 3))
    np.save(tmp_path / "run.npy", np.asarray(values, order=order))
    found = np.column_stack(list(columns_of(tmp_path / "run.npy").values()))
    assert np.array_equal(found, values.T if lying else values)


@pytest.mark.parametrize("lying", [False, True])
def test_an_array_of_more_signals_than_the_fewest_rows_has_its_rows_along_its_longer_side(tmp_path, lying):
    values = np.random.default_rng(1).normal(size=(1000, 15))
    np.save(tmp_path / "run.npy", values.T if lying else values)
    found = columns_of(tmp_path / "run.npy")
    assert list(found) == [f"column{k}" for k in range(1, 16)]
    assert np.array_equal(np.column_stack(list(found.values())), values)


def test_a_mat_file_of_more_compressed_variables_than_files_can_be_open(tmp_path):
    savemat = pytest.importorskip("scipy.io").savemat
    savemat(tmp_path / "run.mat", {f"x{k}": np.arange(20.0) + k for k in range(1500)}, do_compression=True)
    found = columns_of(tmp_path / "run.mat")
    assert len(found) == 1500
    assert found["x7"][3] == 10.0


def test_texts_in_a_table_of_hdf5_are_left_out_and_its_numbers_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        rows = np.zeros(50, dtype=[("word", h5py.string_dtype()), ("q", "f8"), ("three", "i4", 3)])
        rows["word"], rows["q"], rows["three"] = "text", np.arange(50), np.arange(150).reshape(50, 3)
        file["table"] = rows
    found = columns_of(tmp_path / "run.h5")
    assert list(found) == ["q", "three1", "three2", "three3"]
    assert found["q"][7] == 7.0
    assert found["three3"][1] == 5.0


def test_filters_that_come_with_hdf5_are_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    values = np.random.default_rng(1).normal(size=(100_000, 3))
    ways = {
        "a": {"chunks": (512, 3), "compression": "gzip", "shuffle": True, "fletcher32": True},
        "b": {"chunks": (512, 3), "compression": "lzf"},
        "c": {"chunks": (512, 3)},
        "d": {"chunks": (100_000, 3), "compression": "gzip"},  # larger than what is unpacked unseen
    }
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name, way in ways.items():
            file.create_dataset(name, data=values, **way)
        assert file["d"].id.get_chunk_info(0).size > 2**18
    found = columns_of(tmp_path / "run.h5")
    for name in ways:
        assert np.array_equal(np.column_stack([found[f"{name}{k}"] for k in (1, 2, 3)]), values), name


def test_chunks_that_unpack_to_more_than_they_hold_are_refused_for_every_filter(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        item = file.create_dataset("q", (60_000,), "f8", chunks=(60_000,), compression="gzip", fletcher32=True)
        item.id.write_direct_chunk((0,), zlib.compress(bytes(400 * 2**20), 9) + bytes(4))
    with pytest.raises(RecordingError, match="q has a chunk that unpacks to more than the 480000 bytes"):
        open_source(tmp_path / "run.h5", None)


def test_messages_of_a_data_base_come_by_their_time_without_an_index(tmp_path):
    pytest.importorskip("rosbags")
    path = tmp_path / "run.db3"
    path.write_bytes(rosbag2_file())
    wanted = columns_of(path)
    base = sqlite3.connect(path)
    base.execute("DROP INDEX timestamp_idx")
    rows = base.execute("SELECT topic_id, timestamp, data FROM messages").fetchall()
    base.execute("DELETE FROM messages")
    shuffled = [rows[k] for k in np.random.default_rng(2).permutation(len(rows))]
    base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", shuffled)
    base.commit()
    base.close()
    found = columns_of(path)
    assert found.keys() == wanted.keys()
    assert all(np.array_equal(found[name], values) for name, values in wanted.items())


def test_a_data_base_whose_pages_lead_round_in_a_circle_is_refused(tmp_path):
    """A page of the table's tree is named by all of its parents' places: rows come again and again."""
    path = tmp_path / "run.db3"
    base = sqlite3.connect(path)
    base.execute("PRAGMA page_size=512")
    base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
    base.execute("INSERT INTO topics VALUES (1, '/joint_states', ?)", (JOINT_STATE,))
    base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    base.executemany("INSERT INTO messages VALUES (?, 1, ?, zeroblob(100))", [(k, k) for k in range(200)])
    (root,) = base.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    base.commit()
    base.close()
    content = bytearray(path.read_bytes())
    page = 512 * (root - 1)
    assert content[page] == 5  # a page of places of other pages
    number = int.from_bytes(content[page + 3 : page + 5], "big")
    places = [int.from_bytes(content[page + 12 + 2 * k : page + 14 + 2 * k], "big") for k in range(number)]
    first = content[page + places[0] : page + places[0] + 4]
    for place in places:
        content[page + place : page + place + 4] = first
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="is damaged"):
        open_source(path, None)


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_mcap_gives_the_same_with_and_without_chunks_and_index(tmp_path, compression):
    pytest.importorskip("mcap")
    (tmp_path / "run.mcap").write_bytes(mcap_file(compression))
    (tmp_path / "plain.mcap").write_bytes(mcap_file(chunked=False))
    wanted, found = columns_of(tmp_path / "plain.mcap"), columns_of(tmp_path / "run.mcap")
    assert len(wanted["t"]) == 300
    assert found.keys() == wanted.keys()
    assert all(np.array_equal(found[name], values) for name, values in wanted.items())


def test_a_header_of_very_many_columns_is_counted_at_once(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(",".join(f"{k:x}" for k in range(13_000)) + "\n")
    begin = time.perf_counter()
    with pytest.raises(RecordingError, match="columns; at most 10000"):
        open_source(path, None)
    assert time.perf_counter() - begin < 10.0


def test_a_file_that_does_not_fit_on_the_disk_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    content = written(lambda path: np.savez_compressed(path, q=np.zeros(1_000_000)), "run.npz")
    (tmp_path / "run.npz").write_bytes(content)
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 2**20}))
    with pytest.raises(RecordingError, match="unpacks to 8 MB, but only 1 MB are free"):
        open_source(tmp_path / "run.npz", None)


def test_a_column_whose_name_is_no_unicode_is_refused(tmp_path):
    np.save(tmp_path / "run.npy", np.zeros(20, dtype=[("t", "f8"), ("q1", "f8")]))
    content = (tmp_path / "run.npy").read_bytes()
    (tmp_path / "run.npy").write_bytes(
        content.replace(b"('q1', '<f8')]", b"('\\ud800', '<f8')]").replace(b"    \n", b"\n", 1)
    )
    with pytest.raises(RecordingError, match="is not valid Unicode text"):
        open_source(tmp_path / "run.npy", None)
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        h5py.h5d.create(file.id, b"q\xff", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((20,)))
        file["t"] = np.zeros(20)
    with pytest.raises(RecordingError, match="is not UTF-8 text"):
        open_source(tmp_path / "run.h5", None)
