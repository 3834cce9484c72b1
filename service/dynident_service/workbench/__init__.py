"""The workbench: a page at `/`, made of static files, that uses the public API as any other program does."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, HTTPException, Request
from starlette.responses import RedirectResponse, Response

from dynident_service.workbench.files import PageFile, PageFiles

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
# The page is asked for anew, and names its files by their version, which are the same for good: page and service never
# differ in version.
ANEW, FOR_GOOD = {"Cache-Control": "no-cache"}, {"Cache-Control": "public, max-age=31536000, immutable"}


def mount(app: FastAPI) -> None:
    """Serve the page at `/` and what it is made of below `/workbench`; neither is a part of the contract."""
    page = PageFiles.read(FOLDER, PREFIX)

    @app.api_route("/", methods=["GET", "HEAD"], include_in_schema=False)
    async def workbench(request: Request) -> Response:
        return _answer(page.index, request, ANEW)

    @app.api_route(f"{PREFIX}/{{path:path}}", methods=["GET", "HEAD"], include_in_schema=False)
    async def file(path: str, request: Request) -> Response:
        name = page.current(path)
        if name not in page.files:
            raise HTTPException(404)
        if path != f"{page.version}/{name}":
            return RedirectResponse(f"{PREFIX}/{page.version}/{name}", headers=HEADERS | ANEW)
        return _answer(page.files[name], request, FOR_GOOD)


def _answer(found: PageFile, request: Request, headers: dict[str, str]) -> Response:
    headers = HEADERS | headers
    content = found.content
    if "gzip" in request.headers.get("accept-encoding", ""):
        content, headers = found.compressed, headers | {"Content-Encoding": "gzip"}
    return Response(content, headers=headers, media_type=found.media_type)
