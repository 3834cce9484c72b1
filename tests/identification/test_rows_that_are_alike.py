"""Tests check like rows against their robot once; rows of which one sample is another are not alike."""

from __future__ import annotations

import numpy as np
import pytest
from support.drawn_recordings import log
from support.rows_alike import outline_rows


def outline(q: np.ndarray, tau: np.ndarray) -> object:
    return outline_rows([(q[:700], tau[:700]), (q[700:], tau[700:])])


def test_rows_that_were_written_with_nine_digits_are_alike() -> None:
    given = log(duration=10.0)
    written = (np.array([float(f"{one:.9g}") for one in values.ravel()]) for values in (given.q, given.tau))
    assert outline(*(values.reshape(given.q.shape) for values in written)) == outline(given.q, given.tau)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("row", [0, 699, 700, 999])
def test_rows_with_one_sample_off_are_not(row: int, joint: int) -> None:
    given = log(duration=10.0)
    for values in (given.q, given.tau):
        changed = values.copy()
        changed[row, joint] += 0.02 * values[:, joint].std()
        q, tau = (changed, given.tau) if values is given.q else (given.q, changed)
        assert outline(q, tau) != outline(given.q, given.tau)


def test_rows_in_another_order_or_unit_are_not() -> None:
    given = log(duration=10.0)
    as_is = outline(given.q, given.tau)
    assert outline(given.q[::-1], given.tau[::-1]) != as_is
    assert outline(given.q[:, ::-1], given.tau) != as_is
    assert outline(given.q, -given.tau) != as_is
    assert outline(given.q, 1.001 * given.tau) != as_is
    assert outline(given.q + 0.001, given.tau) != as_is


def test_rows_with_a_sample_that_is_no_number_are_alike_only_where_they_are_the_same() -> None:
    given = log(duration=10.0)
    rows = [(given.q, np.where(given.q > 0, np.nan, given.tau))]
    assert outline_rows(rows) is rows
    assert outline_rows([]) == []
