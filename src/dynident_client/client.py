"""`Client`: one service with its key and all collections; the collection of jobs."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Self

import httpx2

from dynident_client import answers
from dynident_client.analysis_and_report_collections import (
    Comparisons,
    CurrentModelSets,
    Diagnoses,
    DriveGainSets,
    Reports,
    SeriesOfDays,
    Validations,
)
from dynident_client.identification_collection import Campaigns, Identifications
from dynident_client.resource_objects import Job, Page, Record, get_identifier
from dynident_client.robot_measurement_design_collections import (
    Designs,
    Imports,
    Measurements,
    NextExperiments,
    Robots,
    Simulations,
)
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


class Client:
    """A connection to a dynident service.

    Parameters
    ----------
    base_url : str
        Address of the service, such as http://127.0.0.1:8000.
    api_key : str, optional
        Key of the user; not needed on the service's own machine.
    timeout : float
        Seconds to wait for an answer; computations may take as long as they like, see `wait`.
    transport : httpx2.BaseTransport, optional
        Another way to reach the service, for tests.

    Examples
    --------
    >>> client = Client("http://127.0.0.1:8000")
    >>> robot = client.robots.create("arm", urdf=Path("arm.urdf"))
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        api_key: str | None = None,
        timeout: float = 120.0,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        self._transport = Transport(base_url, api_key, timeout, transport)
        # All collections share the connection.
        self.robots = Robots(self._transport)
        self.imports = Imports(self._transport)
        self.measurements = Measurements(self._transport)
        self.designs = Designs(self._transport)
        self.campaigns = Campaigns(self._transport)
        self.simulations = Simulations(self._transport)
        self.identifications = Identifications(self._transport)
        self.comparisons = Comparisons(self._transport)
        self.diagnoses = Diagnoses(self._transport)
        self.next_experiments = NextExperiments(self._transport)
        self.series = SeriesOfDays(self._transport)
        self.validations = Validations(self._transport)
        self.drive_gains = DriveGainSets(self._transport)
        self.current_models = CurrentModelSets(self._transport)
        self.reports = Reports(self._transport)
        self.jobs = Jobs(self._transport)

    def effects(self) -> list[answers.EffectView]:
        """Read the catalogue of effects."""
        return self._transport.get("/v1/effects", answers.Catalogue)["items"]

    def known_robots(self) -> list[answers.KnownRobot]:
        """Read the well-known arms, whose descriptions `robots.create` takes."""
        return self._transport.get("/v1/known-robots", answers.KnownRobots)["items"]

    def health(self) -> answers.Health:
        """Read whether the service answers."""
        return self._transport.get("/healthz", answers.Health)

    def readiness(self) -> answers.Readiness:
        """Read whether database, object store and engine work.

        Raises
        ------
        ProblemError
            With status 503 where one of them does not.
        """
        return self._transport.get("/readyz", answers.Readiness)

    def usage(self) -> list[answers.KeyUsage]:
        """Read what this key has stored and under way, and how much it may; all keys for a key with all rights."""
        return self._transport.get("/v1/usage", answers.UsageView)["items"]

    def metrics(self) -> str:
        """Read the metrics for Prometheus."""
        return self._transport.get_bytes("/metrics").decode()

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def __enter__(self) -> Self:
        """Return the client, for a with statement."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connection."""
        self.close()
