"""Routes of a recording under way: more rows, and the estimate as it comes.

Holds the shortest time between two estimates (1 s), and how often rows are compared anew with those of others (20).
"""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

import anyio
from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.measurements.routes import IMPORT, show_measurement
from dynident_service.measurements.wire_types import ROWS, LiveEstimateView, MeasurementMetadata, MeasurementView
from dynident_service.problems import ProblemError
from dynident_service.request_limits import MOST_SAMPLES
from dynident_service.shared.required_resources import copy_original, is_under_way, require_design
from dynident_service.shared.upload_forms import MEDIA_TYPES, hash_file, require_room_for
from dynident_service.shared.wire_types import to_plain_json
from dynident_service.storage.object_store import ObjectGone
from dynident_service.storage.repository_values import CHANGED, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/measurements", tags=["measurements"])

APPEND = "dynident_service.measurements.jobs:append_rows"
ESTIMATE = "dynident_service.measurements.jobs:estimate_rows"
TRIES = 20
"""Times that rows are appended anew because another request has changed the recording: of so many at once, all end."""
SOONEST, LOOK, SHARE = 1.0, 0.2, 0.25
"""Seconds between two estimates at least, and between two looks for rows; share of the time that estimates may take."""

_NUMBERS = {"type": "array", "maxItems": MOST_SAMPLES, "items": {"type": "number", "nullable": True}}
_COLUMNS = {"type": "object", "maxProperties": 1000, "additionalProperties": _NUMBERS}
ROWS_BODY = {
    "requestBody": {
        "description": "Columns of numbers, as in a file; none with finished=true where all rows were sent",
        "content": {
            "application/json": {"schema": {**_COLUMNS, "title": "RowsByColumn"}},
            "text/csv": {"schema": {"type": "string"}},
            MEDIA_TYPES["parquet"]: {"schema": {"type": "string", "format": "binary"}},
        },
    }
}


@router.patch("/{measurement_id}/rows", openapi_extra=ROWS_BODY)
async def append_rows(
    measurement_id: str,
    request: Request,
    services: ServicesDep,
    offset: Annotated[int, Query(ge=0, description="Number of rows that were sent before these: a retry is harmless")],
    finished: Annotated[bool, Query(description="Whether these are the last rows: then all checks are made")] = False,
) -> MeasurementView:
    """Append rows to a recording under way; the last ones make it a measurement like any other.

    The body has the same columns each time, as JSON, CSV with a header, or Parquet.
    """
    with services.create_scratch_folder() as folder:
        body = folder / "body"
        await _receive_body(request, body)
        for tries_left in reversed(range(TRIES)):
            measurement = await to_thread.run_sync(services.resources.get, "measurement", measurement_id)
            try:
                if not is_under_way(measurement):
                    await _replay_finished(request, services, measurement, body, offset, finished, folder)
                    return show_measurement(measurement)
                measurement = await _append(request, services, measurement, body, offset, folder)
                if finished:
                    measurement = await _finish(request, services, measurement, folder)
                return show_measurement(measurement)
            except ProblemError as error:
                # Another request has just changed it: these rows are compared with what that one stored.
                if error.problem.title != CHANGED or not tries_left:
                    raise
        raise AssertionError("the last try returns or raises")


async def _receive_body(request: Request, body: Path) -> None:
    async with await anyio.open_file(body, "wb") as file:
        async for chunk in request.stream():
            await file.write(chunk)


async def _replay_finished(
    request: Request,
    services: Services,
    measurement: Resource,
    body: Path,
    offset: int,
    finished: bool,
    folder: Path,
) -> None:
    """Refuse rows for a measurement that is complete, unless they are its last ones, whose answer was lost."""
    received = (measurement.result or {}).get("received")
    if finished and received is not None:
        total, size = offset, body.stat().st_size
        if size:
            size += measurement.objects["original"].size
            total = await _join_rows(request, services, measurement, body, offset, folder, size)
        if total == received:
            return
    raise ProblemError(
        409, f"The measurement {measurement.id} is complete; no rows can be added to it.", title="Complete"
    )


async def _join_rows(
    request: Request, services: Services, measurement: Resource, body: Path, offset: int, folder: Path, size: int
) -> int:
    """Write the stored rows and those of the body into `rows.parquet` of a folder, and return their number."""
    await to_thread.run_sync(require_room_for, services, size)
    stored = await to_thread.run_sync(copy_original, services, measurement, folder) if measurement.objects else None
    arguments: dict[str, Any] = {
        "stored": None if stored is None else str(stored),
        "sent": str(body),
        "media_type": request.headers.get("content-type", "").partition(";")[0].strip().lower(),
        "first": offset,
        "destination": str(folder / "rows.parquet"),
    }
    limits = ComputationLimits.from_file_sizes(size)
    return await services.interactive.call(request, APPEND, int, arguments, limits, is_long=True)


async def _append(
    request: Request, services: Services, measurement: Resource, body: Path, offset: int, folder: Path
) -> Resource:
    stored = measurement.objects.get(ROWS)
    rows, count = folder / "rows.parquet", (measurement.result or {})["n_samples"]
    if not body.stat().st_size:
        if offset == count:
            return measurement
        raise ProblemError(409, f"{count} rows have arrived, not {offset}.", title="Rows are missing")
    size = body.stat().st_size + (0 if stored is None else stored.size)
    _refuse_too_large(services, size)
    total = await _join_rows(request, services, measurement, body, offset, folder, size)
    if total == count:
        # All of these rows are there already.
        return measurement
    _refuse_too_large(services, rows.stat().st_size)

    def store() -> Resource:
        services.resources.check_room("measurement", (rows,), attached_to=measurement.id)
        owned = services.resources.put_with_role(ROWS, rows, MEDIA_TYPES["parquet"])
        change = {"n_samples": total}
        try:
            attached = services.resources.attach(
                "measurement", measurement.id, change, (owned,), instead_of=measurement
            )
        except ObjectGone as error:
            # Another recording had the same rows, and gave them up before this one owned them.
            raise ProblemError(409, "The rows were deleted meanwhile; try again.", title=CHANGED) from error
        if stored is not None:
            # Each is a copy of all rows so far: kept for a while as other files, they would fill the disk.
            services.resources.delete_object(stored.key)
        return attached

    return await to_thread.run_sync(store)


def _refuse_too_large(services: Services, size: int) -> None:
    largest = services.settings.max_upload_bytes
    if size > largest:
        detail = f"With these rows the recording has more than {largest} bytes (DYNIDENT_MAX_UPLOAD_BYTES)."
        raise ProblemError(413, detail, title="Content too large")


async def _finish(request: Request, services: Services, measurement: Resource, folder: Path) -> Resource:
    """Make all checks, and store the rows as a measurement's file."""
    if ROWS not in measurement.objects:
        raise ProblemError(422, "No rows have arrived.", title="Unusable file")
    arguments = await to_thread.run_sync(_describe_rows, services, measurement, folder)
    source, recording = Path(arguments["source"]), folder / "recording.parquet"
    sha256 = await to_thread.run_sync(hash_file, source)
    result = await services.interactive.call(
        request,
        IMPORT,
        dict,
        {**arguments, "destination": str(recording), "sha256": sha256},
        ComputationLimits.from_file_sizes(source.stat().st_size),
        is_long=True,
    )

    def store() -> Resource:
        services.resources.check_room("measurement", (recording,), attached_to=measurement.id)
        objects = (
            services.resources.put_with_role("original", source, MEDIA_TYPES["parquet"]),
            services.resources.put_with_role("recording", recording, MEDIA_TYPES["parquet"]),
        )
        received = (measurement.result or {})["n_samples"]
        complete = {**result, "under_way": False, "received": received}
        return services.resources.attach(
            "measurement", measurement.id, complete, objects, instead_of=measurement, dropped=(ROWS,)
        )

    return await to_thread.run_sync(store)


def _describe_rows(services: Services, measurement: Resource, folder: Path) -> dict[str, Any]:
    """Return what a child has to know of the rows so far."""
    metadata = MeasurementMetadata.model_validate(measurement.request)
    return {
        "source": str(copy_original(services, measurement, folder)),
        "robot": dict(services.resources.get("robot", metadata.robot_id).request),
        "metadata": to_plain_json(metadata),
    }


def find_measurement(measurement_id: str, services: ServicesDep) -> Resource:
    """Find the measurement before the stream begins: afterwards it is too late for a 404."""
    return services.resources.get("measurement", measurement_id)


def find_planned(
    services: ServicesDep,
    measurement: Annotated[Resource, Depends(find_measurement)],
    design_id: Annotated[
        str | None, Query(description="The design of its motion: a run that is much slower is to be stopped")
    ] = None,
) -> Path | None:
    """Find the trajectory that the recording is compared with."""
    if design_id is None:
        return None
    require_design(services, design_id, services.resources.get("robot", measurement.get_dependency("robot")))
    return services.objects.fetch_file(services.resources.get("design", design_id).objects["trajectory"].key)


@router.get("/{measurement_id}/estimates", response_class=EventSourceResponse)
async def follow_estimates(
    measurement: Annotated[Resource, Depends(find_measurement)],
    planned: Annotated[Path | None, Depends(find_planned)],
    request: Request,
    services: ServicesDep,
    last_event_id: Annotated[str | None, Header(max_length=18, description="Resume with rows after so many")] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Follow a recording under way: an event `estimate` (LiveEstimateView) when rows came, and `finished` at the end.

    Ids of events are numbers of rows. Estimates are computed from the stored rows: those that nobody waited for are
    left out. Where none can be computed, an event `problem` (Problem) is the last one.
    """
    last = int(last_event_id) if last_event_id is not None and last_event_id.isdecimal() else -1
    current, pause = measurement, 0.0
    while True:
        is_open, count = is_under_way(current), _count_rows(current)
        if count > last or not is_open:
            began = time.monotonic()
            try:
                view = await _estimate(request, services, current, max(last, 0), planned)
            except ProblemError as error:
                # Too many requests at once, or rows that came meanwhile: the next estimate has them.
                if error.problem.status != 429 and error.problem.title != CHANGED:
                    yield ServerSentEvent(event="problem", data=error.problem)
                    return
                view = None
            if view is not None:
                last = count
                event = "estimate" if is_open else "finished"
                yield ServerSentEvent(event=event, id=str(count), data=view, retry=1000)
                if not is_open:
                    return
            # Many followers share the processors with all others: estimates take a share of the time only.
            pause = max(SOONEST, (time.monotonic() - began) * (1.0 / SHARE - 1.0))
        await anyio.sleep(max(pause, LOOK))
        pause = 0.0
        reread = await to_thread.run_sync(services.resources.find, measurement.id)
        if reread is None:
            return
        current = reread


def _count_rows(measurement: Resource) -> int:
    """Return the number of rows that were sent; of a complete recording `n_samples` counts the resampled ones."""
    result = measurement.result or {}
    return int(result.get("received") or result["n_samples"])


async def _estimate(
    request: Request, services: Services, measurement: Resource, before: int, planned: Path | None
) -> LiveEstimateView:
    is_open, count = is_under_way(measurement), _count_rows(measurement)
    if is_open and not count:
        joints = list((measurement.result or {})["joints"])
        return LiveEstimateView(
            rows=0,
            seconds=0.0,
            equations=0,
            parameters=[],
            reason="No rows have arrived.",
            joints=joints,
            error=None,
            predicted=None,
            stop=[],
        )
    with services.create_scratch_folder() as folder:
        arguments = await to_thread.run_sync(_describe_rows, services, measurement, folder)
        arguments |= {
            "identifier": measurement.id,
            "count": count,
            "before": min(before, count),
            "is_final": not is_open,
            "planned": None if planned is None else str(planned),
        }
        limits = ComputationLimits.from_file_sizes(Path(arguments["source"]).stat().st_size)
        answer = await services.interactive.call(request, ESTIMATE, dict, arguments, limits, is_long=True)
    return LiveEstimateView.model_validate(answer)
