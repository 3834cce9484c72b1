"""For `dynident doctor`: check in a child process that stored resources can be read and shown.

Files are read in a child process, so that one that kills or blocks its reader is reported like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import TracebackType

from dynident_service.campaigns.wire_types import CampaignRequest
from dynident_service.comparisons.wire_types import ComparisonView
from dynident_service.designs.wire_types import DesignView, SimulationView
from dynident_service.diagnoses.wire_types import DiagnosisView, NextExperimentView, SeriesView
from dynident_service.drive_gains.wire_types import CurrentModelsView, DriveGainsView
from dynident_service.identifications.batch_routes import member_ids
from dynident_service.identifications.routes import show_identification
from dynident_service.jobs.child_pool import ChildProcess, ForkServer
from dynident_service.jobs.confinement import REQUEST_MEMORY, AllowedFolders, Confinement
from dynident_service.jobs.task_input_output import Answer, Call
from dynident_service.measurements.import_routes import show_import
from dynident_service.measurements.routes import show_measurement
from dynident_service.problems import ProblemError
from dynident_service.reports.wire_types import ReportView
from dynident_service.robots.routes import show_robot
from dynident_service.service_routes import show_job
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import Kind, Resource
from dynident_service.validations.wire_types import ValidationView

LONGEST = 120.0
"""Seconds to read one resource, including the start of the process; as long as a request that reads it may take."""
FUNCTION = "dynident_service.shared.stored_inputs:read_stored"


class StoredFilesReader:
    """Reads resources one after the other in a child process, which is replaced if it dies or hangs."""

    def __init__(self, objects: ObjectStore) -> None:
        self._objects = objects
        folder = objects.local_folder
        self._confinement = Confinement(REQUEST_MEMORY, folders=AllowedFolders(folder, (folder,), ()))
        self._fork_server = ForkServer()
        self._child: ChildProcess | None = None

    def __enter__(self) -> StoredFilesReader:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._replace()
        self._fork_server.close()

    def find_problem(self, resource: Resource) -> str | None:
        """Return what cannot be read of a resource, and why; None if everything can.

        Missing or damaged files are left out, as the check of all objects reports them.
        """
        if resource.job is not None and resource.job.state != "succeeded":
            return None
        try:
            files = {role: str(self._objects.fetch_file(owned.key)) for role, owned in resource.objects.items()}
        except ProblemError:
            return None
        arguments = {
            "kind": resource.kind,
            "request": resource.request,
            "result": resource.result or {},
            "files": files,
        }
        try:
            self._child = self._child or ChildProcess(self._fork_server, self._confinement)
            self._child.send(Call(FUNCTION, arguments))
            answer = self._child.receive(LONGEST)
        except EOFError:
            self._replace()
            return "the process that read it died"
        if answer is None:
            self._replace()
            return f"it was not read within {LONGEST:.0f} s"
        assert isinstance(answer, Answer)
        if answer.problem is not None:
            return answer.problem.detail
        problem: str | None = answer.value
        return problem

    def _replace(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child = None


_FILES: Mapping[Kind, frozenset[str]] = {
    "measurement": frozenset({"recording"}),
    "import": frozenset({"original"}),
    "design": frozenset({"trajectory"}),
    "identification": frozenset({"model"}),
    "comparison": frozenset({"signals"}),
    "diagnosis": frozenset({"evidence"}),
    "series": frozenset({"days", "figure"}),
    "report": frozenset({"content"}),
}
"""What there is of each, once it has been computed."""


SHOW_FUNCTIONS: Mapping[Kind, Callable[[Resource], object]] = {
    "robot": show_robot,
    "import": show_import,
    "measurement": show_measurement,
    "identification": show_identification,
    "batch": member_ids,
    # Its steps are resources of their own.
    "campaign": lambda campaign: CampaignRequest.model_validate(campaign.request),
    "comparison": ComparisonView.show,
    "current_models": CurrentModelsView.show,
    "design": DesignView.show,
    "diagnosis": DiagnosisView.show,
    "drive_gains": DriveGainsView.show,
    "next_experiment": NextExperimentView.show,
    "report": ReportView.show,
    "series": SeriesView.show,
    "simulation": SimulationView.show,
    "validation": ValidationView.show,
}
"""The function that shows a resource, by kind."""


def check_stored_resource(resource: Resource) -> None:
    """Show a resource and its job; raises ValueError, or whatever showing it does, where this service could not."""
    show_resource(resource)
    if resource.job is None or resource.job.state == "succeeded":
        lacking = _FILES.get(resource.kind, frozenset()) - resource.objects.keys()
        if lacking:
            raise ValueError(f"it has no {' and no '.join(sorted(lacking))}")


def show_resource(resource: Resource) -> None:
    """Show a resource and its job, whatever files it has; raises what showing it does where this service cannot."""
    if resource.job is not None:
        show_job(resource.job)
    SHOW_FUNCTIONS[resource.kind](resource)
