"""Start of the service."""

from __future__ import annotations

import os
from importlib import import_module

import uvicorn
from fastapi import FastAPI

from dynident_service import traces
from dynident_service.app import create_app
from dynident_service.connections import create_protocol
from dynident_service.draining import DrainingServer
from dynident_service.environment import forget_keys
from dynident_service.logs import configure_logging
from dynident_service.settings import Settings, load_settings
from dynident_service.storage.data_directory import PRIVATE, prepare_data_directory


def serve(settings: Settings | None = None) -> None:
    """Answer requests until the process is interrupted or terminated.

    Parameters
    ----------
    settings : Settings, optional
        Settings; those of the environment by default.
    """
    settings = settings or load_settings()
    forget_keys()
    os.umask(os.umask(PRIVATE) | PRIVATE)
    if settings.database.startswith("postgresql"):
        # Imported here, so that a missing package is reported at once and not by a traceback during the start.
        import_module("psycopg")
    if settings.traces:
        traces.check_packages()
    configure_logging(settings.log_level, settings.log_format)
    prepare_data_directory(settings.data_dir)
    app = create_app(settings)
    DrainingServer(build_server_config(app, settings), lambda: app.state.services.engine, settings.drain_seconds).run()


def build_server_config(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """Return the configuration of the server for an application."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level.lower(),
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=3,
        http=create_protocol(settings),
        ws="none",
        backlog=settings.max_connections,
    )
