"""The streamed position filter and differences against scipy's filter over the whole segment at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from dynident.recordings import Preprocessing, Recording, RecordingError, filtered_blocks, recording_from_arrays
from dynident.recordings.low_pass_decimation import stream_samples
from dynident.recordings.recording import StoredRows


class Pieces:
    """A source that gives its rows in pieces of odd lengths, as a file may."""

    def __init__(self, q, tau, piece):
        self.q, self.tau, self.piece = q, tau, piece

    def rows(self, first, length, block_length):
        step = min(self.piece, block_length)
        for start in range(first, first + length, step):
            part = slice(start, min(start + step, first + length))
            yield StoredRows(self.q[part], self.tau[part], None)


def random_walk(n_rows: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.arange(n_rows) / 500.0, np.cumsum(rng.normal(0, 0.01, (n_rows, 2)), axis=0), rng.normal(0, 1, (n_rows, 2))


def joined(recording: Recording, choice: Preprocessing, **how) -> dict[str, np.ndarray]:
    blocks = list(filtered_blocks(recording, choice, **how))
    names = ("t", "q", "dq", "ddq", "dddq", "ddddq", "tau", "used")
    return {name: np.concatenate([getattr(b, name) for b in blocks]) for name in names}


def reference(q: np.ndarray, rate: float, cutoff: float, order: int) -> tuple[np.ndarray, ...]:
    """q and its four derivatives; NaN where neighbours are missing."""
    filtered = signal.sosfiltfilt(signal.butter(order, cutoff, fs=rate, output="sos"), q, axis=0)
    stencils = (
        np.array([1, -8, 0, 8, -1]) / 12,
        np.array([-1, 16, -30, 16, -1]) / 12,
        [-0.5, 1, 0, -1, 0.5],
        [1, -4, 6, -4, 1],
    )
    found = [filtered]
    for k, stencil in enumerate(stencils, start=1):
        reach = len(stencil) // 2
        inner = sum(w * filtered[i : len(q) - 2 * reach + i] for i, w in enumerate(stencil))
        found.append(np.pad(inner * rate**k, ((reach, reach), (0, 0)), constant_values=np.nan))
    return tuple(found)


@settings(max_examples=25, deadline=None)
@given(
    n_rows=st.integers(40, 40_000),
    cutoff=st.floats(3.0, 200.0),
    order=st.integers(1, 8),
    piece=st.integers(1, 9000),
    block=st.integers(1, 5000),
)
def test_blocks_equal_the_filter_over_the_whole_segment(n_rows, cutoff, order, piece, block):
    block = max(block, n_rows // 200)
    t, q, tau = random_walk(n_rows)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    recording = replace(recording, source=Pieces(q, tau, max(piece, n_rows // 200)))
    got = joined(recording, Preprocessing(cutoff, None, filter_order=order), block_length=block)
    wanted = reference(q, recording.sampling_rate, cutoff, order)
    assert np.array_equal(got["tau"], tau)
    np.testing.assert_allclose(got["t"], t, atol=1e-9)
    names = ("q", "dq", "ddq", "dddq", "ddddq")
    for derivative, (name, values) in enumerate(zip(names, wanted, strict=True)):
        inner = slice(2, -2) if name != "q" else slice(None)
        # Differencing magnifies the rounding errors of scipy's filter itself: some 700 ulp of q for slow, steep ones.
        rounding = 1e-12 * np.abs(q).max() * recording.sampling_rate**derivative
        assert np.abs(got[name][inner] - values[inner]).max() <= 1e-9 * np.abs(values[inner]).max() + rounding


def test_a_slow_cutoff_at_a_fast_clock_needs_no_more_than_the_overlap():
    rng = np.random.default_rng(1)
    q = np.cumsum(rng.normal(0, 1e-3, (120_000, 1)), axis=0)
    recording = recording_from_arrays(np.arange(120_000) / 5000.0, q, q, joint_names=("a",))
    recording = replace(recording, source=Pieces(q, q, 3000))
    got = joined(recording, Preprocessing(5.0, None))
    wanted = signal.sosfiltfilt(signal.butter(4, 5.0, fs=recording.sampling_rate, output="sos"), q, axis=0)
    assert np.abs(got["q"] - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.parametrize(("n_rows", "cutoff", "wider"), [(30_000, 8.0, 18.0), (40_000, 1.0, 100.0), (30, 8.0, 18.0)])
def test_the_acceleration_may_pass_a_wider_filter_and_the_other_derivatives_stay_as_they_are(n_rows, cutoff, wider):
    t, q, tau = random_walk(n_rows)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    recording = replace(recording, source=Pieces(q, tau, 900))
    got = joined(recording, Preprocessing(cutoff, 0.7 * cutoff), acceleration_cutoff=wider)
    narrow = joined(recording, Preprocessing(cutoff, 0.7 * cutoff))
    for name in sorted(narrow.keys() - {"ddq"}):
        assert np.array_equal(got[name], narrow[name]), name
    wanted = reference(q, recording.sampling_rate, wider, 4)[2][2:-2]
    assert np.abs(got["ddq"][2:-2] - wanted).max() <= 1e-8 * np.abs(wanted).max()


def test_derivatives_are_those_of_a_known_motion():
    t = np.arange(4000) / 500.0
    w = 2 * np.pi * 0.7
    q = np.sin(w * t)[:, None]
    got = joined(recording_from_arrays(t, q, q, joint_names=("a",)), Preprocessing(20.0, None))
    used = got["used"]
    inner = (t > 1.0) & (t < 7.0)
    assert np.abs(got["dq"][inner, 0] - w * np.cos(w * t[inner])).max() < 1e-4 * w
    assert np.abs(got["ddq"][inner, 0] + w * w * np.sin(w * t[inner])).max() < 1e-4 * w * w
    assert np.abs(got["ddq"][used, 0] + w * w * np.sin(w * t[used])).max() < 0.05 * w * w
    assert np.abs(got["dddq"][inner, 0] + w**3 * np.cos(w * t[inner])).max() < 2e-4 * w**3
    assert np.abs(got["ddddq"][inner, 0] - w**4 * np.sin(w * t[inner])).max() < 2e-3 * w**4


@given(borders=st.lists(st.integers(1, 1999), max_size=6))
@settings(max_examples=15, deadline=None)
def test_high_derivatives_are_the_same_wherever_blocks_end(borders):
    t, q, tau = random_walk(2000)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    choice = Preprocessing(12.0, None)
    whole = joined(recording, choice, block_length=5000)
    for block in {1 + (b % 700) for b in borders}:
        cut = joined(replace(recording, source=Pieces(q, tau, 3 * block)), choice, block_length=block)
        for name in ("dddq", "ddddq"):
            np.testing.assert_allclose(cut[name], whole[name], atol=1e-7 * np.abs(whole[name]).max())


def test_runs_in_one_file_are_never_filtered_across():
    t, q, tau = random_walk(3000)
    q[1700:] += 5.0
    label = np.repeat([4, 9], [1700, 1300])
    clock = np.concatenate([t[:1700], t[:1300]])
    both = recording_from_arrays(clock, q, tau, joint_names=("a", "b"), segment=label)
    assert [segment.label for segment in both.segments] == [4, 9]
    choice = Preprocessing(8.0, None)
    for index, part in enumerate((slice(0, 1700), slice(1700, 3000))):
        alone = recording_from_arrays(clock[part], q[part], tau[part], joint_names=("a", "b"))
        alone = replace(alone, sampling_rate=both.sampling_rate)
        got, wanted = joined(both, choice, segments=[index]), joined(alone, choice)
        for name in wanted:
            assert np.array_equal(got[name], wanted[name]), name


def test_each_segment_starts_once_and_its_blocks_follow_each_other():
    t, q, tau = random_walk(3000)
    label = np.repeat([0, 1, 2], 1000)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"), segment=label)
    blocks = list(filtered_blocks(recording, Preprocessing(8.0, None), block_length=300))
    assert [block.segment for block in blocks if block.starts_segment] == [0, 1, 2]
    np.testing.assert_allclose(np.concatenate([block.t for block in blocks]), t, atol=1e-9)


def test_windows_choose_rows_and_leave_the_filter_its_surroundings():
    t, q, tau = random_walk(4000)
    whole = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    cut = whole.with_windows(((2.0, 3.0), (5.0, 5.5)))
    everything, chosen = joined(whole, Preprocessing(8.0, None)), joined(cut, Preprocessing(8.0, None))
    assert np.array_equal(everything["q"], chosen["q"])
    inside = ((t >= 2.0) & (t <= 3.0)) | ((t >= 5.0) & (t <= 5.5))
    assert np.array_equal(chosen["used"], inside)


def test_rows_near_the_ends_of_a_segment_are_not_used():
    t, q, tau = random_walk(4000)
    used = joined(recording_from_arrays(t, q, tau, joint_names=("a", "b")), Preprocessing(5.0, None))["used"]
    lost = int(np.argmax(used))
    assert 0.2 < lost / 500.0 < 0.8
    assert np.array_equal(used, used[::-1])


@pytest.mark.parametrize("n_rows", [8, 9, 15, 30])
def test_a_segment_shorter_than_the_filter_gives_rows_that_are_not_used(n_rows):
    t, q, tau = random_walk(n_rows)
    got = joined(recording_from_arrays(t, q, tau, joint_names=("a", "b")), Preprocessing(5.0, None))
    assert len(got["q"]) == n_rows
    assert not got["used"].any()
    assert all(np.isfinite(values).all() for values in got.values())


def test_without_a_filter_positions_stay_as_they_are():
    t, q, tau = random_walk(1000)
    got = joined(recording_from_arrays(t, q, tau, joint_names=("a", "b")), Preprocessing(None, None), block_length=7)
    assert np.array_equal(got["q"], q)
    slope = (8 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) * 500.0 / 12
    np.testing.assert_allclose(got["dq"][2:-2], slope, atol=1e-9)
    fourth = (q[4:] - 4 * q[3:-1] + 6 * q[2:-2] - 4 * q[1:-3] + q[:-4]) * 500.0**4
    np.testing.assert_allclose(got["ddddq"][2:-2], fourth, rtol=1e-9, atol=1e-3)


def test_a_cutoff_above_the_nyquist_frequency_is_refused_and_the_frequency_named():
    t, q, tau = random_walk(1000)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    with pytest.raises(RecordingError, match="250 Hz") as caught:
        next(filtered_blocks(recording, Preprocessing(300.0, None)))
    assert caught.value.pointer == "/preprocessing/position_cutoff"


def test_a_block_is_split_without_losing_a_sample():
    t, q, tau = random_walk(1000)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    (whole,) = filtered_blocks(recording, Preprocessing(None, None))
    parts = list(whole.split(300))
    assert [len(part.t) for part in parts] == [300, 300, 300, 100]
    assert [part.starts_segment for part in parts] == [True, False, False, False]
    for name in ("t", "q", "dq", "ddq", "dddq", "ddddq", "tau", "used"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name), strict=True
        )
    assert list(whole.split(1000)) == [whole]


@pytest.mark.parametrize("width", [5, 2_000, 20_000])
def test_of_many_columns_few_samples_are_evaluated_at_once(width):
    """Robots on their feet have 20,000 columns and more: a block of all samples would take gigabytes."""
    t, q, tau = random_walk(4000)
    recording = recording_from_arrays(t, q, tau, joint_names=("a", "b"))
    lengths = []

    def values(block):
        lengths.append(len(block.t))
        return block.q

    list(stream_samples(recording, Preprocessing(10.0, 10.0), values, width=width))
    assert sum(lengths) == 4000
    assert max(lengths) * width < 50e6 / 8
