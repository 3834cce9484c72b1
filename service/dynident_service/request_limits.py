"""Limits of requests: body size and speed, values in JSON, requests at a time, room for uploads, Retry-After.

Quotas of stored data are in storage/quotas.py.
"""

from __future__ import annotations

import random
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from typing import Literal

import anyio
from anyio import to_thread
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident_service.fair_queue import FairQueue, SharedPlaces, Ticket, name_address_party, name_key_party
from dynident_service.problem_responses import respond
from dynident_service.problems import ProblemError, make_problem
from dynident_service.settings import Settings
from dynident_service.storage.data_directory import check_disk_space
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import RetryRow
from dynident_service.storage.quotas import Account, QuotaLimits, check_quota, get_account, make_bytes_error, sum_bytes
from dynident_service.storage.repository_values import Kind, NewResource

UPLOADS = frozenset({"/v1/measurements", "/v1/imports"})
MESHES = re.compile("/v1/robots/[^/]+/meshes")
TRAJECTORIES = re.compile("/v1/simulations|/v1/identifications/[^/]+/predictions|/v1/measurements/[^/]+/rows")
MOST_VALUES = 200_000
"""Upper limit for the weight of the values of a JSON body."""
MOST_SAMPLES = 4_000_000
"""The same for a JSON body that holds a trajectory, sample by sample."""
WEIGHTS = ((b",", 1), (b"[", 2), (b"{", 4))
"""Weights of the characters that precede values: a byte of JSON may become a hundred bytes in memory."""
ALWAYS_ANSWERED = frozenset({"/healthz", "/readyz", "/metrics"})
FIRST_GRACE = 30.0
"""Seconds that the first bytes may take, whatever the required rate."""
MOST_A_THREAD = 8
"""Short requests that may be under way per thread; further ones would wait too long."""
AT_A_TIME = 2
"""Short requests that are answered at a time if the database is a file. Each then computes nearly all of its time, so
more of them would only compete for the interpreter.
"""
SHORT_BODY = 100_000
"""Bytes of a body that arrives together with its headers; a larger one takes as long as its network does."""
SWITCH = 0.001
"""Seconds after which a computing thread lets the answering thread run."""
LONGEST_RETRY = 3
"""Upper limit in seconds for Retry-After, which is random so that refused clients do not return all at once."""
Pace = Literal["short", "long", "following"]
TURN = "dynident.turn"


def set_threads(settings: Settings) -> None:
    """Set how many requests use the database at a time; with more threads each request only takes longer.

    Call it in the event loop that answers requests.
    """
    to_thread.current_default_thread_limiter().total_tokens = settings.request_threads
    sys.setswitchinterval(SWITCH)


@dataclass(frozen=True)
class Allowance:
    """Limits for the body of a request."""

    bytes: int
    values: int | None
    setting: str


def get_allowance(scope: Scope, settings: Settings) -> Allowance:
    """Return the limits for the body of a request; its content type alone grants nothing."""
    is_form = Headers(scope=scope).get("content-type", "").lower().startswith("multipart/")
    if is_form and is_upload(scope):
        return Allowance(settings.max_upload_bytes, None, "DYNIDENT_MAX_UPLOAD_BYTES")
    values = MOST_SAMPLES if TRAJECTORIES.fullmatch(scope["path"].rstrip("/")) else MOST_VALUES
    return Allowance(settings.max_body_bytes, values, "DYNIDENT_MAX_BODY_BYTES")


def is_upload(scope: Scope) -> bool:
    """Return whether a request sends files that will be stored."""
    path = scope["path"].rstrip("/")
    return (path in UPLOADS and scope["method"] == "POST") or (
        MESHES.fullmatch(path) is not None and scope["method"] == "PUT"
    )


class BodyLimit:
    """Middleware that refuses bodies that are too large, too complex or too slow, while they arrive."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with a counted body; answer 413 if it is too much, 408 if it does not arrive."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        allowed = get_allowance(scope, self._settings)
        length = Headers(scope=scope).get("content-length", "")
        # Refused by its announced length, before any of it is read.
        if length.isdecimal() and int(length) > allowed.bytes:
            problem = make_problem(413, _describe_size_limit(allowed))
            return await respond(problem, {"connection": "close"})(scope, receive, send)
        meter = _Meter(allowed, self._settings)

        async def receive_metered() -> Message:
            if meter.is_over:
                return await receive()  # only the client's leaving can come now, whenever it does
            with anyio.move_on_after(self._settings.body_timeout_seconds) as patience:
                message = await receive()
            if patience.cancelled_caught:
                raise _make_slow_error(self._settings.body_timeout_seconds)
            meter.count(message)
            return message

        return await self._app(scope, receive_metered, send)


class _Meter:
    """Counter of the bytes, the values and the duration of one body."""

    def __init__(self, allowed: Allowance, settings: Settings) -> None:
        self._allowed = allowed
        self._slowest = settings.slowest_upload_bytes_per_second
        self._began = time.monotonic()
        self._bytes = 0
        self._weight = 0
        self.is_over = False

    def count(self, message: Message) -> None:
        """Count a piece of the body; raise HTTPException if it is too much or arrives too slowly."""
        body: bytes = message.get("body", b"")
        self._bytes += len(body)
        # A message of another kind says that the client has left.
        self.is_over = message["type"] != "http.request" or not message.get("more_body", False)
        if self._bytes > self._allowed.bytes:
            raise HTTPException(413, _describe_size_limit(self._allowed), {"connection": "close"})
        if self._allowed.values is not None:
            # Counting characters is far cheaper than parsing, and happens before the body is in memory as objects.
            self._weight += sum(weight * body.count(sign) for sign, weight in WEIGHTS)
            if self._weight > self._allowed.values:
                detail = f"The body contains more than {self._allowed.values} values; send less at a time."
                raise HTTPException(413, detail, {"connection": "close"})
        took = time.monotonic() - self._began
        # A body that is complete is not refused any more, however slow it was.
        if not self.is_over and took > FIRST_GRACE + self._bytes / self._slowest:
            raise _make_slow_error(took)


class RequestSlot:
    """Place of a request among those under way; it may turn out to take long.

    Short requests, and those that begin to follow a job, are answered a few at a time: if many share the processor,
    each is answered as late as the last one. A slow client delays nobody: a request counts as short from when its body
    is complete until its answer begins.
    """

    def __init__(self, party: str, places: SharedPlaces, short: SharedPlaces | None, queue: FairQueue | None) -> None:
        self.party = party
        self._places = places
        self._short = short
        self._queue = queue
        self._ticket: Ticket | None = None

    def __enter__(self) -> RequestSlot:
        self._places.take(self.party)
        return self

    def __exit__(self, *_: object) -> None:
        self.release_short_place()
        self._places.give_back(self.party)

    def release_short_place(self) -> None:
        """Release the place among short requests, as this one only waits for a computation elsewhere."""
        # Both are forgotten: a place is given back once, and the request does not queue again.
        ticket, queue = self._ticket, self._queue
        self._ticket = self._queue = None
        if ticket is not None and queue is not None:
            if self._short is not None:
                self._short.give_back(self.party)
            queue.leave(ticket)

    def charge_party(self, party: str) -> None:
        """Count the request for another party, once its key is known."""
        pools = [self._places]
        # The request may be in the queue already: its place there goes to the other party, too.
        if self._ticket is not None:
            self._ticket.party = party
            pools += [] if self._short is None else [self._short]
        for pool in pools:
            pool.give_back(self.party)
            pool.take(party)
        self.party = party

    async def run_request(self, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request when it is its turn."""

        async def receive_in_turn() -> Message:
            message = await receive()
            if message["type"] == "http.request" and not message.get("more_body", False):
                await self._wait()
            return message

        async def send_and_release(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.release_short_place()
            await send(message)

        headers = Headers(scope=scope)
        # A request without a body waits for its turn at once; one with a body does so when all of it has come.
        if headers.get("content-length", "0") == "0" and "transfer-encoding" not in headers:
            await self._wait()
        await app(scope, receive_in_turn, send_and_release)

    async def _wait(self) -> None:
        queue = self._queue
        if queue is None or self._ticket is not None:
            return
        if self._short is not None:
            self._short.take(self.party)
        self._ticket = Ticket(self.party)
        try:
            await queue.wait(self._ticket)
        except BaseException:
            # The client left while it waited; the place is released.
            self._ticket = None
            if self._short is not None:
                self._short.give_back(self.party)
            raise


class Admission:
    """Middleware that answers 429 if too many requests are under way, instead of letting all of them wait.

    Places are shared by party (`fair_queue`); a key that was not seen before counts by its address.
    """

    def __init__(self, app: ASGIApp, settings: Settings, party_of: Callable[[Scope], str] = name_address_party) -> None:
        self._app = app
        self._settings = settings
        self._party_of = party_of
        self._requests = SharedPlaces(settings.max_requests)
        self._followers = SharedPlaces(settings.max_followers)
        self._short = SharedPlaces(MOST_A_THREAD * settings.request_threads)
        # With PostgreSQL a request mostly waits for the server, so more of them can be answered at a time.
        waits = not settings.database.startswith("sqlite")
        self._queue = FairQueue(settings.request_threads if waits else min(AT_A_TIME, settings.request_threads))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Admit a request if there is room; requests that only follow a job are counted separately."""
        if scope["type"] != "http" or scope["path"] in ALWAYS_ANSWERED:
            return await self._app(scope, receive, send)
        pace, party = _classify_request(scope), self._party_of(scope)
        refusal = self._find_refusal(pace, party)
        if refusal is not None:
            again = {"retry-after": str(random.randint(1, LONGEST_RETRY)), "connection": "close"}
            return await respond(make_problem(429, refusal, title="Too busy"), again)(scope, receive, send)
        # Followers keep their connection for minutes: they have places of their own. What those of a recording compute
        # runs in child processes, which have places of theirs.
        places = self._followers if pace == "following" else self._requests
        short = self._short if pace == "short" else None
        with RequestSlot(party, places, short, None if pace == "long" else self._queue) as turn:
            scope[TURN] = turn
            return await turn.run_request(self._app, scope, receive, send)

    def _find_refusal(self, pace: Pace, party: str) -> str | None:
        if pace == "following":
            return _describe_refusal(self._followers, party, "jobs are being followed", "DYNIDENT_MAX_FOLLOWERS")
        refusal = _describe_refusal(self._requests, party, "requests are in progress", "DYNIDENT_MAX_REQUESTS")
        if refusal is None and pace == "short":
            each = f"{MOST_A_THREAD} for each of DYNIDENT_REQUEST_THREADS"
            return _describe_refusal(self._short, party, "requests wait for an answer", each)
        return refusal


def _describe_refusal(places: SharedPlaces, party: str, doing: str, setting: str) -> str | None:
    """Return why a party may not have another place, or None if it may."""
    if places.may_take(party):
        return None
    return (
        f"{places.held[party]} of your {doing}, {places.held.total()} in total. The limit is {places.total} "
        f"({setting}), and a part is reserved for other callers. Try again soon."
    )


def mark_long(scope: Scope) -> None:
    """Mark a request as long, so that it takes no place of a short one."""
    turn = scope.get(TURN)
    if isinstance(turn, RequestSlot):
        turn.release_short_place()


def charge_key(scope: Scope, name: str) -> None:
    """Count a request for its API key."""
    turn = scope.get(TURN)
    if isinstance(turn, RequestSlot):
        turn.charge_party(name_key_party(name))


def find_request_party(scope: Scope) -> str:
    """Return the party that a request counts for."""
    turn = scope.get(TURN)
    return turn.party if isinstance(turn, RequestSlot) else name_address_party(scope)


def _classify_request(scope: Scope) -> Pace:
    if scope["path"].endswith(("/events", "/estimates")):
        return "following"
    length = Headers(scope=scope).get("content-length", "0")
    return "short" if length.isdecimal() and int(length) <= SHORT_BODY else "long"


def _describe_size_limit(allowed: Allowance) -> str:
    return (
        f"The body is larger than {allowed.bytes} bytes ({allowed.setting}); send it in parts, and recordings as "
        "Parquet."
    )


def _make_slow_error(seconds: float) -> HTTPException:
    detail = f"No more of the body arrived within {seconds:.0f} s; send it again, over a better connection."
    return HTTPException(408, detail, {"connection": "close"})


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
        upload = _Upload(get_account(), int(length) if length.isdecimal() else 0)
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
