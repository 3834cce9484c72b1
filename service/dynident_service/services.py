"""What the routes work with, opened when the application starts and closed when it ends."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, cast

from fastapi import Depends, Request

from dynident_service.awaited import Awaited
from dynident_service.fair_shares import SharedPlaces
from dynident_service.following import Following
from dynident_service.housekeeping import Housekeeping
from dynident_service.jobs.engine import Engine
from dynident_service.jobs.nursery import Nursery
from dynident_service.models.verdicts import VerdictView
from dynident_service.quotas import limits_of
from dynident_service.remembered import Remembered
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.ledger import Ledger
from dynident_service.storage.migrate import migrate
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.resources import Resources

MOST_BUNDLES = 8
"""That are read at a time: each is a file as large as all recordings of its robot."""
MOST_VERDICTS = 500
"""Of some 2 kB each."""


@dataclass(frozen=True)
class Services:
    """The storage and the engine of one running application."""

    settings: Settings
    database: Database
    objects: ObjectStore
    resources: Resources
    ledger: Ledger
    engine: Engine
    housekeeping: Housekeeping
    awaited: Awaited
    following: Following
    bundles: SharedPlaces = field(default_factory=lambda: SharedPlaces(MOST_BUNDLES))
    verdicts: Remembered[VerdictView] = field(default_factory=lambda: Remembered(MOST_VERDICTS))

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """A folder for the files of one request, which is gone with it."""
        folder = self.settings.uploads_dir
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as name:
            yield Path(name)


@contextmanager
def open_services(settings: Settings, nursery: Nursery) -> Iterator[Services]:
    """Open the storage, bring the database up to date, and start the engine in the background."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    database = Database(settings.database)
    try:
        migrate(database)
        objects = ObjectStore(settings.objects, settings.cache_dir)
        ledger = Ledger(database, settings.max_attempts)
        following = Following(ledger)
        engine = Engine(settings, ledger, nursery, following.nudge)
        engine.start()
        housekeeping = Housekeeping(settings, database, objects)
        housekeeping.start()
        awaited = Awaited(settings.request_workers, nursery)
        resources = Resources(database, objects, limits_of(settings))
        try:
            yield Services(settings, database, objects, resources, ledger, engine, housekeeping, awaited, following)
        finally:
            awaited.close()
            housekeeping.close()
            engine.close()
    finally:
        database.close()


async def services_of(request: Request) -> Services:
    """Give the services of the application that answers a request.

    Asynchronous, as it is short: else each request would wait for a thread just for this.
    """
    return cast(Services, request.app.state.services)


ServicesDep = Annotated[Services, Depends(services_of)]
