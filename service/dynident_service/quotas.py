"""Quotas where requests come in: what settings allow, and uploads that are refused before they are received."""

from __future__ import annotations

from collections.abc import Callable

from anyio import to_thread
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident_service.limits import UPLOADS
from dynident_service.problem_responses import respond
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.quotas import Account, Limits, OverQuota, acting, bytes_of, check, files_too_large
from dynident_service.storage.records import Kind, NewResource, Owned
from dynident_service.storage.tables import RetryRow

FORM = 65_536
"""Bytes of a form besides its file, at most; how large the file itself is shows once all of it is there."""


def limits_of(settings: Settings) -> Limits:
    """What each key may have that has no limits of its own."""
    return Limits(settings.quota_bytes, settings.quota_recordings, settings.quota_jobs)


class UploadQuota:
    """Refuses an upload for which there is no room, by its length or as it comes in, before anything is done with it.

    What is left is looked at again where the recording is stored: others may take it meanwhile.
    """

    def __init__(self, app: ASGIApp, database: Callable[[], Database]) -> None:
        self._app = app
        self._database = database

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Look at what is left where a limited account uploads something."""
        account = acting()
        if (
            scope["type"] != "http"
            or account is None
            or not (account.limits.bytes or account.limits.recordings)
            or scope["method"] != "POST"
            or scope["path"].rstrip("/") not in UPLOADS
        ):
            return await self._app(scope, receive, send)
        try:
            left = await to_thread.run_sync(self._left, account, scope)
        except OverQuota as error:
            return await respond(error.problem, {"connection": "close"})(scope, receive, send)
        return await self._app(scope, receive if left is None else _metered(receive, account, left), send)

    def _left(self, account: Account, scope: Scope) -> int | None:
        """Bytes that may still come; `None` where they are not limited. Raises OverQuota where there are too few."""
        headers = Headers(scope=scope)
        path: str = scope["path"].rstrip("/")
        kind: Kind = "import" if path.endswith("imports") else "measurement"
        length = headers.get("content-length", "")
        size = max(0, int(length) - FORM) if length.isdigit() else 0
        form = (Owned("form", "", size, ""),) if size else ()
        with self._database().read() as session:
            retry = headers.get("idempotency-key")
            if retry and session.get(RetryRow, (f"POST {scope['path']}", retry)) is not None:
                return None  # what was stored already is answered again, and takes no room
            check(session, account, [NewResource(kind, {}, objects=form)])
            if not account.limits.bytes:
                return None
            return max(0, account.limits.bytes - bytes_of(session, account.name))


def _metered(receive: Receive, account: Account, left: int) -> Receive:
    came = 0

    async def metered() -> Message:
        nonlocal came
        message = await receive()
        came += len(message.get("body", b""))
        if came > left + FORM:
            allowed = account.limits.bytes or 0
            raise files_too_large(account, allowed, allowed - left, came)
        return message

    return metered
