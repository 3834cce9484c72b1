"""Exception handlers: each exception of the application becomes a problem with its status; headers of every answer."""

from __future__ import annotations

import logging
from collections.abc import Callable
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException as StarletteHTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident.errors import DynidentError
from dynident_service.problems import (
    MEDIA_TYPE,
    Problem,
    ProblemError,
    make_problem,
    make_validation_problem,
    to_problem,
    to_problem_fields,
)
from dynident_service.storage.data_directory import is_disk_full
from dynident_service.storage.database import AWAY, describe_error
from dynident_service.tracing import get_current_request

REQUEST_ID = "X-Request-ID"
log = logging.getLogger("dynident.service")


def respond(problem: Problem, headers: dict[str, str] | None = None) -> JSONResponse:
    """Return the answer for a problem."""
    identifier = get_current_request()
    # Set here as well: an answer to an unexpected error does not pass the middleware that adds these headers.
    carried = {**SAFE, **({} if identifier is None else {REQUEST_ID: identifier}), **(headers or {})}
    content = problem.model_copy(update={"request_id": identifier}).model_dump(exclude_none=True)
    return JSONResponse(content, problem.status, headers=carried, media_type=MEDIA_TYPE)


def install_handlers(app: FastAPI, allowed_methods: Callable[[str], list[str]]) -> None:
    """Register handlers that turn every error of the application into a problem.

    `allowed_methods` returns the methods of a path, for the header `Allow` of 405.
    """
    app.exception_handler(ProblemError)(_on_problem)
    app.exception_handler(DynidentError)(_on_unusable_input)
    app.exception_handler(RequestValidationError)(_on_invalid_request)

    @app.exception_handler(StarletteHTTPException)
    async def on_http_error(request: Request, error: StarletteHTTPException) -> JSONResponse:
        return await _on_http_error(request, error, allowed_methods)

    # FastAPI chooses handlers by the class of the error: each has to be registered.
    for kind in AWAY:
        app.exception_handler(kind)(_on_infrastructure)
    app.exception_handler(OSError)(_on_operating_system)
    app.exception_handler(Exception)(_on_unexpected)


async def _on_problem(_: Request, error: ProblemError) -> JSONResponse:
    headers = {"retry-after": error.retry_after} if error.problem.status in (429, 503) else None
    return respond(error.problem, headers)


async def _on_unusable_input(_: Request, error: DynidentError) -> JSONResponse:
    return respond(to_problem(error))


async def _on_invalid_request(_: Request, error: RequestValidationError) -> JSONResponse:
    return respond(make_validation_problem(to_problem_fields(error.errors(), error.body)))


async def _on_http_error(
    request: Request, error: StarletteHTTPException, allowed_methods: Callable[[str], list[str]]
) -> JSONResponse:
    headers = {name.lower(): value for name, value in (error.headers or {}).items()}
    path = request.url.path
    if is_disk_full(error.__cause__):  # while a body was received
        return respond(_make_disk_full_problem())
    if isinstance(error.__cause__, ProblemError):  # likewise
        return await _on_problem(request, error.__cause__)
    detail = str(error.detail)
    if error.status_code == 405:
        methods = allowed_methods(path)
        headers["allow"] = ", ".join(methods)
        detail = f"{path} does not support {request.method}; it supports {', '.join(methods)}."
    elif error.status_code == 404 and detail == HTTPStatus.NOT_FOUND.phrase:
        detail = f"There is nothing at {path}; /docs lists all addresses."
    return respond(make_problem(error.status_code, detail), headers)


async def _on_infrastructure(request: Request, error: Exception) -> JSONResponse:
    log.error("%s %s: %s", request.method, request.url.path, describe_error(error))
    if is_disk_full(error):
        return respond(_make_disk_full_problem())
    detail = "The database or the object store does not answer; try again in a moment. Nothing was stored."
    return respond(make_problem(503, detail, title="Storage away"), {"retry-after": "5"})


async def _on_operating_system(request: Request, error: OSError) -> JSONResponse:
    if is_disk_full(error):
        log.error("%s %s: %s", request.method, request.url.path, error)
        return respond(_make_disk_full_problem())
    return await _on_unexpected(request, error)


async def _on_unexpected(request: Request, error: Exception) -> JSONResponse:
    log.error("%s %s failed unexpectedly", request.method, request.url.path, exc_info=error)
    return respond(make_problem(500, "The service failed unexpectedly; its log says where. Nothing was stored."))


def _make_disk_full_problem() -> Problem:
    detail = "The disk of the service is full, so nothing was stored; ask its operator to free space."
    return make_problem(507, detail, title="Disk full")


SAFE = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    # Data is no page; pages say for themselves what they need.
    "content-security-policy": "default-src 'none'; frame-ancestors 'none'",
}


class SafeHeaders:
    """Middleware that adds the headers to an answer that does not have its own."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and add the headers to its answer."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SAFE.items():
                    headers.setdefault(name, value)
            await send(message)

        return await self._app(scope, receive, send_with_headers)
