"""What a job has reached, so that its next attempt goes on from there; gone once the job has ended."""

from __future__ import annotations

from sqlalchemy import select

from dynident_service.storage.database import Database
from dynident_service.storage.tables import CheckpointRow, JobRow
from dynident_service.storage.turns import Claim

MOST = 20_000_000
"""Bytes of a checkpoint that are kept; a larger one is not worth its place in the database."""


class Checkpointing:
    """The last checkpoint of each job."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def find(self, job_id: str) -> bytes | None:
        """Give the last one of a job."""
        with self._database.read() as session:
            return session.scalar(select(CheckpointRow.content).where(CheckpointRow.job_id == job_id))

    def keep(self, claim: Claim, content: bytes) -> None:
        """Keep one in place of the last; not for a worker that has lost its claim."""
        if len(content) > MOST:
            return
        with self._database.write() as session:
            held = select(JobRow.id).where(JobRow.id == claim.job_id, JobRow.attempt == claim.attempt)
            if session.scalar(held.where(JobRow.state == "running").with_for_update()) is not None:
                session.merge(CheckpointRow(job_id=claim.job_id, content=content))
