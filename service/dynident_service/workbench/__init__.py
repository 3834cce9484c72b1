"""The workbench: a page at `/`, made of static files, that uses the public API as any other program does."""

from __future__ import annotations

import os
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

PREFIX = "/workbench"
FOLDER = Path(__file__).parent / "static"
HEADERS = {
    # Nothing is fetched from elsewhere and no inline script runs, whatever names and files users bring.
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    # Asked for anew, and answered by 304 as long as it is the same: page and service never differ in version.
    "Cache-Control": "no-cache",
}


class Files(StaticFiles):
    """The page's files, with its headers."""

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Answer with a file."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers.update(HEADERS)
        return response


def mount(app: FastAPI) -> None:
    """Serve the page at `/` and what it is made of below `/workbench`; neither is a part of the contract."""

    @app.api_route("/", methods=["GET", "HEAD"], include_in_schema=False)
    def workbench() -> FileResponse:
        return FileResponse(FOLDER / "index.html", headers=HEADERS)

    app.mount(PREFIX, Files(directory=FOLDER), name="workbench_files")
