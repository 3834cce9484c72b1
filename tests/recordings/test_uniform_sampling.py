"""Stamps with few digits: taken for the even clock behind them, and for nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.recordings import Recording, recording_from_arrays

JOINTS = ("joint1",)


def recorded(stamps: np.ndarray, sampled: np.ndarray, segment: np.ndarray | None = None) -> Recording:
    q = np.sin(3.0 * sampled)[:, None]
    return recording_from_arrays(stamps, q, q.copy(), joint_names=JOINTS, name="run", segment=segment)


def positions(made: Recording) -> np.ndarray:
    parts = made.source.rows(made.segments[0].first_row, made.segments[0].length, 10**6)
    return np.concatenate([rows.q for rows in parts])[:, 0]


@pytest.mark.parametrize("start", [0.0, 608.0])
def test_samples_with_stamps_of_whole_milliseconds_stay_what_they_are(start):
    """At 400 Hz such stamps are off by half a millisecond, which would shake a joint of 1 rad/s by 0.25 mrad."""
    sampled = start + np.arange(3200) / 400.0
    made = recorded(np.round(sampled, 3), sampled)
    assert made.sampling_rate == pytest.approx(400.0, rel=1e-5)
    np.testing.assert_array_equal(positions(made), np.sin(3.0 * sampled))


@settings(max_examples=25, deadline=None)
@given(st.floats(90.0, 450.0), st.floats(0.0, 1e3), st.sampled_from([3, 4]))
def test_any_even_clock_is_found_behind_rounded_stamps(rate, start, digits):
    sampled = start + np.arange(2000) / rate
    made = recorded(np.round(sampled, digits), sampled)
    count = min(len(positions(made)), len(sampled))
    assert count >= 1999
    assert made.sampling_rate == pytest.approx(rate, rel=1e-3)
    assert np.abs(positions(made)[:count] - np.sin(3.0 * sampled[:count])).max() < 1e-9


def test_a_clock_that_jitters_by_more_than_its_digits_is_taken_at_its_word():
    rng = np.random.default_rng(0)
    sampled = np.cumsum(rng.choice([0.010, 0.012], 3000))
    made = recorded(sampled, sampled)
    grid = made.segments[0].start_time + np.arange(made.segments[0].length) / made.sampling_rate
    assert np.abs(positions(made) - np.sin(3.0 * grid)).max() < 1e-4


def test_lost_samples_leave_the_clock_as_even_as_it_is():
    sampled = np.delete(np.arange(3000) / 400.0, [700, 1500, 1501])
    made = recorded(np.round(sampled, 3), sampled)
    grid = made.segments[0].start_time + np.arange(made.segments[0].length) / made.sampling_rate
    assert np.abs(positions(made) - np.sin(3.0 * grid)).max() < 5e-6


def test_runs_of_one_file_have_one_clock_whenever_they_begin():
    first, second = np.arange(1500) / 400.0, 1000.0007 + np.arange(1500) / 400.0
    sampled = np.concatenate([first, second])
    made = recorded(np.round(sampled, 3), sampled, np.repeat([0, 1], 1500))
    assert len(made.segments) == 2
    np.testing.assert_array_equal(positions(made), np.sin(3.0 * first))
