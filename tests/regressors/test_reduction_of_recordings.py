"""Streaming into triangular factors against a dense W made of Pinocchio, scipy and numpy, all at once in memory."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import signal
from support.oracles import arm, fourier_motion, pinocchio_rows, pinocchio_torque

import dynident.recordings.low_pass_decimation as stream
from dynident import parallel
from dynident.effects import STOP, EffectChoice, ReferenceParameters
from dynident.effects.effect_signals import MemorySignal
from dynident.effects.hysteresis_states import step_state
from dynident.estimation import compute_errors, solve_ordinary, solve_weighted
from dynident.recordings import (
    Preprocessing,
    Recording,
    Segment,
    compute_edge_margin,
    filtered_blocks,
    low_pass,
    recording_from_arrays,
)
from dynident.recordings.recording import StoredRows
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.qr_accumulation import choose_block_length, compute_used_duration
from dynident.regressors.row_phases import RowPhases

ROBOT = arm("scara")
N = ROBOT.n
RATE = 100.0
# The acceleration passes a filter of its own.
PREPROCESSING = Preprocessing(position_cutoff=8.4, torque_cutoff=6.0, decimation=4)
SLIP = 5e-3
EFFECTS = (
    *(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")),
    EffectChoice("load_dependent_friction", (ROBOT.joint_names[1],)),
    EffectChoice("presliding", (ROBOT.joint_names[0],), (("d0", SLIP),)),
)
MODEL = build_model(ROBOT, EFFECTS)
REFERENCE = ReferenceParameters.from_links(ROBOT.inertias, ROBOT.n)


def recording(seconds: float, seed: int, parts: int = 1, windows=(), gap: float = 3.0) -> Recording:
    """Runs of different motions in one file, `gap` seconds apart."""
    times, positions, torques, labels = [], [], [], []
    start = 0.0
    for part in range(parts):
        motion = fourier_motion(ROBOT, seconds, RATE, 10 * seed + part)
        noise = np.random.default_rng(seed).normal(0, 0.3, motion.q.shape)
        friction = np.array([4.0, 3.0, 9.0, 0.5]) * np.sign(motion.dq) + motion.dq
        times.append(start + motion.t)
        positions.append(motion.q + (part % 2) * 0.7)
        torques.append(pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + friction + noise)
        labels.append(np.full(len(motion.t), part))
        start = times[-1][-1] + gap
    return recording_from_arrays(
        np.concatenate(times),
        np.concatenate(positions),
        np.concatenate(torques),
        joint_names=ROBOT.joint_names,
        segment=np.concatenate(labels),
        windows=windows,
        name=f"run {seed}",
    )


def stored(recording: Recording, segment) -> tuple[np.ndarray, np.ndarray]:
    rows = list(recording.source.rows(segment.first_row, segment.length, 10**9))
    return np.concatenate([r.q for r in rows]), np.concatenate([r.tau for r in rows])


def dense(recordings, preprocessing=PREPROCESSING) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """W (rows, n, b) and Y (rows, n) of all recordings, zero where a row is no equation of its joint; which are."""
    found = [dense_segment(r, k, preprocessing) for r in recordings for k in range(len(r.segments))]
    return tuple(np.concatenate(items) for items in zip(*found, strict=True))


def dense_segment(recording: Recording, number: int, preprocessing: Preprocessing):
    segment = recording.segments[number]
    q, tau = stored(recording, segment)
    rate = recording.sampling_rate
    order, cutoff, raw = preprocessing.filter_order, preprocessing.position_cutoff, q
    if cutoff is not None:
        q = signal.sosfiltfilt(signal.butter(order, cutoff, fs=rate, output="sos"), raw, axis=0)
    wide = preprocessing.find_acceleration_cutoff(rate)
    # Without a wider filter the acceleration passes that of the positions.
    quick = q if wide is None else signal.sosfiltfilt(signal.butter(order, wide, fs=rate, output="sos"), raw, axis=0)
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    dq[2:-2] = (8 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) * rate / 12
    ddq[2:-2] = (16 * (quick[3:-1] + quick[1:-3]) - 30 * quick[2:-2] - (quick[4:] + quick[:-4])) * rate**2 / 12
    columns = all_columns(q, dq, ddq)[:, :, list(MODEL.base.kept)]
    t = segment.start_time + np.arange(len(q)) / rate
    margin = compute_edge_margin(preprocessing, rate)
    used = recording.inside_windows(t)
    used[:margin] = used[len(used) - margin :] = False
    taps = low_pass(rate, preprocessing.torque_cutoff)
    phases = RowPhases.from_recording(MODEL.observation, recording, preprocessing)
    both = np.concatenate([columns, tau[:, :, None]], axis=2)
    both[~phases.find_certain_samples(number, t)] = 0.0
    wide = both.reshape(len(q), -1)
    valid = np.array([np.convolve(column, taps, mode="valid") for column in wide.T]).T
    complete = np.convolve(used.astype(float), np.ones(len(taps)), mode="valid") > len(taps) - 0.5
    # Row 0, d, 2d, … of the segment, as far as the filter's window around it lies inside.
    kept = slice(-(len(taps) // 2) % preprocessing.decimation, None, preprocessing.decimation)
    rows = valid[kept][complete[kept]]
    rows = rows.reshape(len(rows), N, -1)
    # As the stream counts time: where a filter is as wide as so many samples, rounding decides about a border's row.
    times = segment.start_time + np.arange(len(taps) // 2, len(q) - len(taps) // 2) * recording.period
    times = times[kept][complete[kept]]
    equations = phases.find_used_rows(number, times)
    rows[~equations] = 0.0
    return rows[:, :, :-1], rows[:, :, -1], equations


def all_columns(q, dq, ddq) -> np.ndarray:
    rigid = pinocchio_rows(ROBOT, q, dq, ddq)
    load = rigid @ REFERENCE.inertias.ravel()
    ones = np.ones_like(q)
    per_joint = [np.eye(N) * values[:, :, None] for values in (ddq, np.sign(dq), dq, ones)]
    friction = np.zeros((len(q), N, 1))
    friction[:, 1, 0] = np.abs(load[:, 1]) * np.sign(dq[:, 1])
    z, state, before = np.empty(len(q)), 0.0, q[0, 0]
    for k, here in enumerate(q[:, 0]):
        state = step_state(MemorySignal(STOP, 0, SLIP), state, here - before)
        z[k], before = state, here
    presliding = np.zeros((len(q), N, 2))
    presliding[:, 0, 0], presliding[:, 0, 1] = z, np.abs(load[:, 0]) * z
    return np.concatenate([rigid, *per_joint, friction, presliding], axis=2)


def least_squares(w: np.ndarray, y: np.ndarray, noise=None) -> np.ndarray:
    noise = np.ones(N) if noise is None else noise
    a = (w / noise[:, None]).reshape(-1, w.shape[2])
    scale = np.linalg.norm(a, axis=0)
    return np.linalg.lstsq(a / scale, (y / noise).ravel(), rcond=None)[0] / scale


def assert_same_solution(recordings, preprocessing=PREPROCESSING) -> None:
    w, y, equations = dense(recordings, preprocessing)
    reduction = reduce_recordings(MODEL.observation, RegressorInputs(recordings, preprocessing, REFERENCE))
    assert reduction.n_rows == equations.sum() < y.size
    expected = least_squares(w, y)
    found = solve_ordinary(reduction).values
    # In torque: what a poorly determined parameter is off by must not be seen either.
    predicted, wanted = w @ found, w @ expected
    np.testing.assert_allclose(predicted, wanted, atol=1e-8 * np.abs(wanted).max())
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-8 * np.abs(expected).max())
    residual = ((y - wanted) ** 2).sum(axis=0)
    np.testing.assert_allclose(compute_errors(reduction, found).squares, residual, rtol=1e-9)
    np.testing.assert_allclose(compute_errors(reduction, found).measured, (y**2).sum(axis=0), rtol=1e-11)


def test_streaming_gives_the_solution_of_the_whole_matrix():
    assert_same_solution([recording(20, 1)])


def test_several_recordings_with_segments_and_windows_give_the_solution_of_the_whole_matrix():
    assert_same_solution(
        [recording(12, 1), recording(9, 2, parts=3), recording(15, 3, windows=((2.0, 6.5), (7.03, 13.0)))]
    )


@pytest.mark.parametrize(
    "preprocessing",
    [
        Preprocessing(None, None),
        Preprocessing(None, 5.0, 3),
        Preprocessing(12.0, None, 7),
        Preprocessing(6.0, 2.0, 10, filter_order=2),
    ],
    ids=["nothing", "torque alone", "position alone", "narrow"],
)
def test_any_preprocessing_gives_the_solution_of_the_whole_matrix(preprocessing):
    assert_same_solution([recording(14, 4, parts=2)], preprocessing)


def test_weighted_least_squares_is_that_of_the_whole_matrix():
    recordings = [recording(15, 5), recording(10, 6)]
    w, y, equations = dense(recordings)
    chi = least_squares(w, y)
    share = 1 - w.shape[2] / equations.sum()
    for _ in range(20):
        noise = np.sqrt(((y - w @ chi) ** 2).sum(axis=0) / equations.sum(axis=0) / share)
        chi = least_squares(w, y, noise)
    solution = solve_weighted(
        reduce_recordings(MODEL.observation, RegressorInputs(recordings, PREPROCESSING, REFERENCE))
    )
    # Rounds end once the noise changes by a millionth.
    np.testing.assert_allclose(solution.values, chi, rtol=1e-5, atol=1e-6 * np.abs(chi).max())
    np.testing.assert_allclose(solution.noise, noise, rtol=1e-5)


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(length=st.integers(1, 700))
def test_the_length_of_blocks_changes_nothing(monkeypatch, length):
    recordings = [recording(8, 1, parts=2, windows=((1.0, 14.0),))]
    with monkeypatch.context() as patch:
        patch.setattr(stream, "filtered_blocks", lambda *r, **p: filtered_blocks(*r, **p, block_length=length))
        cut = reduce_recordings(MODEL.observation, RegressorInputs(recordings, PREPROCESSING, REFERENCE))
    whole = reduce_recordings(MODEL.observation, RegressorInputs(recordings, PREPROCESSING, REFERENCE))
    np.testing.assert_array_equal(cut.spans, whole.spans)
    for one, other in zip(cut.equations, whole.equations, strict=True):
        np.testing.assert_array_equal(one.counts, other.counts)
        gram, expected = (f.transpose(0, 2, 1) @ f for f in (one.factors, other.factors))
        np.testing.assert_allclose(gram, expected, atol=1e-9 * np.abs(expected).max())


def test_two_runs_in_one_file_are_the_same_as_two_files():
    together = recording(10, 7, parts=2)
    apart = []
    for segment in together.segments:
        q, tau = stored(together, segment)
        t = segment.start_time + np.arange(len(q)) / RATE
        apart.append(recording_from_arrays(t, q, tau, joint_names=ROBOT.joint_names))
    one, two = (
        reduce_recordings(MODEL.observation, RegressorInputs(group, PREPROCESSING, REFERENCE))
        for group in ([together], apart)
    )
    assert one.n_rows == two.n_rows
    np.testing.assert_allclose(solve_ordinary(one).values, solve_ordinary(two).values, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(one.spans, two.spans)


def test_stretches_cover_the_windows_end_to_end_and_none_spans_two_runs():
    run = recording(12, 8, parts=2, gap=0.01)
    reduction = reduce_recordings(MODEL.observation, RegressorInputs([run], PREPROCESSING, REFERENCE))
    length = choose_block_length([run])
    assert (np.diff(reduction.spans, axis=1) <= length + 1e-9).all()
    assert (np.diff(reduction.spans.ravel()) >= 0).all()
    border = run.segments[1].start_time
    assert not ((reduction.spans[:, 0] < border) & (reduction.spans[:, 1] >= border)).any()


def test_stretches_are_a_twentieth_of_the_data_within_a_quarter_and_two_seconds():
    assert choose_block_length([recording(12, 1)]) == pytest.approx(12 / 20, rel=0.01)
    assert choose_block_length([recording(4, 1)]) == pytest.approx(0.25)
    assert choose_block_length([recording(60, 1)]) == pytest.approx(2.0)
    assert compute_used_duration(recording(20, 1, windows=((-5.0, 2.0), (3.0, 4.0)))) == pytest.approx(3.0)


def test_progress_runs_from_low_to_one_and_may_cancel():
    seen: list[float] = []
    recordings = [recording(10, 1), recording(10, 2)]
    reduce_recordings(
        MODEL.observation,
        RegressorInputs(recordings, PREPROCESSING, REFERENCE),
        lambda share, message: seen.append(share),
    )
    assert seen
    assert seen == sorted(seen)
    assert 0.9 < seen[-1] <= 1.0

    def cancel(share: float, message: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reduce_recordings(MODEL.observation, RegressorInputs(recordings, PREPROCESSING, REFERENCE), cancel)


def test_a_window_shorter_than_the_filter_leaves_no_rows():
    run = recording(10, 1, windows=((5.0, 5.1),))
    reduction = reduce_recordings(MODEL.observation, RegressorInputs([run], PREPROCESSING, REFERENCE))
    assert reduction.n_rows == 0
    assert reduction.n_blocks == 0


class Endless:
    """Rows of a periodic motion of any length, made as they are read."""

    def __init__(self) -> None:
        motion = fourier_motion(ROBOT, 10.0, RATE, 1)
        self.q = motion.q
        self.tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)

    def rows(self, first, length, block_length):
        for start in range(first, first + length, block_length):
            index = np.arange(start, min(start + block_length, first + length)) % len(self.q)
            yield StoredRows(self.q[index], self.tau[index], None)


@pytest.mark.slow
def test_ten_times_the_data_takes_no_more_memory(monkeypatch: pytest.MonkeyPatch):
    # How many of the few blocks that another thread makes ahead are there at a time is chance.
    monkeypatch.setattr(parallel, "count_processors", lambda: 1)
    peaks = []
    for length in (60_000, 600_000):
        run = Recording("long", ROBOT.joint_names, RATE, (Segment(0, length, 0.0),), Endless())
        tracemalloc.start()
        reduce_recordings(MODEL.observation, RegressorInputs([run], PREPROCESSING, REFERENCE))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.25 * peaks[0]


def test_every_pair_of_stretches_is_disjoint_in_rows():
    run = recording(10, 9)
    reduction = reduce_recordings(MODEL.observation, RegressorInputs([run], PREPROCESSING, REFERENCE))
    for (_, end), (start, _) in itertools.pairwise(reduction.spans):
        assert start > end
    assert sum(equation.counts.sum() for equation in reduction.equations) == reduction.n_rows
