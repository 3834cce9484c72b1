"""From files in many dialects to one canonical recording."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from support.recording_data import GAINS, JOINTS, motion, write_csv, write_parquet

from dynident.errors import Remedy
from dynident.recordings import (
    JointLimits,
    Preprocessing,
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    filtered_blocks,
    import_recording,
    open_recording,
    recording_from_arrays,
)
from dynident.recordings.file_source import find_bursts
from dynident.recordings.formats import open_source
from dynident.recordings.uniform_segments import Resampler


def stored(recording) -> dict[str, np.ndarray]:
    table = pq.read_table(recording.path)
    return {name: table[name].to_numpy() for name in table.column_names}


def imported(source: Path, *, gains=None, limits=None, **how):
    joints = RecordedJoints(JOINTS, limits=limits, gains=gains)
    return import_recording(source, source.with_suffix(".stored"), joints, **how)


def test_a_parquet_file_comes_out_in_si_and_in_the_robots_order(tmp_path):
    columns = motion()
    recording, checks = imported(write_parquet(tmp_path / "run.parquet", columns))
    assert [check.name for check in checks if check.status != "ok"] == []
    assert (recording.n_samples, recording.n) == (3000, 3)
    assert recording.sampling_rate == pytest.approx(200.0)
    kept = stored(recording)
    assert list(kept) == ["t", "segment", *(f"{kind}_{joint}" for kind in ("q", "tau") for joint in JOINTS)]
    assert np.array_equal(kept["q_elbow"], columns["q2"])
    assert np.array_equal(kept["tau_wrist"], columns["tau3"])


def test_a_stored_recording_opens_as_it_was(tmp_path):
    metadata = RecordingMetadata("first run", windows=((1.0, 5.0), (6.0, 9.0)), role="payload", payload={"mass": 2.5})
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", motion()), metadata=metadata)
    again = open_recording(recording.path)
    for name in ("name", "joint_names", "sampling_rate", "segments", "windows", "role", "payload", "source", "path"):
        assert getattr(again, name) == getattr(recording, name), name


@pytest.mark.parametrize(("separator", "comma"), [(",", False), (";", False), (";", True), ("\t", True), ("|", False)])
def test_csv_dialects_give_the_same_numbers(tmp_path, separator, comma):
    columns = motion(400)
    recording, _ = imported(write_csv(tmp_path / "run.csv", columns, separator, comma))
    assert np.array_equal(stored(recording)["q_shoulder"], columns["q1"])
    assert np.array_equal(stored(recording)["tau_wrist"], columns["tau3"])


def test_a_byte_order_mark_comments_quotes_and_spaces_in_the_header_do_no_harm(tmp_path):
    path = write_csv(tmp_path / "run.csv", motion(400))
    header, rest = path.read_text().split("\n", 1)
    names = ", ".join(f' "{name}" ' for name in header.split(","))
    path.write_bytes(b"\xef\xbb\xbf# recorded on a Tuesday\n# " + names.encode() + b"\n" + rest.encode())
    recording, _ = imported(path)
    assert recording.n_samples == 400


def test_units_are_converted_by_kind_and_by_column(tmp_path):
    columns = motion()
    given = dict(columns, t=columns["t"] * 1e3, q1=np.degrees(columns["q1"]), q2=np.degrees(columns["q2"]))
    given["tau2"] = columns["tau2"] * 1e3
    units = {"t": "ms", "q": "deg", "q_wrist": "rad", "tau2": "N*mm"}
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", given), metadata=RecordingMetadata(units=units))
    kept = stored(recording)
    for joint, number in (("shoulder", 1), ("elbow", 2), ("wrist", 3)):
        np.testing.assert_allclose(kept[f"q_{joint}"], columns[f"q{number}"], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(kept[f"tau_{joint}"], columns[f"tau{number}"], rtol=1e-12)
    np.testing.assert_allclose(kept["t"], columns["t"], atol=1e-9)


def test_a_prismatic_joint_is_in_metres(tmp_path):
    columns = motion()
    given = dict(columns, q3=columns["q3"] * 1e3)
    how = {"limits": [JointLimits(), JointLimits(), JointLimits("prismatic")]}
    metadata = RecordingMetadata(units={"q3": "mm"})
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", given), metadata=metadata, **how)
    np.testing.assert_allclose(stored(recording)["q_wrist"], columns["q3"], rtol=1e-12)
    with pytest.raises(RecordingError, match="choose from m, mm, cm") as caught:
        imported(tmp_path / "run.parquet", metadata=RecordingMetadata(units={"q3": "deg"}), **how)
    assert caught.value.pointer == "/units/q3"


def test_current_becomes_torque_by_the_drive_gain(tmp_path):
    columns = motion()
    given = {name: values for name, values in columns.items() if not name.startswith("tau")}
    for number, gain in enumerate(GAINS, start=1):
        given[f"current{number}"] = columns[f"tau{number}"] / gain * 1e3
    path = write_parquet(tmp_path / "run.parquet", given)
    metadata = RecordingMetadata(units={"current": "mA"})
    recording, checks = imported(path, gains=GAINS, metadata=metadata)
    np.testing.assert_allclose(stored(recording)["tau_elbow"], columns["tau2"], rtol=1e-12)
    assert "drive gain" in checks[0].detail
    with pytest.raises(RecordingError, match="elbow has no drive gain") as caught:
        imported(path, gains=(50.0, None, 20.0), metadata=metadata)
    assert caught.value.pointer == "/drives/elbow/drive_gain"


def test_with_torque_and_current_the_torque_is_taken_and_the_user_told(tmp_path):
    columns = motion()
    path = write_parquet(tmp_path / "run.parquet", dict(columns, current2=np.zeros(3000)))
    recording, checks = imported(path, gains=GAINS)
    assert np.array_equal(stored(recording)["tau_elbow"], columns["tau2"])
    assert "current2" in next(check.detail for check in checks if check.name == "torque_source")


def test_columns_called_torques_that_the_user_says_are_currents_need_drive_gains(tmp_path):
    columns = motion()
    given = columns | {f"tau{number}": columns[f"tau{number}"] / gain for number, gain in enumerate(GAINS, start=1)}
    path = write_parquet(tmp_path / "run.parquet", given)
    metadata = RecordingMetadata(effort_kind="motor_current")
    recording, _ = imported(path, gains=GAINS, metadata=metadata)
    np.testing.assert_allclose(stored(recording)["tau_elbow"], columns["tau2"], rtol=1e-12)
    with pytest.raises(RecordingError, match="elbow has no drive gain"):
        imported(path, gains=(50.0, None, 20.0), metadata=metadata)


def test_columns_are_found_by_joint_name_by_number_and_by_mapping(tmp_path):
    columns = motion()
    given = {"t": columns["t"], "q_shoulder": columns["q1"], "Q2": columns["q2"], "wrist angle": columns["q3"]}
    given |= {f"tau{number}": columns[f"tau{number}"] for number in (1, 2, 3)}
    metadata = RecordingMetadata(columns={"q_wrist": "wrist angle"})
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", given), metadata=metadata)
    assert np.array_equal(stored(recording)["q_wrist"], columns["q3"])


@pytest.mark.parametrize(
    ("change", "metadata", "pointer", "words"),
    [
        ({"q2": None}, {}, "/columns/q2", "q_elbow or q2"),
        ({"t": None}, {}, "/columns/t", "no column t"),
        ({"tau3": None}, {}, "/columns/tau3", "current3"),
        ({}, {"columns": {"q1": "angle"}}, "/columns/q1", "not in the file"),
        ({}, {"columns": {"angle": "q1"}}, "/columns/angle", "not a standard column"),
        ({}, {"units": {"q": "gradians"}}, "/units/q", "choose from rad"),
        ({}, {"units": {"speed": "rad/s"}}, "/units/speed", "neither"),
        ({}, {"windows": ((20.0, 30.0),)}, "/windows/0", "runs from 0 to"),
    ],
)
def test_what_is_missing_or_unknown_is_named(tmp_path, change, metadata, pointer, words):
    columns = {name: values for name, values in (motion() | change).items() if values is not None}
    with pytest.raises(RecordingError, match=words) as caught:
        imported(write_parquet(tmp_path / "run.parquet", columns), metadata=RecordingMetadata(**metadata))
    assert caught.value.pointer == pointer
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"]


def test_a_window_that_ends_before_it_begins_is_refused():
    with pytest.raises(RecordingError, match="Window 2"):
        RecordingMetadata(windows=((0.0, 1.0), (5.0, 4.0)))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"\x00\x01\x02", "neither Parquet nor text"),
        (b"0.0,1.0,2.0\n0.1,1.0,2.0\n", "no column names"),
        (b"PAR1 and then nothing", "Parquet"),
        (b"t,q1,q1\n0,1,2\n", "more than once"),
    ],
)
def test_a_file_that_cannot_be_read_says_why(tmp_path, content, words):
    path = tmp_path / "run.bin"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        imported(path)
    assert [left.name for left in tmp_path.iterdir()] == ["run.bin"]


def test_a_word_in_a_column_of_numbers_is_bridged_and_named_by_column_and_row(tmp_path):
    path = write_csv(tmp_path / "run.csv", motion(2000))
    lines = path.read_text().splitlines()
    fields = lines[43].split(",")
    fields[list(motion(2)).index("tau1")] = "oops"
    lines[43] = ",".join(fields)
    path.write_text("\n".join(lines))
    recording, checks = imported(path)
    check = next(check for check in checks if check.name == "missing_values")
    assert (check.column, check.row, check.rows) == ("tau1", 43, {"tau1": (43,)})
    assert recording.n_samples == 2000


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_columns_of_words_beside_the_signals_are_ignored(tmp_path, suffix):
    columns = {name: values for name, values in motion(30_000).items() if values.ndim == 1}
    words = np.where(np.arange(30_000) % 700 < 300, "IDLE", "RUNNING")
    # Words that begin after the first block of the file, too.
    late = np.where(np.arange(30_000) < 25_000, "1", "fault")
    plain = {name: columns[name] for name in ("t", "q1", "q2", "q3", "tau1", "tau2", "tau3")}
    table = pa.table({**plain, "mode": words, "code": late})
    if suffix == "csv":
        pacsv.write_csv(table, tmp_path / "run.csv")
    else:
        pq.write_table(table, tmp_path / "run.parquet")
    source = open_source(tmp_path / f"run.{suffix}", None)
    values = np.concatenate(list(source.blocks()))
    assert values.shape == (30_000, 9)
    assert np.isnan(values[:, 7]).all()
    assert (np.isnan(values[:, 8]) == (np.arange(30_000) >= 25_000)).all()
    np.testing.assert_array_equal(values[:, 1], columns["q1"])
    recording, checks = imported(tmp_path / f"run.{suffix}")
    assert recording.n_samples == 30_000
    assert next(check for check in checks if check.name == "missing_values").status == "ok"


def test_jitter_is_resampled_onto_a_uniform_grid(tmp_path):
    rng = np.random.default_rng(5)
    t = np.cumsum(np.where(rng.random(4000) < 0.4, 0.012, 0.010))
    q = np.stack([np.sin(2 * np.pi * 0.4 * t + phase) for phase in (0.0, 1.0, 2.0)], axis=1)
    recording = recording_from_arrays(t, q, 10 * q, joint_names=JOINTS)
    (rows,) = recording.source.rows(0, recording.n_samples, 10**9)
    grid = recording.segments[0].start_time + np.arange(recording.n_samples) * recording.period
    wanted = np.stack([np.sin(2 * np.pi * 0.4 * grid + phase) for phase in (0.0, 1.0, 2.0)], axis=1)
    assert recording.n_samples == 4000
    assert np.abs(rows.q - wanted).max() < 1e-6
    assert np.abs(rows.tau - 10 * wanted).max() < 1e-5


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), cuts=st.lists(st.integers(1, 399), max_size=8))
def test_resampling_does_not_depend_on_how_the_rows_arrive(seed, cuts):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.5, 1.5, 400))
    values = CubicSpline(t, rng.normal(size=(400, 2)))(t)
    edges = [0, *sorted(set(cuts)), 400]
    results = []
    for borders in ([0, 400], edges):
        resampler = Resampler(1.0)
        parts = [resampler.push(t[a:b], values[a:b]) for a, b in pairwise(borders)]
        results.append(np.concatenate([*parts, resampler.finish()]))
    np.testing.assert_allclose(results[0], results[1], atol=1e-12)


def test_a_torque_that_is_known_to_be_late_is_read_later(tmp_path):
    t = np.arange(2000) / 100.0
    q = np.stack([np.sin(t + phase) for phase in (0.0, 1.0, 2.0)], axis=1)
    for delay in (0.0334, -0.0334):
        columns = {"t": t}
        columns |= {f"q{j + 1}": q[:, j] for j in range(3)}
        columns |= {f"tau{j + 1}": np.cos(t - delay + j) for j in range(3)}
        path = write_parquet(tmp_path / "run.parquet", columns)
        recording, _ = imported(path, metadata=RecordingMetadata(torque_delay=delay))
        kept = stored(recording)
        np.testing.assert_allclose(kept["tau_elbow"], np.cos(kept["t"] + 1), atol=1e-6)
        np.testing.assert_allclose(kept["q_elbow"], np.sin(kept["t"] + 1), atol=1e-6)


def test_a_gap_splits_the_recording_and_is_named_with_its_start_and_length(tmp_path):
    columns = {name: np.delete(values, np.s_[1200:1400], axis=0) for name, values in motion().items()}
    recording, checks = imported(write_parquet(tmp_path / "run.parquet", columns))
    assert [segment.length for segment in recording.segments] == [1200, 1600]
    gap = next(check for check in checks if check.name == "gaps")
    assert (gap.status, gap.row, gap.column) == ("warning", 1200, "t")
    assert gap.time == pytest.approx(1199 / 200)
    assert "1.005 s" in gap.detail


def test_runs_with_a_long_pause_between_them_in_one_file_are_taken_as_two(tmp_path):
    columns = motion()
    columns["t"] = columns["t"] + np.where(np.arange(len(columns["t"])) < 1500, 0.0, 600.0)
    recording, checks = imported(write_parquet(tmp_path / "run.parquet", columns))
    assert [segment.length for segment in recording.segments] == [1500, 1500]
    assert next(check for check in checks if check.name == "gaps").status == "warning"


@pytest.mark.parametrize(
    ("pause", "status", "is_resting"), [(60, "ok", False), (60, "ok", True), (0.5, "warning", False)]
)
def test_a_pause_at_standstill_between_two_repetitions_is_no_lost_sample(tmp_path, pause, status, is_resting):
    once = motion()
    t = once["t"]
    # From rest to rest, as a designed motion begins and ends.
    rest = np.clip(4.0 * np.minimum(t, t[-1] - t) / t[-1], 0.0, 1.0) ** 3
    once |= {name: values * rest for name, values in once.items() if name.startswith("q")}
    if is_resting:
        once["q2"] = 1e-5 * np.random.default_rng(0).normal(size=len(t))
    columns = {name: np.concatenate([values, values]) for name, values in once.items()}
    columns["t"] = np.concatenate([t, t + t[-1] + pause])
    recording, checks = imported(write_parquet(tmp_path / "run.parquet", columns))
    assert len(recording.segments) == 2
    gap = next(check for check in checks if check.name == "gaps")
    assert gap.status == status
    assert ("while the robot stands" in gap.detail) == (status == "ok")
    assert ("dropping" in gap.detail) == (status == "warning")


def test_short_pieces_between_gaps_are_refused_with_how_much_of_the_time_is_lost(tmp_path):
    columns = {name: values[np.arange(len(values)) % 250 < 150] for name, values in motion().items()}
    with pytest.raises(RecordingError, match=r"Gaps take 38\s% of the time \(gaps: 11\)"):
        imported(write_parquet(tmp_path / "run.parquet", columns))


def test_bursts_of_a_buffer_have_a_rate_and_lost_rows_have_none(tmp_path):
    columns = motion()
    k = np.arange(len(columns["t"]))
    # Bursts of 20 rows, the last one begun only: whole ones are counted.
    received = {**columns, "t": (k // 20 + 1) / 10.0 + 4e-4 * (k % 20)}
    received = {name: values[:-7] for name, values in received.items()}
    with pytest.raises(RecordingError, match="come 20 at a time") as bursts:
        imported(write_parquet(tmp_path / "run.parquet", received))
    assert bursts.value.remedies[0] == Remedy("rate", 200.0)
    ends = np.cumsum(np.random.default_rng(0).integers(130, 320, 12))
    lost = np.isin(k, (ends[:, None] - np.arange(100)).ravel())
    with pytest.raises(RecordingError, match="Gaps take") as refused:
        imported(write_parquet(tmp_path / "run.parquet", {name: values[~lost] for name, values in columns.items()}))
    assert ("at a time" in str(refused.value), "rate" in str(refused.value.remedies)) == (False, False)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bursts_of_any_length_that_a_network_delayed_have_the_rate_of_the_rows(seed):
    rng = np.random.default_rng(seed)
    last = np.cumsum(rng.integers(2, 14, 300))
    sent = np.arange(last[-1] + 1) / 125.0
    burst = np.searchsorted(last, np.arange(last[-1] + 1))
    begins = np.concatenate([[0], last[:-1] + 1])
    arrived = sent[last[burst]] + 3e-4 * (np.arange(len(sent)) - begins[burst]) + rng.exponential(1e-3, 300)[burst]
    assert find_bursts(last, arrived[last], 3e-4)[1] == pytest.approx(125.0, rel=0.01)
    # Of rows that were lost the gaps say nothing of what lies between.
    lost = sent[last] + np.cumsum(rng.exponential(0.1, 300))
    assert find_bursts(last, lost, 8e-3) == (0, 0.0)
    # Gaps that are short against the runs before them make the time grow with the rows all the same.
    ends = np.cumsum(rng.integers(60, 140, 100))
    assert find_bursts(ends, ends / 125.0 + 0.08 * np.arange(100), 8e-3) == (0, 0.0)


def test_rows_that_repeat_the_one_before_are_left_out_with_a_warning(tmp_path):
    columns = {name: np.insert(values, [500, 900], values[[499, 899]], axis=0) for name, values in motion().items()}
    recording, checks = imported(write_parquet(tmp_path / "run.parquet", columns))
    assert recording.n_samples == 3000
    repeated = next(check for check in checks if check.name == "repeated_time")
    assert (repeated.status, repeated.row) == ("warning", 501)


def test_what_is_no_number_outside_the_windows_is_a_gap(tmp_path):
    columns = motion()
    columns["tau2"] = columns["tau2"].copy()
    columns["tau2"][2500:2520] = np.nan
    metadata = RecordingMetadata(windows=((1.0, 10.0),))
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", columns), metadata=metadata)
    assert [segment.length for segment in recording.segments] == [2500, 480]
    assert all(np.isfinite(block.q).all() for block in filtered_blocks(recording, Preprocessing(6.0, None)))


def test_a_slow_thermometer_holds_its_last_reading(tmp_path):
    columns = motion()
    for number in (1, 2, 3):
        reading = np.full(3000, np.nan)
        reading[5::500] = 30.0 + number + np.arange(6)
        columns[f"temperature{number}"] = reading + 273.15
    metadata = RecordingMetadata(units={"temperature": "K"})
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", columns), metadata=metadata)
    assert recording.has_temperature
    block = next(filtered_blocks(recording, Preprocessing(6.0, None)))
    np.testing.assert_allclose(block.temperature[[0, 5, 504, 505], 1], [32.0, 32.0, 32.0, 33.0])


def test_segments_of_a_file_are_kept_apart(tmp_path):
    columns = motion()
    columns["segment"] = np.repeat([1, 2, 1], 1000)
    recording, _ = imported(write_parquet(tmp_path / "run.parquet", columns))
    assert [(s.label, s.first_row, s.length) for s in recording.segments] == [
        (1, 0, 1000),
        (2, 1000, 1000),
        (1, 2000, 1000),
    ]


def test_timestamps_of_parquet_are_seconds(tmp_path):
    columns = {name: values for name, values in motion().items() if values.ndim == 1}
    stamps = pa.array((columns.pop("t") * 1e9).astype(np.int64)).cast(pa.timestamp("ns"))
    pq.write_table(pa.table({"t": stamps, **columns}), tmp_path / "run.parquet")
    recording, _ = imported(tmp_path / "run.parquet")
    assert recording.sampling_rate == pytest.approx(200.0)


def test_cancelling_an_import_leaves_nothing_behind(tmp_path):
    path = write_parquet(tmp_path / "run.parquet", motion())

    def cancel(fraction, message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        imported(path, progress=cancel)
    assert [left.name for left in tmp_path.iterdir()] == ["run.parquet"]


MEMORY = """
import sys
from pathlib import Path
from dynident.recordings import Preprocessing, RecordedJoints, filtered_blocks, import_recording
# Not ru_maxrss: a new process inherits that of the one that started it.
peak = lambda: next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
source = Path(sys.argv[1])
bare = peak()
recording, _ = import_recording(source, source.with_suffix(".stored"), RecordedJoints(("a", "b", "c")))
rows = sum(len(block.t) for block in filtered_blocks(recording, Preprocessing(6.0, None)))
print(rows, peak() - bare)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", pytest.param("parquet", marks=pytest.mark.thorough)])
def test_ten_times_the_rows_take_no_more_memory(tmp_path, kind):
    peaks = []
    for n_rows in (200_000, 2_000_000):
        columns = {name: values for name, values in motion(n_rows, rate=1000.0).items() if values.ndim == 1}
        path = tmp_path / f"run{n_rows}.{kind}"
        table = pa.table(columns)
        if kind == "csv":
            from pyarrow import csv

            csv.write_csv(table, path)
        else:
            pq.write_table(table, path, row_group_size=65536)
        run = subprocess.run([sys.executable, "-c", MEMORY, path], capture_output=True, text=True, check=True)
        rows, peak = map(int, run.stdout.split())
        assert rows == n_rows
        peaks.append(peak / 1024)
        path.unlink()
    assert peaks[1] < peaks[0] + 40.0, f"{peaks} MB"
    assert peaks[1] < 180.0, f"{peaks} MB, with what is read ahead and the checks"
