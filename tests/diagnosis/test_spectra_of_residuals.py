"""Spectra over time and angle, and autocorrelation, on signals whose spectra are known."""

from __future__ import annotations

import numpy as np
import pytest
from support.hidden_effects import ROBOT
from support.oracles import fourier_motion

from dynident.diagnosis import angle_spectrum, autocorrelation, time_spectrum
from dynident.diagnosis.comparison.residual_autocorrelation_and_spectra import count_independent_squares
from dynident.errors import DynidentError

T = np.arange(4000) / 50.0
ONE = np.zeros(len(T))


def white(seed: int, count: int = len(T)):
    return np.random.default_rng(seed).normal(size=count)


def test_a_vibration_stands_in_the_time_spectrum_with_its_frequency_and_amplitude():
    found = time_spectrum(T, ONE, 0.8 * np.sin(2 * np.pi * 7.3 * T + 1) + 0.1 * white(0) + 5.0)
    peak = found.list_highest_peaks()[0]
    assert found.frequency[peak] == pytest.approx(7.3, abs=found.resolution)
    assert found.amplitude[peak] == pytest.approx(0.8, rel=0.15)
    assert found.over == "time"
    assert found.is_line(peak)


def test_noise_has_peaks_but_none_that_stands_out():
    found = time_spectrum(T, ONE, white(7))
    assert not any(found.is_line(k) for k in found.list_highest_peaks())


def test_gaps_and_segments_are_not_taken_for_signal():
    segment = np.repeat([0.0, 1.0], len(T) // 2)
    t = T + np.where(segment == 1, 300.0, 0.0)
    found = time_spectrum(t, segment, np.sin(2 * np.pi * 3.0 * t))
    peak = found.list_highest_peaks()[0]
    assert found.frequency[peak] == pytest.approx(3.0, abs=found.resolution)
    assert found.amplitude[peak] == pytest.approx(1.0, rel=0.15)


def test_a_ripple_stands_in_the_angle_spectrum_with_its_amplitude_however_the_joint_moves():
    motion = fourier_motion(ROBOT, 60.0, 50.0, 3)
    q, dq = motion.q[:, 4], motion.dq[:, 4]
    for k in (9.0, 40.0, 121.0):
        found = angle_spectrum(q, dq, 0.5 * np.sin(k * q + 0.4) + 0.1 * white(1, len(q)))
        peak = found.list_highest_peaks()[0]
        assert found.frequency[peak] * 2 * np.pi == pytest.approx(k, abs=2 * np.pi * found.resolution)
        assert found.amplitude[peak] == pytest.approx(0.5, rel=0.2)


def test_a_joint_at_rest_has_no_angle_spectrum_and_says_so():
    with pytest.raises(DynidentError, match="moves through") as caught:
        angle_spectrum(0.01 * np.sin(T), 0.01 * np.cos(T), white(2))
    assert caught.value.pointer == "joint"


def test_too_few_rows_for_a_spectrum_are_answered_with_what_to_do():
    with pytest.raises(DynidentError, match="longer recording"):
        time_spectrum(T[:10], ONE[:10], white(3)[:10])


def test_white_noise_is_worth_all_its_samples():
    found = autocorrelation(T, ONE, white(4))
    assert found.value[0] == 1.0
    assert np.abs(found.value[1:]).max() < 3 * found.limit
    assert found.effective_samples > 0.7 * len(T)


def test_a_residual_with_memory_is_worth_as_many_samples_as_theory_says():
    for memory in (0.5, 0.9):
        x = np.zeros(40_000)
        noise = white(5, len(x))
        for k in range(1, len(x)):
            x[k] = memory * x[k - 1] + noise[k]
        t = np.arange(len(x)) / 50.0
        found = autocorrelation(t, np.zeros(len(t)), x)
        np.testing.assert_allclose(found.value[:6], memory ** np.arange(6), atol=0.05)
        assert found.effective_samples == pytest.approx(len(x) * (1 - memory) / (1 + memory), rel=0.2)
        squares = count_independent_squares([x])
        assert squares == pytest.approx(len(x) * (1 - memory**2) / (1 + memory**2), rel=0.2)


def test_lags_are_in_seconds_and_do_not_reach_across_a_gap():
    segment = np.repeat(np.arange(40.0), 100)
    t = T + 10.0 * segment
    level = np.random.default_rng(6).normal(size=40)
    found = autocorrelation(t, segment, np.repeat(level, 100))
    assert found.lag[1] == pytest.approx(0.02)
    assert found.lag[-1] == pytest.approx(99 * 0.02)
    # Each segment is constant: what is common decays with the share of the segment that is left, not at once.
    np.testing.assert_allclose(found.value, 1.0 - np.arange(100) / 100.0, atol=1e-9)
