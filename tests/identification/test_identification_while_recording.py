"""A recording that grows, and the estimates that it gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynident.effects import DEFAULT_EFFECTS, OFFSETS, EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import merge_row_groups
from dynident.identification import IdentificationChoices, identify
from dynident.identification.identified_models import recursive_identification
from dynident.identification.identified_models.recursive_identification import RecursiveIdentification
from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import Preprocessing, Recording, RecordingMetadata, recording_from_arrays
from dynident.recordings.recording import StoredRows
from dynident.testing.trial_arm import record_trial

# The acceleration passes a filter of its own.
FILTERS = Preprocessing(8.4, 6.0, 4)
TRIAL = record_trial((), noise=0.3, runs=2)
ROBOT = TRIAL.robot
CHOICES = IdentificationChoices(effects=(*DEFAULT_EFFECTS, OFFSETS), preprocessing=FILTERS)


def read(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    rows = list(recording.source.rows(0, recording.n_samples, recording.n_samples))
    return np.concatenate([r.q for r in rows]), np.concatenate([r.tau for r in rows])


def cut(recording: Recording, count: int) -> Recording:
    """Return the first rows of a recording, as far as they were there then."""
    segments, left = [], count
    for segment in recording.segments:
        if left > 0:
            segments.append(replace(segment, length=min(segment.length, left)))
        left -= segment.length
    return replace(recording, segments=tuple(segments))


def two_segments() -> Recording:
    q, tau = (np.concatenate(parts) for parts in zip(*map(read, TRIAL.recordings), strict=True))
    count = len(q) // 2
    rate = TRIAL.recordings[0].sampling_rate
    t = np.concatenate([np.arange(count) / rate, 100.0 + np.arange(len(q) - count) / rate])
    return recording_from_arrays(t, q, tau, joint_names=ROBOT.joint_names, name="both")


@pytest.mark.parametrize("choices", [CHOICES, replace(CHOICES, preprocessing=None)], ids=["filters", "auto"])
@pytest.mark.parametrize("step", [37, 400])
@pytest.mark.parametrize("recording", [TRIAL.recordings[0], two_segments()], ids=["one", "two segments"])
def test_the_last_estimate_is_that_of_a_batch(recording, step, choices):
    batch = identify(ROBOT, [recording], (), choices)
    live = RecursiveIdentification(ROBOT, choices)
    for count in range(step, recording.n_samples + step, step):
        live.push(cut(recording, count))
        if count % 10 == 0:
            live.estimate()
    last = live.finish(recording)
    assert last.identification is not None
    assert last.estimate is last.identification.estimate
    scale = np.abs(batch.values).max()
    np.testing.assert_allclose(last.estimate.values, batch.values, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(
        last.estimate.statistics.standard_deviations, batch.estimate.statistics.standard_deviations, rtol=1e-7
    )
    assert last.identification.warnings == batch.warnings
    assert last.identification.data.digests == batch.data.digests


def test_the_recursion_folds_the_same_rows_as_a_batch():
    """Before its end, a recording gives the rows that the whole one has up to then."""
    recording = TRIAL.recordings[0]
    live = RecursiveIdentification(ROBOT, CHOICES)
    for count in range(200, recording.n_samples, 200):
        live.push(cut(recording, count))
        live.estimate()
    rows = live._rows
    assert rows is not None
    assert rows.reduction is not None
    live.finish(recording)
    kept = [samples for samples in rows._kept if samples.t[-1] <= rows.reduction.spans[-1, 1]]
    assert sum(len(samples.t) for samples in kept) > 100
    n = ROBOT.n
    merged = merge_row_groups(rows.reduction)
    for joint in range(n):
        places, _ = rows.model.observation.joint_entries(joint)
        w = np.concatenate([np.hstack([s.values[:, places], s.tau[:, [joint]]]) for s in kept])
        gram = merged.equations[joint].whole_factor.T @ merged.equations[joint].whole_factor
        # Rows at standstills are left out of the factors: of this motion only the first and the last ones.
        assert merged.equations[joint].counts.sum() > 0.9 * len(w)
        assert gram[-1, -1] == pytest.approx(float((w[:, -1] ** 2).sum()), rel=0.1)


def test_an_estimate_predicts_the_newest_rows_and_its_deviations_fall():
    recording = TRIAL.recordings[0]
    live, deviations, predicted = RecursiveIdentification(ROBOT, CHOICES), [], []
    for count in range(100, recording.n_samples, 100):
        live.push(cut(recording, count))
        estimate = live.estimate()
        if estimate.estimate is None:
            assert estimate.reason
            continue
        deviations.append(np.median(estimate.estimate.statistics.standard_deviations))
        if estimate.predicted is not None:
            predicted.append(estimate.predicted)
    assert deviations[-1] < 0.5 * deviations[0]
    assert np.all(predicted[-1] < 0.1)
    assert np.all(predicted[-1] > 0.0)


def test_effects_that_need_a_first_fit_come_at_the_end():
    choices = replace(CHOICES, effects=(*CHOICES.effects, EffectChoice("stribeck")))
    recording = TRIAL.recordings[0]
    live = RecursiveIdentification(ROBOT, choices)
    live.push(cut(recording, 1500))
    during = live.estimate().estimate
    assert during is not None
    assert all(choice.effect != "stribeck" for choice in during.model.effects)
    last, batch = live.finish(recording), identify(ROBOT, [recording], (), choices)
    np.testing.assert_allclose(last.estimate.values, batch.values, rtol=0, atol=1e-9 * np.abs(batch.values).max())


def test_rows_that_were_changed_afterwards_count_as_they_are_at_the_end():
    recording = TRIAL.recordings[0]
    q, tau = read(recording)
    other = recording_from_arrays(
        np.arange(len(q)) / recording.sampling_rate, q, 1.1 * tau, joint_names=ROBOT.joint_names, name=recording.name
    )
    live = RecursiveIdentification(ROBOT, CHOICES)
    live.push(cut(recording, 1000))
    batch = identify(ROBOT, [other], (), CHOICES).values
    np.testing.assert_allclose(live.finish(other).estimate.values, batch, rtol=0, atol=1e-9 * np.abs(batch).max())


@pytest.mark.parametrize("signal", ["temperature", "command"])
def test_other_signals_that_were_changed_count_as_they_are_at_the_end(signal):
    recording = TRIAL.recordings[0]
    q, tau = read(recording)

    class Source:
        def __init__(self, extra):
            self.extra = extra

        def rows(self, first, length, block_length):
            part = slice(first, first + length)
            yield StoredRows(q[part], tau[part], **({"temperature": None} | {signal: self.extra[part]}))

    t = np.linspace(0, 1, len(q))[:, None] * np.ones((1, ROBOT.n))
    early, late = (replace(recording, source=Source(20 + 20 * t**k), **{f"has_{signal}": True}) for k in (1, 2))
    live = RecursiveIdentification(ROBOT, CHOICES)
    live.push(early)
    assert live._rows.finish(late) is None


@pytest.mark.parametrize(("jitter", "most"), [(1e-5, 1), (1e-3, None)])
def test_a_shaky_clock_keeps_the_recursion(tmp_path, jitter, most):
    q, tau = read(TRIAL.recordings[0])
    t = np.arange(len(q)) / TRIAL.recordings[0].sampling_rate
    t = t + jitter * np.random.default_rng(0).uniform(-1, 1, len(t))
    live, made, predicted = RecursiveIdentification(ROBOT, CHOICES), [], []
    counts = [*range(500, len(q), 250), len(q)]
    for count in counts:
        signals = {f"q{j + 1}": q[:count, j] for j in range(ROBOT.n)}
        signals |= {f"tau{j + 1}": tau[:count, j] for j in range(ROBOT.n)}
        sent = tmp_path / "sent.parquet"
        pq.write_table(pa.table({"t": t[:count], **signals}), sent)
        recording, _ = import_for_robot(ROBOT, sent, tmp_path / f"{count}.parquet", RecordingMetadata())
        live.push(recording)
        if not any(rows is live._rows for rows in made):
            made.append(live._rows)
        predicted.append(live.estimate().predicted)
    assert most is None or len(made) <= most
    assert sum(errors is not None for errors in predicted) > len(counts) // 2
    assert np.all(predicted[-1] < 0.15)
    batch = identify(ROBOT, [recording], (), CHOICES).values
    last = live.finish(recording).estimate.values
    np.testing.assert_allclose(last, batch, rtol=0, atol=1e-9 * np.abs(batch).max())


def test_blocks_of_time_are_joined_without_changing_their_rows(monkeypatch):
    monkeypatch.setattr(recursive_identification, "MOST_BLOCKS", 6)
    recording = TRIAL.recordings[0]
    live = RecursiveIdentification(ROBOT, replace(CHOICES, preprocessing=Preprocessing(20.0, 16.0, 1)))
    sizes = []
    for count in range(20, recording.n_samples, 20):
        live.push(cut(recording, count))
        live.estimate()
        if live._rows is not None and live._rows.reduction is not None:
            sizes.append(live._rows.reduction)
    assert max(size.n_blocks for size in sizes) <= 6
    joined = next(k for k in range(1, len(sizes)) if sizes[k].n_blocks < sizes[k - 1].n_blocks)
    before, after = (
        np.array([e.whole_factor[:, -1] @ e.whole_factor[:, -1] for e in sizes[k].equations])
        for k in (joined - 1, joined)
    )
    assert np.all(after >= before * (1 - 1e-12))
    merged = sizes[joined].merge_block_pairs()
    assert merged.n_rows == sizes[joined].n_rows
    for one, two in zip(merged.equations, sizes[joined].equations, strict=True):
        np.testing.assert_allclose(
            one.whole_factor.T @ one.whole_factor, two.whole_factor.T @ two.whole_factor, atol=1e-8
        )


@pytest.mark.parametrize(
    ("choices", "memory"), [(IdentificationChoices(model="energy"), None), (CHOICES, 0.0), (CHOICES, -1.0)]
)
def test_what_cannot_be_followed_is_refused(choices, memory):
    with pytest.raises(DynidentError):
        RecursiveIdentification(ROBOT, choices, memory=memory)
    with pytest.raises(DynidentError, match="nothing was recorded"):
        RecursiveIdentification(ROBOT, CHOICES).finish()
