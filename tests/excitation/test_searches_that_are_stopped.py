"""A search that is stopped from outside goes on from what it had reached, and ends where it would have ended."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.optimisation.augmented_lagrangian import read_checkpoint
from dynident.excitation.optimisation.design_problem import Budget
from dynident.robot import Robot, robot_from_library

REQUEST = DesignRequest(
    trajectory=TrajectoryRequest(harmonics=2, duration=4.0, sampling_rate=50.0),
    starts=2,
    random_trajectories=4,
)


class Kept:
    """Keeps every checkpoint, and stops the search after some."""

    def __init__(self, stop_after: int | None = None, content: bytes | None = None) -> None:
        self.content, self.kept = content, 0
        self._stop_after = stop_after

    def load_last(self) -> bytes | None:
        return self.content

    def save(self, make: Callable[[], bytes]) -> None:
        self.content = make()
        self.kept += 1
        if self.kept == self._stop_after:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_from_library("scara")


def test_a_search_that_was_stopped_again_and_again_gives_the_same_design(robot: Robot) -> None:
    at_once = Kept()
    whole = design_experiment(robot, REQUEST, checkpoints=at_once)
    last = read_checkpoint(at_once.content)
    assert last is not None
    assert last.completed > 0  # there was one to be counted
    content, rounds = None, 0
    for stop_after in (1, 3, None):
        kept = Kept(stop_after, content)
        if stop_after is None:
            again = design_experiment(robot, REQUEST, checkpoints=kept)
        else:
            with pytest.raises(KeyboardInterrupt):
                design_experiment(robot, REQUEST, checkpoints=kept)
        content, rounds = kept.content, rounds + kept.kept
    assert np.array_equal(again.q, whole.q)
    assert again.notes == whole.notes
    assert rounds == at_once.kept  # no round was done twice


def test_the_time_that_was_taken_before_counts() -> None:
    budget = Budget(None, 60.0)
    budget.add_elapsed(50.0)
    assert budget.share_spent == pytest.approx(50 / 60, abs=0.01)
    time.sleep(0.01)
    assert budget.elapsed > 50.0


def test_a_part_of_the_time_is_one_of_what_is_left_when_it_begins() -> None:
    budget = Budget(None, 60.0)
    # Building the columns of a machine with many joints took more than the random motions may take.
    budget.add_elapsed(30.0)
    is_over = budget.start_part(0.3)
    assert not is_over()
    budget.add_elapsed(8.0)
    assert not is_over()
    budget.add_elapsed(2.0)
    assert is_over()
    assert not Budget(None, None).start_part(0.3)()


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 half of it"])
def test_a_checkpoint_that_cannot_be_read_is_none(content: bytes | None) -> None:
    assert read_checkpoint(content) is None
