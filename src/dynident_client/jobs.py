"""The collection of jobs."""

from __future__ import annotations

from collections.abc import Iterator

from dynident_client.records import Job, Page, Record, get_identifier
from dynident_client.transport import Event, ListPart, Transport


class Jobs:
    """Computations."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def get(self, job: Record | str) -> Job:
        """Read the state of a job."""
        return Job(self._transport, self._transport.get(f"{Job.path}/{get_identifier(job)}", dict))

    def page(
        self,
        limit: int | None = None,
        cursor: str | None = None,
        *,
        state: str | None = None,
        kind: str | None = None,
    ) -> Page[Job]:
        """Read a part of the list, newest first.

        Parameters
        ----------
        limit : int, optional
            Most jobs in the part.
        cursor : str, optional
            Cursor of the part before; None for the first part.
        state : str, optional
            State of the jobs that are listed; all where not given.
        kind : str, optional
            Kind of the jobs that are listed; all where not given.

        Returns
        -------
        Page
            The jobs of the part, and where the next one begins.
        """
        data = self._transport.get(Job.path, ListPart, limit=limit, cursor=cursor, state=state, kind=kind)
        return Page([Job(self._transport, job) for job in data["items"]], data["cursor"])

    def events(self, job: Record | str) -> Iterator[Event]:
        """Yield the events of a job from the first to its end, over lost connections."""
        return self._transport.events(f"{Job.path}/{get_identifier(job)}/events")

    def cancel(self, job: Record | str) -> Job:
        """Stop a job."""
        return Job(self._transport, self._transport.post(f"{Job.path}/{get_identifier(job)}/cancel", dict))
