"""The streamed parallel filter against one convolution over everything."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from dynident.recordings import ParallelFilter, low_pass


def rows(n_rows: int, width: int = 3, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n_rows, width)), np.arange(n_rows) / 100.0, rng.random(n_rows) < 0.98


def pushed(filtering: ParallelFilter, values, t, used, lengths, starts=True):
    given_rows, start = [], 0
    for length in lengths:
        part = slice(start, start + length)
        given_rows.append(filtering.push(values[part], t[part], used[part], starts and start == 0))
        start += length
    given_rows.append(filtering.flush())
    return [np.concatenate(parts) for parts in zip(*given_rows, strict=True)]


def at_once(values, t, used, rate, cutoff, decimation):
    """The same by one full convolution (scipy), then picking rows 0, d, 2d, … that lie under a whole window."""
    taps = low_pass(rate, cutoff)
    half = len(taps) // 2
    full = np.apply_along_axis(lambda column: signal.convolve(column, taps, method="direct"), 0, values)
    chosen = np.arange(0, len(values), decimation)
    chosen = chosen[(chosen >= half) & (chosen < len(values) - half)]
    complete = [bool(used[row - half : row + half + 1].all()) for row in chosen]
    return full[chosen + half], t[chosen], np.array(complete, dtype=bool)


@st.composite
def partitions(draw):
    total = draw(st.integers(0, 1500))
    cuts = sorted(draw(st.lists(st.integers(0, total), max_size=12)))
    edges = [0, *cuts, total]
    return [end - start for start, end in pairwise(edges)]


@settings(max_examples=60, deadline=None)
@given(lengths=partitions(), cutoff=st.sampled_from([None, 2.0, 7.5, 20.0, 45.0]), decimation=st.integers(1, 60))
def test_blocks_of_any_length_give_the_rows_of_one_convolution(lengths, cutoff, decimation):
    values, t, used = rows(sum(lengths))
    got = pushed(ParallelFilter(100.0, cutoff, decimation), values, t, used, lengths)
    if not sum(lengths):
        assert not len(got[1])
        return
    wanted = at_once(values, t, used, 100.0, cutoff, decimation)
    assert got[0].shape == wanted[0].shape
    np.testing.assert_allclose(got[0], wanted[0], atol=1e-12)
    assert np.array_equal(got[1], wanted[1])
    assert np.array_equal(got[2], wanted[2])
    whole = pushed(ParallelFilter(100.0, cutoff, decimation), values, t, used, [sum(lengths)])
    assert np.array_equal(got[0], whole[0]), "cut into blocks, the result differs in the last digit"


@settings(max_examples=20, deadline=None)
@given(first=st.integers(1, 400), second=st.integers(1, 400), decimation=st.integers(1, 9))
def test_segments_are_never_filtered_across(first, second, decimation):
    values, t, used = rows(first + second)
    filtering = ParallelFilter(100.0, 6.0, decimation)
    before = filtering.push(values[:first], t[:first], used[:first], True)
    after = filtering.push(values[first:], t[first:], used[first:], True)
    got = np.concatenate([before.values, after.values, filtering.flush().values])
    parts = (slice(0, first), slice(first, first + second))
    wanted = [at_once(values[part], t[part], used[part], 100.0, 6.0, decimation)[0] for part in parts]
    np.testing.assert_allclose(got, np.concatenate(wanted), atol=1e-12)


@pytest.mark.parametrize(("cutoff", "decimation"), [(5.0, 5), (2.0, 10), (9.0, 3), (4.0, 1)])
def test_upfirdn_of_scipy_gives_the_same_rows(cutoff, decimation):
    values, t, used = rows(2000)
    filtering = ParallelFilter(100.0, cutoff, decimation)
    got, at, _ = pushed(filtering, values, t, used, [700, 1300])
    ahead = -filtering.half % decimation
    padded = np.concatenate([np.zeros((ahead, 3)), values])
    wanted = signal.upfirdn(filtering.taps, padded, down=decimation, axis=0)
    chosen = (np.rint(at * 100.0).astype(int) + filtering.half + ahead) // decimation
    np.testing.assert_allclose(got, wanted[chosen], atol=1e-12)


def test_a_matrix_in_each_row_keeps_its_shape():
    values, t, used = rows(500, width=12)
    filtering = ParallelFilter(100.0, 5.0, 4)
    flat = pushed(filtering, values, t, used, [500])[0]
    shaped = pushed(filtering, values.reshape(500, 3, 4), t, used, [200, 300])[0]
    assert shaped.shape[1:] == (3, 4)
    assert np.array_equal(shaped.reshape(len(shaped), 12), flat)


def test_slow_signals_pass_without_lag_and_fast_ones_are_kept_out():
    t = np.arange(4000) / 500.0
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 40.0 * t)
    values = np.stack([slow, fast], axis=1)
    filtering = ParallelFilter(500.0, 10.0, 10)
    got, at, _ = pushed(filtering, values, t, np.ones(4000, dtype=bool), [4000])
    assert np.abs(got[:, 0] - np.sin(2 * np.pi * at)).max() < 0.005
    assert np.abs(got[:, 1]).max() < 0.005


def test_the_same_filter_on_both_sides_keeps_the_equation():
    values, t, used = rows(900, width=5)
    parameters = np.array([3.0, -1.0, 0.5, 2.0])
    values[:, 4] = values[:, :4] @ parameters
    got = pushed(ParallelFilter(100.0, 4.0, 6), values, t, used, [400, 500])[0]
    np.testing.assert_allclose(got[:, 4], got[:, :4] @ parameters, atol=1e-12)


def test_rows_that_do_not_agree_in_number_are_refused():
    filtering = ParallelFilter(100.0, 4.0, 2)
    with pytest.raises(ValueError, match="agree"):
        filtering.push(np.zeros((5, 1)), np.zeros(4), np.ones(5, dtype=bool), True)
