"""Routes of measurements: upload with checks, original file, raw signals, standstills, revision.

A revision changes the metadata of the same file, and nothing is uploaded.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, File, Form, Query, Request, Response, UploadFile
from fastapi.responses import FileResponse, StreamingResponse
from starlette.background import BackgroundTask

from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.measurements.wire_types import (
    JSON_BODY,
    ROWS,
    CheckView,
    ConditionedRows,
    ConditioningSubject,
    ConditioningView,
    MeasurementMetadata,
    MeasurementOfImport,
    MeasurementResult,
    MeasurementUnderWay,
    MeasurementView,
    RawSignals,
    RevisionRequest,
    Standstills,
    begins_recording,
)
from dynident_service.problems import (
    Problem,
    ProblemError,
    ProblemField,
    make_unusable,
    make_validation_problem,
)
from dynident_service.robots.wire_types import RobotResult
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import copy_original, find_original, require_resource
from dynident_service.shared.resource_routes import (
    LabelledPagesDep,
    RetryKey,
    RetryKeyDep,
    create_or_replay,
    parse_json_body,
    replay_response,
    update_labels,
)
from dynident_service.shared.upload_forms import (
    FURTHER,
    MEDIA_TYPES,
    MOST_FILES,
    FormRoute,
    detect_media_type,
    hash_file,
    receive_files,
    require_room_for,
)
from dynident_service.shared.wire_types import LabelsRequest, Page, to_plain_json
from dynident_service.storage.object_store import ObjectGone
from dynident_service.storage.repository_values import Dependency, NewResource, OwnedObject, Resource, Retry
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/measurements", tags=["measurements"], route_class=FormRoute)

IMPORT = "dynident_service.measurements.jobs:import_measurement"
RAW = "dynident_service.measurements.jobs:write_raw_signals"
STANDSTILLS = "dynident_service.measurements.jobs:find_standstills"
SMALLEST_ANSWER, LARGEST_ANSWER = 16_000_000, 500_000_000
"""Bytes of signals that one answer may have: the largest is twenty minutes of 6 joints at 1 kHz."""
DIGITS = 20
"""Times as large as a file its signals may be as text: a number has 20 digits, and the file may be compressed."""


@router.post("", status_code=201, openapi_extra=JSON_BODY)
async def upload_measurement(
    request: Request,
    services: ServicesDep,
    retry: RetryKeyDep,
    response: Response,
    file: Annotated[UploadFile | None, File(description="t, q…, tau… or current…, …, in any format")] = None,
    metadata: Annotated[str | None, Form(description="A JSON object: see MeasurementMetadata")] = None,
    further: Annotated[list[UploadFile] | None, File(description=FURTHER, max_length=MOST_FILES - 1)] = None,
) -> MeasurementView:
    """Check and store a recording; an unusable one is refused, with the column and the row or time.

    Send a form with the file and its metadata, or a JSON body that names an import: see MeasurementOfImport. With
    `"under_way": true` instead of an import the rows come by `PATCH /v1/measurements/{id}/rows`.
    """
    # One path for both, since both make a measurement; FastAPI cannot declare a form and a JSON body in one function.
    if request.headers.get("content-type", "").lower().startswith("application/json"):
        return await _create_from_import(request, services, retry, response)
    if file is None or metadata is None:
        lacking = [name for name, value in (("file", file), ("metadata", metadata)) if value is None]
        fields = [ProblemField(pointer=f"/{name}", detail="Field required") for name in lacking]
        raise ProblemError.from_problem(make_validation_problem(fields))
    with services.create_scratch_folder() as folder:
        stated_metadata = parse_json_body(MeasurementMetadata, metadata, "/metadata")
        received = await to_thread.run_sync(
            _receive_upload, services, stated_metadata, [file, *(further or ())], folder, retry
        )
        return await check_and_store(request, services, received, response)


async def _create_from_import(
    request: Request, services: Services, retry: RetryKey, response: Response
) -> MeasurementView:
    """Store a recording of a file that was imported before."""
    body = await request.body()
    if begins_recording(body):
        started = parse_json_body(MeasurementUnderWay, body)
        return show_measurement(await to_thread.run_sync(_start_measurement, services, started, retry, response))
    import_request = parse_json_body(MeasurementOfImport, body)
    with services.create_scratch_folder() as folder:
        received = await to_thread.run_sync(_receive_import, services, import_request, folder, retry)
        return await check_and_store(request, services, received, response)


async def check_and_store(
    request: Request, services: Services, received: ReceivedFile | Resource, response: Response
) -> MeasurementView:
    """Check a file and store it, unless an earlier try did, which made the resource."""
    if isinstance(received, Resource):
        return show_measurement(replay_response(received, response))
    limits = ComputationLimits.from_file_sizes(received.source.stat().st_size)
    result = await services.interactive.call(request, IMPORT, dict, received.import_arguments(), limits, is_long=True)
    return await to_thread.run_sync(lambda: show_measurement(_store_measurement(services, received, result, response)))


def _start_measurement(services: Services, started: MeasurementUnderWay, key: RetryKey, response: Response) -> Resource:
    """Store a measurement without rows, which come later."""
    metadata = started.metadata
    robot = require_resource(services, "robot", metadata.robot_id, "/metadata/robot_id")
    joints = [joint.name for joint in RobotResult.model_validate(robot.result).joints]
    nothing = MeasurementResult(
        sha256="",
        under_way=True,
        n_samples=0,
        sampling_rate=0.0,
        joints=joints,
        segments=[],
        has_temperature=False,
        checks=[],
    )
    new = NewResource(
        "measurement",
        to_plain_json(metadata),
        name=metadata.name,
        result=to_plain_json(nothing),
        rests_on=(Dependency(metadata.robot_id, "robot", "robot", "/metadata/robot_id"),),
        retry=key.bind_to_body(started),
    )
    return create_or_replay(services, new, response)


def _receive_import(
    services: Services, import_request: MeasurementOfImport, folder: Path, key: RetryKey
) -> ReceivedFile | Resource:
    retry, source, metadata = key.bind_to_body(import_request), folder / "source", import_request.metadata
    if (existing := services.resources.find_retried(retry)) is not None:
        return existing
    imported = services.resources.find(import_request.import_id)
    if imported is None or imported.kind != "import":
        detail = f"there is no import {import_request.import_id!r}; imports are stored for a day: upload the file again"
        raise make_unusable(detail, "/import_id", title="Unknown resource")
    original = imported.objects["original"]
    # The file is copied out of the store, for which there has to be room.
    require_room_for(services, original.size)
    with source.open("wb") as target:
        target.writelines(services.objects.stream(original.key))
    robot = require_resource(services, "robot", metadata.robot_id, "/metadata/robot_id").request
    return ReceivedFile(metadata, source, folder, original.key, retry, robot, import_id=imported.id)


@router.get("/{measurement_id}/content", response_class=StreamingResponse)
def get_measurement_content(measurement_id: str, services: ServicesDep) -> StreamingResponse:
    """Give the file back as it was uploaded; of a recording under way, its rows so far."""
    original = find_original(services.resources.get("measurement", measurement_id), ROWS)
    try:
        content = services.objects.stream(original.key)
    except ProblemError:  # More rows came meanwhile: those before are deleted.
        original = find_original(services.resources.get("measurement", measurement_id), ROWS)
        content = services.objects.stream(original.key)
    # The key is the hash of the content, and thereby an ETag as it should be.
    headers = {"Content-Length": str(original.size), "ETag": f'"{original.key}"'}
    return StreamingResponse(content, media_type=original.media_type, headers=headers)


_FIRST_ROWS = 20
"""Rows of a correction that are listed; the check of the same name has up to a thousand."""


def _describe_conditioning(
    views: Sequence[CheckView], metadata: MeasurementMetadata, joints: Sequence[str]
) -> list[ConditioningView]:
    """Build the views of what was put right before the checks, column by column."""
    stated = metadata.model_dump(include={"columns", "skip"})
    return [
        ConditioningView(
            code=view.name,
            subject=ConditioningSubject(
                recording=metadata.name, column=column, joint=_find_joint(column, stated["columns"], joints)
            ),
            rows=ConditionedRows(count=len(rows), first=rows[:_FIRST_ROWS]),
            detail=view.detail,
            undo=RevisionRequest.model_validate({"skip": [*stated["skip"], view.name]}),
        )
        for view in views
        # A correction is a finding that is undone by leaving its step out.
        if view.remedy is not None and view.remedy.field == "skip"
        for column, rows in view.rows.items()
    ]


def _find_joint(column: str, columns: Mapping[str, str], joints: Sequence[str]) -> str | None:
    """Return the joint of a column of the file: standard names end with its number or its name."""
    name = next((ours for ours, theirs in columns.items() if theirs == column), column)
    stem = name.rstrip("0123456789")
    found = [
        joint
        for number, joint in enumerate(joints, start=1)
        if name.endswith(f"_{joint}") or (stem and name == f"{stem}{number}")
    ]
    # The name of a joint may end with that of another: the longest is the whole name.
    return max(found, key=len, default=None)


def show_measurement(resource: Resource) -> MeasurementView:
    """Show a stored measurement."""
    metadata = MeasurementMetadata.model_validate(resource.request)
    result = MeasurementResult.model_validate(resource.result)
    return MeasurementView.model_validate(
        {
            **vars(resource),
            **result.model_dump(),
            "conditioning": _describe_conditioning(result.checks, metadata, result.joints),
            **metadata.model_dump(include={"robot_id", "role", "windows"}),
            "parent_id": next(iter(resource.get_dependencies("parent")), None),
            "revision": len((resource.result or {}).get("edits", [])),
            "effort_kind": metadata.model_dump(include={"effort_kind"})["effort_kind"] or "unknown",
            "request": metadata,
        }
    )


@router.get("")
def list_measurements(pages: LabelledPagesDep, robot_id: str | None = None) -> Page[MeasurementView]:
    """List the measurements, newest first; those of one robot if requested."""
    return pages.show("measurement", show_measurement, robot_id)


@router.get("/{measurement_id}")
def get_measurement(measurement_id: str, services: ServicesDep) -> MeasurementView:
    """Show a measurement."""
    return show_measurement(services.resources.get("measurement", measurement_id))


@router.delete("/{measurement_id}", status_code=204)
def delete_measurement(measurement_id: str, services: ServicesDep) -> None:
    """Delete a measurement; 409 while other resources need it."""
    services.resources.delete("measurement", measurement_id)


@router.patch("/{measurement_id}")
def label_measurement(measurement_id: str, body: LabelsRequest, services: ServicesDep) -> MeasurementView:
    """Rename, tag or archive a measurement; the runs of its recording keep their names."""
    return show_measurement(update_labels(services, "measurement", measurement_id, body))


@dataclass(frozen=True)
class ReceivedFile:
    """A file that was received, and what is said of it."""

    metadata: MeasurementMetadata
    source: Path
    folder: Path
    sha256: str
    retry: Retry | None
    robot: Mapping[str, Any]
    import_id: str | None = None
    """The import that the file comes from."""
    parent: Resource | None = None
    """The measurement of the same file of which something else is said now."""
    edits: Sequence[Mapping[str, object]] = ()
    """All that was said of it since it was uploaded."""

    @property
    def recording(self) -> Path:
        """Where the recording is to be written."""
        return self.folder / "recording.parquet"

    def import_arguments(self) -> dict[str, object]:
        """Give what the import is told."""
        return {
            "source": str(self.source),
            "destination": str(self.recording),
            "robot": dict(self.robot),
            "metadata": to_plain_json(self.metadata),
            "sha256": self.sha256,
        }


def _receive_upload(
    services: Services, metadata: MeasurementMetadata, files: Sequence[UploadFile], folder: Path, key: RetryKey
) -> ReceivedFile | Resource:
    source = folder / "source"
    receive_files(services, files, source)
    sha256 = hash_file(source)
    # The file belongs to what was asked: the same key with another file is another request.
    retry = key.bind_to_body(metadata, sha256)
    if (existing := services.resources.find_retried(retry)) is not None:
        return existing
    robot = require_resource(services, "robot", metadata.robot_id, "/metadata/robot_id").request
    return ReceivedFile(metadata, source, folder, sha256, retry, robot)


def _store_measurement(
    services: Services, received: ReceivedFile, result: Mapping[str, Any], response: Response
) -> Resource:
    metadata, revised = received.metadata, received.parent
    new = NewResource(
        "measurement",
        to_plain_json(metadata),
        name=metadata.name,
        result={**result, "edits": received.edits},
        rests_on=(
            Dependency(metadata.robot_id, "robot", "robot", "/metadata/robot_id"),
            *([Dependency(received.import_id, "import", "import", "/import_id")] if received.import_id else []),
            *([Dependency(revised.id, "measurement", "parent", "/")] if revised else []),
        ),
        objects=_store_objects(services, received),
        retry=received.retry,
    )
    try:
        return create_or_replay(services, new, response)
    except ObjectGone:  # swept away while this waited for longer than such files are kept
        return create_or_replay(services, replace(new, objects=_store_objects(services, received)), response)


def _store_objects(services: Services, received: ReceivedFile) -> tuple[OwnedObject, ...]:
    source, canonical = received.source, received.recording
    # A revision adds its recording only: the original is its parent's. Rows of a recording under way do not stay there.
    original = None if received.parent is None else received.parent.objects.get("original")
    # Before anything is put into the store.
    services.resources.check_room("measurement", (source, canonical) if original is None else (canonical,))
    if original is None:
        original = services.resources.put_with_role("original", source, detect_media_type(source))
    return original, services.resources.put_with_role("recording", canonical, MEDIA_TYPES["parquet"])


@router.get(
    "/{measurement_id}/raw",
    response_class=FileResponse,
    responses={200: {"model": RawSignals}},
)
async def get_raw_signals(
    measurement_id: str,
    request: Request,
    services: ServicesDep,
    signals: Annotated[
        str | None,
        Query(description="q1,tau_elbow,… or columns of the file, separated by commas; by default, all q and tau"),
    ] = None,
    start: Annotated[float | None, Query(alias="from", allow_inf_nan=False, description="s")] = None,
    end: Annotated[float | None, Query(alias="to", allow_inf_nan=False, description="s")] = None,
    points: Annotated[
        int | None, Query(ge=12, le=100_000, description="Approximate number of samples; all by default")
    ] = None,
) -> FileResponse:
    """Give signals as they were recorded; with `points`, thinned so that extremes are kept, else all samples."""
    # Not in a `with` block: the folder has to outlive this function until the answer was sent.
    folder = Path(tempfile.mkdtemp(dir=services.settings.uploads_dir))
    removal = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
    try:
        names = [name.strip() for name in (signals or "").split(",") if name.strip()]
        sent = await to_thread.run_sync(_describe_raw, services, measurement_id, folder)
        arguments = {**sent, "signals": names, "start": start, "end": end, "points": points}
        size = Path(sent["source"]).stat().st_size
        largest = min(max(SMALLEST_ANSWER, DIGITS * size), LARGEST_ANSWER)
        # `require_room_for` takes twice the size of a file: half of the answer's stands for the whole answer.
        await to_thread.run_sync(require_room_for, services, largest // 2)
        await services.interactive.call(
            request, RAW, NoneType, arguments, replace(ComputationLimits.from_file_sizes(size), file_bytes=largest)
        )
    # The folder is removed after the answer was sent, or here, where there is none.
    except BaseException:
        await removal()
        raise
    return FileResponse(sent["destination"], media_type="application/json", background=removal)


def _describe_raw(services: Services, measurement_id: str, folder: Path) -> dict[str, Any]:
    """Return what a child has to know of the file of a measurement, and where it is to write signals of it."""
    measurement = services.resources.get("measurement", measurement_id)
    metadata = MeasurementMetadata.model_validate(measurement.request)
    robot = services.resources.get("robot", metadata.robot_id)
    return {
        "source": str(services.objects.fetch_file(find_original(measurement).key)),
        "destination": str(folder / "signals.json"),
        "robot": dict(robot.request),
        "metadata": to_plain_json(metadata),
    }


@router.get("/{measurement_id}/standstills")
async def get_standstills(measurement_id: str, request: Request, services: ServicesDep) -> Standstills:
    """Give the intervals in which each joint stands still, as identification uses them for friction."""
    measurement = await to_thread.run_sync(services.resources.get, "measurement", measurement_id)
    find_original(measurement)
    path = await to_thread.run_sync(services.objects.fetch_file, measurement.objects["recording"].key)
    arguments = {"recording": str(path)}
    return Standstills.model_validate(await services.interactive.call(request, STANDSTILLS, dict, arguments))


revisions_router = APIRouter(prefix="/v1/measurements", tags=["measurements"])

_NUMBERED = re.compile(r" r\d+$")


@revisions_router.post("/{measurement_id}/revisions", status_code=201)
async def revise_measurement(
    measurement_id: str,
    body: RevisionRequest,
    request: Request,
    services: ServicesDep,
    retry: RetryKeyDep,
    response: Response,
) -> MeasurementView:
    """Change the metadata of a measurement's file: makes a new measurement, checked again, whose parent is this one.

    Of a recording under way, which may be refused at its end, the file is that of its rows so far.
    """
    with services.create_scratch_folder() as folder:
        received = await to_thread.run_sync(
            _prepare_revision, services, measurement_id, body, folder, retry.bind_to_body(body)
        )
        try:
            return await check_and_store(request, services, received, response)
        except ProblemError as error:
            raise _repoint_to_body(error.problem) from error


def _prepare_revision(
    services: Services, measurement_id: str, body: RevisionRequest, folder: Path, key: Retry | None
) -> ReceivedFile | Resource:
    parent = services.resources.get("measurement", measurement_id)
    if (existing := services.resources.find_retried(key)) is not None:
        return existing
    metadata, edits = _merge_revision(parent, body)
    original = find_original(parent, ROWS)
    sha256 = (parent.result or {}).get("sha256") or original.key
    robot = services.resources.get("robot", metadata.robot_id).request
    if original.role == ROWS:
        source = copy_original(services, parent, folder)
    else:
        source = services.objects.fetch_file(original.key)
    return ReceivedFile(metadata, source, folder, sha256, key, robot, parent=parent, edits=edits)


def _merge_revision(parent: Resource, body: RevisionRequest) -> tuple[MeasurementMetadata, list[dict[str, Any]]]:
    """Return what is said of the file from now on, and all that was said anew since it was uploaded."""
    with hold_import_lock():
        from dynident_service.measurements.adapters import apply_revision

    change = to_plain_json(body)
    if not change:
        raise make_unusable("give at least one field to change", "/", title="Nothing to revise")
    edits = [*(parent.result or {}).get("edits", []), change]
    # The number counts all revisions of the file: a revision of "run1 r2" is "run1 r3".
    own_name = f"{_NUMBERED.sub('', parent.name or 'measurement')[:190]} r{len(edits)}"
    return apply_revision(
        MeasurementMetadata.model_validate(parent.request), body.model_copy(update={"name": body.name or own_name})
    ), edits


def _repoint_to_body(problem: Problem) -> ProblemError:
    """Return what is wrong with a file, told by the fields of a revision: there is no form around them."""
    fields = [
        field.model_copy(update={"pointer": field.pointer.removeprefix("/metadata")}) for field in problem.errors or []
    ]
    return ProblemError.from_problem(problem.model_copy(update={"errors": fields or None}))
