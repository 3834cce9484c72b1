"""The workbench: a page at `/` of static files, which uses the public API as any other program does."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, HTTPException, Request
from starlette.responses import RedirectResponse, Response

from dynident_service.workbench.page_files import PageFile, PageFiles

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
    "Vary": "Accept-Encoding",
}
# Browsers ask for the page each time, but keep its files for good: the page names them by their version, so page and
# service never differ in version.
REVALIDATED, IMMUTABLE = {"Cache-Control": "no-cache"}, {"Cache-Control": "public, max-age=31536000, immutable"}


def mount_workbench(app: FastAPI) -> None:
    """Serve the page at `/` and its files below `/workbench`, outside of the HTTP contract.

    Parameters
    ----------
    app : FastAPI
    """
    # Read once: the files do not change while the service runs.
    page = PageFiles.read(FOLDER, PREFIX)

    @app.api_route("/", methods=["GET", "HEAD"], include_in_schema=False)
    async def workbench(request: Request) -> Response:
        return _build_response(page.index, request, REVALIDATED)

    @app.api_route(f"{PREFIX}/{{path:path}}", methods=["GET", "HEAD"], include_in_schema=False)
    async def file(path: str, request: Request) -> Response:
        name = page.strip_version(path)
        if name not in page.files:
            raise HTTPException(404)
        # A page that was loaded before an update may ask for files of the older version; it gets the present ones.
        if path != f"{page.version}/{name}":
            return RedirectResponse(f"{PREFIX}/{page.version}/{name}", headers=HEADERS | REVALIDATED)
        return _build_response(page.files[name], request, IMMUTABLE)


def _build_response(page_file: PageFile, request: Request, headers: dict[str, str]) -> Response:
    headers = HEADERS | headers
    content = page_file.content
    if "gzip" in request.headers.get("accept-encoding", ""):
        content, headers = page_file.compressed, headers | {"Content-Encoding": "gzip"}
    return Response(content, headers=headers, media_type=page_file.media_type)
