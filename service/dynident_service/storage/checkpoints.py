"""Checkpoints of jobs: the state from which the next attempt continues, kept in the database until the job ends."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from sqlalchemy import select

from dynident_service.storage.database import Database
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.retry import INFRASTRUCTURE_ERRORS, describe_error
from dynident_service.storage.tables import CheckpointRow, JobRow

CHECKPOINT_INTERVAL = 3.0
"""Seconds between checkpoints: at most about as much work is lost when a worker is killed."""
MAX_CHECKPOINT_SHARE = 0.05
"""Upper limit for the share of time that checkpoints take; one that takes long is written less often."""
log = logging.getLogger("dynident.job")


class JobCheckpoints:
    """Checkpoints of one attempt at a job; the attempt continues from the last checkpoint of any earlier one."""

    def __init__(self, storage: CheckpointStore, claim: Claim) -> None:
        self._storage = storage
        self._claim = claim
        self._next = time.monotonic() + CHECKPOINT_INTERVAL

    def load_last(self) -> bytes | None:
        """Return the last checkpoint of earlier attempts, or None."""
        # A first attempt has nothing to continue from, and need not ask.
        return self._storage.find(self._claim.job_id) if self._claim.attempt > 1 else None

    def save(self, make: Callable[[], bytes]) -> None:
        """Write a checkpoint if it is time; a database that is away costs only the checkpoint."""
        began = time.monotonic()
        if began < self._next:
            return
        try:
            self._storage.save(self._claim, make())
        except INFRASTRUCTURE_ERRORS as error:
            log.warning("job %s: a checkpoint could not be stored: %s", self._claim.job_id, describe_error(error))
        ended = time.monotonic()
        self._next = ended + max(CHECKPOINT_INTERVAL, (ended - began) / MAX_CHECKPOINT_SHARE)


MAX_CHECKPOINT_BYTES = 20_000_000
"""Upper limit in bytes; a larger checkpoint is not worth its place in the database."""


class CheckpointStore:
    """Store with the last checkpoint of each job."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def find(self, job_id: str) -> bytes | None:
        """Return the last checkpoint of a job, or None."""
        with self._database.read() as session:
            return session.scalar(select(CheckpointRow.content).where(CheckpointRow.job_id == job_id))

    def save(self, claim: Claim, content: bytes) -> None:
        """Replace the checkpoint of a job, unless the worker has lost its claim or the checkpoint is too large."""
        if len(content) > MAX_CHECKPOINT_BYTES:
            return
        with self._database.write() as session:
            # The lock on the job's row keeps it from ending in between, which would leave a checkpoint of a job that
            # has ended.
            held = select(JobRow.id).where(JobRow.id == claim.job_id, JobRow.attempt == claim.attempt)
            if session.scalar(held.where(JobRow.state == "running").with_for_update()) is not None:
                session.merge(CheckpointRow(job_id=claim.job_id, content=content))
