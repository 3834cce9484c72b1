"""`Services`: storage, job engine and child processes that routes use, opened at start; cache of verdicts (500)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, cast

from fastapi import Depends, Request

from dynident_service.interactive_compute import InteractiveCompute
from dynident_service.job_events import JobEventNotifier
from dynident_service.jobs.child_pool import ForkServer
from dynident_service.jobs.confinement import REQUEST_MEMORY, AllowedFolders, Confinement
from dynident_service.jobs.job_engine import Engine
from dynident_service.jobs.task_input_output import LruCache
from dynident_service.readiness import Housekeeping, Readiness
from dynident_service.request_limits import get_quota_limits
from dynident_service.settings import Settings
from dynident_service.storage.data_directory import mark_in_use, prepare_data_directory
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.resource_repository import Resources

MOST_VERDICTS = 500
"""Cached verdicts, of some 2 kB each."""


@dataclass(frozen=True)
class Services:
    """Storage and engine of a running application."""

    settings: Settings
    database: Database
    objects: ObjectStore
    resources: Resources
    job_queue: JobQueue
    engine: Engine
    housekeeping: Housekeeping
    interactive: InteractiveCompute
    following: JobEventNotifier
    readiness: Readiness
    verdicts: LruCache[dict[str, Any]] = field(default_factory=lambda: LruCache(MOST_VERDICTS))

    @contextmanager
    def create_scratch_folder(self) -> Iterator[Path]:
        """Create a folder for the files of one request, and remove it afterwards."""
        folder = self.settings.uploads_dir
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as name:
            yield Path(name)


@contextmanager
def open_services(settings: Settings, fork_server: ForkServer) -> Iterator[Services]:
    """Open the storage, migrate the database, and start the engine in the background."""
    prepare_data_directory(settings.data_dir)
    with mark_in_use(settings.data_dir) as is_alone, closing(Database(settings.database)) as database:
        # If no other service uses the directory, every unfinished file is from before this moment.
        abandoned_before = time.time() if is_alone else 0.0
        migrate(database)
        # After the migration: no other part may see tables of an older version.
        objects = ObjectStore(settings.objects, settings.cache_dir)
        job_queue = JobQueue(database, settings.max_attempts)
        following = JobEventNotifier(job_queue)
        engine = Engine(settings, job_queue, fork_server, following.wake)
        engine.start()
        housekeeping = Housekeeping(settings, database, objects, abandoned_before)
        housekeeping.start()
        awaited = InteractiveCompute(settings.request_workers, fork_server, confine_readers(settings, objects))
        resources = Resources(database, objects, get_quota_limits(settings))
        try:
            readiness = Readiness(database, objects, awaited)
            yield Services(
                settings, database, objects, resources, job_queue, engine, housekeeping, awaited, following, readiness
            )
        finally:
            # In reverse: first what requests wait for, then maintenance, and last the engine, which gives its jobs
            # back.
            awaited.close()
            housekeeping.close()
            engine.close()


def confine_readers(settings: Settings, objects: ObjectStore) -> Confinement:
    """Return the confinement of processes that read strangers' files: uploads and stored files only, and no network."""
    uploads = settings.uploads_dir.resolve()
    for folder in (uploads, objects.local_folder):
        folder.mkdir(parents=True, exist_ok=True)  # Landlock allows existing folders only
    folders = AllowedFolders(settings.data_dir.resolve(), (objects.local_folder,), (uploads,))
    return Confinement(min(REQUEST_MEMORY, settings.job_memory), settings.processes_dir, folders)


async def get_services(request: Request) -> Services:
    """Return the services of the application that answers a request.

    Asynchronous because it is short: a synchronous dependency would wait for a thread in every request.
    """
    return cast(Services, request.app.state.services)


ServicesDep = Annotated[Services, Depends(get_services)]
