"""The six optional columns of the base's reaction: read, converted, resampled, checked and streamed like torque."""

from __future__ import annotations

import numpy as np
import pytest
from support.recording_data import JOINTS, motion, write_csv, write_parquet

from dynident.recordings import (
    FurtherColumns,
    Preprocessing,
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    filtered_blocks,
    import_recording,
    open_recording,
    recording_from_arrays,
)
from dynident.recordings.recording import WRENCH_NAMES

PREPROCESSING = Preprocessing(6.0, None)


def with_wrench(n_rows: int = 3000) -> dict[str, np.ndarray]:
    columns = motion(n_rows)
    for k, name in enumerate(WRENCH_NAMES):
        columns[name] = 10.0 * k + np.sin(columns["t"] + k)
    return columns


def wrench(columns: dict[str, np.ndarray]) -> np.ndarray:
    return np.column_stack([columns[name] for name in WRENCH_NAMES])


def imported(source, **metadata):
    said = RecordingMetadata(**metadata)
    return import_recording(source, source.with_suffix(".stored"), RecordedJoints(JOINTS), metadata=said)[0]


def streamed(recording, **how) -> np.ndarray:
    return np.concatenate([block.wrench for block in filtered_blocks(recording, PREPROCESSING, **how)])


@pytest.mark.parametrize("write", [write_csv, write_parquet])
def test_a_wrench_is_read_stored_and_streamed(tmp_path, write):
    columns = with_wrench(1000)
    recording = imported(write(tmp_path / "run.csv", columns))
    for found in (recording, open_recording(recording.path)):
        assert found.has_wrench
        np.testing.assert_array_equal(streamed(found, block_length=77), wrench(columns))


def test_a_recording_without_a_wrench_says_so(tmp_path):
    recording = imported(write_parquet(tmp_path / "run.parquet", motion(1000)))
    assert not recording.has_wrench
    assert next(filtered_blocks(recording, PREPROCESSING)).wrench is None


def test_forces_and_moments_have_units_of_their_own_and_columns_are_mapped(tmp_path):
    columns = with_wrench(1000)
    given = {name: values for name, values in columns.items() if name != "base_fz"}
    given["vertical"] = columns["base_fz"] * 1e-3
    for name in WRENCH_NAMES[3:]:
        given[name] = columns[name] * 1e3
    units = {"base_fz": "kN", "base_moment": "N mm"}
    recording = imported(write_parquet(tmp_path / "a.parquet", given), columns={"base_fz": "vertical"}, units=units)
    np.testing.assert_allclose(streamed(recording), wrench(columns), rtol=1e-12)
    with pytest.raises(RecordingError, match="choose from N, mN, kN") as caught:
        imported(tmp_path / "a.parquet", columns={"base_fz": "vertical"}, units={"base_force": "kg"})
    assert caught.value.pointer == "/units/base_force"


def test_five_of_six_columns_are_refused_by_name(tmp_path):
    columns = with_wrench(1000)
    del columns["base_my"]
    with pytest.raises(RecordingError, match="missing columns: base_my") as caught:
        imported(write_parquet(tmp_path / "run.parquet", columns))
    assert caught.value.pointer == "/columns/base_my"


def test_a_wrench_without_a_number_is_bridged(tmp_path):
    columns = with_wrench()
    columns["base_mx"][700] = np.nan
    path = write_parquet(tmp_path / "run.parquet", columns)
    recording = imported(path)
    assert np.isfinite(streamed(recording)).all()
    assert len(recording.segments) == 1


def test_a_wrench_beside_temperatures_and_velocities_keeps_its_place(tmp_path):
    columns = with_wrench(1000)
    for number in (1, 2, 3):
        columns[f"temperature{number}"] = np.full(1000, 30.0 + number)
        columns[f"dq{number}"] = np.gradient(columns[f"q{number}"], columns["t"])
    recording = imported(write_parquet(tmp_path / "run.parquet", columns), torque_delay=0.01)
    block = next(filtered_blocks(recording, PREPROCESSING))
    np.testing.assert_allclose(block.wrench, wrench(columns)[: len(block.t)], rtol=1e-9)
    np.testing.assert_allclose(block.temperature[0], [31.0, 32.0, 33.0])


def test_jittering_stamps_put_the_wrench_on_the_grid_of_the_positions(tmp_path):
    t = np.arange(3000) / 200.0
    jitter = np.random.default_rng(1).uniform(-1e-3, 1e-3, len(t))
    columns = with_wrench()
    columns["t"] = t + jitter
    for k, name in enumerate(WRENCH_NAMES):
        columns[name] = 10.0 * k + np.sin(columns["t"] + k)
    recording = imported(write_parquet(tmp_path / "run.parquet", columns), accept=("jitter",))
    times = np.concatenate([block.t for block in filtered_blocks(recording, PREPROCESSING)])
    found = streamed(recording)
    np.testing.assert_allclose(found[:, 2], 20.0 + np.sin(times + 2), atol=1e-6)


def test_arrays_take_a_wrench_of_six_columns():
    columns = with_wrench(500)
    q, tau = (np.column_stack([columns[f"{kind}{k}"] for k in (1, 2, 3)]) for kind in ("q", "tau"))
    recording = recording_from_arrays(
        columns["t"], q, tau, joint_names=JOINTS, further=FurtherColumns(wrench=wrench(columns))
    )
    np.testing.assert_array_equal(streamed(recording), wrench(columns))
    with pytest.raises(RecordingError, match="wrench has shape"):
        recording_from_arrays(
            columns["t"], q, tau, joint_names=JOINTS, further=FurtherColumns(wrench=wrench(columns)[:, :3])
        )
