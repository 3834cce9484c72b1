"""Recordings that others reduce elsewhere: the same factors, whoever is there, and however they fail."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident import parallel as threads
from dynident.effects import DEFAULT_EFFECTS, EffectChoice
from dynident.errors import Cancelled
from dynident.parallel import RemoteWorkersBusy, RemoteWorkFailed, map_in_threads, share_work_with
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors import row_cache
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.regressors.row_cache import reduce_and_cache

ROBOT = arm("scara")
ITEMS = list(range(6))
SIZES = [1.0] * len(ITEMS)


@pytest.fixture(autouse=True)
def worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the size, and the machine."""
    monkeypatch.setattr(threads, "MIN_PARALLEL_SIZE", 0)
    monkeypatch.setattr(threads, "count_processors", lambda: 1)
    monkeypatch.setattr(threads, "_RETRY_INTERVAL", 0.01)


Place = Callable[[Any, Progress], Any]


@dataclass
class Others:
    """Those elsewhere, each of whom does a part in its own way."""

    makes: Sequence[Callable[[Place], Place]]
    asked: list[float] = field(default_factory=list)

    def list_workers(self, work: Place, size: float) -> Sequence[Place]:
        self.asked.append(size)
        return [make(work) for make in self.makes]


def here(item: int, told: Progress) -> tuple[int, str]:
    time.sleep(0.02)
    told(1.0, str(item))
    return item, "here"


def there(_: Place) -> Place:
    return lambda item, told: (item, "there")


def test_others_take_parts_and_the_answers_keep_their_order() -> None:
    others, told = Others([there, there]), []
    with share_work_with(others):
        found = map_in_threads(here, ITEMS, SIZES, lambda fraction, _: told.append(fraction))
    assert [item for item, _ in found] == ITEMS
    assert {where for _, where in found} == {"here", "there"}
    assert others.asked == [6.0]
    assert told == sorted(told)
    map_in_threads(here, ITEMS, SIZES)
    assert others.asked == [6.0]  # nobody is asked behind it


def test_what_goes_wrong_elsewhere_is_done_here() -> None:
    tries: list[int] = []

    def fails(_: Place) -> Place:
        def place(item: int, told: Progress) -> Any:
            tries.append(item)
            raise RemoteWorkFailed

        return place

    with share_work_with(Others([fails])):
        assert map_in_threads(here, ITEMS, SIZES) == [(item, "here") for item in ITEMS]
    assert len(tries) == 1


def test_whoever_is_busy_is_asked_again() -> None:
    tries: list[int] = []

    def busy_at_first(_: Place) -> Place:
        def place(item: int, told: Progress) -> Any:
            tries.append(item)
            if len(tries) < 3:
                raise RemoteWorkersBusy
            return item, "there"

        return place

    with share_work_with(Others([busy_at_first])):
        found = map_in_threads(here, ITEMS, SIZES)
    assert [item for item, _ in found] == ITEMS
    assert "there" in {where for _, where in found}


def never(stopped: threading.Event) -> Callable[[Place], Place]:
    """Somebody elsewhere who works on an item until nobody waits for it any more."""

    def of(_: Place) -> Place:
        def place(item: int, told: Progress) -> Any:
            try:
                while True:
                    told(0.0, "")
                    time.sleep(0.005)
            finally:
                stopped.set()

        return place

    return of


def test_what_never_comes_back_is_done_here_and_no_longer_waited_for() -> None:
    stopped = threading.Event()
    with share_work_with(Others([never(stopped)])):
        assert map_in_threads(here, ITEMS, SIZES) == [(item, "here") for item in ITEMS]
    assert stopped.is_set()


def test_who_stops_the_whole_stops_those_elsewhere() -> None:
    stopped = threading.Event()

    def endless(item: int, told: Progress) -> None:
        while True:
            told(0.5, "")
            time.sleep(0.005)

    def cancel(fraction: float, message: str) -> None:
        raise Cancelled

    with share_work_with(Others([never(stopped)])), pytest.raises(Cancelled):
        map_in_threads(endless, ITEMS, SIZES, cancel)
    assert stopped.is_set()


def run(seed: int, seconds: float) -> Recording:
    motion = fourier_motion(ROBOT, seconds, 200.0, seed)
    return record(ROBOT, motion, pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), f"run {seed}")


def sent(work: Place) -> Place:
    """As through another process: what is done, what it is done to and what comes of it are bytes on the way."""
    packed = pickle.dumps(work)

    def place(item: Recording, told: Progress) -> Any:
        return pickle.loads(pickle.dumps(pickle.loads(packed)(pickle.loads(pickle.dumps(item)), ignore_progress)))

    return place


@pytest.mark.parametrize("effects", [DEFAULT_EFFECTS, [*DEFAULT_EFFECTS, EffectChoice("load_dependent_friction")]])
def test_recordings_reduced_elsewhere_give_the_same_factors(
    effects: Sequence[EffectChoice], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(row_cache, "MOST_VALUES", 0)
    model = build_model(ROBOT, effects)
    reference = model.build_reference(np.full(model.n_parameters, 0.3))
    runs = [run(seed, 4.0 + seed) for seed in range(4)]
    alone, _ = reduce_and_cache(model, RegressorInputs(runs, Preprocessing(10.0, 10.0, 4), reference))
    with share_work_with(Others([sent, sent])):
        shared, _ = reduce_and_cache(model, RegressorInputs(runs, Preprocessing(10.0, 10.0, 4), reference))
    np.testing.assert_array_equal(alone.spans, shared.spans)
    for one, other in zip(alone.equations, shared.equations, strict=True):
        np.testing.assert_array_equal(one.factors, other.factors)
        np.testing.assert_array_equal(one.counts, other.counts)
