"""Series that are thinned for figures keep what a reader looks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynident.diagnosis import Comparison
from dynident.reports.figures.signals_over_time import build_time_axis, find_extremes, thin_series, thin_series_together


def comparison(t, segment) -> Comparison:
    t = np.asarray(t, dtype=float)
    zero = np.zeros((len(t), 1))
    signals = ("measured", "predicted", "lower", "upper", "deviation", "q", "dq", "ddq", "load")
    return Comparison(
        joint_names=("j",),
        units=("N m",),
        t=t,
        segment=np.asarray(segment, dtype=float),
        noise=np.ones(1),
        phase=zero.astype(np.int8),
        off_halts=zero == 0,
        remembering=np.zeros(1, dtype=bool),
        free=np.zeros(1, dtype=bool),
        **dict.fromkeys(signals, zero),
    )


@given(arrays(float, st.integers(1, 400), elements=st.floats(-1e6, 1e6)), st.integers(1, 50))
def test_the_largest_and_the_least_value_survive_and_so_do_the_ends(values, bins) -> None:
    kept = find_extremes(values, bins)
    assert values[kept].max() == values.max()
    assert values[kept].min() == values.min()
    assert kept[0] == 0
    assert kept[-1] == len(values) - 1
    assert np.all(np.diff(kept) > 0)
    assert len(kept) <= 2 * bins + 2


def test_every_part_of_a_long_series_keeps_its_own_spike() -> None:
    values = np.zeros(100_000)
    spikes = np.arange(500, 100_000, 1000)
    values[spikes] = np.arange(len(spikes)) + 1
    assert set(spikes) <= set(find_extremes(values, 100))


def test_lines_are_broken_at_gaps_and_between_runs() -> None:
    t = np.concatenate([np.arange(0, 1, 0.01), np.arange(3, 4, 0.01), np.arange(4, 5, 0.01)])
    axis = build_time_axis(comparison(t, np.repeat([0, 0, 1], 100)))
    assert [(part.start, part.stop) for part in axis.intervals] == [(0, 100), (100, 200), (200, 300)]
    assert not axis.shifted
    _, values = thin_series(axis, np.ones(300), 60)
    assert np.isnan(values).sum() == 2


def test_runs_that_overlap_in_time_are_set_one_after_another() -> None:
    t = np.tile(np.arange(0, 1, 0.01), 3)
    made = comparison(t, np.repeat([0, 1, 2], 100))
    axis = build_time_axis(made)
    assert axis.shifted
    assert np.all(np.diff(axis.t) > 0)
    assert "one after another" in axis.label
    np.testing.assert_array_equal(made.t, t)
    assert build_time_axis(replace(made, t=np.arange(300) * 0.01)).label == "time (s)"


def test_stretches_are_cut_to_the_rows_that_are_wanted():
    axis = build_time_axis(comparison(np.arange(100) / 100, np.repeat([0, 1], 50)))
    wanted = np.zeros(100, dtype=bool)
    wanted[10:20] = wanted[45:60] = True
    assert axis.restrict(wanted).intervals == (slice(10, 20), slice(45, 50), slice(50, 60))
    assert axis.restrict(~wanted).intervals == (slice(0, 10), slice(20, 45), slice(60, 100))
    assert axis.restrict(np.zeros(100, dtype=bool)).intervals == ()


def test_two_lines_share_their_times_and_keep_the_extremes_of_both():
    axis = build_time_axis(comparison(np.arange(1000) / 100, np.zeros(1000)))
    lower, upper = np.zeros(1000), np.ones(1000)
    lower[333], upper[777] = -5.0, 6.0
    t, low, high = thin_series_together(axis, 40, lower, upper)
    assert len(t) == len(low) == len(high) < 200
    assert (low.min(), high.max()) == (-5.0, 6.0)
    assert [len(one) for one in thin_series_together(axis.restrict(np.zeros(1000, dtype=bool)), 40, lower)] == [0, 0]
