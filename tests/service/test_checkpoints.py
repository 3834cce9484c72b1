"""A job whose worker is killed goes on from what it had reached."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.exc import OperationalError

from dynident_service.storage import job_queue
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import CheckpointRow
from dynident_service.storage.job_queue import MAX_CHECKPOINT_BYTES, CheckpointStore, JobCheckpoints, JobQueue
from dynident_service.storage.repository_values import NewJob

JOB = NewJob("report", "small_jobs:answer")


@pytest.fixture
def database(ledger: JobQueue) -> Database:
    return ledger._database


def kept(database: Database) -> list[bytes]:
    with database.read() as session:
        return list(session.scalars(select(CheckpointRow.content)))


def test_the_next_attempt_begins_where_the_last_one_was(ledger: JobQueue, database: Database) -> None:
    ledger.enqueue(JOB)
    storage = CheckpointStore(database)
    (first,) = ledger.claim(1)
    storage.save(first, b"half")
    storage.save(first, b"more than half")
    ledger.record_death(first, "killed")
    (second,) = ledger.claim(1)
    assert JobCheckpoints(storage, first).load_last() is None
    assert JobCheckpoints(storage, second).load_last() == b"more than half"
    storage.save(first, b"of one that was given up for dead")
    storage.save(second, b"." * (MAX_CHECKPOINT_BYTES + 1))
    assert kept(database) == [b"more than half"]
    ledger.record_success(second, lambda session: None)
    assert kept(database) == []


def test_checkpoints_are_kept_from_time_to_time_and_never_stop_the_work(
    ledger: JobQueue, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)
    made: list[bytes] = []

    def make() -> bytes:
        made.append(b"x")
        return b"x"

    seldom = JobCheckpoints(CheckpointStore(database), claim)
    for _ in range(100):
        seldom.save(make)
    assert made == []
    monkeypatch.setattr(job_queue, "CHECKPOINT_INTERVAL", 0.0)
    broken = CheckpointStore(database)
    monkeypatch.setattr(broken, "save", _away)
    JobCheckpoints(broken, claim).save(make)
    assert made == [b"x"]


def _away(*_: Any) -> None:
    raise OperationalError("UPDATE", {}, Exception("database is locked"))


def test_a_job_that_dies_in_the_middle_goes_on(
    start: Callable[..., str], wait: Callable[..., Any], tmp_path: Path
) -> None:
    note = tmp_path / "note"
    job = wait(start("goes_on", note=str(note)), timeout=60)
    assert (job.state, job.attempt) == ("succeeded", 2)
    assert int(note.read_text()) == 6
