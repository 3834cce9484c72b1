"""Serve the workbench (the page at `/`): static files with hashed paths.

The files are read once at the start. Their paths hold the hash of their contents, so browsers may keep them for good.
"""

from __future__ import annotations

import gzip
import hashlib
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fastapi import FastAPI, HTTPException, Request
from starlette.responses import RedirectResponse, Response

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


START, INDEX = "js/app.js", "index.html"
_IMPORT_STATEMENT = re.compile(r'^import [^"]*"(\.{1,2}/[^"]+)";$', re.MULTILINE)
_DIGITS = 16
# Not from the `mimetypes` of the machine: some say that JavaScript is plain text, which browsers refuse to run.
_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class PageFile:
    """One text file: its bytes, and the same bytes compressed."""

    content: bytes = field(repr=False)
    media_type: str
    compressed: bytes = field(repr=False)

    @classmethod
    def from_content(cls, name: str, content: bytes) -> PageFile:
        """Return a file, with the media type of its name's ending.

        Parameters
        ----------
        name : str
        content : bytes

        Returns
        -------
        PageFile
        """
        media_type = _TYPES.get(posixpath.splitext(name)[1], "text/plain")
        # Without a time in its header, the compressed file is the same in every process.
        return cls(content, media_type, gzip.compress(content, mtime=0))


@dataclass(frozen=True)
class PageFiles:
    """All files by their paths below the folder; `version` is the hash of all of them."""

    version: str
    files: Mapping[str, PageFile]
    index: PageFile

    @classmethod
    def read(cls, folder: Path, prefix: str) -> PageFiles:
        """Read a folder and write the version into the index.

        Parameters
        ----------
        folder : Path
        prefix : str
            The path in URLs at which the folder is served.

        Returns
        -------
        PageFiles
        """
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        contents = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
        hashed = hashlib.sha256()
        for name, content in contents.items():
            # Name and length are hashed, too, so that no content can pass for another split of files.
            hashed.update(f"{name}\0{len(content)}\0".encode() + content)
        version = hashed.hexdigest()[:_DIGITS]
        # Only the index names versions: all other files refer to each other by relative paths.
        index = contents[INDEX].decode().replace(f"{prefix}/", f"{prefix}/{version}/")
        # The browser loads all modules at once instead of finding them one import after the other.
        links = (
            f'<link rel="modulepreload" href="{prefix}/{version}/{name}">\n'
            for name in list_imported_modules(contents, START)
        )
        index = index.replace("</head>", f"{''.join(links)}</head>", 1)
        files = {name: PageFile.from_content(name, content) for name, content in contents.items() if name != INDEX}
        return cls(version, files, PageFile.from_content(INDEX, index.encode()))

    def strip_version(self, path: str) -> str:
        """Return a path without the version that it begins with, whichever that is.

        Parameters
        ----------
        path : str

        Returns
        -------
        str
        """
        first, _, rest = path.partition("/")
        return rest if re.fullmatch(f"[0-9a-f]{{{_DIGITS}}}", first) else path


def list_imported_modules(contents: Mapping[str, bytes], start: str) -> list[str]:
    """Return the modules that one module imports, directly or by others, in the order in which they are met.

    Parameters
    ----------
    contents : mapping of path to bytes
    start : str
        Path of the first module.

    Returns
    -------
    list of str
        With `start` at the front.
    """
    names = [start]
    # The list grows while it is gone through, so that imports of imports are met as well.
    for name in names:
        for relative in _IMPORT_STATEMENT.findall(contents[name].decode()):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(name), relative))
            if path not in names:
                names.append(path)
    return names
