"""Check quotas and disk space before and while a file is uploaded; the quotas are in storage/quotas.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile

from anyio import to_thread
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident_service.problem_responses import respond
from dynident_service.problems import ProblemError
from dynident_service.request_limits import is_upload
from dynident_service.settings import Settings
from dynident_service.storage.data_directory import check_disk_space
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import RetryRow
from dynident_service.storage.quotas import Account, QuotaLimits, check_quota, get_account, make_bytes_error, sum_bytes
from dynident_service.storage.repository_values import Kind, NewResource

FORM = 65_536
"""Upper limit in bytes for a form without its file. The size of the file itself is known only when it has arrived."""

COPIES = 3
"""Copies of an upload on the disk: as received, in the store, and as read."""
_KINDS: dict[str, Kind] = {"/v1/measurements": "measurement", "/v1/imports": "import"}


def get_quota_limits(settings: Settings) -> QuotaLimits:
    """Return the limits of keys that have none of their own."""
    return QuotaLimits(settings.quota_bytes, settings.quota_recordings, settings.quota_jobs)


@dataclass(eq=False)
class _Upload:
    """Upload under way."""

    account: Account | None
    size: int
    """Announced bytes, or received bytes if these are more."""
    came: int = 0

    @property
    def remaining_bytes(self) -> int:
        """Bytes that it will still write to the disk."""
        return COPIES * self.size - self.came


class UploadRoom:
    """Middleware that refuses uploads for which there is no room, by their length or while they arrive.

    Uploads under way count as if they were stored, so of many simultaneous ones only as many are accepted as fit. The
    quota is checked again when the recording is stored, since services that share a database do not know of each
    other's uploads.
    """

    def __init__(self, app: ASGIApp, settings: Settings, database: Callable[[], Database]) -> None:
        self._app = app
        self._settings = settings
        self._database = database
        self._coming: dict[_Upload, None] = {}
        """Uploads under way in the order in which they began; a dict serves as an ordered set."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check the room for an upload; pass other requests on."""
        if scope["type"] != "http" or not is_upload(scope):
            return await self._app(scope, receive, send)
        length = Headers(scope=scope).get("content-length", "")
        upload = _Upload(get_account(), int(length) if length.isdigit() else 0)
        # Counted from here on, before a byte has come: uploads that begin at once see each other.
        self._coming[upload] = None
        try:
            await self._pass_on(upload, scope, receive, send)
        finally:
            self._coming.pop(upload, None)

    async def _pass_on(self, upload: _Upload, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            self._check_disk()
            remaining = await to_thread.run_sync(self._compute_remaining, upload, scope)
            self._check_quota(upload, remaining)
        except ProblemError as error:
            await respond(error.problem, {"connection": "close"})(scope, receive, send)
            return

        async def receive_counted() -> Message:
            message = await receive()
            upload.came += len(message.get("body", b""))
            if upload.came > upload.size:  # it did not say its length
                upload.size = upload.came
                self._check_disk()
                self._check_quota(upload, remaining)
            return message

        async def send_and_release(message: Message) -> None:
            # Released before the client learns that its file is stored: its next upload must not find this one still
            # counted.
            if message["type"] == "http.response.start":
                self._coming.pop(upload, None)
            await send(message)

        await self._app(scope, receive_counted, send_and_release)

    def _check_disk(self) -> None:
        needed = sum(upload.remaining_bytes for upload in self._coming)
        check_disk_space(self._settings.data_dir, needed, self._settings.reserved_bytes)

    def _compute_remaining(self, upload: _Upload, scope: Scope) -> int | None:
        """Return the bytes that an account may still store, or None if they are not limited.

        Raise `QuotaExceeded` if it may not have another recording.
        """
        account, headers = upload.account, Headers(scope=scope)
        if account is None or not (account.limits.bytes or account.limits.recordings):
            return None
        kind: Kind = _KINDS.get(scope["path"].rstrip("/"), "robot")
        with self._database().read() as session:
            retry = headers.get("idempotency-key")
            if retry and session.get(RetryRow, (f"{scope['method']} {scope['path']}", retry)) is not None:
                return None  # what was stored already is answered again, and takes no room
            check_quota(session, account, [NewResource(kind, {})])
            return account.limits.bytes - sum_bytes(session, account.name) if account.limits.bytes else None

    def _check_quota(self, upload: _Upload, remaining: int | None) -> None:
        """Raise QuotaExceeded if an upload, with earlier ones of the account under way, exceeds what remains."""
        account = upload.account
        if account is None or remaining is None:
            return
        # Only earlier uploads count: of two that together do not fit, the first one goes on.
        others = takewhile(lambda other: other is not upload, self._coming)
        size = upload.size + sum(other.size for other in others if other.account and other.account.name == account.name)
        # The announced length is that of the whole form, with some fields beside the file.
        if size > remaining + FORM:
            allowed = account.limits.bytes or 0
            raise make_bytes_error(account, allowed, allowed - remaining, size)
