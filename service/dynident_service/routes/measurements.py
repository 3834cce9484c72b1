"""Measurements: upload with checks, look, fetch what was uploaded or some signals of it, delete."""

from __future__ import annotations

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

from dynident_service.jobs.confinement import Limits
from dynident_service.models.common import plain
from dynident_service.models.imports import MeasurementOfImport
from dynident_service.models.measurements import MeasurementMetadata, MeasurementView, RawSignals, Standstills
from dynident_service.problems import ProblemError, ProblemField, not_found, unusable, validation_problem
from dynident_service.routes.common import RetryKey, RetryKeyDep, again, make, stated
from dynident_service.routes.forms import FormRoute
from dynident_service.routes.kept import Kept, keep
from dynident_service.routes.needs import needed
from dynident_service.routes.uploads import (
    FURTHER,
    MEDIA_TYPES,
    MOST_FILES,
    media_type_of,
    receive,
    require_room_for,
    sha256_of,
)
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import NewResource, Owned, Resource, RestsOn, Retry
from dynident_service.storage.tombstones import ObjectGone

router = APIRouter(prefix="/v1/measurements", tags=["measurements"], route_class=FormRoute)

JSON_BODY = {
    "requestBody": {
        "content": {
            "application/json": {
                "schema": {
                    "type": "object",
                    "title": "MeasurementOfImport",
                    "required": ["import_id", "metadata"],
                    "properties": {
                        "import_id": {"type": "string", "description": "A file that was imported before"},
                        "metadata": {"$ref": "#/components/schemas/MeasurementMetadata"},
                    },
                }
            }
        },
        "required": True,
    }
}


IMPORT = "dynident_service.work.awaited:import_measurement"
RAW = "dynident_service.work.awaited:write_raw_signals"
STANDSTILLS = "dynident_service.work.awaited:find_standstills"
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
    """Store a recording, checked; one that cannot be used is refused with the column and the row or time.

    Either a form with the file and its metadata, or a JSON body that names an import: see MeasurementOfImport.
    """
    if request.headers.get("content-type", "").lower().startswith("application/json"):
        return await _of_import(request, services, retry, response)
    if file is None or metadata is None:
        lacking = [name for name, value in (("file", file), ("metadata", metadata)) if value is None]
        fields = [ProblemField(pointer=f"/{name}", detail="Field required") for name in lacking]
        raise ProblemError.of(validation_problem(fields))
    with services.scratch() as folder:
        stated_metadata = stated(MeasurementMetadata, metadata, "/metadata")
        received = await to_thread.run_sync(
            _receive, services, stated_metadata, [file, *(further or ())], folder, retry
        )
        return await checked(request, services, received, response)


async def _of_import(request: Request, services: Services, retry: RetryKey, response: Response) -> MeasurementView:
    """Store a recording of a file that was imported before."""
    import_request = stated(MeasurementOfImport, await request.body())
    with services.scratch() as folder:
        received = await to_thread.run_sync(_imported, services, import_request, folder, retry)
        return await checked(request, services, received, response)


async def checked(
    request: Request, services: Services, received: Received | Resource, response: Response
) -> MeasurementView:
    """Check a file and store it, unless an earlier try did, which made the resource."""
    if isinstance(received, Resource):
        return show(again(received, response))
    limits = Limits.for_files(received.source.stat().st_size)
    result = await services.awaited.call(request, IMPORT, dict, received.to_import(), limits, is_long=True)
    return await to_thread.run_sync(lambda: show(_store(services, received, result, response)))


def _imported(
    services: Services, import_request: MeasurementOfImport, folder: Path, key: RetryKey
) -> Received | Resource:
    retry, source, metadata = key.of(import_request), folder / "source", import_request.metadata
    if (existing := services.resources.known(retry)) is not None:
        return existing
    imported = services.resources.find(import_request.import_id)
    if imported is None or imported.kind != "import":
        detail = f"there is no import {import_request.import_id!r}; they are kept for a day: upload the file again"
        raise unusable(detail, "/import_id", title="Unknown resource")
    original = imported.objects["original"]
    require_room_for(services, original.size)
    with source.open("wb") as target:
        for part in services.objects.stream(original.key):
            target.write(part)
    robot = needed(services, "robot", metadata.robot_id, "/metadata/robot_id").request
    return Received(metadata, source, folder, original.key, retry, robot, import_id=imported.id)


@router.get("/{measurement_id}/content", response_class=StreamingResponse)
def get_measurement_content(measurement_id: str, services: ServicesDep) -> StreamingResponse:
    """Give the file back as it was uploaded."""
    original = original_of(services.resources.get("measurement", measurement_id))
    headers = {"Content-Length": str(original.size), "ETag": f'"{original.key}"'}
    return StreamingResponse(services.objects.stream(original.key), media_type=original.media_type, headers=headers)


def original_of(measurement: Resource) -> Owned:
    """Give the file of a measurement as it was uploaded; a problem 404 where there is none."""
    if "original" not in measurement.objects:
        raise not_found("file of measurement", measurement.id)
    return measurement.objects["original"]


def show(resource: Resource) -> MeasurementView:
    """Show a stored measurement."""
    metadata = MeasurementMetadata.model_validate(resource.request)
    return MeasurementView.model_validate(
        {
            **vars(resource),
            **(resource.result or {}),
            **metadata.model_dump(include={"robot_id", "role", "windows"}),
            "parent_id": next(iter(resource.all("parent")), None),
            "revision": len((resource.result or {}).get("edits", [])),
            "effort_kind": metadata.model_dump(include={"effort_kind"})["effort_kind"] or "unknown",
            "request": metadata,
        }
    )


keep(
    router,
    Kept(
        "measurement",
        MeasurementView,
        of="robot",
        show=show,
        shown="Show a measurement.",
        deleted="Delete a measurement; 409 while others rest on it.",
        labelled="Rename, tag or archive a measurement; the runs of a recording keep the name that they were read "
        "with.",
    ),
)


@dataclass(frozen=True)
class Received:
    """A file that was received, and what is said of it."""

    said: MeasurementMetadata
    source: Path
    folder: Path
    sha256: str
    retry: Retry | None
    robot: Mapping[str, Any]
    import_id: str | None = None
    """The import that the file comes from."""
    revised: Resource | None = None
    """The measurement of the same file of which something else is said now."""
    edits: Sequence[Mapping[str, object]] = ()
    """All that was said of it since it was uploaded."""

    @property
    def recording(self) -> Path:
        """Where the recording is to be written."""
        return self.folder / "recording.parquet"

    def to_import(self) -> dict[str, object]:
        """Give what the import is told."""
        return {
            "source": str(self.source),
            "destination": str(self.recording),
            "robot": dict(self.robot),
            "metadata": plain(self.said),
            "sha256": self.sha256,
        }


def _receive(
    services: Services, metadata: MeasurementMetadata, files: Sequence[UploadFile], folder: Path, key: RetryKey
) -> Received | Resource:
    source = folder / "source"
    receive(services, files, source)
    sha256 = sha256_of(source)
    retry = key.of(metadata, sha256)
    if (existing := services.resources.known(retry)) is not None:
        return existing
    robot = needed(services, "robot", metadata.robot_id, "/metadata/robot_id").request
    return Received(metadata, source, folder, sha256, retry, robot)


def _store(services: Services, received: Received, result: Mapping[str, Any], response: Response) -> Resource:
    metadata, revised = received.said, received.revised
    new = NewResource(
        "measurement",
        plain(metadata),
        name=metadata.name,
        result={**result, "edits": received.edits},
        rests_on=(
            RestsOn(metadata.robot_id, "robot", "robot", "/metadata/robot_id"),
            *([RestsOn(received.import_id, "import", "import", "/import_id")] if received.import_id else []),
            *([RestsOn(revised.id, "measurement", "parent", "/")] if revised else []),
        ),
        objects=_keep(services, received),
        retry=received.retry,
    )
    try:
        return make(services, new, response)
    except ObjectGone:  # swept away while this waited for longer than such files are kept
        return make(services, replace(new, objects=_keep(services, received)), response)


def _keep(services: Services, received: Received) -> tuple[Owned, ...]:
    source, canonical, revised = received.source, received.recording, received.revised
    services.resources.check_room("measurement", (source, canonical) if revised is None else (canonical,))
    original = (
        services.resources.put_as("original", source, media_type_of(source))
        if revised is None
        else original_of(revised)
    )
    return original, services.resources.put_as("recording", canonical, MEDIA_TYPES["parquet"])


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
        Query(description="q1,tau_elbow,… or the file's own columns, with commas between; else all q and tau"),
    ] = None,
    start: Annotated[float | None, Query(alias="from", allow_inf_nan=False, description="s")] = None,
    end: Annotated[float | None, Query(alias="to", allow_inf_nan=False, description="s")] = None,
    points: Annotated[int | None, Query(ge=12, le=100_000, description="About how many; all where not given")] = None,
) -> FileResponse:
    """Give signals as they were recorded; with `points` thinned so that extremes survive, else all of them."""
    folder = Path(tempfile.mkdtemp(dir=services.settings.uploads_dir))
    removal = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
    try:
        names = [name.strip() for name in (signals or "").split(",") if name.strip()]
        sent = await to_thread.run_sync(_describe_raw, services, measurement_id, folder)
        arguments = {**sent, "signals": names, "start": start, "end": end, "points": points}
        size = Path(sent["source"]).stat().st_size
        largest = min(max(SMALLEST_ANSWER, DIGITS * size), LARGEST_ANSWER)
        await to_thread.run_sync(require_room_for, services, largest // 2)
        await services.awaited.call(
            request, RAW, NoneType, arguments, replace(Limits.for_files(size), file_bytes=largest)
        )
    except BaseException:
        await removal()
        raise
    return FileResponse(sent["destination"], media_type="application/json", background=removal)


def _describe_raw(services: Services, measurement_id: str, folder: Path) -> dict[str, Any]:
    """What a child is told of the file of a measurement, and where it is to write signals of it."""
    measurement = services.resources.get("measurement", measurement_id)
    metadata = MeasurementMetadata.model_validate(measurement.request)
    robot = services.resources.get("robot", metadata.robot_id)
    return {
        "source": str(services.objects.path(original_of(measurement).key)),
        "destination": str(folder / "signals.json"),
        "robot": dict(robot.request),
        "metadata": plain(metadata),
    }


@router.get("/{measurement_id}/standstills")
async def get_standstills(measurement_id: str, request: Request, services: ServicesDep) -> Standstills:
    """Give the stretches of time in which each joint stands, as the recording's rows are told apart for friction."""
    measurement = await to_thread.run_sync(services.resources.get, "measurement", measurement_id)
    path = await to_thread.run_sync(services.objects.path, measurement.objects["recording"].key)
    arguments = {"recording": str(path)}
    return Standstills.model_validate(await services.awaited.call(request, STANDSTILLS, dict, arguments))
