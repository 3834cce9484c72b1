"""HTTP requests: problems become exceptions, retries (4 tries, 60 s while busy), event streams that resume."""

from __future__ import annotations

import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NoReturn, TypedDict, TypeVar

import httpx2

from dynident_client.answers import Problem, ProblemField


class ProblemError(Exception):
    """Raised where the service refuses a request (RFC 9457).

    Parameters
    ----------
    problem : Problem
        The body of the answer; `status`, `title` and `detail` are taken from it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        # A problem need not state all of them: RFC 9457 leaves every member open.
        self.status = int(problem.get("status", 0))
        self.title = str(problem.get("title", ""))
        self.detail = str(problem.get("detail", ""))
        super().__init__(f"{self.title}: {self.detail}" if self.title else self.detail)

    @property
    def errors(self) -> list[ProblemField]:
        """The fields, columns or parameters that are wrong: pointer and detail of each."""
        return self.problem.get("errors") or []


class JobFailed(ProblemError):
    """Raised where a computation has failed.

    Parameters
    ----------
    problem : Problem
        Why it has failed, as the service states it.
    """


class JobCancelled(Exception):
    """Raised where a computation was cancelled."""


T = TypeVar("T")
Param = str | int | float | bool | None
"""What a query may state; None is left out."""

TRIES = 4
PAUSE = 0.25
"""Seconds before the second try; twice as long before each further one."""
BUSY = frozenset({429, 503})
PATIENCE = 60.0
"""Seconds for which a busy service is asked again, as often as it says by Retry-After."""


@dataclass(frozen=True)
class Event:
    """One event of a job, or of a recording under way.

    Parameters
    ----------
    id : str
        Number of the event, from which a lost stream continues.
    event : str
        Kind of the event: "progress" or "state" of a job, "estimate", "finished" or "problem" of a recording.
    data : mapping
        Fraction and message of a progress, the state, or the estimate.
    """

    id: str
    event: str
    data: Mapping[str, Any]


class ListPart(TypedDict):
    """A part of a list, as it is answered."""

    items: list[dict[str, Any]]
    cursor: str | None


class Transport:
    """A connection to one service.

    Parameters
    ----------
    base_url : str
        Address of the service.
    api_key : str or None
        Key of the user.
    timeout : float
        Seconds to wait for an answer.
    transport : httpx2.BaseTransport or None
        Another way to reach the service, for tests.
    """

    def __init__(
        self, base_url: str, api_key: str | None, timeout: float, transport: httpx2.BaseTransport | None
    ) -> None:
        # Without a key the service answers on its own machine alone.
        headers = {} if api_key is None else {"Authorization": f"Bearer {api_key}"}
        # One client for all requests: it keeps connections open, and may be used by several threads.
        self._http = httpx2.Client(base_url=base_url, headers=headers, timeout=timeout, transport=transport)

    def get(self, path: str, answer: type[T], **params: Param) -> T:
        """Read JSON.

        Parameters
        ----------
        path : str
            Path of the resource.
        answer : type
            Type of the answer, by the contract; for type checkers alone.
        **params : str, int, float, bool or None
            Values of the query; None is left out.

        Returns
        -------
        object
            The answer.
        """
        content: T = self._send("GET", path, params=params).json()
        return content

    def get_bytes(self, path: str, **params: Param) -> bytes:
        """Read bytes."""
        return self._send("GET", path, params=params).content

    def get_with_header(self, path: str, header: str, **params: Param) -> tuple[bytes, str | None]:
        """Read bytes and a header of the answer, None where it has none."""
        answer = self._send("GET", path, params=params)
        return answer.content, answer.headers.get(header)

    def stream(self, path: str, **params: Param) -> Iterator[bytes]:
        """Yield bytes in pieces."""
        with self._http.stream("GET", path, params=_drop_missing(params)) as answer:
            if answer.is_error:
                # A stream has no body yet: the problem has to be read before it can be raised.
                answer.read()
                _raise_problem(answer)
            yield from answer.iter_bytes()

    def post(self, path: str, answer: type[T], body: Mapping[str, object] | None = None) -> T:
        """Send JSON; a request whose answer was lost is repeated without doing the work twice."""
        content: T = self._send("POST", path, json=None if body is None else _drop_missing(body)).json()
        return content

    def patch(self, path: str, answer: type[T], body: Mapping[str, object]) -> T:
        """Send changes as JSON."""
        content: T = self._send("PATCH", path, json=_drop_missing(body)).json()
        return content

    def patch_content(self, path: str, answer: type[T], content: bytes, media_type: str, **params: Param) -> T:
        """Send a body of any media type; the request has to be one that does no harm if it is repeated."""
        headers = {"Content-Type": media_type}
        answered: T = self._send("PATCH", path, content=content, headers=headers, params=params).json()
        return answered

    def upload(self, path: str, answer: type[T], files: Sequence[Path], fields: Mapping[str, str]) -> T:
        """Send a file, or several that belong together, and fields as a form."""
        with ExitStack() as stack:
            # Files are streamed from disk, so that a recording of any size needs little memory.
            opened = [stack.enter_context(file.open("rb")) for file in files]
            parts = [
                ("further" if place else "file", (files[place].name, stream)) for place, stream in enumerate(opened)
            ]
            sent = self._send("POST", path, files=parts, data=dict(fields), rewind=opened)
        content: T = sent.json()
        return content

    def put_files(self, path: str, answer: type[T], files: Mapping[str, Path]) -> T:
        """Put several files, by the names that they have in the form."""
        # Each is as large as a drawing of a part: small beside what a recording may be, which is streamed.
        form = [("files", (name, file.read_bytes())) for name, file in files.items()]
        content: T = self._send("PUT", path, files=form).json()
        return content

    def delete(self, path: str) -> None:
        """Delete."""
        self._send("DELETE", path)

    def events(self, path: str) -> Iterator[Event]:
        """Yield the events of a stream to its end, over lost connections."""
        last, tries = "", 0
        until = time.monotonic() + PATIENCE
        while True:
            # By this header the service continues behind the last event that arrived.
            headers = {"Last-Event-ID": last} if last else {}
            try:
                with self._http.stream("GET", path, headers=headers, timeout=httpx2.Timeout(30.0)) as answer:
                    if answer.is_error:
                        answer.read()
                        pause = _get_retry_delay(answer)
                        if pause is None or time.monotonic() + pause > until:
                            _raise_problem(answer)
                        time.sleep(pause)
                        continue
                    for event in httpx2.EventSource(answer):
                        # Every event that arrives shows that the connection works again: the tries begin anew.
                        last, tries = event.id or last, 0
                        data = event.json()
                        assert isinstance(data, dict)
                        yield Event(event.id, event.event, data)
                return
            except httpx2.TransportError:
                tries += 1
                if tries >= TRIES:
                    raise
                time.sleep(PAUSE * 2**tries)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def _send(self, method: str, path: str, *, rewind: Sequence[IO[bytes]] = (), **content: Any) -> httpx2.Response:
        # The service answers a second POST of the same key as the first, so that a lost answer is no reason to compute
        # again.
        headers = {"Idempotency-Key": uuid.uuid4().hex} if method == "POST" else {}
        headers |= content.pop("headers", {})
        if "params" in content:
            content["params"] = _drop_missing(content["params"])
        # The patience is that of the whole request, however often it is sent.
        until = time.monotonic() + PATIENCE
        attempt = 0
        while True:
            try:
                answer = self._http.request(method, path, headers=headers, **content)
            except httpx2.TransportError:
                # A DELETE has no idempotency key, so it is repeated once only.
                if attempt == TRIES - 1 or (method == "DELETE" and attempt > 0):
                    raise
                pause, attempt = PAUSE * 2**attempt, attempt + 1
            else:
                if not answer.is_error:
                    return answer
                # A request is sent again only if the answer says when: all others would be refused again.
                pause = _get_retry_delay(answer)
                if pause is None or time.monotonic() + pause > until:
                    _raise_problem(answer)
            time.sleep(pause)
            # A try that was broken off has read part of the files.
            for file in rewind:
                file.seek(0)


def _drop_missing(values: Mapping[str, T]) -> dict[str, T]:
    """Return values without those that are None; an underscore at the end of a name is removed."""
    # "from" is a keyword of Python and is given as `from_`.
    return {name.removesuffix("_"): value for name, value in values.items() if value is not None}


def _get_retry_delay(answer: httpx2.Response) -> float | None:
    """Return the seconds after which a busy service wants the request again; `None` where it states none."""
    after = answer.headers.get("retry-after", "")
    return float(after) if answer.status_code in BUSY and after.isdecimal() else None


def _raise_problem(answer: httpx2.Response) -> NoReturn:
    problem: Problem = {}
    if "problem+json" in answer.headers.get("content-type", ""):
        problem = answer.json()
    # A proxy between client and service answers with pages of its own: what HTTP states is then all that is known.
    stated: Problem = {"status": answer.status_code, "title": answer.reason_phrase, "detail": answer.text[:500]}
    raise ProblemError({**stated, **problem})
