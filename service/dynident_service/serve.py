"""Starts the service."""

from __future__ import annotations

import uvicorn

from dynident_service.app import create_app
from dynident_service.connections import protocol_with
from dynident_service.logs import configure
from dynident_service.settings import Settings


def serve(settings: Settings | None = None) -> None:
    """Answer requests until interrupted."""
    settings = settings or Settings()
    configure(settings.log_level, settings.log_format)
    uvicorn.Server(configuration(settings)).run()


def configuration(settings: Settings) -> uvicorn.Config:
    """Configure the server that answers with the application."""
    return uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level.lower(),
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=3,
        http=protocol_with(settings),
        ws="none",
        backlog=settings.max_connections,
    )
