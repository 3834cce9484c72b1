"""The optional commanded positions: read, converted, resampled, stored, and given in place of the measured ones."""

from __future__ import annotations

import numpy as np
import pytest
from support.recording_data import JOINTS, motion, write_csv, write_parquet

from dynident.recordings import (
    FurtherColumns,
    Preprocessing,
    RecordedJoints,
    RecordingMetadata,
    filtered_blocks,
    import_recording,
    open_recording,
    recording_from_arrays,
)
from dynident.recordings.row_storage import replace_by_command

RAW = Preprocessing(None, None)


def with_command(n_rows: int = 1000) -> dict[str, np.ndarray]:
    columns = motion(n_rows)
    for k in range(len(JOINTS)):
        columns[f"q_command{k + 1}"] = columns[f"q{k + 1}"] + 0.01 * (k + 1)
    return columns


def imported(source, **metadata):
    said = RecordingMetadata(**metadata)
    return import_recording(source, source.with_suffix(".stored"), RecordedJoints(JOINTS), metadata=said)[0]


def positions(recording) -> np.ndarray:
    return np.concatenate([block.q for block in filtered_blocks(recording, RAW, block_length=77)])


@pytest.mark.parametrize("write", [write_csv, write_parquet])
def test_a_command_is_read_stored_and_given_in_place_of_the_measured_positions(tmp_path, write):
    recording = imported(write(tmp_path / "run.csv", with_command()))
    for found in (recording, open_recording(recording.path)):
        assert found.has_command
        off = positions(replace_by_command(found)) - positions(found)
        np.testing.assert_allclose(off, np.broadcast_to(0.01 * np.arange(1, len(JOINTS) + 1), off.shape), atol=1e-9)


def test_a_recording_without_a_command_says_so(tmp_path):
    recording = imported(write_parquet(tmp_path / "run.parquet", motion(1000)))
    assert not recording.has_command
    with pytest.raises(ValueError, match="no commanded positions"):
        replace_by_command(recording)


def test_a_command_has_the_units_that_are_said_and_columns_are_mapped(tmp_path):
    columns = with_command()
    columns["target"] = np.degrees(columns.pop("q_command1"))
    mapped = {"columns": {"q_command1": "target"}, "units": {"q_command1": "deg"}}
    recording = imported(write_parquet(tmp_path / "run.parquet", columns), **mapped)
    off = positions(replace_by_command(recording)) - positions(recording)
    np.testing.assert_allclose(off[:, 0], 0.01, atol=1e-9)


def test_a_command_stands_beside_temperatures_and_in_arrays():
    t = np.arange(600) / 200.0
    q = np.sin(t)[:, None] * np.ones(len(JOINTS))
    heat = 30.0 + 0.0 * q
    recording = recording_from_arrays(
        t, q, q, joint_names=JOINTS, further=FurtherColumns(temperature=heat, command=q + 0.5)
    )
    np.testing.assert_allclose(positions(replace_by_command(recording)), positions(recording) + 0.5, atol=1e-9)
    block = next(filtered_blocks(recording, RAW))
    np.testing.assert_allclose(block.temperature, 30.0)


def test_a_command_with_holes_leaves_the_recording_as_it_is(tmp_path):
    columns = with_command()
    whole = positions(imported(write_parquet(tmp_path / "whole.parquet", columns)))
    columns["q_command2"][500] = np.nan
    np.testing.assert_array_equal(positions(imported(write_parquet(tmp_path / "holes.parquet", columns))), whole)
