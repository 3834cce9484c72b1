"""Check of resources that another service stored: can this one show them."""

from __future__ import annotations

from collections.abc import Mapping

from dynident_service.routes import batches, jobs
from dynident_service.routes.crud import SHOW_FUNCTIONS
from dynident_service.storage.records import Kind, Resource

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
        jobs.show_job(resource.job)
    if resource.kind == "batch":
        batches.member_ids(resource)
    else:
        SHOW_FUNCTIONS[resource.kind](resource)
