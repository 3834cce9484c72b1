"""Forms with files, which are received in the data directory, where free space is checked."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, BinaryIO, cast

from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.datastructures import FormData
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException, MultiPartParser

from dynident_service.services import get_services


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
