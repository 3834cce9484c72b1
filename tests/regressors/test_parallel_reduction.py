"""Large recordings are reduced several at a time, to the same factors, with progress and an end that come in time."""

from __future__ import annotations

import gc
import pickle
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident import parallel as threads
from dynident.array_types import FloatArray
from dynident.effects import DEFAULT_EFFECTS
from dynident.errors import Cancelled
from dynident.estimation import EquationFactors, Reduction, WeightedRows
from dynident.parallel import Deferring, defer, map_in_threads, prefetch
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, SampleBlock
from dynident.regressors.dynamic_model_rows import SampleFunction, reduce_recordings
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.qr_accumulation import EquationRows, accumulate_equations
from dynident.regressors.row_cache import reduce_and_cache

ROBOT = arm("scara")


@pytest.fixture(autouse=True)
def worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the size, and the machine."""
    monkeypatch.setattr(threads, "MIN_PARALLEL_SIZE", 0)
    monkeypatch.setattr(threads, "count_processors", lambda: 3)


def run(seed: int, seconds: float) -> Recording:
    motion = fourier_motion(ROBOT, seconds, 200.0, seed)
    return record(ROBOT, motion, pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), f"run {seed}")


def test_the_factors_are_those_of_one_recording_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    model = build_model(ROBOT, DEFAULT_EFFECTS)
    runs = [run(seed, 4.0 + seed) for seed in range(4)]
    reference = model.build_reference(np.zeros(model.n_parameters))
    told: list[float] = []

    def reduced(progress: Progress = ignore_progress) -> Reduction:
        return reduce_recordings(
            model.observation, RegressorInputs(runs, Preprocessing(10.0, 10.0, 4), reference), progress
        )

    at_once = reduced(lambda fraction, _: told.append(fraction))
    monkeypatch.setattr(threads, "count_processors", lambda: 1)
    for one, other in zip(at_once.equations, reduced().equations, strict=True):
        np.testing.assert_array_equal(one.factors, other.factors)
    # The filters leave out the ends.
    assert told[-1] > 0.8
    assert told == sorted(told)


def test_rows_that_are_kept_are_those_of_their_recordings() -> None:
    model, runs = build_model(ROBOT, DEFAULT_EFFECTS), [run(1, 40.0), run(2, 3.0), run(3, 3.0)]
    preprocessing = Preprocessing(10.0, 10.0, 4)
    _, rows = reduce_and_cache(
        model, RegressorInputs(runs, preprocessing, model.build_reference(np.zeros(model.n_parameters)))
    )
    assert rows is not None
    for recording in runs:
        kept = rows.find_samples(recording, preprocessing)
        assert kept is not None
        assert kept[-1].t[-1] == pytest.approx(recording.segments[-1].length * recording.period, abs=0.5)


def test_a_single_large_recording_is_evaluated_while_the_rows_before_are_folded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, alone = build_model(ROBOT, DEFAULT_EFFECTS), run(1, 60.0)
    reference = model.build_reference(np.zeros(model.n_parameters))
    makers: set[int] = set()
    evaluate = SampleFunction.fill

    def fill(self: SampleFunction, block: SampleBlock, out: FloatArray) -> None:
        makers.add(threading.get_ident())
        evaluate(self, block, out)

    def reduced() -> Reduction:
        return reduce_recordings(model.observation, RegressorInputs([alone], Preprocessing(10.0, 10.0, 4), reference))

    monkeypatch.setattr(SampleFunction, "fill", fill)
    at_once, elsewhere = reduced(), set(makers)
    makers.clear()
    monkeypatch.setattr(threads, "count_processors", lambda: 1)
    in_turn = reduced()
    assert threading.get_ident() not in elsewhere
    assert makers == {threading.get_ident()}
    for one, other in zip(at_once.equations, in_turn.equations, strict=True):
        np.testing.assert_array_equal(one.factors, other.factors)


def test_items_made_ahead_come_in_their_order_and_few_of_them_wait() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for number in range(20):
            made.append(number)
            yield number

    for number in prefetch(items(), 1.0):
        time.sleep(0.005)
        # Two wait, one more is made, and this one.
        assert number < len(made) <= number + 4
    assert made == list(range(20))


def test_what_goes_wrong_while_an_item_is_made_is_raised_when_it_is_its_turn() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("a gap in the second")

    taken = prefetch(items(), 1.0)
    assert next(taken) == 1
    with pytest.raises(ValueError, match="a gap in the second"):
        next(taken)


def test_who_stops_taking_items_leaves_no_thread_behind() -> None:
    ended = threading.Event()

    def items() -> Iterator[int]:
        try:
            while True:
                yield 0
        finally:
            ended.set()

    before = threading.active_count()
    taken = prefetch(items(), 1.0)
    next(taken)
    taken.close()
    assert threading.active_count() == before
    # Of a generator that nobody asks any more.
    gc.collect()
    assert ended.wait(5.0)


def test_as_many_work_at_a_time_as_there_are_processors_and_answers_keep_their_order() -> None:
    together = threading.Barrier(3, timeout=10.0)

    def work(item: int, told: Progress) -> int:
        together.wait()
        told(1.0, str(item))
        return 10 * item

    assert map_in_threads(work, [0, 1, 2], [1.0, 1.0, 1.0]) == [0, 10, 20]


def test_what_goes_wrong_in_one_ends_the_others() -> None:
    ended = threading.Event()

    def work(item: int, told: Progress) -> int:
        if item == 1:
            raise ValueError("a gap in the second")
        try:
            while True:
                told(0.1, "")
                time.sleep(0.001)
        finally:
            ended.set()

    with pytest.raises(ValueError, match="a gap in the second"):
        map_in_threads(work, [0, 1], [1.0, 1.0])
    assert ended.is_set()


def test_who_asks_is_told_in_his_own_thread_and_may_end_it() -> None:
    asked = threading.get_ident()

    def progress(fraction: float, message: str) -> None:
        assert threading.get_ident() == asked
        raise Cancelled

    def work(item: int, told: Progress) -> None:
        while True:
            told(0.5, "")
            time.sleep(0.001)

    with pytest.raises(Cancelled):
        map_in_threads(work, [0, 1], [1.0, 1.0], progress)


def test_rows_that_depend_on_the_recordings_before_are_made_in_turn() -> None:
    runs, asked = [run(seed, 4.0) for seed in range(3)], []

    def rows_of(recording: Recording) -> Iterator[EquationRows]:
        asked.append((recording.name, threading.get_ident()))
        t = np.arange(20) / 10.0
        yield EquationRows(t, [np.random.default_rng(1).normal(size=(20, 3))], 0)

    accumulate_equations(rows_of, [np.arange(2)], 2, runs, in_turn=True)
    assert asked == [(one.name, threading.get_ident()) for one in runs]


@dataclass(frozen=True)
class Answer(Deferring):
    quick: int
    slow: int


def test_a_deferred_field_is_computed_once_for_all_copies_and_threads() -> None:
    calls = []

    def compute() -> int:
        calls.append(1)
        time.sleep(0.02)
        return 7

    answer = Answer(1, defer(compute))
    copies = [answer, answer.with_changes(quick=2), answer.with_changes(quick=3)]
    assert answer.with_changes(slow=5).slow == 5
    assert not calls
    with ThreadPoolExecutor() as pool:
        assert list(pool.map(lambda copy: copy.slow, copies)) == [7, 7, 7]
    assert len(calls) == 1
    assert replace(copies[1], slow=8) == Answer(2, 8)


def test_a_deferred_field_that_cannot_be_computed_says_so_every_time() -> None:
    answer = Answer(1, defer(lambda: 1 // 0))
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            _ = answer.slow
    with pytest.raises(AttributeError, match="no attribute absent"):
        _ = answer.absent  # type: ignore[attr-defined]


def test_a_copy_in_another_process_has_its_deferred_fields() -> None:
    assert pickle.loads(pickle.dumps(Answer(1, defer(lambda: 7)))) == Answer(1, 7)


def test_factors_of_weighted_rows_are_computed_when_they_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, size = np.random.default_rng(3), 4
    weighted = WeightedRows(rng.normal(size=(5, 2, size)), np.full(5, 2), rng.normal(size=(5, size, size)))
    rows = np.concatenate([weighted.others, 0.5 * weighted.rows], axis=1)
    computed = []
    factors_of = vars(WeightedRows)["weighted_factors"].fget
    watched = property(lambda own: computed.append(own.weight) or factors_of(own))
    monkeypatch.setattr(WeightedRows, "weighted_factors", watched)
    whole = EquationFactors.from_groups(np.arange(size - 1), weighted, np.full(5, 6), None)
    # Weights are found in many rounds, of which each needs all blocks together alone.
    for weight in (0.5, 0.25):
        whole = whole.weight_group(weight)
        stacked = np.concatenate([weighted.others, np.sqrt(weight) * weighted.rows], axis=1)
        flat = stacked.reshape(-1, size)
        np.testing.assert_allclose(whole.whole_factor.T @ whole.whole_factor, flat.T @ flat, rtol=1e-12)
    assert not computed
    grams = whole.factors.transpose(0, 2, 1) @ whole.factors
    np.testing.assert_allclose(grams, rows.transpose(0, 2, 1) @ rows, rtol=1e-12)
    assert computed == [0.25]
