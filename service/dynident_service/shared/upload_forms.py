"""Receive multipart uploads into the data directory: space, media type, hash."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path, PurePath
from typing import Any, BinaryIO, cast

from fastapi import Request, Response, UploadFile
from fastapi.routing import APIRoute
from starlette.datastructures import FormData
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException, MultiPartParser

from dynident.recordings.file_names_and_digests import MOST_FILES, pack_files
from dynident_service.problems import make_unusable
from dynident_service.storage.data_directory import check_disk_space
from dynident_service.storage.object_store import compute_digest
from dynident_service.storage_and_engine import Services, get_services


class FormRoute(APIRoute):
    """A route whose forms have their files in a folder that is gone with the request."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[object, object, Response]]:
        """Give what answers a request."""
        answer = super().get_route_handler()

        async def answer_form(request: Request) -> Response:
            if not request.headers.get("content-type", "").lower().startswith("multipart/"):
                return await answer(request)
            services = await get_services(request)
            with services.create_scratch_folder() as folder:
                return await answer(_RequestWithFiles(request, folder))

        return answer_form


class _RequestWithFiles(Request):
    def __init__(self, request: Request, folder: Path) -> None:
        super().__init__(request.scope, request.receive)
        self._folder = folder

    async def _get_form(self, **limits: Any) -> FormData:
        if self._form is None:
            parser = _FormParser(self.headers, self.stream(), **limits)
            # The parser's own temporary files may lie on another disk, from where they would have to be copied.
            parser.folder = self._folder
            try:
                self._form = await parser.parse()
            except MultiPartException as error:
                raise HTTPException(400, error.message) from error
        return self._form


class _FormParser(MultiPartParser):
    folder: Path

    def on_headers_finished(self) -> None:
        """Begin a file, where what follows is one."""
        super().on_headers_finished()
        if self._current_part.file is not None:
            file = _SentFile(self.folder / f"sent-{self._current_files}")
            self._current_part.file.file = cast(BinaryIO, file)


class _SentFile:
    """As much of a file as a form needs; open while something is written alone, as one form may have a thousand."""

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        path.touch()

    def write(self, content: bytes) -> None:
        """Append."""
        with open(self.name, "ab") as opened:
            opened.write(content)

    def seek(self, offset: int) -> None:
        """Do nothing: who reads it opens it by its name."""

    def close(self) -> None:
        """Do nothing: it is open while something is written alone."""


__all__ = [
    "FURTHER",
    "MEDIA_TYPES",
    "MOST_FILES",
    "detect_media_type",
    "hash_file",
    "receive_files",
    "require_room_for",
]

FURTHER = "Further files of the same recording: signals in separate files, joined by time or row by row"
MEDIA_TYPES = {"csv": "text/csv", "parquet": "application/vnd.apache.parquet"}


def require_room_for(services: Services, size: int) -> None:
    """Refuse a file of so many bytes for which there is no room, with what is made of it."""
    check_disk_space(services.settings.data_dir, 2 * size, services.settings.reserved_bytes)


def receive_files(services: Services, files: Sequence[UploadFile], target: Path) -> None:
    """Move what was uploaded to where it is wanted; several files that are one recording become an archive."""
    require_room_for(services, sum(file.size or 0 for file in files))
    sent = [Path(file.file.name) for file in files]
    if len(sent) == 1:
        # On the same disk renaming is all: nothing is copied.
        sent[0].replace(target)
        return
    # Only the last part of a name counts: some clients send the whole path.
    names = [PurePath(file.filename or f"file{number}").name for number, file in enumerate(files, start=1)]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        detail = f"two files have the name {repeated!r}; rename one, because names distinguish the signals of the files"
        raise make_unusable(detail, "/further", title="Unusable file")
    pack_files(list(zip(names, sent, strict=True)), target)


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, in hex."""
    with path.open("rb") as opened:
        return compute_digest(opened)[0]


def detect_media_type(source: Path) -> str:
    """Return the media type of a file, by its first bytes."""
    with source.open("rb") as opened:
        start = opened.read(16)
    if start.startswith(b"PAR1"):
        return MEDIA_TYPES["parquet"]
    foreign = (b"\x93NUMPY", b"PK\x03\x04", b"MATLAB", b"\x89HDF", b"#ROSBAG", b"SQLite", b"\x89MCAP")
    return "application/octet-stream" if start.startswith(foreign) else MEDIA_TYPES["csv"]
