"""Whose job is next: nobody waits behind all that another one sent, and finding it takes no longer for many jobs."""

from __future__ import annotations

import statistics
import threading
import time

import pytest

from dynident_service.storage import job_transitions
from dynident_service.storage.database import Database, get_database_time, migrate
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.repository_values import NewJob

JOB = NewJob("report", "nowhere:nothing")


@pytest.fixture
def queue(new_database: Database) -> JobQueue:
    migrate(new_database)
    return JobQueue(new_database)


def add(database: Database, number: int, owner: str | None) -> list[str]:
    with database.write() as session:
        return [
            job.id
            for job in job_transitions.add_jobs(session, [(JOB, None)] * number, get_database_time(session), owner)
        ]


def end(queue: JobQueue, claim: Claim) -> None:
    queue.record_success(claim, lambda session: None)


def test_the_next_job_is_the_oldest_of_the_key_of_which_the_fewest_run(queue: JobQueue, new_database: Database) -> None:
    many, nobody, few = add(new_database, 4, "many"), add(new_database, 2, None), add(new_database, 2, "few")
    first = [claim.job_id for claim in queue.claim(4)]
    assert first == [many[0], nobody[0], few[0], many[1]]  # one of each, then the oldest of all
    assert [claim.job_id for claim in queue.claim(7)] == [nobody[1], few[1], many[2]]


def test_who_has_nothing_running_goes_before_who_has(queue: JobQueue, new_database: Database) -> None:
    add(new_database, 5, "many")
    held = queue.claim(2)
    (late,) = add(new_database, 1, "late")
    end(queue, held[0])
    (following,) = queue.claim(2)
    assert following.job_id == late


def test_services_that_take_at_once_take_no_job_twice_and_leave_none(queue: JobQueue, new_database: Database) -> None:
    several = {one for owner in ("a", "b", None) for one in add(new_database, 20, owner)}
    taken: list[str] = []

    def take() -> None:
        database = Database(new_database.url)
        until = time.monotonic() + 30
        while len(taken) < len(several) and time.monotonic() < until:
            for claim in JobQueue(database).claim(1000):
                taken.append(claim.job_id)
                end(queue, claim)
        database.close()

    threads = [threading.Thread(target=take) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) == len(set(taken))
    assert set(taken) == several


def test_to_find_the_next_job_takes_no_longer_of_ten_thousand_than_of_ten(
    queue: JobQueue, new_database: Database
) -> None:
    def median_seconds() -> float:
        seconds = []
        for _ in range(15):
            began = time.perf_counter()
            (claim,) = queue.claim(1)
            seconds.append(time.perf_counter() - began)
            end(queue, claim)
        return statistics.median(seconds)

    add(new_database, 30, "many")
    add(new_database, 30, "few")
    of_few = median_seconds()
    add(new_database, 10_000, "many")
    # A scan of all of them would take more than ten times as long.
    assert median_seconds() < 5 * of_few
