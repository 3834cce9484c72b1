"""The ways to install the service that the client's suite is told about: the smallest, and those that grow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx2
import pytest
from dask_cluster import SCIENCE, Cluster
from s3_server import BUCKET, s3_server
from service_helpers import serving, wait_for
from sqlalchemy import make_url, text

from dynident_service.settings import Settings
from dynident_service.storage.database import Database

SMALLEST = "sqlite_and_folder"
LARGER = ("postgresql_and_s3", "postgresql_s3_and_cluster")
INSTALLATIONS = (SMALLEST, *LARGER)


@contextmanager
def installed(name: str, folder: Path, postgresql_server: Callable[[], str]) -> Iterator[str]:
    """A service of one of the INSTALLATIONS that listens on a port of its own; gives its address.

    `postgresql_server` gives the URL of a server, which is asked for a new database where one is needed.
    """
    here = Settings(data_dir=folder / "data", workers=2, port=0, log_level="warning")
    with ExitStack() as stack:
        more: dict[str, str] = {}
        if name != SMALLEST:
            server = stack.enter_context(s3_server(folder / "s3.log"))
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            for variable, value in server.environment.items():
                patch.setenv(variable, value)
            more = {
                "object_store_url": BUCKET,
                "database_url": stack.enter_context(temporary_database(postgresql_server())),
            }
        if name == "postgresql_s3_and_cluster":
            cluster = Cluster(folder, SCIENCE)
            stack.callback(cluster.end)
            cluster.new_worker()
            more["dask_scheduler"] = cluster.address
        address = stack.enter_context(serving(here.model_copy(update=more), with_science_of_its_own=bool(more)))
        # A worker of the cluster may still be on its way; a service is ready while its engine starts.
        wait_for(lambda: httpx2.get(f"{address}/readyz").json()["checks"]["engine"] == "ready", timeout=120.0)
        yield address


@contextmanager
def temporary_database(server: str) -> Iterator[str]:
    """An empty database of a PostgreSQL server, dropped at the end; gives its URL."""
    name = f"dynident_{os.urandom(4).hex()}"
    administration = Database(server)
    alone = administration.engine.execution_options(isolation_level="AUTOCOMMIT")
    try:
        with alone.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        yield make_url(server).set(database=name).render_as_string(hide_password=False)
        with alone.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    finally:
        administration.close()
