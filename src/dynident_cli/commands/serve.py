"""`dynident serve` (the service) and `dynident mcp` (tools for agents)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_cli.input_checks import READABLE_FOLDER


def serve(
    host: Annotated[str | None, typer.Option("--host", help="Address to listen on; 127.0.0.1 by default.")] = None,
    port: Annotated[int | None, typer.Option("--port", help="Port; 8000 by default.", min=0, max=65535)] = None,
    data_dir: Annotated[
        Path | None, typer.Option("--data-dir", help="Folder for the data; ./dynident-data by default.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", help="Jobs at the same time; one per core by default.", min=1)
    ] = None,
) -> None:
    """Run the HTTP service.

    Every setting is also an environment variable, DYNIDENT_HOST, DYNIDENT_PORT and so on.
    """
    from dynident_service.serve import serve as run
    from dynident_service.settings import load_settings

    options = {"host": host, "port": port, "data_dir": data_dir, "workers": workers}
    run(load_settings(**{name: value for name, value in options.items() if value is not None}))


def mcp(
    folder: Annotated[
        Path,
        typer.Option(
            "--folder", metavar="DIR", help="The folder whose files the agent may use; nothing outside of it."
        ),
        READABLE_FOLDER,
    ],
) -> None:
    """Serve the library's functions to an agent (MCP).

    The Model Context Protocol runs over stdin and stdout.
    """
    from dynident_service.agents.server import serve_folder

    serve_folder(folder)
