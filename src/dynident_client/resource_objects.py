"""Resources as objects: their fields, results and files; waiting for a job, following its events, cancelling."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from dynident_client import answers
from dynident_client.transport import Event, JobCancelled, JobFailed, Transport
from dynident_client.upload_options import MeasurementOptions

RecordT = TypeVar("RecordT", bound="Record")
ResultT = TypeVar("ResultT")
OnProgress = Callable[[float, str], None]


class Record:
    """A resource of the service.

    Parameters
    ----------
    transport : Transport
        The connection to the service.
    data : mapping
        The service's answer, whose fields can also be read by index.
    """

    path = ""

    def __init__(self, transport: Transport, data: Mapping[str, Any]) -> None:
        self._transport = transport
        self.data = data

    def __getitem__(self, field: str) -> Any:
        """Return a field of the answer."""
        return self.data[field]

    def __repr__(self) -> str:
        """Return class, identifier and name of the resource."""
        # Short: the answer itself may have thousands of numbers.
        return f"<{type(self).__name__} {self.id} {self.name or ''}>"

    @property
    def id(self) -> str:
        """The identifier."""
        return str(self.data["id"])

    @property
    def name(self) -> str | None:
        """The name, if the resource has one."""
        return self.data.get("name")

    def refresh(self) -> Self:
        """Read the resource again and return it."""
        self.data = self._transport.get(f"{self.path}/{self.id}", dict)
        return self


class Computed(Record, Generic[ResultT]):
    """A resource that a job computes.

    Parameters
    ----------
    transport : Transport
        The connection to the service.
    data : mapping
        The service's answer, whose fields can also be read by index.
    """

    @property
    def status(self) -> str:
        """The state as of the last answer: queued, running, succeeded, failed or cancelled."""
        return str(self.data["status"])

    @property
    def result(self) -> ResultT:
        """The result, once the status is succeeded."""
        result: ResultT | None = self.data.get("result")
        # A missing result is a mistake of the caller, who did not wait: say so instead of returning None.
        if result is None:
            raise LookupError(f"{self.id} is {self.status}: it has no result; call wait() first")
        return result

    @property
    def job_id(self) -> str:
        """The job that computes it."""
        return str(self.data["job_id"])

    def wait(self, on_progress: OnProgress | None = None) -> Self:
        """Wait until the resource has been computed, over lost connections.

        Parameters
        ----------
        on_progress : function, optional
            Called with the share that is done, from 0 to 1, and a message.

        Returns
        -------
        Computed
            The resource itself, read again.

        Raises
        ------
        JobFailed
            If the computation has failed, with the problem that the service states.
        JobCancelled
            If it was cancelled.
        """
        for event in self.events():
            if event.event == "progress" and on_progress is not None:
                on_progress(float(event.data["fraction"]), str(event.data["message"]))
        # The events tell that the job has ended; what came of it is in the resource.
        self.refresh()
        if self.status == "failed":
            raise JobFailed(self.data["error"])
        if self.status == "cancelled":
            raise JobCancelled(f"{self.id} was cancelled")
        return self

    def events(self) -> Iterator[Event]:
        """Yield the events of the job from the first to its end."""
        return self._transport.events(f"/v1/jobs/{self.job_id}/events")

    def cancel(self) -> None:
        """Stop the computation."""
        self._transport.post(f"/v1/jobs/{self.job_id}/cancel", dict)


class Robot(Record):
    """A robot."""

    path = "/v1/robots"

    @property
    def joints(self) -> list[answers.JointView]:
        """Name, type and limits of each moving joint."""
        return list(self.data["joints"])


class ProposedMetadata(MeasurementOptions, total=False):
    """Metadata of a file, with its robot and its name."""

    robot_id: str
    name: str | None


class Import(Record):
    """A file that was inspected, and is kept for a day."""

    path = "/v1/imports"

    @property
    def proposed(self) -> ProposedMetadata:
        """The proposed metadata of the file."""
        metadata: ProposedMetadata = self.data["proposed"]
        return metadata

    @property
    def questions(self) -> list[answers.QuestionView]:
        """Questions to answer before the file can be used."""
        return list(self.data["questions"])


class Measurement(Record):
    """A recording.

    Parameters
    ----------
    transport : Transport
        The connection to the service.
    data : mapping
        The service's answer, whose fields can also be read by index.
    """

    path = "/v1/measurements"

    @property
    def checks(self) -> list[answers.CheckView]:
        """The checks of the recording and their findings."""
        return list(self.data["checks"])

    @property
    def phases(self) -> dict[str, list[float]]:
        """Shares of time in which each joint is "standing" or "reversing"; it moves in the rest."""
        return dict(self.data.get("phases") or {})


class Design(Computed[answers.DesignResult]):
    """A designed experiment."""

    path = "/v1/designs"


class Campaign(Record):
    """Runs of a robot, one after the other, until its torque is predicted as well as asked for."""

    path = "/v1/campaigns"

    @property
    def state(self) -> str:
        """asking, designing, waiting, estimating, reached, unreachable or stopped."""
        return str(self.data["state"])

    @property
    def sentence(self) -> str:
        """What to do next, and why."""
        return str(self.data["decision"]["sentence"])

    @property
    def robot_time(self) -> float:
        """Time of all runs so far, s."""
        return float(self.data["robot_time"])

    @property
    def promised_error(self) -> float | None:
        """Relative error of the worst joint that the last motion promises."""
        return None if self.data["promised"] is None else float(self.data["promised"])

    @property
    def achieved_error(self) -> float | None:
        """Relative error of the worst joint after the last run."""
        return None if self.data["achieved"] is None else float(self.data["achieved"])

    @property
    def design_id(self) -> str | None:
        """Identifier of the motion to make; None if none is waiting."""
        return None if self.data["design_id"] is None else str(self.data["design_id"])

    @property
    def identification_id(self) -> str | None:
        """Identifier of the model from all runs; None before the first."""
        return None if self.data["identification_id"] is None else str(self.data["identification_id"])

    @property
    def steps(self) -> list[answers.CampaignStep]:
        """Motions that were asked for and recordings that were told, in order."""
        return list(self.data["steps"])


class Simulation(Computed[answers.SimulationResult]):
    """A virtual robot's recorded motion."""

    path = "/v1/simulations"


class Identification(Computed[answers.IdentificationResult]):
    """An identified model."""

    path = "/v1/identifications"


class Batch(Record):
    """Identifications that were requested together."""

    path = "/v1/identifications/batch"

    @property
    def states(self) -> dict[str, int]:
        """How many are in which state, as of the last answer."""
        return dict(self.data["states"])

    @property
    def identifications(self) -> list[Identification]:
        """The identifications, in the order of the request; `wait()` for one reads its result."""
        return [Identification(self._transport, item) for item in self.data["items"]]


class Comparison(Computed[answers.ComparisonResult]):
    """A model compared with a measurement."""

    path = "/v1/comparisons"


class Diagnosis(Computed[answers.DiagnosisResult]):
    """A diagnosis: what is missing in a model."""

    path = "/v1/diagnoses"


class NextExperiment(Computed[answers.NextExperimentResult]):
    """The search for the experiment that decides what a diagnosis leaves open."""

    path = "/v1/next_experiments"


class Series(Computed[answers.SeriesResult]):
    """A robot over many days."""

    path = "/v1/series"


class Validation(Computed[answers.ValidationResult]):
    """A validation of a model."""

    path = "/v1/validations"


class DriveGains(Computed[answers.DriveGainsResult]):
    """Drive gains from runs without and with a known load."""

    path = "/v1/drive_gains"


class CurrentModels(Computed[answers.CurrentModelsResult]):
    """Every joint's parameters in units of its current."""

    path = "/v1/current_models"


class Report(Computed[answers.ReportResult]):
    """A report.

    Parameters
    ----------
    transport : Transport
        The connection to the service.
    data : mapping
        The service's answer, whose fields can also be read by index.
    """

    path = "/v1/reports"

    def content(self) -> bytes:
        """Read the document."""
        return self._transport.get_bytes(f"{self.path}/{self.id}/content")

    def save(self, path: Path | str) -> Path:
        """Write the document to a file.

        Parameters
        ----------
        path : Path or str
            Where the file is to lie; one that is there is replaced.

        Returns
        -------
        Path
            The same path.
        """
        target = Path(path)
        target.write_bytes(self.content())
        return target


class Job(Record):
    """A computation.

    Parameters
    ----------
    transport : Transport
        The connection to the service.
    data : mapping
        The service's answer, whose fields can also be read by index.
    """

    path = "/v1/jobs"

    @property
    def state(self) -> str:
        """The state as of the last answer."""
        return str(self.data["state"])


class Page(Generic[RecordT]):
    """A part of a list, newest first.

    Parameters
    ----------
    items : list of Record
        The resources of this part.
    cursor : str or None
        Gives the next part; None for the last one.
    """

    def __init__(self, items: list[RecordT], cursor: str | None) -> None:
        self.items = items
        self.cursor = cursor

    def __iter__(self) -> Iterator[RecordT]:
        """Go through the items of this part."""
        return iter(self.items)

    def __len__(self) -> int:
        """Count the items of this part."""
        return len(self.items)


def get_identifier(resource: Record | str) -> str:
    """Return the identifier of a resource, which may be given as such.

    Parameters
    ----------
    resource : Record or str
        The resource or its identifier.

    Returns
    -------
    str
        The identifier.
    """
    return resource if isinstance(resource, str) else resource.id
