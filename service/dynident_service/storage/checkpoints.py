"""Checkpoints of jobs: the state from which the next attempt of a job continues; deleted once the job has ended."""

from __future__ import annotations

from sqlalchemy import select

from dynident_service.storage.database import Database
from dynident_service.storage.tables import CheckpointRow, JobRow
from dynident_service.storage.turns import Claim

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
