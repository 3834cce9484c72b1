"""Comparisons are written to files and read out of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from support.installed_versions import older_than_locked

from dynident.recordings.arrow_tables import from_numbers, table_column_to_numbers

WRITTEN_AND_READ = """
import sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from dynident.diagnosis.comparison.comparison_files import SIGNALS, StoredComparison, write_comparison

t = np.arange(4.0)
signals = {name: np.column_stack([t + k, t]) for k, name in enumerate(SIGNALS)}
made = SimpleNamespace(t=t, segment=np.zeros(4, dtype=np.int64), joint_names=["a", "b"], units=["N m", "N"],
                       noise=np.ones(2), temperature=None, **{**signals, "phase": np.zeros((4, 2), dtype=np.int8)})
found = StoredComparison(write_comparison(made, Path(sys.argv[1])))
assert found.read_signals("a", 1.0).predicted.tolist() == [2.0, 3.0, 4.0]
assert found.compute_residual_map("b", "q_a", None, 2).count.sum() == 4
assert "pandas" not in sys.modules, "a process that never shows a frame loads pandas"
"""


@pytest.mark.skipif(older_than_locked("pyarrow"), reason="an older Arrow loads pandas by itself")
def test_signals_of_a_comparison_are_kept_and_shown_without_the_second_that_loading_pandas_takes(
    tmp_path: Path,
) -> None:
    pytest.importorskip("pandas")
    done = subprocess.run(
        [sys.executable, "-c", WRITTEN_AND_READ, str(tmp_path / "signals.parquet")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("kind", ["float64", "float32", "int64", "int8"])
def test_columns_of_numbers_are_arrays_of_the_same_numbers(kind: str) -> None:
    values = np.arange(12).reshape(6, 2).astype(kind)[:, 1]
    column = from_numbers(values)
    whole = pa.chunked_array([column.slice(0, 2), column.slice(2, 0), column.slice(2)])
    for there in (whole, whole.slice(1), pa.chunked_array([column]), whole.slice(6)):
        found = table_column_to_numbers(there)
        assert found.dtype == values.dtype
        assert found.tolist() == there.to_pylist()
    with pytest.raises(ValueError, match="1 values are missing"):
        table_column_to_numbers(pa.chunked_array([pa.array([1.0, None])]))
