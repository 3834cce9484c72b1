"""Tables as tools export them are read as they were measured; what cannot be read is refused with a way on."""

from __future__ import annotations

import gzip
import json
import pickle
import pkgutil
import re
import subprocess
import sys
import threading
import time
import zipfile
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat
from support.exported_tables import EXPORTED_TABLES, FILES_OF_RUNS, split_runs
from support.floating_robots import WALKER, draw_motion, stand_on_shin, write_log
from support.logger_layouts import cells, counted, table, written
from support.oracles import crooked_urdf
from test_layouts_of_loggers import CASES, check_signals, machine, read_as_proposed
from test_layouts_of_loggers import recorded as record_layout

import dynident.recordings
from dynident.api.recording_files import read_recordings
from dynident.errors import DynidentError
from dynident.identification.column_inference import unit_inference as of_units
from dynident.identification.column_inference.column_groups import group_columns
from dynident.identification.column_inference.column_names import read_names
from dynident.identification.column_inference.file_inspection import inspect_file, read_sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.recordings import RecordingError, RecordingMetadata, choose_preprocessing
from dynident.recordings.conditioning.signed_registers import _has_lost_sign
from dynident.recordings.formats import csv_and_parquet, json_records, open_source, rearranged_tables
from dynident.recordings.formats.text_streams import TextContent, find_stated_rate
from dynident.robot import robot_from_urdf
from dynident.robot.description_and_json import set_base

# Half of the rows that loggers write: a layout is the same in all of them.
recorded = partial(record_layout, duration=5.0)


@pytest.mark.parametrize("layout", EXPORTED_TABLES)
def test_an_exported_table_is_read_as_it_was_measured(tmp_path, layout):
    case = CASES[sorted(EXPORTED_TABLES).index(layout) % 2]
    run = recorded(*case)
    check_signals(read_as_proposed(EXPORTED_TABLES[layout](tmp_path, run), machine(case[0]), None), run, layout)


@pytest.mark.parametrize("side", ["left", "right"])
def test_of_two_arms_in_a_file_the_one_with_the_words_of_the_joints_is_meant(side):
    names = [f"{arm}_joint_{k}.{signal}" for arm in ("left", "right") for signal in ("pos", "tau") for k in (1, 2, 3)]
    named = read_names(names, {})
    groups, _, _ = group_columns(named, [f"robot_{side}_joint{k}" for k in (1, 2, 3)])
    assert sorted(names[group.columns[0]] for group in groups) == [f"{side}_joint_1.pos", f"{side}_joint_1.tau"]
    # Without a word of one arm in all names nobody knows.
    groups, _, _ = group_columns(named, [f"joint{k}" for k in (1, 2, 3)])
    assert len(groups) == 4


@pytest.mark.parametrize("layout", FILES_OF_RUNS)
def test_runs_in_one_file_are_segments(tmp_path, layout):
    run = recorded(*CASES[0])
    path = FILES_OF_RUNS[layout](tmp_path, run)
    proposal = propose(read_sample(path), machine("ur10"))
    assert (proposal.questions, proposal.columns["segment"]) == ((), "segment")
    (item,) = read_recordings(path, robot=machine("ur10"), columns=dict(proposal.columns), units=dict(proposal.units))
    lengths = [segment.length for segment in item.recording.segments]
    # Written with nine digits, the last time may lie behind the last instant of an even clock.
    np.testing.assert_allclose(lengths, [len(t) for t, _, _ in split_runs(run)], atol=1)
    assert np.abs(item._columns()["q_elbow_joint"][: lengths[0]] - run.q[: lengths[0], 2]).max() < 1e-6
    # The numbers of two arms count no runs.
    arms = {f"arm{k}.{name}": values for k in (1, 2) for name, values in (("t", run.t), ("q", run.q), ("tau", run.tau))}
    np.savez(tmp_path / "arms.npz", **arms)
    assert "segment" not in read_sample(tmp_path / "arms.npz").names


def test_letters_and_pulses_of_a_pendant_are_axes(tmp_path):
    run = recorded(*CASES[0])
    values = np.column_stack([1e3 * run.t, np.rint(run.q * 8e4), 2.0 * run.tau])
    # S is no unit of a pulse.
    for q, tau in (("{} pulse", "{} torque[%]"), ("FB_PULSE_{}", "TORQUE_{}(%)")):
        header = ["time[ms]", *(name.format(axis) for name in (q, tau) for axis in "SLURBT")]
        proposal = propose(read_sample(written(tmp_path / "p.csv", table(header, cells(values)))), machine("ur10"))
        assert [proposal.columns[f"q{k}"] for k in (1, 2, 6)] == [q.format(axis) for axis in "SLT"]
        assert {"units/q", "drives"} >= {question.field for question in proposal.questions} >= {"drives"}


def test_a_file_without_torques_says_which_columns_are_left(tmp_path):
    run = recorded(*CASES[0])
    values = np.column_stack([run.t, run.q])
    path = written(tmp_path / "egm.csv", table(["t", *counted("feedback.joints{}", run.n, 1)], cells(values)))
    details = " ".join(question.detail for question in propose(read_sample(path), machine("ur10")).questions)
    assert "do not say what they are: feedback.joints1 … feedback.joints6" in details
    path = written(tmp_path / "q.csv", table(["t", *counted("position{}", run.n, 1)], cells(values)))
    (question,) = propose(read_sample(path), machine("ur10")).questions
    assert "was the torque recorded?" in question.detail


@pytest.mark.parametrize("protocol", [0, 2, 3, 4, 5])
def test_a_pickle_of_any_protocol_is_named_and_not_opened(tmp_path, protocol):
    path = tmp_path / "run.pkl"
    path.write_bytes(pickle.dumps({"t": [0.1], "q": [1.0]}, protocol=protocol))
    with pytest.raises(RecordingError, match=r"a pickle of Python.*save the table as CSV or Parquet"):
        read_sample(path)
    with zipfile.ZipFile(tmp_path / "run.pt", "w") as archive:
        archive.writestr("run/data.pkl", path.read_bytes())
    with pytest.raises(RecordingError, match=r"PyTorch.*np\.savez"):
        read_sample(tmp_path / "run.pt")


def rename_in(header: Path, name: str) -> Path:
    header.write_text(header.read_text().replace("trace.r64", name))
    return header.with_name(name)


def put_elsewhere(numbers: Path) -> None:
    (numbers.parent / "elsewhere").mkdir()
    numbers.symlink_to(numbers.rename(numbers.parent / "elsewhere" / "trace.r64"))


def count_alone(count: int) -> str:
    channel = f"#BEGINCHANNELHEADER\n200,Time\n210,IMPLIZIT\n220,{count}\n#ENDCHANNELHEADER\n"
    return f"DIAEXTENDED  {{@:ENGLISH\n{channel}"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda header, numbers: numbers.unlink(), "numbers are in trace.r64: put that beside it"),
        (lambda header, numbers: numbers.write_bytes(numbers.read_bytes()[:-8]), "fewer numbers than the header says"),
        (lambda header, numbers: header.write_text(header.read_text().replace("REAL64", "ASCII")), "stored as ASCII"),
        (lambda header, numbers: header.write_text(header.read_text().replace("220,", "220,x")), "is damaged"),
        (lambda header, numbers: header.write_text("DIAEXTENDED"), "no arrays of numbers"),
        (lambda header, numbers: numbers.rename(rename_in(header, "other.r64")), "in other.r64: put that beside it"),
        (lambda header, numbers: numbers.rename(rename_in(header, f"{'x' * 90}.r64")), "leave both their common name"),
        (lambda header, numbers: rename_in(header, f"trace.{'x' * 300}"), "put that beside it"),
        (lambda header, numbers: put_elsewhere(numbers), "put that beside it"),
        (lambda header, numbers: header.write_text(count_alone(10**12)), "no arrays of numbers"),
    ],
    ids=["missing", "cut", "text", "damaged", "empty", "of another", "long", "no name", "linked", "counted"],
)
def test_a_damaged_data_set_says_what_is_wrong(tmp_path, change, words):
    path = EXPORTED_TABLES["data_set_of_diadem"](tmp_path, recorded(*CASES[0]))
    change(path, tmp_path / "trace.r64")
    with pytest.raises(RecordingError, match=words):
        read_sample(path)


def test_a_header_of_a_data_set_that_states_too_much_is_read_quickly(tmp_path):
    """Its clock counts further than there are numbers; and channels that never end were sought to the end each."""
    run = recorded(*CASES[0])
    path = EXPORTED_TABLES["data_set_of_diadem"](tmp_path, run)
    text = path.read_text()
    path.write_text(text.replace(f"220,{len(run.t)}", f"220,{10**12}", 1))
    assert sum(len(block) for block in open_source(path, None).blocks()) == len(run.t)
    path.write_text(text + "#BEGINCHANNELHEADER\n" * 5000)
    start = time.process_time()
    assert len(open_source(path, None).names) == 1 + 2 * run.n
    path.write_text(text + "#BEGINCHANNELHEADER\n" * 800_000)
    with pytest.raises(RecordingError, match="columns"):
        open_source(path, None)
    assert time.process_time() - start < 5.0


def test_many_columns_of_json_are_taken_apart_once(tmp_path, monkeypatch):
    """Each of several passes over 120 columns took as long as the first."""
    run = recorded(*CASES[0])
    rows = [
        f'{{"t": {t}, "q": {q.tolist()}, "tau": {tau.tolist()}, "state": "RUN", "on": true, '
        + ", ".join(f'"aux_{k}": {k + 1e-3 * i:.4f}' for k in range(107))
        + "}"
        for i, (t, q, tau) in enumerate(zip(run.t, run.q, run.tau, strict=True))
    ]
    # A record of another form among them, and a number that no float holds.
    rows[700] = f'{{"t": {run.t[700]}, "q": {run.q[700].tolist()}, "tau": null, "aux_3": 1{"0" * 400}}}'
    path = written(tmp_path / "wide.jsonl", "\n".join([*rows, ""]))
    source = open_source(path, None)
    first = np.concatenate(list(source.blocks()))
    monkeypatch.setattr(json_records, "_read_records", None)
    np.testing.assert_array_equal(first, np.concatenate(list(source.blocks())))
    names = source.names
    np.testing.assert_array_equal(np.delete(first[:, names.index("q3")], 700), np.delete(run.q[:, 2], 700))
    assert np.isnan(first[700, names.index("tau1")])
    assert np.isnan(first[700, names.index("aux_3")])
    assert first[701, names.index("aux_3")] == pytest.approx(3.701)


def test_columns_of_a_floating_base_are_proposed(tmp_path):
    robot = set_base(robot_from_urdf("walker", WALKER), "floating")
    motion = draw_motion(4, duration=6.0)
    torque, force = stand_on_shin(motion)
    pose = tuple(f"pelvis_{part}" for part in ("pos_x", "pos_y", "pos_z", "quat_x", "quat_y", "quat_z", "quat_w"))
    path = write_log(tmp_path / "walk.csv", motion, torque, {"shin": force}, pose=pose)
    proposal = inspect_file(path, robot).proposal
    assert proposal is not None
    assert proposal.questions == ()
    assert proposal.columns["base_qw"] == "pelvis_quat_w"
    guesses = {guess.field: guess.value for guess in proposal.guesses}
    assert guesses["columns/wrenches"] == "shin (link frame)"
    assert "check" not in guesses
    (item,) = read_recordings(path, robot=robot, columns=dict(proposal.columns), units=dict(proposal.units))
    assert np.abs(item._columns()["q_base_x"] - motion.q[:, 0]).max() < 1e-8
    hidden = write_log(tmp_path / "no.csv", motion, torque, {}, pose=tuple("abcdefg"))
    questions = {question.field: question for question in inspect_file(hidden, robot).proposal.questions}
    assert "orientation" in questions["columns/base_qx"].detail


def test_every_module_of_recordings_can_be_imported_first(tmp_path):
    names = [module.name for module in pkgutil.walk_packages(dynident.recordings.__path__, "dynident.recordings.")]
    assert len(names) > 50
    # Packages of others are imported once, ahead of the forks.
    program = (
        "import os, sys\n"
        "import casadi, pyarrow.csv, pyarrow.parquet, pydantic, scipy.signal\n"
        "for name in sys.argv[1:]:\n"
        "    child = os.fork()\n"
        "    if not child:\n"
        "        __import__(name)\n"
        "        os._exit(0)\n"
        "    if os.waitpid(child, 0)[1]:\n"
        "        sys.exit(f'{name} cannot be imported first')\n"
    )
    run = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_groups_of_arrays_with_times_of_their_own_are_joined_by_time(tmp_path):
    run = recorded(*CASES[0])
    with h5py.File(tmp_path / "topics.h5", "w") as file:
        for name, step, values in (("q", 2, run.q), ("tau", 1, run.tau)):
            file[f"{name}/time"], file[f"{name}/data"] = 5.0 + run.t[::step], values[::step]
    t, q, tau = read_as_proposed(tmp_path / "topics.h5", machine("ur10"), None)
    assert (len(t), np.abs(tau - run.tau).max()) == (len(run.t), 0.0)
    # Between two samples on a straight line; the last instants lie behind the last of them.
    assert np.nanmax(np.abs(q - run.q)) < 1e-3
    assert np.isnan(q[-1]).all()
    assert np.isfinite(q[:-1]).all()
    with h5py.File(tmp_path / "apart.h5", "w") as file:
        for name, begin, values in (("q", 0.0, run.q[::2]), ("tau", 900.0, run.tau)):
            file[f"{name}/time"], file[f"{name}/data"] = begin + np.arange(len(values)) / 100.0, values
    assert not any(name.startswith("q/data") for name in read_sample(tmp_path / "apart.h5").names)


def test_a_unit_may_stand_before_the_number_of_the_joint(tmp_path):
    run = recorded(*CASES[0])
    header = ["time_ms", *counted("pos_mrad_{}", run.n, 1), *counted("torque_cNm_{}", run.n, 1)]
    path = written(tmp_path / "c.csv", table(header, cells(1e3 * np.column_stack([run.t, run.q, 0.1 * run.tau]))))
    proposal = propose(read_sample(path), machine("ur10"))
    assert (proposal.questions, proposal.units) == ((), {"t": "ms", "q": "mrad", "tau": "cN m"})


def test_an_array_of_arrays_is_a_row_each_to_its_end(tmp_path):
    rows = [[0.01 * k, np.sin(k), np.cos(k)] for k in range(3000)]
    blocks = open_source(written(tmp_path / "rows.json", json.dumps(rows)), None).blocks()
    np.testing.assert_array_equal(np.concatenate(list(blocks)), rows)


def test_two_values_of_one_name_in_a_record_are_one_column(tmp_path):
    path = written(tmp_path / "twice.jsonl", '{"t": 0, "q1": 1, "q": [2, 3]}\n{"t": 1, "q1": 4, "q": [5, 6]}\n')
    source = open_source(path, None)
    assert source.names == ["t", "q1", "q2"]
    np.testing.assert_array_equal(np.concatenate(list(source.blocks())), [[0, 2, 3], [1, 5, 6]])


def test_runs_in_a_list_are_not_held_beyond_the_longest_object(tmp_path, monkeypatch):
    runs = [{"t": list(range(300)), "q": [[k, k] for k in range(300)]} for _ in range(9)]
    path = written(tmp_path / "runs.json", json.dumps(runs))
    assert "segment" in open_source(path, None).names
    decoded = []
    decode = json.JSONDecoder.raw_decode
    monkeypatch.setattr(json.JSONDecoder, "raw_decode", lambda *given: decoded.append(0) or decode(*given))
    monkeypatch.setattr(json_records, "LARGEST_OBJECT", 2 * path.stat().st_size // 9)
    monkeypatch.setattr(json_records, "RecordSource", lambda _: None)
    assert json_records.open_json(TextContent(path)) is None
    assert len(decoded) < 6


@pytest.mark.parametrize("column", ["motion_type", "kind", "parameter"])
def test_a_word_for_how_rows_move_does_not_tear_a_table_apart(tmp_path, column):
    rows = [f"{0.01 * k:.2f},{np.sin(k):.6f},{np.cos(k):.6f},{'slow' if k < 700 else 'fast'}" for k in range(1000)]
    source = open_source(written(tmp_path / "t.csv", "\n".join([f"t,q1,tau1,{column}", *rows, ""])), None)
    assert source.names[:3] == ["t", "q1", "tau1"]
    assert sum(len(block) for block in source.blocks()) == 1000


def test_signals_below_another_are_bounded_by_what_they_become(tmp_path, monkeypatch):
    # A long signal and many short ones, of which each would be as long as it.
    names = [("long", 6000), *((f"s{k}", 8) for k in range(1200))]
    rows = [f"{k / count:.6f},{name},{np.sin(k):.4f}" for name, count in names for k in range(count)]
    path = written(tmp_path / "s.csv", "\n".join(["time,signal,value", *rows, ""]))
    monkeypatch.setattr(rearranged_tables, "MOST_UNPACKED", 1 << 20)
    with pytest.raises(RecordingError, match="below another, in too many rows"):
        open_source(path, None)
    # Where the table is too long, one signal alone is none of several, and the table stays as it is.
    monkeypatch.setattr(rearranged_tables, "_MOST_STACKED", 1 << 10)
    word = "\n".join(["time,signal,value", *rows[:900], *(row.replace("long", "end") for row in rows[900:6000]), ""])
    assert "value" in open_source(written(tmp_path / "w.csv", word), None).names


@pytest.mark.parametrize(
    ("names", "are_runs"),
    [
        (["exp3_joint1", "exp3_joint2", "exp3_joint3"], False),
        (["run1_joint1", "run2_joint2"], False),
        (["arm2_run1", "arm2_run2"], True),
        (["run1_slow", "run2_fast"], False),
        (["run_2024-01-30_9", "run_2024-01-30_10"], True),
    ],
)
def test_the_number_that_differs_says_whether_files_are_runs(tmp_path, names, are_runs):
    run = recorded(*CASES[0])
    with zipfile.ZipFile(tmp_path / "files.zip", "w") as archive:
        for k, name in enumerate(names):
            values = np.column_stack([run.t, run.q[:, k], run.tau[:, k]])
            archive.writestr(f"{name}.csv", table(["t", "q", "tau"], cells(values)))
    assert ("segment" in open_source(tmp_path / "files.zip", None).names) == are_runs


def read_columns(path: Path) -> dict[str, np.ndarray]:
    source = open_source(path, None)
    return dict(zip(source.names, np.concatenate(list(source.blocks())).T, strict=True))


NUMBERS = np.column_stack([0.01 * np.arange(50), np.sin(np.arange(50)), np.cos(np.arange(50))])
ROWS = "\n".join([",".join(f"{cell:.6f}" for cell in row) for row in NUMBERS]) + "\n"


@pytest.mark.parametrize(
    "title",
    [
        "# Set 1 of 3 from robot A",
        "Copy of the data from Monday",
        "Insert of row 3 into this table",
        "-- a remark",
        "Log {robot: ur5, run: 3}",
        "State(t=1)",
    ],
)
def test_a_title_above_a_table_is_no_statement_and_no_object(tmp_path, title):
    columns = read_columns(written(tmp_path / "run.csv", f"{title}\nt,q1,tau1\n{ROWS}"))
    np.testing.assert_allclose(np.column_stack([columns[name] for name in ("t", "q1", "tau1")]), NUMBERS, atol=1e-6)


@pytest.mark.parametrize(
    "begin", ["begin transaction;", "BEGIN;", "COPY log (t, q) FROM stdin;", "create table log (\n"]
)
def test_statements_of_sql_are_called_that(tmp_path, begin):
    with pytest.raises(RecordingError, match="a dump of SQL"):
        read_sample(written(tmp_path / "log.sql", f"-- a dump\n\n{begin}\n{ROWS}"))


def test_a_workbook_of_xml_is_no_page(tmp_path):
    text = "<?xml version='1.0'?>\n<Workbook><Worksheet><Table><Row/></Table></Worksheet></Workbook>\n"
    with pytest.raises(RecordingError, match="The file is XML"):
        read_sample(written(tmp_path / "run.xml", text))


def test_names_with_brackets_are_a_header(tmp_path):
    text = f"position(joint=1),position(joint=2),torque(joint=1)\n{ROWS}"
    assert len(read_columns(written(tmp_path / "run.csv", text))) == 3


def test_nothing_is_rewritten_within_a_text_of_a_printed_object(tmp_path):
    rows = [f"State(t={k}, note='a, b: (None) 1. nan', q=[{k}, 1.], ok=True)" for k in range(20)]
    source = open_source(written(tmp_path / "run.log", "\n".join([*rows, ""])), None)
    assert (source.names, source.texts["note"][0]) == (["t", "note", "q1", "q2", "ok"], "a, b: (None) 1. nan")
    np.testing.assert_array_equal(next(source.batches(["q1"])).column("q1").to_numpy(), np.arange(20))


@pytest.mark.parametrize("first", ["header { stamp { sec: 7 nsec: 5 } }", "header {\n  stamp { sec: 7 nsec: 5 }\n}"])
def test_messages_of_protobuf_may_stand_on_one_line_and_texts_hold_braces(tmp_path, first):
    rows = [f'{first}\nname: "a{{b}}: }}"\njoint {{ name: "j{{" position: {k} torque: {-k}.5 }}\n' for k in range(20)]
    columns = read_columns(written(tmp_path / "echo.txt", "".join(rows)))
    np.testing.assert_array_equal(columns["joint.position"], np.arange(20))
    np.testing.assert_array_equal(columns["joint.torque"], [float(f"{-k}.5") for k in range(20)])
    assert {"header.stamp.sec", "header.stamp.nsec"} < set(columns) or "header.stamp.time" in columns


@pytest.mark.parametrize(
    ("remark", "rate"),
    [
        ("Sampling rate: 250 Hz", 250.0),
        ("logging frequency [Hz]: 125 Hz", 125.0),
        ("Abtastfrequenz = 1 kHz", 1000.0),
        ("Control frequency: 500 Hz, cut-off frequency: 20 Hz", 500.0),
        ("fs = 100 Hz", 100.0),
        ("dt = 0.008 s", 125.0),
        ("cut-off frequency: 20 Hz", None),
        ("PWM frequency: 20 kHz", None),
        ("Baud rate 9600 Hz", None),
        ("payload attached at t = 0.5 s", None),
        ("Sampling rate: 1,000 Hz", None),
    ],
)
def test_only_a_rate_of_rows_in_a_remark_is_their_rate(tmp_path, remark, rate):
    text = f"# {remark}\nq1,q2,tau1\n{ROWS}"
    assert open_source(written(tmp_path / "run.csv", text), None).stated_rate in (None, rate)
    columns = read_columns(written(tmp_path / "run.csv", text))
    assert ("t" in columns) == (rate is not None)
    if rate is not None:
        np.testing.assert_allclose(columns["t"], np.arange(50) / rate)


@pytest.mark.parametrize(("unit", "name"), [(1e3, "stamp_ms"), (1e9, "stamp_ns")])
def test_milliseconds_beside_a_whole_stamp_are_no_part_of_it(tmp_path, unit, name):
    t = 0.01 * np.arange(300)
    whole, part = np.rint(unit * t), np.rint(1e3 * t) % 1000
    stamps = [f"{a:.0f},{b:.0f},{np.sin(a):.4f}" for a, b in zip(whole, part, strict=True)]
    path = written(tmp_path / "run.csv", "\n".join([f"{name},msec,q1", *stamps, ""]))
    assert open_source(path, None).names == [name, "msec", "q1"]
    seconds = [f"{np.floor(a + 1e-9):.0f},{b:.0f},{np.sin(a):.4f}" for a, b in zip(t, part, strict=True)]
    columns = read_columns(written(tmp_path / "s.csv", "\n".join(["time,msec,q1", *seconds, ""])))
    np.testing.assert_allclose(columns["t"], t)


LISTS = {"t": NUMBERS[:, 0].tolist(), "q": NUMBERS[:, 1:].tolist(), "tau": NUMBERS[:, 1:].tolist()}
SMALL = {"columns": ["axis", "gain"], "data": [[k, 2.0 * k] for k in range(10)]}


@pytest.mark.parametrize("beside", [{"columns": ["a", "b"]}, {"meta": SMALL}, {"columns": ["a", "b"], "meta": SMALL}])
def test_signals_beside_names_or_a_small_table_are_read(tmp_path, beside):
    columns = read_columns(written(tmp_path / "run.json", json.dumps({**beside, **LISTS})))
    np.testing.assert_array_equal(np.column_stack([columns[name] for name in ("t", "q1", "tau2")]), NUMBERS)


def test_records_beside_a_small_table_are_read(tmp_path):
    records = [{"t": t, "q": q, "tau": tau} for t, q, tau in NUMBERS.tolist()]
    columns = read_columns(written(tmp_path / "run.json", json.dumps({"meta": SMALL, "samples": records})))
    np.testing.assert_array_equal(np.column_stack(list(columns.values())), NUMBERS)


@pytest.mark.parametrize("around", [lambda table: table, lambda table: {"data": table, "id": 1}])
def test_a_table_of_json_with_a_row_of_another_length_says_so(tmp_path, around):
    answer = {"columns": ["t", "q1", "tau1"], "index": list(range(50)), "data": NUMBERS.tolist()}
    columns = read_columns(written(tmp_path / "run.json", json.dumps(around(answer))))
    np.testing.assert_array_equal(np.column_stack([columns[name] for name in ("t", "q1", "tau1")]), NUMBERS)
    answer["data"][30] = [1.0, 2.0]
    with pytest.raises(RecordingError, match=r"Row 31 of the table has 2 values, but 3 columns"):
        read_columns(written(tmp_path / "run.json", json.dumps(around(answer))))


@pytest.mark.parametrize("rate", [0.1, 0.3])
def test_too_few_rows_a_second_are_the_reason_given(tmp_path, rate):
    run = recorded(*CASES[0])
    values = np.column_stack([np.arange(len(run.t)) / rate, run.q, run.tau])
    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    path = written(tmp_path / "slow.csv", table(header, cells(values)))
    accepted = RecordingMetadata(accept=("sampling_jitter",))
    (item,) = read_recordings(path, robot=machine("ur10"), metadata=accepted)
    with pytest.raises(DynidentError, match="rows a second: too few to choose the filters"):
        choose_preprocessing([item.recording])


@pytest.mark.parametrize(
    ("column", "word"),
    [
        ("state", lambda i, j: "INIT" if i < 20 else "RUN"),
        ("mode", lambda i, j: "STOP" if i > 1500 else "RUN"),
        ("direction", lambda i, j: ("Rx", "Tx")[(i + j) % 2]),
        ("comment", lambda i, j: ("ok", "ok", "warn")[(i // 7) % 3]),
    ],
)
@pytest.mark.parametrize("is_split", [False, True])
def test_a_word_that_changes_within_a_signal_is_no_name_of_it(tmp_path, column, word, is_split):
    run = recorded(*CASES[0])
    names = [*counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    values = np.column_stack([run.q, run.tau])
    nanoseconds = np.rint(1e9 * run.t).astype(int)
    stamps = [f"{n // 10**9},{n % 10**9}" if is_split else f"{1e-9 * n:.9f}" for n in nanoseconds]
    rows = [
        f"{stamps[i]},{name},{values[i, j]:.9f},{word(i, j)}"
        for i in range(len(values))
        for j, name in enumerate(names)
    ]
    header = f"{'sec,nanosec' if is_split else 'timestamp'},signal,value,{column}"
    path = written(tmp_path / "long.csv", "\n".join([header, *rows, ""]))
    names_of_columns = open_source(path, None).names
    assert {f"value_{name}" for name in names} <= set(names_of_columns)
    if not is_split:
        check_signals(read_as_proposed(path, machine("ur10"), None), run, column)
    # A row at a change of state may be written twice, once with each word.
    rows.insert(500, rows[500].rpartition(",")[0] + ",CHANGE")
    twice = written(tmp_path / "twice.csv", "\n".join([header, *rows, ""]))
    assert open_source(twice, None).names == names_of_columns


@pytest.mark.parametrize(
    ("names", "bad"),
    [("sec,nanosec", -1), ("sec,nanosec", 2 * 10**9), ("Time[s],Time[ns]", -1), ("stamp_sec,stamp_nsec", 2 * 10**9)],
)
@pytest.mark.parametrize("rows", [20, 2000])
def test_a_damaged_stamp_leaves_the_time_of_all_others(tmp_path, names, bad, rows):
    nanoseconds = [(10**9 * k // 100) for k in range(rows)]
    stamps = [[100 + n // 10**9, n % 10**9] for n in nanoseconds]
    stamps[7][1] = bad
    text = "\n".join([f"{names},q1,tau1", *(f"{s},{n},{np.sin(s + 1e-9 * n)},1" for s, n in stamps), ""])
    source = open_source(written(tmp_path / "stamps.csv", text), None)
    t = np.concatenate(list(source.blocks()))[:, 0]
    np.testing.assert_allclose(np.delete(t, 7), np.delete(100 + 1e-9 * np.array(nanoseconds), 7), atol=1e-6)


@pytest.mark.parametrize("names", [("time_q", "time_tau"), ("Time", "Time"), ("q.t [s]", "tau.t [s]")])
@pytest.mark.parametrize("offset", [0.0, 9000.0])
def test_blocks_side_by_side_with_times_of_other_rates_are_joined(tmp_path, names, offset):
    case = CASES[0]
    run, slow = recorded(*case), slice(None, None, 4)
    rows = [[*row, *[""] * (1 + run.n)] for row in cells(np.column_stack([run.t, run.q]).T)]
    for row, late in zip(rows, cells(np.column_stack([run.t[slow] + offset, run.tau[slow]]).T), strict=False):
        row[1 + run.n :] = late
    header = [names[0], *counted("q{}", run.n, 1), names[1], *counted("tau{}", run.n, 1)]
    path = written(tmp_path / "sheet.csv", table(header, list(map(list, zip(*rows, strict=True)))))
    if offset:
        sample = read_sample(path)
        assert "tau1 … tau6 is left out. Write both with the time of one clock." in " ".join(sample.remarks)
        assert not any("tau" in name for name in sample.names)
        return
    _, q, tau = read_as_proposed(path, machine(case[0]), None)
    inside = slice(None, len(run.t) - 4)
    np.testing.assert_allclose(q[inside], run.q[inside], atol=1e-8)
    np.testing.assert_allclose(tau[slow][:-1], run.tau[slow][:-1], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("n_lost", [0, 1])
def test_a_second_time_of_the_same_rows_joins_nothing(tmp_path, n_lost):
    run = recorded(*CASES[0])
    seconds = (run.t + 3.0, 1e3 * run.t, 1e9 * run.t, np.arange(len(run.t)), 1e7 * run.t, 1.3 * run.t, run.t / 3600)
    for name in ("time_sent", "wall_time", "time_h"):
        for second in (*seconds, 6.4e17 + 1e7 * run.t):
            columns = cells(np.column_stack([run.t, run.q, second, run.tau]))
            for column in columns[1 + run.n :] if n_lost else ():
                column[-n_lost:] = [""] * n_lost
            header = ["time", *counted("q{}", run.n, 1), name, *counted("tau{}", run.n, 1)]
            sample = read_sample(written(tmp_path / "both.csv", table(header, columns)))
            assert (sample.names[0], sample.names[1 + run.n], sample.remarks) == ("time", name, ())


def test_a_time_that_ends_early_beside_whole_columns_is_no_block(tmp_path):
    run = recorded(*CASES[0])
    columns = cells(np.column_stack([run.t, run.q, 4.0 * run.t, run.tau]))
    columns[1 + run.n][len(run.t) // 4 :] = [""] * (len(run.t) - len(run.t) // 4)
    header = ["time", *counted("q{}", run.n, 1), "time_sent", *counted("tau{}", run.n, 1)]
    source = open_source(written(tmp_path / "early.csv", table(header, columns)), None)
    values = np.concatenate(list(source.blocks()))
    np.testing.assert_allclose(values[:, source.names.index("tau1")], run.tau[:, 0], rtol=1e-6)


@pytest.mark.parametrize(("name", "scale"), [("time_ms", 1e3), ("time [us]", 1e6), ("time_h", 1 / 3600)])
@pytest.mark.parametrize("turned", [False, True])
def test_blocks_side_by_side_are_joined_in_the_units_that_their_times_state(tmp_path, name, scale, turned):
    case = CASES[0]
    run, slow = recorded(*case), slice(None, None, 4)
    names, scales = (name, "time_s")[:: -1 if turned else 1], (scale, 1.0)[:: -1 if turned else 1]
    rows = [[*row, *[""] * (1 + run.n)] for row in cells(np.column_stack([scales[0] * run.t, run.q]).T)]
    second = np.column_stack([scales[1] * run.t[slow], run.tau[slow]])
    for row, late in zip(rows, cells(second.T), strict=False):
        row[1 + run.n :] = late
    header = [names[0], *counted("q{}", run.n, 1), names[1], *counted("tau{}", run.n, 1)]
    source = open_source(written(tmp_path / "b.csv", table(header, list(map(list, zip(*rows, strict=True))))), None)
    values = np.concatenate(list(source.blocks()))
    np.testing.assert_allclose(values[:, 0], scales[0] * run.t, atol=1e-6)
    tau = values[slow, source.names.index("tau1")]
    np.testing.assert_allclose(tau[1:-1], run.tau[slow, 0][1:-1], rtol=1e-4, atol=1e-4)


def test_tuples_within_tuples_are_columns(tmp_path):
    case = CASES[1]
    run = recorded(*case)
    states = [
        tuple((float(q), float(dq), (0.0,) * 6, float(tau)) for q, dq, tau in zip(*row, strict=True))
        for row in zip(run.q, run.dq, run.tau, strict=True)
    ]
    path = written(tmp_path / "states.txt", "".join(f"{state!r}\n" for state in states))
    check_signals(read_as_proposed(path, machine(case[0]), case[1]), run, "states")


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("delta_x\t0.01\t0.01", 100.0),
        ("Delta_X: 0.002", 500.0),
        ("wf_increment,0.001,0.001", 1000.0),
        ("wf_increment;0,001;0,001", 1000.0),
        ("delta_x 0.5 ms", 2000.0),
        ("delta_x 0.5 mm", None),
        ("wf_increment 0.001 0.01", None),
        ("wf_increment\t0.001\t0.001\tabout", None),
    ],
)
def test_a_step_of_time_without_a_unit_is_that_of_all_channels(line, rate):
    assert find_stated_rate(f"{line}\n1,2\n".encode(), 1) == (None if rate is None else pytest.approx(rate))


@pytest.mark.parametrize("word", ["init", "nan", "hold"])
def test_rows_that_begin_with_words_are_rows(tmp_path, word):
    rows = [*[f"{word},0,{k}" for k in range(5)], *[f"{k},{0.1 * k},{0.2 * k}" for k in range(100)]]
    source = open_source(written(tmp_path / "modes.csv", "\n".join(["mode,q1,tau1", *rows, ""])), None)
    assert sum(map(len, source.blocks())) == 105


def test_lines_of_properties_below_the_names_are_told(tmp_path):
    rows = ["channel,q1,tau1", "length,100,100", "unit,rad,Nm", *[f"{k},{0.1 * k},{0.2 * k}" for k in range(100)]]
    source = open_source(written(tmp_path / "waveforms.csv", "\n".join([*rows, ""])), None)
    assert sum(map(len, source.blocks())) == 100
    assert any(remark.startswith("2 lines below the names") for remark in source.remarks)


@pytest.mark.parametrize("cell", ["Mar 14", "14. Mrz", "3-Dez", "14-Mar", "3/14/2024", "Jan 02", "7-Juni"])
def test_dates_that_a_spreadsheet_made_of_numbers_are_named(tmp_path, cell):
    with pytest.raises(RecordingError, match="Cells of q1 are dates") as refused:
        read_columns(written(tmp_path / "run.csv", f"t,q1,tau1\n{ROWS}9.8,{cell},1.0\n9.9,1.0,1.0\n"))
    assert repr(cell) in str(refused.value)


@pytest.mark.parametrize("cell", ["n.c.", "overflow", "e5", "no data", "Error 12", "STOP-1", "mode-2", "12.deg"])
def test_words_among_numbers_are_shown(tmp_path, cell):
    path = written(tmp_path / "run.csv", f"t,q1,tau1\n{ROWS}9.8,{cell},1.0\n9.9,1.0,1.0\n")
    assert np.isnan(read_columns(path)["q1"]).sum() == 1
    assert [remark for remark in read_sample(path).remarks if repr(cell) in remark]


def cut(path: Path) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    return path


def test_a_file_that_is_cut_short_says_so_and_what_to_do(tmp_path):
    values = np.random.default_rng(0).normal(size=(400, 3))
    text = table(["t", "q1", "tau1"], cells(values)).encode()
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(text))
    with zipfile.ZipFile(tmp_path / "run.zip", "w") as archive:
        archive.writestr("run.csv", text)
    np.savez(tmp_path / "run.npz", t=values[:, 0], q=values[:, 1:2], tau=values[:, 2:])
    savemat(tmp_path / "run.mat", {"q": values}, do_compression=True)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["q"] = values
    pq.write_table(pa.table({"q1": values[:, 1]}), tmp_path / "run.parquet")
    for path in tmp_path.iterdir():
        with pytest.raises(RecordingError, match=r"cut short or damaged.*copy it again"):
            read_columns(cut(path))


def test_sound_files_that_are_not_read_are_not_called_damaged(tmp_path):
    names = [f"c{k}" for k in range(10_001)]
    pq.write_table(pa.table([[0.0]] * len(names), names=names), tmp_path / "wide.parquet")
    objects = np.array([{}, None], dtype=object)
    np.save(tmp_path / "objects.npy", objects)
    np.savez(tmp_path / "objects.npz", q=objects)
    with zipfile.ZipFile(tmp_path / "lzma.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("q.npy", b"")
    for path in tmp_path.iterdir():
        with pytest.raises(RecordingError, match=r"at most 10000|Python objects|by a method") as refused:
            open_source(path, None)
        assert "damaged" not in str(refused.value)


def test_the_reader_of_a_file_that_is_refused_has_ended(tmp_path, monkeypatch):
    # A thread of Arrow that calls Python while the program ends aborts it.
    ends = []

    class Watched(threading.Event):
        def wait(self, timeout=None):
            ends.append(super().wait(timeout))

    monkeypatch.setattr(csv_and_parquet, "Event", Watched)
    row = ",".join(f"{k / 7:.6f}" for k in range(22))
    text = ",".join(["t", *counted("x{}", 15)]) + "\n" + f"{row}\n" * 5_000
    with pytest.raises(RecordingError, match="there are 16 columns"):
        read_columns(written(tmp_path / "run.csv", text))
    assert ends == [True]


def test_names_of_a_plc_keep_their_quotes(tmp_path):
    run = recorded(*CASES[0])
    rows = ["NodeId,SourceTimestamp,Value"]
    for t, *signals in zip(run.t, run.q, run.tau, strict=True):
        for kind, values in zip(("ActPos", "ActTorque"), signals, strict=True):
            ids = [f'"ns=3;s=""Robot"".""Axis""[{j + 1}].""{kind}"""' for j in range(run.n)]
            rows += [f"{name},{t:.9g},{value:.9g}" for name, value in zip(ids, values, strict=True)]
    path = written(tmp_path / "run.csv", "\n".join([*rows, ""]))
    check_signals(read_as_proposed(path, machine("ur10"), None), run, "plc")


def propose_of(folder: Path, t: np.ndarray, q: np.ndarray, tau: np.ndarray, name: str = "t"):
    header = [name, *counted("q{}", q.shape[1], 1), *counted("tau{}", q.shape[1], 1)]
    times = t if isinstance(t, list) else cells(t[:, None])[0]
    path = written(folder / "run.csv", table(header, [times, *cells(np.column_stack([q, tau]))]))
    return path, inspect_file(path, machine("ur10")).proposal


def test_rows_that_come_in_bursts_have_the_rate_of_their_mean(tmp_path):
    run = recorded(*CASES[0])
    k = np.arange(len(run.t))
    received = (k // 8 + 1) * 8 / 200.0 + 4e-4 * (k % 8) + 1e-4 * run.rng.random(len(k))
    path, proposal = propose_of(tmp_path, received, run.q, run.tau)
    (question,) = proposal.questions
    remedy = question.remedies[0]
    assert question.check in ("gaps", "")
    # Or the times are right as they are.
    assert [each.field for each in question.remedies] == ["rate", "columns"]
    assert abs(remedy.value / 200.0 - 1.0) < 0.002
    stated = RecordingMetadata(rate=200.0)
    (item,) = read_recordings(path, robot=machine("ur10"), columns=dict(proposal.columns), metadata=stated)
    assert np.abs(item._columns()["q_elbow_joint"] - run.q[:, 2]).max() < 1e-6


@pytest.mark.parametrize("case", CASES[:2], ids=lambda case: case[0])
def test_ticks_of_a_clock_are_no_nanoseconds(tmp_path, case):
    run, robot = recorded(*case), machine(case[0])
    header = ["TIMESTAMP", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    for per_second, is_right in ((80e6, False), (24e6, False), (1e9, True)):
        ticks = [f"{round(per_second * t) + 8 * 10**12}" for t in run.t]
        path = written(tmp_path / "run.csv", table(header, [ticks, *cells(np.column_stack([run.q, run.tau]))]))
        fields = [question.field for question in propose(read_sample(path), robot).questions]
        assert fields == ([] if is_right else ["units/t"])


def test_torques_without_their_sign_are_named(tmp_path):
    run = recorded(*CASES[0])
    _, proposal = propose_of(tmp_path, run.t, run.q, np.abs(run.tau))
    assert [question.check for question in proposal.questions] == ["lost_sign"]
    # Of currents whose drive gains are asked for, too.
    header = ["t", *counted("q{}", run.n, 1), *counted("motor{}_current_A", run.n, 1)]
    content = cells(np.column_stack([run.t, run.q, np.abs(run.tau) / 9.0]))
    proposal = propose(read_sample(written(tmp_path / "rms.csv", table(header, content))), machine("ur10"))
    assert [question.check for question in proposal.questions if question.check] == ["lost_sign"]
    # Of links that are held on one side no torque changes its sign, and none comes to 0.
    _, proposal = propose_of(tmp_path, run.t, run.q, run.tau - run.tau.min(axis=0) + 0.02 * np.ptp(run.tau, axis=0))
    assert "lost_sign" not in [question.check for question in proposal.questions]


def test_a_lift_that_locks_itself_has_not_lost_its_sign():
    """It holds its load on the way up, and needs nearly nothing on the way down."""
    t = np.arange(12_000) / 200.0
    up = np.sin(2.0 * np.pi * t / 8.0)
    noise = np.abs(np.random.default_rng(0).normal(0.0, 0.5, len(t)))
    assert not _has_lost_sign(40.0 + 39.6 * np.tanh(20.0 * up) + noise)
    assert _has_lost_sign(np.abs(40.0 * up) + noise)


def test_a_torque_that_was_written_twice_is_named(tmp_path):
    run = recorded(*CASES[0])
    tau = run.tau.copy()
    tau[:, 2] = tau[:, 1]
    _, proposal = propose_of(tmp_path, run.t, run.q, tau)
    (question,) = proposal.questions
    assert (question.check, question.remedies[0].value) == ("repeated_torque", {"tau3": "none"})
    # Two fingers that one motor drives may have its torque both.
    q = run.q.copy()
    q[:, 2] = -q[:, 1]
    _, proposal = propose_of(tmp_path, run.t, q, tau)
    assert "repeated_torque" not in [question.check for question in proposal.questions]


def test_of_exchanged_columns_no_unit_is_asked(tmp_path):
    run = recorded(*CASES[0])
    _, proposal = propose_of(tmp_path, run.t, run.q[:, ::-1], run.tau[:, ::-1])
    assert {question.check for question in proposal.questions} == {"joint_order"}


@pytest.mark.parametrize("names", [("{}_pos", "{}_torque"), ("{}_Winkel", "{}_Moment"), ("q_{}", "tau_{}")])
def test_joints_that_the_description_calls_otherwise_are_those_of_the_file_in_its_order(tmp_path, names):
    run = recorded(*CASES[2])
    joints = ("base", "shoulder", "elbow", "w1", "w2", "hand")
    header = ["t", *(name.format(joint) for name in names for joint in joints)]
    for order, is_known in ((range(6), True), ([3, 0, 5, 1, 4, 2], False)):
        values = np.column_stack([run.t, run.q[:, order], run.tau[:, order]])
        proposal = propose(read_sample(written(tmp_path / "run.csv", table(header, cells(values)))), machine("crooked"))
        assert (not proposal.questions) == is_known
    # Torques of other joints than the positions are none of the robot's.
    header[7:] = [names[1].format(joint) for joint in ("thumb", "index", "middle", "ring", "little", "palm")]
    values = np.column_stack([run.t, run.q, run.tau])
    proposal = propose(read_sample(written(tmp_path / "run.csv", table(header, cells(values)))), machine("crooked"))
    assert proposal.questions


@pytest.mark.parametrize(("unit", "per_metre"), [("mm", 1e3), ("cm", 1e2), ("inches", 1 / 0.0254)])
def test_lengths_of_a_description_in_another_unit_are_named(tmp_path, unit, per_metre):
    run = recorded(*CASES[2])
    path, _ = propose_of(tmp_path, run.t, run.q, run.tau)
    text = re.sub(
        r'<origin xyz="([^"]*)"',
        lambda match: f'<origin xyz="{" ".join(f"{per_metre * float(word):.9g}" for word in match[1].split())}"',
        crooked_urdf(),
    )
    (question,) = inspect_file(path, robot_from_urdf("arm", text)).proposal.questions
    assert question.field == "robot"
    assert f"in {unit} {of_units.compute_reach(machine('crooked')):.2g} m" in question.detail


def test_checks_name_seconds_also_of_times_since_1970(tmp_path):
    run = recorded(*CASES[0], duration=10.0)
    start, tau = 1.7e9, run.tau.copy()
    limit = 0.7 * np.abs(tau[:, 1]).max()
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    tau[5::97, 3] = 1e6
    q = run.q.copy()
    q[1500:, 4] += 0.8
    path, _ = propose_of(tmp_path, [f"{start + t:.4f}" for t in run.t], q, tau)
    accept = ("saturation", "position_jump", "joint_zero", "torque_scale", "gravity_direction", "joint_order")
    accept += ("torque_order", "torque_sign", "torque_delay", "quantisation", "commanded_torque", "position_limits")
    metadata = RecordingMetadata(accept=accept)
    (item,) = read_recordings(path, robot=machine("ur10"), metadata=metadata)
    sentences = [check.detail for check in item.checks if check.status != "ok"]
    assert any("t = 1700000007.500 s" in sentence for sentence in sentences)
    assert not [sentence for sentence in sentences if re.search(r"1\.7e\+09|1\.70000e", sentence)]


def open_names(folder: Path, rows: list[str], head: str = "") -> tuple[str, ...]:
    """Return the names of the columns of a text with these rows."""
    return tuple(
        open_source(written(folder / "rows.csv", "\n".join([*([head] if head else []), *rows, ""])), None).names
    )


@pytest.mark.parametrize(
    ("head", "words", "names"),
    [
        ("time;state;q", ("move", "hold"), ("time", "state", "q1", "q2", "q3")),
        ("time;key;value", ("q", "tau"), ("time", *counted("value_q_{}", 3, 1), *counted("value_tau_{}", 3, 1))),
    ],
)
def test_words_beside_lists_are_keys_where_the_names_say_so(tmp_path, head, words, names):
    rows = [f"{0.01 * i:.2f};{words[i // 5 % 2]};[0.1, 0.{i % 7}, {i}]" for i in range(60)]
    assert open_names(tmp_path, rows, head) == names


def test_words_beside_lists_are_keys_where_each_time_has_several(tmp_path):
    rows = [f"{0.01 * i:.2f};{word};[0.1, {i}]" for i in range(60) for word in ("q", "tau")]
    names = ("t", "data_q_1", "data_q_2", "data_tau_1", "data_tau_2")
    assert open_names(tmp_path, rows, "t;what;data") == names


@pytest.mark.parametrize(
    ("titles", "lengths", "is_stacked"),
    [
        (("Run A", "Run B"), (40, 40), False),
        (("Log started 2024-01-01 10:00", "Log started 2024-01-01 10:05"), (40, 40), False),
        (("slow", "fast"), (40, 50), False),
        (("Run 1 of joint 2", "Run 2 of joint 2"), (40, 40), False),
        (("angle", "torque"), (40, 40), True),
        (("Joint 1", "Joint 2"), (40, 40), True),
    ],
)
def test_blocks_below_titles_are_signals_only_at_the_same_times(tmp_path, titles, lengths, is_stacked):
    rows: list[str] = []
    for title, length in zip(titles, lengths, strict=True):
        rows += [title, "time,q1,tau1", *(f"{0.01 * i:.2f},{i % 7},{i % 5}" for i in range(length))]
    names = tuple(f"value_{title} {name}" for title in titles for name in ("q1", "tau1"))
    assert open_names(tmp_path, rows) == ("time", *(names if is_stacked else ("q1", "tau1")))
    if not is_stacked:
        assert len(read_columns(tmp_path / "rows.csv")["time"]) == sum(lengths)


@pytest.mark.parametrize("names", ["_value,_field,joint", "_time,_value,joint", "_time,_value", "joint,_value"])
def test_an_answer_of_a_query_without_times_or_fields_says_what_to_keep(tmp_path, names):
    names = f",result,table,{names}"
    head = ["#group" + names.count(",") * ",false", names]
    rows = [f",,0{(names.count(',') - 2) * f',{i}'}" for i in range(40)]
    with pytest.raises(RecordingError, match=r"lacks _(time|field).*keep _time, _value and _field.*pivot"):
        open_names(tmp_path, [*head, *rows])


@pytest.mark.parametrize("first", ["#default rate 100 Hz", "#Group 7 of the laboratory", "#group"])
def test_a_remark_that_begins_like_an_answer_of_a_query_is_a_remark(tmp_path, first):
    rows = [first, "time,q1,tau1", *(f"{0.01 * i:.2f},{i % 7},{i % 5}" for i in range(40))]
    assert open_names(tmp_path, rows) == ("time", "q1", "tau1")
    assert open_source(tmp_path / "rows.csv", None).remarks == ()


@pytest.mark.parametrize(
    "rows",
    [
        [
            f"{0.01 * i:.2f},{key},{i % 7}.5,{kind}"
            for i in range(60)
            for key in ("j1", "j2")
            for kind in ("pos", "trq")
        ],
        [f"{0.01 * i:.2f},{('move', 'hold')[i // 5 % 2]},{i % 7}.5,OK" for i in range(60)],
    ],
)
def test_words_behind_values_that_are_no_types_are_not_left_out(tmp_path, rows):
    # Words that the next row repeats, or that stand where it has others, are values: there are no names then.
    assert open_names(tmp_path, rows) == (*counted("column{}", 4, 1),)


def test_a_file_without_names_may_have_columns_of_words(tmp_path):
    rows = [f"2,2,0,{100 + i},{-100 - i},{i % 7},R,R" for i in range(60)]
    source = open_source(written(tmp_path / "ticks.csv", "\n".join([*rows, ""])), None)
    assert source.names == list(counted("column{}", 8, 1))
    assert sum(batch.num_rows for batch in source.batches(["column4"])) == 60


def test_a_word_that_changes_behind_the_looked_at_rows_is_named(tmp_path):
    rows = [f"{0.01 * i:.2f},{key},{i},{kind}" for kind in ("pos", "trq") for i in range(900) for key in ("j1", "j2")]
    with pytest.raises(RecordingError, match="the word of j1 is pos in some rows and trq in others"):
        open_names(tmp_path, rows)


def _read_time(folder, **columns):
    """Return the time of a file and what was done to read it."""
    pq.write_table(pa.table(columns), folder / "counts.parquet")
    source = open_source(folder / "counts.parquet", None)
    if "t" not in source.names:
        return None, source.remarks
    return np.concatenate([batch.column("t").to_numpy() for batch in source.batches(["t"])]), source.remarks


@pytest.mark.parametrize("step", [1, 4])
@pytest.mark.parametrize("further", ["counter", "cnt_s", None])
def test_a_counter_begins_again_late_in_a_long_file_and_beside_another(tmp_path, step, further):
    rows = np.arange(300_000 if step == 1 else 70_000)
    other = {further: rows} if further else {}
    t, remarks = _read_time(tmp_path, tick_ms=(step * rows) % 65536, q1=np.sin(rows), **other)
    np.testing.assert_allclose(t, 1e-3 * step * rows, atol=1e-9)
    assert any("from 0 again where it is full" in remark for remark in remarks)


def test_a_counter_goes_on_across_rows_without_a_count(tmp_path):
    rows = np.arange(40_000)
    counts = ((4 * rows) % 65536).astype(float)
    counts[[5, 16_380, 30_000]] = np.nan
    t, _ = _read_time(tmp_path, tick_ms=counts, q1=np.sin(rows))
    np.testing.assert_allclose(t, np.where(np.isnan(counts), np.nan, 4e-3 * rows), atol=1e-9)


@pytest.mark.parametrize("last", [65_488, 65_492, 30_000])
def test_runs_that_end_near_a_full_count_are_not_joined(tmp_path, last):
    counts = np.concatenate([np.arange(0, last + 1, 4), np.arange(0, 20_000, 4)])
    t, _ = _read_time(tmp_path, time_ms=counts, q1=np.sin(counts))
    assert t is None


def test_a_time_that_goes_on_is_not_replaced_by_a_counter(tmp_path):
    rows = np.arange(40_000)
    t, remarks = _read_time(tmp_path, t=4e-3 * rows, tick_ms=(4 * rows) % 65536)
    np.testing.assert_allclose(t, 4e-3 * rows)
    assert not remarks


def test_the_number_of_a_clock_is_no_factor_and_a_counter_that_is_never_full_is_not_said_to_be(tmp_path):
    rows = np.arange(1000)
    assert _read_time(tmp_path, **{"t0 ms": rows, "q1": np.sin(rows)})[0] is None
    assert _read_time(tmp_path, **{"t2 ms": rows, "q1": np.sin(rows)})[0] is None
    t, remarks = _read_time(tmp_path, tick_100us=rows, q1=np.sin(rows))
    np.testing.assert_allclose(t, 1e-4 * rows)
    assert remarks == ("tick_100us counts: t is its time.",)
