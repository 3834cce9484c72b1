"""Request ids and the access log."""

from __future__ import annotations

import logging
import re
import secrets
import time
from urllib.parse import quote

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident_service.keys import KeyHolder
from dynident_service.logs import FIELDS, set_current_request
from dynident_service.middleware import HOLDER
from dynident_service.problem_responses import REQUEST_ID

VALID_REQUEST_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""Pattern of an id that is accepted from the caller; anything else would be written into the log unchecked."""
CLIENT_LEFT = 499
"""Status in the log of a request whose client left before the answer; HTTP has none for it."""
log = logging.getLogger("dynident.access")


class AccessLog:
    """Middleware that gives every request its id (`X-Request-ID`: the caller's, or a new one) and logs its answer.

    Query and headers are not logged, as they may hold credentials.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and log its status and duration."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        sent_identifier = Headers(scope=scope).get(REQUEST_ID, "")
        identifier = sent_identifier if VALID_REQUEST_ID.fullmatch(sent_identifier) else secrets.token_hex(8)
        # Never reset: an unexpected error is answered and logged outside of this middleware. As each request is a task
        # of its own, the id reaches no other request.
        set_current_request(identifier)
        status: int | None = None

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = identifier
            await send(message)

        began = time.perf_counter()
        without_answer = CLIENT_LEFT
        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            without_answer = 500
            raise
        finally:
            _log_request(scope, without_answer if status is None else status, 1e3 * (time.perf_counter() - began))


def _log_request(scope: Scope, status: int, milliseconds: float) -> None:
    holder = scope.get(HOLDER)
    key = holder.name if isinstance(holder, KeyHolder) else None
    path = quote(scope["path"])  # no line breaks, whatever was asked for
    fields = {
        "method": scope["method"],
        "path": path,
        "status": status,
        "milliseconds": round(milliseconds, 1),
        "key": key,
    }
    by = "" if key is None else f" by {key!r}"
    log.info("%s %s %d in %.1f ms%s", scope["method"], path, status, milliseconds, by, extra={FIELDS: fields})
