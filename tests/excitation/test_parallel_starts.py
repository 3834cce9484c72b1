"""Starts of a search are improved several at a time: to the same design, told in one thread, and stopped from there."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from dynident import parallel
from dynident.errors import Cancelled
from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.optimisation import augmented_lagrangian
from dynident.excitation.optimisation.design_problem import DesignProblem, Evaluation, Multipliers
from dynident.robot import Robot, robot_from_library

REQUEST = DesignRequest(
    trajectory=TrajectoryRequest(harmonics=2, duration=4.0, sampling_rate=50.0),
    starts=5,
    random_trajectories=8,
)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_from_library("scara")


def at_a_time(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    for module in (parallel, augmented_lagrangian):
        monkeypatch.setattr(module, "count_processors", lambda: count)


def test_as_many_at_a_time_as_there_are_processors_give_the_same_design(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: set[int] = set()
    evaluate = DesignProblem.evaluate

    def noted(self: DesignProblem, flat: np.ndarray, multipliers: Multipliers) -> Evaluation:
        threads.add(threading.get_ident())
        return evaluate(self, flat, multipliers)

    monkeypatch.setattr(DesignProblem, "evaluate", noted)
    at_a_time(monkeypatch, 1)
    alone = design_experiment(robot, REQUEST)
    assert threads == {threading.get_ident()}
    threads.clear()
    at_a_time(monkeypatch, 3)
    together = design_experiment(robot, REQUEST)
    assert len(threads - {threading.get_ident()}) > 1
    np.testing.assert_array_equal(together.q, alone.q)
    assert together.notes == alone.notes


def test_the_thread_that_asked_is_told_and_may_stop_it(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    at_a_time(monkeypatch, 2)
    asked, told = threading.get_ident(), []

    def progress(fraction: float, message: str) -> None:
        assert threading.get_ident() == asked
        told.append(fraction)
        if message.startswith("start "):
            raise Cancelled

    before = threading.active_count()
    with pytest.raises(Cancelled):
        design_experiment(robot, REQUEST, progress)
    assert told == sorted(told)
    assert threading.active_count() == before
