"""Routes of reports: create, content."""

from __future__ import annotations

from dataclasses import replace

from fastapi import APIRouter, Request
from fastapi.responses import StreamingResponse

from dynident.reports.reported_data import MEDIA_TYPES
from dynident_service.problems import make_unusable
from dynident_service.reports.wire_types import ReportRequest, ReportView
from dynident_service.shared.required_resources import (
    depend_on,
    require_design,
    require_measurements,
    require_model,
    require_result,
)
from dynident_service.shared.resource_routes import PagesDep, SubmissionDep, require_succeeded
from dynident_service.shared.wire_types import Page
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/reports", tags=["reports"])
JOB = NewJob("report", "dynident_service.reports.jobs:write_report")


def _build_address(request: Request, identification_id: str) -> dict[str, object]:
    """Return where a report leads back to: what the settings say, or where this request was received.

    Never what its `Host` header says, which whoever sends the request makes up.
    """
    base = request.app.state.services.settings.public_url or _server_address(request)
    return {"address": f"{base.rstrip('/')}/?identification={identification_id}" if base else ""}


def _server_address(request: Request) -> str:
    host, port = request.scope.get("server") or ("", None)
    if port is None:  # a Unix socket
        return ""
    return f"{request.url.scheme}://{f'[{host}]' if ':' in host else host}:{port}"


@router.post("", status_code=202)
def create_report(body: ReportRequest, services: ServicesDep, submit: SubmissionDep, request: Request) -> ReportView:
    """Write a report on an identified model, with its ladder and, if requested, a diagnosis."""
    model = require_model(services, body.identification_id)
    robot = services.resources.get("robot", model.get_dependency("robot"))
    needs = [
        depend_on(model),
        *require_measurements(services, robot, body.measurement_ids or [], "measurement", "/measurement_ids"),
    ]
    if body.design_id is not None:
        needs.append(require_design(services, body.design_id, robot))
    needs += [
        _require_validation(services, identifier, index, model) for index, identifier in enumerate(body.validation_ids)
    ]
    if body.diagnosis_id is not None:
        needs.append(_require_diagnosis(services, body.diagnosis_id, model))
    job = replace(JOB, arguments=_build_address(request, body.identification_id))
    return submit(ReportView, "report", body, job, needs)


@router.get("")
def list_reports(pages: PagesDep, identification_id: str | None = None) -> Page[ReportView]:
    """List the reports, newest first; those of one identification if requested."""
    return pages.show("report", ReportView.show, identification_id)


@router.get("/{report_id}")
def get_report(report_id: str, services: ServicesDep) -> ReportView:
    """Show a report; its result says where the document is."""
    return ReportView.show(services.resources.get("report", report_id))


@router.delete("/{report_id}", status_code=204)
def delete_report(report_id: str, services: ServicesDep) -> None:
    """Delete a report."""
    services.resources.delete("report", report_id)


@router.get(
    "/{report_id}/content",
    response_class=StreamingResponse,
    responses={200: {"content": {media_type: {} for media_type in MEDIA_TYPES.values()}}},
)
def get_report_content(report_id: str, services: ServicesDep) -> StreamingResponse:
    """Give the document."""
    document = require_succeeded(services.resources.get("report", report_id)).objects["content"]
    # The document shows names that users gave: no script in it may run, whatever they are.
    headers = {
        "Content-Length": str(document.size),
        "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:",
    }
    return StreamingResponse(services.objects.stream(document.key), media_type=document.media_type, headers=headers)


def _require_validation(services: Services, identifier: str, index: int, model: Resource) -> Dependency:
    """Find a validation; it must be of this model, and have ended."""
    pointer = f"/validation_ids/{index}"
    validation = require_result(services, "validation", identifier, pointer)
    if validation.get_dependency("identification") != model.id:
        raise make_unusable(f"the validation {identifier!r} is of another model", pointer)
    return Dependency(identifier, "validation", "validation", pointer)


def _require_diagnosis(services: Services, identifier: str, model: Resource) -> Dependency:
    """Find a diagnosis; it must be of this model or of one that it was extended from."""
    diagnosis = require_result(services, "diagnosis", identifier, "/diagnosis_id")
    diagnosed = diagnosis.get_dependency("identification")
    ancestor: Resource | None = model
    # A diagnosis is usually of the model before: what it recommended is in this one.
    while ancestor is not None and ancestor.id != diagnosed:
        parents = ancestor.get_dependencies("parent")
        ancestor = services.resources.get("identification", parents[0]) if parents else None
    if ancestor is None:
        detail = f"the diagnosis {identifier!r} is of {diagnosed}, which is neither {model.id} nor one of its parents"
        raise make_unusable(detail, "/diagnosis_id")
    return Dependency(identifier, "diagnosis", "diagnosis", "/diagnosis_id")
