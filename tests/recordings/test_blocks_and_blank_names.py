"""Traces with a block for each variable, columns without a name, and rows that begin with words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynident.recordings.file_source import FileSource, fill_blank_names
from dynident.recordings.formats import open_source

RNG = np.random.default_rng(5)


def read_columns(source: FileSource) -> dict[str, np.ndarray]:
    batches = list(source.batches(list(source.names)))
    return {name: np.concatenate([batch.column(name).to_numpy(False) for batch in batches]) for name in source.names}


@pytest.mark.parametrize(("begin", "unit"), [("; ", ""), (";", ""), ("", "TimeUnit;us\n")])
@pytest.mark.parametrize("digits", [0, 3])
def test_blocks_below_the_name_of_their_variable_are_joined_on_time(
    tmp_path: Path, begin: str, unit: str, digits: int
) -> None:
    """As traces of CODESYS are exported; the trace as a whole has a name, too."""
    names = ["PLC.Axis1.fPos", "PLC.Axis2.fPos", "PLC.Axis1.fTorque", "PLC.Axis2.fTorque"]
    values = np.round(RNG.normal(size=(40, 4)) * 100, digits)
    text = f"[key]; [value]\nVersion; 0x03050000\nName; Application.Trace\nComment; \n{unit}"
    for k, name in enumerate(names):
        text += f"{k}.Variable; {name}\n{k}.Class; 14\n{k}.YAxis; 0\n{k}.Data; \n"
        text += "".join(f"{begin}{2000 * i}; {value:.{digits}f}\n" for i, value in enumerate(values[:, k]))
    (tmp_path / "trace.csv").write_text(text)
    source = open_source(tmp_path / "trace.csv", None)
    columns = read_columns(source)
    time = "time [us]" if unit else "time"
    assert list(columns) == [time, *(f"value_{name}" for name in names)]
    # A row for each value: they are joined on time when the recording is imported.
    for name, signal in zip(names, values.T, strict=True):
        has_value = np.isfinite(columns[f"value_{name}"])
        np.testing.assert_allclose(columns[time][has_value], 2000.0 * np.arange(40))
        np.testing.assert_allclose(columns[f"value_{name}"][has_value], signal)
    assert any("named by the variable above it" in remark for remark in source.remarks)


def test_a_table_of_two_columns_below_the_name_of_a_signal_stays_a_table(tmp_path: Path) -> None:
    text = "Name;Axis 1\n" + "".join(f"{i};{i * i}\n" for i in range(20))
    (tmp_path / "one.csv").write_text(text)
    assert len(open_source(tmp_path / "one.csv", None).names) == 2


@pytest.mark.parametrize(
    ("names", "right"),
    [
        (("t", "q1", "", "q3"), ("t", "q1", "q2", "q3")),
        (("", "t", "q1", "q2", "", "q4", ""), ("column1", "t", "q1", "q2", "q3", "q4", "column7")),
        (("A09_pos", "", "A11_pos"), ("A09_pos", "A10_pos", "A11_pos")),
        (("", "t", "q1"), ("", "t", "q1")),
        (("q1", "", "tau1"), ("q1", "", "tau1")),
        (("q1", "", "q4"), ("q1", "", "q4")),
        (("q2", "q1", "", "q3"), ("q2", "q1", "", "q3")),
    ],
)
def test_a_column_without_a_name_has_the_one_that_is_left_out(names: tuple[str, ...], right: tuple[str, ...]) -> None:
    filled, remarks = fill_blank_names(names)
    assert filled == right
    assert bool(remarks) == any(f"q{k}" in set(right) - set(names) or "A10_pos" in right for k in range(9))


def test_the_remark_says_which_name_was_taken(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,q1,,q3\n" + "".join(f"{i / 100},{i},{2 * i},{3 * i}\n" for i in range(30)))
    source = open_source(tmp_path / "log.csv", None)
    assert tuple(source.names) == ("t", "q1", "q2", "q3")
    assert "Column 3 has no name; between q1 and q3 it is q2." in source.remarks


@pytest.mark.parametrize("first", ["INIT;homing", "RUN;homing", "RUN;moving"])
def test_a_first_row_with_other_words_than_the_next_is_a_row(tmp_path: Path, first: str) -> None:
    rows = [f"{first if i == 0 else 'RUN;moving'};{i / 100:.2f};{np.sin(i):.4f}" for i in range(40)]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    source = open_source(tmp_path / "log.csv", None)
    assert tuple(source.names) == ("column1", "column2", "column3", "column4")
    assert len(read_columns(source)["column3"]) == 40


@pytest.mark.parametrize(
    ("names", "begin"),
    [
        (("t", "1", "2"), ""),
        (("id", "1", "2", "3"), "r"),
        (("id", "0.1", "0.2", "0.3"), "r"),
        (("id", "-0.25", "0.0", "0.25", "0.5"), "r"),
    ],
)
@pytest.mark.parametrize("sign", [";", ",", "\t"])
def test_names_that_are_partly_numbers_stay_names(
    names: tuple[str, ...], begin: str, sign: str, tmp_path: Path
) -> None:
    rows = [names, *((f"{begin}{i}", *(str(i % (k + 3)) for k in range(len(names) - 1))) for i in range(40))]
    (tmp_path / "log.csv").write_text("".join(sign.join(row) + "\n" for row in rows))
    assert tuple(open_source(tmp_path / "log.csv", None).names) == names


def write_pairs(path: Path, late: float = 0.0) -> dict[str, np.ndarray]:
    """Arrays of time and value, one for each signal."""
    arrays, t = {}, np.arange(60) / 100.0
    for k, name in enumerate(("j1_position", "j2_position", "j1_torque", "j2_torque")):
        arrays[name] = np.column_stack([t + late * k, np.sin(3 * t + k)])
    np.savez(path, **arrays)
    return arrays


def test_arrays_of_time_and_value_are_signals_at_one_time(tmp_path: Path) -> None:
    arrays = write_pairs(tmp_path / "log.npz")
    columns = read_columns(open_source(tmp_path / "log.npz", None))
    for name, pair in arrays.items():
        np.testing.assert_allclose(columns[f"{name}/data"], pair[:, 1])
    np.testing.assert_allclose(columns["j1_position/time"], arrays["j1_position"][:, 0])


def test_arrays_with_times_of_their_own_are_read_at_those_of_the_longest(tmp_path: Path) -> None:
    arrays = write_pairs(tmp_path / "log.npz", late=0.003)
    columns = read_columns(open_source(tmp_path / "log.npz", None))
    time, signal = columns["j1_position/time"], columns["j2_torque/data"]
    inside = np.isfinite(signal)
    np.testing.assert_allclose(signal[inside], np.interp(time[inside], *arrays["j2_torque"].T))


@pytest.mark.parametrize("rising", [False, True])
def test_arrays_of_two_joints_stay_arrays_of_two_joints(tmp_path: Path, rising: bool) -> None:
    t = np.arange(60) / 100.0
    q = np.column_stack([t if rising else np.sin(t), np.cos(t)])
    np.savez(tmp_path / "log.npz", q=q, tau=np.column_stack([np.cos(5 * t), np.sin(5 * t)]))
    assert set(open_source(tmp_path / "log.npz", None).names) == {"q1", "q2", "tau1", "tau2"}
