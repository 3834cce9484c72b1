"""What a file that cannot be used as it is lacks, in words that lead on; made of the columns of a drawn arm."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from support.drawn_recordings import guess, log, read, write

from dynident.identification.column_inference.inspection import inspect_file
from dynident.recordings import RecordingError


@pytest.mark.parametrize("seed", [1, 2])
def test_rows_in_reverse_order_are_told_as_that(tmp_path: Path, seed: int) -> None:
    given = log("ur10", seed, duration=8.0)
    columns = {name: values[::-1] for name, values in given.columns().items()}
    (asked,) = guess(given.robot, columns).questions
    assert asked.detail == "t runs backward: the rows are in reverse order. Write the earliest row first."
    with pytest.raises(RecordingError, match="the rows are in reverse order"):
        read(given.robot, tmp_path, columns)


def test_a_file_with_a_row_for_each_signal_is_to_be_transposed() -> None:
    given = log("ur10", 1, duration=8.0)
    rows = np.array(list(given.columns().values()))
    lying = {f"{value:g}": rows[1:, k] for k, value in enumerate(rows[0])}
    (asked,) = guess(given.robot, lying).questions
    assert "transpose the file" in asked.detail


def test_velocities_without_positions_do_not_suffice() -> None:
    given = log("ur10", 1, duration=8.0)
    columns = given.columns(q=np.gradient(given.q, given.t, axis=0))
    named = {name.replace("q", "dq"): values for name, values in columns.items()}
    details = [one.detail for one in guess(given.robot, named).questions]
    assert any("Velocities alone do not suffice" in detail for detail in details)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bursts_of_rows_with_one_time_are_read_without_a_warning_of_numpy(seed: int, tmp_path: Path) -> None:
    """A reader that empties its buffer now and then stamps several rows alike; the rate of the rows is the way on."""
    given = log("ur10", seed, rate=1000.0, duration=6.0)
    rng = np.random.default_rng(seed)
    late = np.maximum.accumulate(given.t + rng.exponential(2e-4, len(given.t)))
    columns = given.columns() | {"t": np.round(late, 4)}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        guess(given.robot, columns)
    with pytest.raises(RecordingError, match='say "rate": … if the rows are evenly spaced'):
        read(given.robot, tmp_path, columns)
    checks = read(given.robot, tmp_path, columns, rate=1000.0).checks
    assert [one.name for one in checks if one.status == "error"] == []


def test_a_look_at_a_file_tells_what_the_import_does_with_its_rows(tmp_path: Path) -> None:
    given = log("ur10", 4)
    columns = given.columns()
    half = len(given.t) // 2
    restarted = columns | {"t": np.concatenate([given.t[:half], given.t[: len(given.t) - half]])}
    jumped = columns | {"t": given.t + np.where(np.arange(len(given.t)) < half, 0.0, 3600.0)}
    for name, content in (("time_restarts", restarted), ("gaps", jumped)):
        proposal = inspect_file(write(tmp_path / f"{name}.parquet", content), given.robot).proposal
        assert proposal is not None
        assert proposal.is_sure
        assert [one.field for one in proposal.guesses if one.value == "noticed"] == [f"rows/{name}"]
