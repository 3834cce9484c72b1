"""`dynident mcp`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import READABLE_FOLDER


def mcp(
    folder: Annotated[
        Path,
        typer.Option(
            "--folder", metavar="DIR", help="The folder whose files the agent may use; nothing outside of it."
        ),
        READABLE_FOLDER,
    ],
) -> None:
    """Serve the library's functions to an agent, by the Model Context Protocol over stdin and stdout."""
    from dynident_service.agents.server import serve_folder

    serve_folder(folder)
