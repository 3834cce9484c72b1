"""Two services on one database, or one with a cluster, and bad luck: does every job accepted end, once, and well?

    python benchmarks/chaos.py
    python benchmarks/chaos.py --database postgresql
    python benchmarks/chaos.py --database postgresql --cluster
    python benchmarks/chaos.py --jobs 12 --brief

Half of the jobs are identifications that a client asks for by HTTP, with an `Idempotency-Key`, again and again until
it is told that one was accepted; half are small ones that report their progress, put into the ledger. Meanwhile, in
an order that the seed gives, kill -9 meets the service that answers, the one that only works, a computing process and
the process that these are forked from; a service stands still (SIGSTOP); the database is away. With `--cluster` two
Dask workers do the jobs, and are what is met instead of the service that only works; so is their scheduler. Whatever
was killed is started again a second later. Then all is left in peace, and what was accepted must end: succeeded, one
end each, one resource for each request, every file whole and owned, no process left behind.

It fails (exit code 1) with what is not so.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
from common import show
from many_clients import Connection, prepare
from mischief.databases import database
from mischief.parties import Party, left_behind, on_a_cluster, two_services
from mischief.weather import BRIEF, STORM, Mischief, Weather
from sqlalchemy import select

from dynident_service.storage.database import Database, retry_while_away
from dynident_service.storage.database_tables import JobEventRow, JobRow, ResourceRow
from dynident_service.storage.integrity_check import check_storage
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import FINAL, NewJob

BUSY = frozenset({429, 500, 502, 503, 504})
PATIENCE = 240.0
"""Seconds in peace within which all must have ended: a lease of half a minute or two, and the work."""


@dataclass
class Told:
    """What came of it."""

    accepted: dict[str, str] = field(default_factory=dict)
    """Name of what was asked for, and id of its job."""
    happened: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)


class Submitter(threading.Thread):
    """Asks for jobs, evenly over some time, each until it is accepted."""

    def __init__(self, number: int, seconds: float, port: int, body: dict[str, Any], ledger: JobQueue) -> None:
        super().__init__(daemon=True)
        self.told = Told()
        self._number = number
        self._pause = seconds / number
        self._port = port
        self._body = body
        self._ledger = ledger

    def run(self) -> None:
        """Ask for all of them."""
        with httpx2.Client(base_url=f"http://127.0.0.1:{self._port}", timeout=60) as http:
            for index in range(self._number):
                name = f"chaos {index}"
                if index % 2 == 0:
                    self.told.accepted[name] = self._identification(http, name)
                else:
                    job = NewJob("report", "small_jobs:count", {"steps": 10, "pause": 0.15})
                    self.told.accepted[name] = retry_while_away(lambda job=job: self._ledger.enqueue(job), 300)
                time.sleep(self._pause)

    def _identification(self, http: httpx2.Client, name: str) -> str:
        headers, body = {"Idempotency-Key": name}, {**self._body, "name": name}
        while True:
            try:
                answer = http.post("/v1/identifications", json=body, headers=headers)
            except httpx2.TransportError as error:
                self.told.refused[type(error).__name__] += 1
            else:
                if answer.status_code == 202:
                    return str(answer.json()["job_id"])
                self.told.refused[str(answer.status_code)] += 1
                if answer.status_code not in BUSY:
                    raise RuntimeError(answer.text)
            time.sleep(0.5)


@dataclass(frozen=True)
class Ledgers:
    """What the database says in the end."""

    jobs: dict[str, JobRow]
    ends: Counter[str]
    models: list[tuple[str, bool]]
    """Name of each identification, and whether it has a result."""

    @classmethod
    def of(cls, own: Database) -> Ledgers:
        """Read it."""
        of_state = select(JobEventRow.job_id, JobEventRow.data).where(JobEventRow.event == "state")
        # That of the preparation has no name.
        kind, is_named = ResourceRow.kind == "identification", ResourceRow.name.is_not(None)
        with own.read() as session:
            jobs = {job.id: job for job in session.scalars(select(JobRow))}
            ends = Counter(job_id for job_id, data in session.execute(of_state) if data["state"] in FINAL)
            found = session.execute(select(ResourceRow.name, ResourceRow.result).where(kind, is_named)).all()
        return cls(jobs, ends, [(str(name), bool(result)) for name, result in found])


def faults(found: Ledgers, accepted: dict[str, str]) -> Iterator[str]:
    """Say what is not as it should be."""
    for name, job_id in accepted.items():
        job = found.jobs.get(job_id)
        if job is None:
            yield f"{name}: its job {job_id} is not there"
        elif job.state != "succeeded":
            yield f"{name}: {job_id} is {job.state} after {job.attempt} attempts: {job.error}"
        elif found.ends[job_id] != 1:
            yield f"{name}: {job_id} ended {found.ends[job_id]} times"
    for name, number in Counter(name for name, _ in found.models).items():
        if name not in accepted or number != 1:
            yield f"{name} is there {number} times"
    yield from (f"{name} has no result" for name, has_result in found.models if not has_result)


def figures(found: Ledgers, accepted: dict[str, str]) -> list[tuple[str, str]]:
    """How often jobs were begun again, and how long they took."""
    ours = [found.jobs[one] for one in accepted.values() if one in found.jobs]
    took = sorted((job.finished_at - job.created_at).total_seconds() for job in ours if job.finished_at is not None)
    return [
        ("jobs accepted", str(len(accepted))),
        ("ended well", str(sum(job.state == "succeeded" for job in ours))),
        ("given up or failed", str(sum(job.state == "failed" for job in ours))),
        ("begun again", str(sum(job.attempt > 1 for job in ours))),
        ("most attempts at one", str(max((job.attempt for job in ours), default=0))),
        ("deaths of a computation", str(sum(job.deaths for job in ours))),
        ("losses of worker or database", str(sum(job.losses for job in ours))),
        ("from accepted to ended, half of them", f"{took[len(took) // 2]:.1f} s" if took else ""),
        ("longest", f"{took[-1]:.1f} s" if took else ""),
    ]


@dataclass(frozen=True)
class Trial:
    """What is tried."""

    kind: str
    """Of the database."""
    with_cluster: bool
    number: int
    """Of jobs."""
    seconds: float
    """Over which they are asked for."""
    weather: Weather
    seed: int

    def run(self) -> list[str]:
        """Try it; gives what is wrong."""
        with tempfile.TemporaryDirectory() as name, database(self.kind, Path(name)) as losable:
            folder, own = Path(name), Database(losable.url)
            with (on_a_cluster if self.with_cluster else two_services)(folder, losable.url) as party:
                body = asyncio.run(prepare(Connection(party.port)))
                submitter = Submitter(self.number, self.seconds, party.port, body, JobQueue(own))
                told, mischief = submitter.told, Mischief(party, losable, self.weather, self.seed)
                began = time.monotonic()
                submitter.start()
                while submitter.is_alive() or told.happened.total() < len(self.weather.deck):
                    if what := mischief.next():
                        told.happened[what] += 1
                peace = time.monotonic()
                until_all_ended(JobQueue(own), submitter)
                calm = time.monotonic() - peace
            found, objects = Ledgers.of(own), ObjectStore((folder / "data" / "objects").as_uri(), folder / "cache")
            wrong = [*faults(found, told.accepted), *damage(own, objects)]
            wrong += [f"left behind: {one}" for one in left_behind(folder)]
            own.close()
            wrong += unexpected(told, party)
            if wrong:
                print("\n".join(line for one in party.everybody for line in one.log_lines()[-30:]))
        rows = [
            *figures(found, told.accepted),
            ("in trouble, then in peace until all had ended", f"{peace - began:.0f} s, {calm:.0f} s"),
            ("starts of a process", ", ".join(f"{one.name} {one.starts}" for one in party.everybody)),
            *((f"what happened: {what}", str(times)) for what, times in sorted(told.happened.items())),
            *((f"requests answered {why}", str(times)) for why, times in sorted(told.refused.items())),
        ]
        show(f"{self.kind}{' and a cluster' if self.with_cluster else ''}, seed {self.seed}", rows)
        return wrong if len(told.accepted) == self.number else [*wrong, "not all were accepted"]


def unexpected(told: Told, party: Party) -> Iterator[str]:
    """Say where a client was told of an error that nobody foresaw."""
    if times := told.refused["500"]:
        print("\n".join(line for line in party.api.log_lines() if "failed unexpectedly" in line))
        yield f"{times} requests were answered 500, which is no word for bad luck"


def damage(own: Database, objects: ObjectStore) -> Iterator[str]:
    """Say which files are lost, damaged by their hashes, or owned by nobody and not marked to be deleted."""
    yield from (f"{one.trouble}: {one.what}: {one.detail}" for one in check_storage(own, objects))


def until_all_ended(ledger: JobQueue, submitter: Submitter) -> None:
    """Leave all in peace, until there is nothing to do any more."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if not submitter.is_alive() and set(retry_while_away(ledger.count_by_state, 60)) <= FINAL:
            return
        time.sleep(0.2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--database", choices=("sqlite", "postgresql"), default="sqlite")
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=180.0, help="over which jobs are asked for, at least")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--brief", action="store_true", help="everything happens once, and is over soon")
    parser.add_argument("--cluster", action="store_true", help="a Dask scheduler and two workers do the jobs")
    asked = parser.parse_args()
    seconds, weather = (1.0, BRIEF) if asked.brief else (asked.seconds, STORM)
    if asked.cluster:
        weather = weather.for_a_cluster()
    wrong = Trial(asked.database, asked.cluster, asked.jobs, seconds, weather, asked.seed).run()
    for sentence in wrong:
        print(f"  wrong: {sentence}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
