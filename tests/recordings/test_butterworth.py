"""Butterworth filters in second-order sections against SciPy's, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from dynident.expressions.recursive_filter import filter_sections
from dynident.recordings.low_pass_decimation import ATTENUATION, correlate_white_noise, low_pass
from dynident.recordings.position_filter import compute_steady_state, design_butterworth


@settings(max_examples=60, deadline=None)
@given(order=st.integers(1, 10), rate=st.floats(10.0, 1e4), share=st.floats(1e-3, 0.49))
def test_a_design_is_that_of_scipy(order: int, rate: float, share: float) -> None:
    sections, poles = design_butterworth(rate, share * rate, order)
    expected = signal.butter(order, share * rate, fs=rate, output="sos")
    np.testing.assert_array_equal(sections, expected)
    np.testing.assert_array_equal(compute_steady_state(sections), signal.sosfilt_zi(expected))
    np.testing.assert_array_equal(poles, signal.butter(order, share * rate, fs=rate, output="zpk")[1])


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 50.0, 80.0, np.nan])
def test_a_cutoff_outside_the_band_is_refused(cutoff: float) -> None:
    with pytest.raises(ValueError, match="must be between 0 and 50 Hz"):
        design_butterworth(100.0, cutoff, 4)


@settings(max_examples=30, deadline=None)
@given(order=st.integers(1, 7), n=st.integers(1, 13), m=st.integers(1, 300), seed=st.integers(0, 99))
def test_samples_are_filtered_as_by_scipy(order: int, n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sections = signal.butter(order, rng.uniform(0.01, 0.9), output="sos")
    state = rng.normal(size=(len(sections), 2, n))
    before = state.copy()
    wide = rng.normal(size=(m, 2 * n))
    for values in (wide[:, :n], wide[::-1, n:], np.asfortranarray(wide[:, :n]), wide[::2, :n]):
        found = filter_sections(sections, values, state)
        for actual, expected in zip(found, signal.sosfilt(sections, values, axis=0, zi=state), strict=True):
            np.testing.assert_array_equal(actual, expected)
    np.testing.assert_array_equal(state, before)


def test_no_samples_leave_the_state() -> None:
    sections, state = signal.butter(4, 0.1, output="sos"), np.ones((2, 2, 3))
    filtered, after = filter_sections(sections, np.empty((0, 3)), state)
    assert filtered.shape == (0, 3)
    np.testing.assert_array_equal(after, state)
    with pytest.raises(ValueError, match="does not fit"):
        filter_sections(sections, np.zeros((5, 2)), state)


@pytest.mark.parametrize(("rate", "cutoff"), [(100.0, 5.0), (1000.0, 20.0), (100.0, 48.0)])
def test_the_taps_of_the_parallel_filter_are_those_of_scipy(rate: float, cutoff: float) -> None:
    taps = low_pass(rate, cutoff)
    window = ("kaiser", signal.kaiser_beta(ATTENUATION))
    np.testing.assert_array_equal(taps, signal.firwin(len(taps), cutoff, window=window, fs=rate))


def test_white_noise_behind_the_low_pass_is_correlated_as_stated():
    rate, cutoff, decimation = 500.0, 20.0, 5
    noise = np.random.default_rng(1).standard_normal(400_000)
    rows = np.convolve(noise, low_pass(rate, cutoff), "valid")
    stated = correlate_white_noise(rate, cutoff)
    middle = len(stated) // 2
    assert stated[middle] == 1.0
    measured = [rows[: len(rows) - lag] @ rows[lag:] / (rows @ rows) for lag in (5, 10, 25)]
    assert stated[[middle + lag for lag in (5, 10, 25)]] == pytest.approx(measured, abs=0.02)
    # The sum over decimated lags is by how much the variance of a mean of rows is larger than of independent ones.
    means = rows[::decimation][: len(rows) // decimation // 400 * 400].reshape(-1, 400).mean(axis=1)
    factor = stated[middle % decimation :: decimation].sum()
    assert 400 * means.var() / rows.var() == pytest.approx(factor, rel=0.25)
    assert correlate_white_noise(rate, None) == pytest.approx([1.0])
