"""Arrays of MAT and NumPy files are found where SciPy and NumPy find them, and read without the rest of the file."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import tracemalloc
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from dynident.identification.column_inference.file_inspection import read_sample
from dynident.recordings import RecordingError, file_size_limits
from dynident.recordings.formats import array_files, hdf5, open_source
from dynident.recordings.formats.matlab import describe_object
from dynident.recordings.formats.open_any_format import format_of

scipy_io = pytest.importorskip("scipy.io")

KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
ROWS = 50


def columns_of(path: Path) -> dict[str, np.ndarray]:
    source = open_source(path, None)
    return dict(zip(source.names, np.concatenate(list(source.blocks())).T, strict=True))


def numbers(kind: str, shape: tuple[int, ...], seed: int) -> np.ndarray:
    return (np.random.default_rng(seed).normal(size=shape) * 50 + 60).clip(0, 120).astype(kind)


@settings(max_examples=40, deadline=None)
@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=4),
    compressed=st.booleans(),
    structured=st.booleans(),
    lying=st.booleans(),
    seed=st.integers(0, 100),
)
def test_mat_files_say_the_same_as_to_scipy(tmp_path_factory, kinds, compressed, structured, lying, seed):
    path = tmp_path_factory.mktemp("mat") / "run.mat"
    arrays = {"t": np.arange(ROWS) * 0.01, "note": "hello", "scale": 3.0, "cell": np.array([[1, "a"]], dtype=object)}
    for index, kind in enumerate(kinds):
        shape = (3, ROWS) if lying else (ROWS, 3)
        arrays[f"{'abcd'[index]}_values"] = numbers(kind, shape, seed + index)
    scipy_io.savemat(path, {"log": arrays} if structured else arrays, do_compression=compressed)
    assert format_of(path) == "mat"
    found = columns_of(path)
    known = scipy_io.loadmat(path, squeeze_me=True)
    known = {name: known["log"][name].item() for name in arrays} if structured else known
    assert np.array_equal(found.pop("t"), known["t"])
    for index in range(len(kinds)):
        name = f"{'abcd'[index]}_values"
        wide = known[name].T if lying else known[name]
        for column in range(3):
            assert np.array_equal(found.pop(f"{name}{column + 1}"), wide[:, column].astype(float)), name
    assert not found


@settings(max_examples=60, deadline=None)
@given(cut=st.floats(0, 1), changed=st.floats(0, 1), value=st.integers(0, 255), compressed=st.booleans())
def test_a_damaged_mat_file_is_unreadable_and_nothing_else(tmp_path_factory, cut, changed, value, compressed):
    path = tmp_path_factory.mktemp("mat") / "run.mat"
    content = {"log": {"t": np.arange(ROWS) * 0.01, "q": numbers("f8", (ROWS, 3), 1)}}
    scipy_io.savemat(path, content, do_compression=compressed)
    data = bytearray(path.read_bytes())
    data[min(int(changed * len(data)), len(data) - 1)] = value
    path.write_bytes(bytes(data[: max(200, int(cut * len(data)))]))
    with suppress(RecordingError):
        columns_of(path)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archives_of_numpy_say_the_same_as_to_numpy(tmp_path, save):
    path = tmp_path / "run.npz"
    arrays = {"t": np.arange(ROWS) * 0.01, "q": numbers("f4", (ROWS, 3), 1), "tau": numbers("i2", (3, ROWS), 2)}
    save(path, **arrays, name=np.array(["a", "b", "c", "d"]), fortran=np.asfortranarray(numbers("f8", (ROWS, 2), 3)))
    found = columns_of(path)
    known = np.load(path)
    for name, wide in (("q", known["q"]), ("tau", known["tau"].T), ("fortran", known["fortran"])):
        for column in range(wide.shape[1]):
            assert np.array_equal(found[f"{name}{column + 1}"], wide[:, column].astype(float))


def test_records_of_numpy_are_columns(tmp_path):
    path = tmp_path / "run.npy"
    records = np.zeros(ROWS, dtype=[("t", "f8"), ("q", "f4", (3,)), ("label", "U4")])
    records["t"], records["q"] = np.arange(ROWS), numbers("f4", (ROWS, 3), 1)
    np.save(path, records)
    found = columns_of(path)
    assert set(found) == {"t", "q1", "q2", "q3"}
    assert np.array_equal(found["q2"], records["q"][:, 1])


def test_an_array_whose_end_is_missing_is_told(tmp_path):
    path = tmp_path / "run.npy"
    np.save(path, np.zeros((ROWS, 4)))
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(RecordingError, match="last numbers are missing"):
        open_source(path, None)


@pytest.mark.parametrize("write", ["npz", "packed npz", "mat", "packed mat"])
def test_a_large_file_is_never_whole_in_memory(tmp_path, write):
    rows = 300_000
    arrays = {"t": np.arange(rows) * 0.001, "q": np.random.default_rng(1).normal(size=(rows, 6))}
    packed = write.startswith("packed")
    path = tmp_path / f"run.{write.split()[-1]}"
    if path.suffix == ".mat":
        scipy_io.savemat(path, {"log": arrays}, do_compression=packed)
    else:
        (np.savez_compressed if packed else np.savez)(path, **arrays)
    size = sum(one.nbytes for one in arrays.values())
    del arrays
    open_source(path, None)  # what is imported at first does not count
    tracemalloc.start()
    try:
        last = None
        for block in open_source(path, None).blocks():
            last = block
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert last is not None
    assert most < 0.75 * size


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_what_unpacks_to_a_full_disk_is_refused(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"run.{suffix}"
    arrays = {"t": np.zeros(1_000_000)}
    if suffix == "mat":
        scipy_io.savemat(path, arrays, do_compression=True)
    else:
        np.savez_compressed(path, **arrays)
    open_source(path, None)
    monkeypatch.setattr(file_size_limits, "MOST_UNPACKED", 2**20)
    with pytest.raises(RecordingError, match="unpacks to more than"):
        open_source(path, None)


CLOCKED = {"imu.t": np.arange(50) / 50.0, "imu.acc": np.ones((50, 3)), "ft.t": np.arange(20) / 20.0,
           "ft.force": np.ones((20, 3))}  # fmt: skip
WIDE = {"t": np.arange(100) / 100.0, "q": np.random.default_rng(0).normal(size=(100, 2)), "tau": np.ones((100, 2))}


def test_arrays_beside_groups_with_times_of_their_own_are_read(tmp_path):
    np.savez(tmp_path / "beside.npz", **WIDE, **CLOCKED)
    assert {"t", "q1", "q2", "tau1", "tau2"} <= set(open_source(tmp_path / "beside.npz", None).names)


def test_pictures_in_groups_are_no_columns(tmp_path):
    pictures = {"camera.t": np.arange(50) / 50.0, "camera.rgb": np.zeros((50, 4, 4, 3))}
    np.savez(tmp_path / "clocks.npz", **pictures, **{f"arm.{name}": values for name, values in WIDE.items()})
    assert not any("rgb" in name for name in open_source(tmp_path / "clocks.npz", None).names)
    runs = {f"demo{k}.{name}": values for k in (1, 2) for name, values in WIDE.items()}
    np.savez(tmp_path / "runs.npz", **runs, **{f"demo{k}.rgb": np.zeros((100, 4, 4, 3)) for k in (1, 2)})
    assert open_source(tmp_path / "runs.npz", None).names == ["t", "q1", "q2", "tau1", "tau2", "segment"]


def test_a_signal_that_one_run_lacks_is_named(tmp_path):
    runs = {f"demo{k}.{name}": values for k in (1, 2) for name, values in WIDE.items()}
    np.savez(tmp_path / "runs.npz", **runs, **{"demo1.temperature": np.ones(100)})
    (remark,) = open_source(tmp_path / "runs.npz", None).remarks
    assert "temperature" in remark
    np.savez(tmp_path / "runs.npz", **runs)
    assert "left out" not in open_source(tmp_path / "runs.npz", None).remarks[0]


@pytest.mark.parametrize("name", ["ft/t", "dt"])
def test_a_damaged_clock_is_unreadable_and_nothing_else(tmp_path, name):
    path = tmp_path / "clocks.h5"
    with h5py.File(path, "w") as file:
        for group, values in ((name.replace(".", "/"), values) for name, values in CLOCKED.items()):
            file.create_dataset(group, data=values, chunks=True, compression="gzip")
        file.create_dataset("dt", data=[0.01], chunks=True, compression="gzip")
        chunk = file[name].id.get_chunk_info(0)
    damaged = bytearray(path.read_bytes())
    damaged[chunk.byte_offset : chunk.byte_offset + chunk.size] = b"x" * chunk.size
    path.write_bytes(damaged)
    with pytest.raises(RecordingError, match=f"{name} cannot be read"):
        open_source(path, None)


def test_arrays_of_other_times_are_not_held_where_they_are_large(tmp_path, monkeypatch):
    np.savez(tmp_path / "clocks.npz", **CLOCKED)
    assert "ft.force1" in open_source(tmp_path / "clocks.npz", None).names
    monkeypatch.setattr(array_files, "MOST_UNPACKED", 8 * 100)
    assert "ft.force1" not in open_source(tmp_path / "clocks.npz", None).names


def test_words_of_a_length_that_the_file_only_states_are_not_read(tmp_path):
    path = tmp_path / "words.h5"
    with h5py.File(path, "w") as file:
        for name, values in WIDE.items():
            file[name] = values
        file.create_dataset("words", (20,), dtype="S1000000000")
    assert path.stat().st_size < 1_000_000
    assert open_source(path, None).names == ["q1", "q2", "t", "tau1", "tau2"]


def test_structures_that_are_named_have_times_of_their_own(tmp_path: Path) -> None:
    """Simulink's blocks To Workspace: a time beside the signals, which stand deeper and have a label."""

    def structure(label: str, t: np.ndarray) -> dict[str, object]:
        values = np.column_stack([np.sin(t), np.cos(t)])
        return {"time": t[:, None], "signals": {"values": values, "label": label}, "blockName": label}

    t = np.arange(200) / 100.0
    scipy_io.savemat(tmp_path / "out.mat", {"q_meas": structure("q", t[::2]), "tau_meas": structure("tau", t)})
    sample = read_sample(tmp_path / "out.mat")
    columns = dict(zip(sample.names, sample.values.T, strict=True))
    assert {"q1", "q2", "tau1", "tau2"} <= set(columns)
    np.testing.assert_allclose(columns["tau2"], np.cos(t))
    np.testing.assert_allclose(columns["q1"][:-1], np.sin(t[:-1]), atol=1e-4)


def test_an_array_without_a_time_keeps_no_group_from_its_own(tmp_path: Path) -> None:
    """Simulink's `tout` stands outside of all structures, and has a row for each step of the solver."""
    t = np.arange(200) / 100.0
    groups = {"q.time": t[::2], "q.values": np.column_stack([np.sin(t), np.cos(t)])[::2]}
    groups |= {"tau.time": t, "tau.values": np.column_stack([np.cos(t), t])}
    for rows, is_read in ((200, True), (350, False)):
        np.savez(tmp_path / "out.npz", **groups, tout=np.linspace(0.0, 2.0, rows))
        source = open_source(tmp_path / "out.npz", None)
        columns = columns_of(tmp_path / "out.npz")
        np.testing.assert_allclose(columns["q.values1"][:-1], np.sin(t[:-1]), atol=1e-4)
        np.testing.assert_array_equal(columns["tau.values2"], t)
        assert ("tout" in columns) is is_read
        assert ("left out is what has no time: tout" in source.remarks[0]) is not is_read


def test_arrays_without_a_time_that_are_the_recording_are_read(tmp_path: Path) -> None:
    wide = {name: values for name, values in WIDE.items() if name != "t"}
    np.savez(tmp_path / "rows.npz", **wide, **CLOCKED)
    assert {"q1", "q2", "tau1", "tau2"} <= set(open_source(tmp_path / "rows.npz", None).names)


@pytest.mark.parametrize(
    ("change", "is_joined"),
    [
        (lambda t: t + 0.5, True),
        (lambda t: t + 1e-6, False),
        (lambda t: 1e3 * t, False),
        (lambda t: t + 900.0, False),
    ],
    ids=["later", "the same", "ms", "elsewhere"],
)
def test_groups_of_one_length_are_joined_by_time_where_their_clocks_differ(tmp_path, change, is_joined):
    t = np.arange(200) / 100.0
    groups = {"q.time": t, "q.values": np.sin(t), "tau.time": change(t), "tau.values": np.sin(change(t))}
    np.savez(tmp_path / "later.npz", **groups)
    columns = columns_of(tmp_path / "later.npz")
    remarks = open_source(tmp_path / "later.npz", None).remarks
    assert any("on a straight line" in remark for remark in remarks) is is_joined
    if not is_joined:
        np.testing.assert_array_equal(columns["tau.values"], groups["tau.values"])
        return
    # The first group's times are those of the rows.
    assert np.isnan(columns["tau.values"][:50]).all()
    np.testing.assert_allclose(columns["tau.values"][50:], columns["q.values"][50:], atol=1e-4)


def test_groups_whose_times_hardly_meet_are_said_to_be_read_side_by_side(tmp_path):
    t, values = 0.005 * np.arange(400), np.random.default_rng(1).normal(size=(400, 6))
    for shift, is_told in ((0.0, False), (1.5, True)):
        savemat(tmp_path / "two.mat", {"pos": {"t": t, "q": values}, "trq": {"t": t + shift, "tau": values}})
        source = open_source(tmp_path / "two.mat", None)
        assert any("less than half of their span" in remark for remark in source.remarks) == is_told


def test_references_of_a_file_to_itself_end(tmp_path):
    q, reference = np.random.default_rng(0).normal(size=(40, 3)), h5py.special_dtype(ref=h5py.Reference)
    with h5py.File(tmp_path / "circle.mat", "w") as file:
        cells = file.create_dataset("cells", (3,), dtype=reference)
        file["group/q"] = q
        cells[0], cells[1], cells[2] = cells.ref, file["group"].ref, file.ref
    source = open_source(tmp_path / "circle.mat", None)
    assert len(source.names) == 3
    np.testing.assert_array_equal(np.concatenate(list(source.blocks())), q)


@pytest.mark.parametrize(("n_further", "offset"), [(20, 1e9), (0, 1e9), (20, 5.0)])
def test_arrays_whose_clocks_have_no_moment_in_common_are_left_out_by_name(tmp_path, n_further, offset):
    rng, n = np.random.default_rng(1), 60
    with h5py.File(tmp_path / "clocks.h5", "w") as file:
        file["joints/time"], file["joints/q"] = np.arange(n) * 0.01, rng.normal(size=(n, 3))
        file["drives/time"], file["drives/tau"] = offset + np.arange(n - 30) * 0.02, rng.normal(size=(n - 30, 3))
        if n_further:
            file["hand/time"], file["hand/force"] = np.arange(n_further) * 0.03, rng.normal(size=(n_further, 2))
    source = open_source(tmp_path / "clocks.h5", None)
    (remark, *others) = source.remarks
    assert remark.startswith(f"The times of drives ({offset:.10g} to ")
    assert "no moment in common: drives is left out. Write both with the time of one clock." in remark
    assert ["longest" in other for other in others] == [True] * bool(n_further)
    assert not any("tau" in name for name in source.names)
    assert any(name.endswith("q1") for name in source.names)


def test_an_array_of_structures_that_are_rows_says_how_to_save_it(tmp_path):
    rows = np.zeros((200, 1), dtype=[("t", object), ("q", object)])
    for k in range(200):
        rows[k, 0] = (0.01 * k, np.full((1, 3), 0.1 * k))
    savemat(tmp_path / "rows.mat", {"log": rows})
    with pytest.raises(RecordingError, match=r"array of structures, one for each row: .* q = vertcat\(log\.q\)"):
        open_source(tmp_path / "rows.mat", None)
    savemat(tmp_path / "rows.mat", {"log": rows, "q": np.zeros((200, 3))})
    assert list(open_source(tmp_path / "rows.mat", None).names) == ["q1", "q2", "q3"]


def write_lists(path: Path, n: int, link: h5py.ExternalLink | None = None) -> None:
    """Write a list of n lists of two arrays each, as cells of cells, and a link among what they refer to."""
    with h5py.File(path, "w") as file:
        stored, whole = file.create_group("#refs#"), []
        for k in range(n):
            vectors = [stored.create_dataset(f"v{k}_{place}", data=np.full(40, k + place / 10)) for place in range(2)]
            whole.append(stored.create_dataset(f"l{k}", data=[one.ref for one in vectors], dtype=h5py.ref_dtype))
        file.create_dataset("logs/c", data=[one.ref for one in whole], dtype=h5py.ref_dtype)
        if link is not None:
            stored["elsewhere"] = link


def test_cells_open_no_other_file(tmp_path):
    # Whoever opens a pipe that nobody writes into waits for ever.
    os.mkfifo(tmp_path / "pipe.h5")
    write_lists(tmp_path / "links.h5", 3, h5py.ExternalLink(str(tmp_path / "pipe.h5"), "/q"))
    script = f"""
from pathlib import Path
from dynident.recordings.formats import open_source
print(len(open_source(Path({str(tmp_path / "links.h5")!r}), None).names))
"""
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (answer.stdout, answer.stderr) == ("6\n", "")


def test_cells_within_many_cells_are_read_in_a_time_that_grows_with_their_number(tmp_path):
    write_lists(tmp_path / "many.h5", 400)
    begin = time.process_time()
    assert len(open_source(tmp_path / "many.h5", None).names) == 800
    assert time.process_time() - begin < 6.0


def test_references_to_one_object_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5, "MOST_OBJECTS", 50)
    for n in (40, 60):
        with h5py.File(tmp_path / "same.h5", "w") as file:
            file["q"] = np.zeros((20, 3))
            file.create_dataset("c", data=[file["q"].ref] * n, dtype=h5py.ref_dtype)
        if n < 50:
            assert len(open_source(tmp_path / "same.h5", None).names) == 3
    with pytest.raises(RecordingError, match="more than 50 groups"):
        open_source(tmp_path / "same.h5", None)


@pytest.mark.parametrize("version", [5, 7.3])
def test_arrays_whose_names_would_be_the_same_are_all_read(tmp_path, version):
    cells = {"q": [1.0, 2.0, 3.0], "c": [[float(10 * k + place) for place in range(11)] for k in range(11)]}
    path = tmp_path / "names.mat"

    def to_cells(values):
        whole = np.empty((1, len(values)), dtype=object)
        for k, one in enumerate(values):
            whole[0, k] = to_cells(one) if isinstance(one, list) else np.full((20, 1), one)
        return whole

    def refer_to(file, values):
        stored = [refer_to(file, one) if isinstance(one, list) else np.full((1, 20), one) for one in values]
        names = [f"#refs#/{len(file.get('#refs#', ())) + k}" for k in range(len(stored))]
        for name, one in zip(names, stored, strict=True):
            file.create_dataset(name, data=one, dtype=h5py.ref_dtype if one.dtype == object else None)
        return np.array([[file[name].ref] for name in names], dtype=h5py.ref_dtype)

    if version == 5:
        savemat(path, {name: to_cells(values) for name, values in cells.items()} | {"q1": np.full((20, 1), 100.0)})
    else:
        with h5py.File(path, "w") as file:
            file["q1"] = np.full((1, 20), 100.0)
            for name, values in cells.items():
                file.create_dataset(name, data=refer_to(file, values), dtype=h5py.ref_dtype)
    columns = columns_of(path)
    expected = sorted([100.0, 1.0, 2.0, 3.0, *(float(10 * k + place) for k in range(11) for place in range(11))])
    assert sorted(float(values[0]) for values in columns.values()) == expected
    assert (columns["c1_11"][0], columns["c11_1"][0]) == (10.0, 100.0)


def test_columns_of_an_array_beside_vectors_with_their_names_are_all_read(tmp_path):
    np.savez(tmp_path / "both.npz", q=np.arange(60.0).reshape(20, 3), q1=np.full(20, 100.0))
    columns = columns_of(tmp_path / "both.npz")
    assert list(columns) == ["q_1", "q_2", "q_3", "q1"]
    assert columns["q1"][0] == 100.0


def test_texts_and_empty_arrays_of_matlab_are_no_columns(tmp_path):
    with h5py.File(tmp_path / "texts.mat", "w") as file:
        file["q"] = np.zeros((3, 40))
        texts = [file.create_dataset(f"#refs#/t{k}", data=np.full((40, 1), 97, dtype="u2")) for k in range(5)]
        for text in texts:
            text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("notes", data=[text.ref for text in texts], dtype=h5py.ref_dtype)
        file["nothing"] = np.zeros(40, dtype="u8")
        file["nothing"].attrs["MATLAB_empty"] = np.uint8(1)
        file["counts"] = np.zeros((1, 40), dtype="u2")
        file["counts"].attrs["MATLAB_class"] = np.bytes_("uint16")
    assert sorted(open_source(tmp_path / "texts.mat", None).names) == ["counts", "q1", "q2", "q3"]


@pytest.mark.parametrize("n", [20, 100, 1500])
@pytest.mark.parametrize("version", [5, 7.3])
def test_structures_that_are_rows_are_named_beside_settings_too(tmp_path, version, n):
    path = tmp_path / "rows.mat"
    if version == 5:
        rows = np.zeros((n, 1), dtype=[("q", object), ("tau", object)])
        for k in range(n):
            rows[k, 0] = (np.full((1, 3), 0.1 * k), np.zeros((1, 3)))
        savemat(path, {"log": rows, "dt": 0.01})
    else:
        with h5py.File(path, "w") as file:
            file["dt"] = np.full((1, 1), 0.01)
            for name in ("q", "tau"):
                targets = [file.create_dataset(f"#refs#/{name}{k}", data=np.zeros((3, 1))).ref for k in range(n)]
                file.create_dataset(f"log/{name}", data=targets, dtype=h5py.ref_dtype)
    with pytest.raises(RecordingError, match=r"array of structures, one for each row: .* q = vertcat\(log\.q\)"):
        open_source(path, None)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("is_wide", [False, True])
def test_files_of_version_4_are_read_as_scipy_reads_them(tmp_path, order, is_wide):
    path, random = tmp_path / "run.mat", np.random.default_rng(5)
    signals = {"q": numbers("f8", (ROWS, 3), 1), "tau": numbers("f4", (ROWS, 3), 2), "ticks": numbers("i2", (ROWS,), 3)}
    if order == "<":
        scipy_io.savemat(path, {**signals, "note": "hello", "z": random.normal(size=4) * 1j}, format="4")
    else:
        kinds = {"f8": 0, "f4": 10, "i2": 30}
        with path.open("wb") as file:
            for name, values in signals.items():
                wide = np.atleast_2d(values.T).T
                head = np.array([1000 + kinds[values.dtype.str[1:]], *wide.shape, 0, len(name) + 1], dtype=">i4")
                file.write(head.tobytes() + name.encode() + b"\0" + wide.T.astype(f">{values.dtype.str[1:]}").tobytes())
    known = scipy_io.loadmat(path)
    if is_wide:
        scipy_io.savemat(path, {name: known[name].T for name in signals}, format="4")
    assert format_of(path) == "mat"
    found = columns_of(path)
    for name in ("q", "tau"):
        wide = np.column_stack([found[f"{name}{j + 1}"] for j in range(3)])
        assert np.array_equal(wide, known[name].astype(float))
    assert np.array_equal(found["ticks"], known["ticks"].ravel().astype(float))
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(RecordingError):
        columns_of(path)


def test_what_only_matlab_can_read_says_how_to_save_it(tmp_path):
    def element(code: int, data: bytes) -> bytes:
        return np.array([code, len(data)], dtype="<u4").tobytes() + data + b"\0" * (-len(data) % 8)

    numbers_of_object = element(14, element(6, np.array([13, 0], dtype="<u4").tobytes()))
    texts = (element(1, word) for word in (b"log", b"MCOS", b"table"))
    table = element(14, element(6, np.array([17, 0], dtype="<u4").tobytes()) + b"".join(texts) + numbers_of_object)
    path = tmp_path / "table.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + table)
    with pytest.raises(RecordingError, match=r"log is an object of MATLAB \(table\): .* writetable\(log, 'run.csv'\)"):
        open_source(path, None)
    # In a cell it has no name of its own.
    texts = (element(1, word) for word in (b"", b"MCOS", b"timetable"))
    inner = element(14, element(6, np.array([17, 0], dtype="<u4").tobytes()) + b"".join(texts) + numbers_of_object)
    head = element(6, np.array([1, 0], dtype="<u4").tobytes()) + element(5, np.array([1, 1], dtype="<i4").tobytes())
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + element(14, head + element(1, b"runs") + inner))
    with pytest.raises(RecordingError, match=r"^runs1? is an object of MATLAB \(timetable\): .* writetimetable\(runs"):
        open_source(path, None)
    with h5py.File(tmp_path / "logged.mat", "w") as file:
        file["data"] = np.zeros((1, 6), dtype="u4")
        file["data"].attrs["MATLAB_class"] = np.bytes_("Simulink.SimulationData.Dataset")
        file["data"].attrs["MATLAB_object_decode"] = 3
    with pytest.raises(RecordingError, match=r"data is an object of MATLAB \(Simulink.SimulationData.Dataset\)"):
        open_source(tmp_path / "logged.mat", None)
    assert "writetimetable(log, 'run.csv')" in describe_object("log", "timetable")
    assert "t = seconds(t - t(1))" in describe_object("t", "datetime")
    assert "double(t)" in describe_object("t", "string")


def test_cells_that_are_rows_say_how_to_save_them(tmp_path):
    rows = np.empty(200, dtype=object)
    rows[:] = [np.full(3, 0.1 * k) for k in range(200)]
    savemat(tmp_path / "rows.mat", {"q": rows, "t": np.arange(200) * 0.01})
    source = open_source(tmp_path / "rows.mat", None)
    assert source.names == ["t"]
    assert any("q is a cell array" in remark and "vertcat(q{:})" in remark for remark in source.remarks)
    rows[:] = ["run"] * 200
    savemat(tmp_path / "words.mat", {"state": rows, "t": np.arange(200) * 0.01})
    # Words are no signal that could be saved in another way.
    assert open_source(tmp_path / "words.mat", None).remarks == ()
