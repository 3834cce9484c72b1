"""Quotas where requests come in: what settings allow, and uploads that are refused before they are received."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile

from anyio import to_thread
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident_service.limits import is_upload
from dynident_service.problem_responses import respond
from dynident_service.problems import ProblemError
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.quotas import Account, Limits, acting, bytes_of, check, files_too_large
from dynident_service.storage.records import Kind, NewResource
from dynident_service.storage.space import require_room
from dynident_service.storage.tables import RetryRow

FORM = 65_536
"""Bytes of a form besides its file, at most; how large the file itself is shows once all of it is there."""

COPIES = 3
"""How often the bytes of an upload may come to lie on the disk: as they come, in the store, and as they are read."""
_KINDS: dict[str, Kind] = {"/v1/measurements": "measurement", "/v1/imports": "import"}


def limits_of(settings: Settings) -> Limits:
    """What each key may have that has no limits of its own."""
    return Limits(settings.quota_bytes, settings.quota_recordings, settings.quota_jobs)


@dataclass(eq=False)
class _Coming:
    """An upload under way."""

    account: Account | None
    size: int
    """Bytes that were announced, or have come where that is more."""
    came: int = 0

    @property
    def to_write(self) -> int:
        """Bytes on the disk that it will still take."""
        return COPIES * self.size - self.came


class UploadRoom:
    """Refuses an upload for which there is no room, by its length or as it comes in, before anything is done with it.

    What is on its way counts as if it were stored: of many that come at once only as many are taken as there is room
    for. What is left of a quota is looked at again where the recording is stored, as other services of the same
    database know nothing of each other's uploads.
    """

    def __init__(self, app: ASGIApp, settings: Settings, database: Callable[[], Database]) -> None:
        self._app = app
        self._settings = settings
        self._database = database
        self._coming: dict[_Coming, None] = {}
        """In the order in which they began."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Look at what is left where something is uploaded."""
        if scope["type"] != "http" or not is_upload(scope):
            return await self._app(scope, receive, send)
        length = Headers(scope=scope).get("content-length", "")
        upload = _Coming(acting(), int(length) if length.isdigit() else 0)
        self._coming[upload] = None
        try:
            await self._pass_on(upload, scope, receive, send)
        finally:
            self._coming.pop(upload, None)

    async def _pass_on(self, upload: _Coming, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            self._check_disk()
            left = await to_thread.run_sync(self._left, upload, scope)
            self._check_quota(upload, left)
        except ProblemError as error:
            await respond(error.problem, {"connection": "close"})(scope, receive, send)
            return

        async def received() -> Message:
            message = await receive()
            upload.came += len(message.get("body", b""))
            if upload.came > upload.size:  # it did not say its length
                upload.size = upload.came
                self._check_disk()
                self._check_quota(upload, left)
            return message

        async def sent(message: Message) -> None:
            # Before its client can know that it is stored, and send another one.
            if message["type"] == "http.response.start":
                self._coming.pop(upload, None)
            await send(message)

        await self._app(scope, received, sent)

    def _check_disk(self) -> None:
        needed = sum(one.to_write for one in self._coming)
        require_room(self._settings.data_dir, needed, self._settings.reserved_bytes)

    def _left(self, upload: _Coming, scope: Scope) -> int | None:
        """Bytes that an account may have beside what it has; `None` where they are not limited.

        Raises OverQuota where it may not have another recording.
        """
        account, headers = upload.account, Headers(scope=scope)
        if account is None or not (account.limits.bytes or account.limits.recordings):
            return None
        kind: Kind = _KINDS.get(scope["path"].rstrip("/"), "robot")
        with self._database().read() as session:
            retry = headers.get("idempotency-key")
            if retry and session.get(RetryRow, (f"{scope['method']} {scope['path']}", retry)) is not None:
                return None  # what was stored already is answered again, and takes no room
            check(session, account, [NewResource(kind, {})])
            return account.limits.bytes - bytes_of(session, account.name) if account.limits.bytes else None

    def _check_quota(self, upload: _Coming, left: int | None) -> None:
        """Raise OverQuota where an upload, with those of the account that began before, is more than is left."""
        account = upload.account
        if account is None or left is None:
            return
        others = takewhile(lambda one: one is not upload, self._coming)
        size = upload.size + sum(one.size for one in others if one.account and one.account.name == account.name)
        if size > left + FORM:
            allowed = account.limits.bytes or 0
            raise files_too_large(account, allowed, allowed - left, size)
