"""Signals of measurements as they were recorded."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response, StreamingResponse

from dynident_service.models.measurements import MeasurementMetadata
from dynident_service.models.raw_signals import RawSignals, Standstills
from dynident_service.routes.measurements import original_of
from dynident_service.science import importing
from dynident_service.services import ServicesDep

router = APIRouter(prefix="/v1/measurements", tags=["measurements"])


@router.get("/{measurement_id}/raw", response_model=RawSignals)
def get_raw_signals(
    measurement_id: str,
    services: ServicesDep,
    signals: Annotated[
        str | None,
        Query(description="q1,tau_elbow,… or the file's own columns, with commas between; else all q and tau"),
    ] = None,
    start: Annotated[float | None, Query(alias="from", allow_inf_nan=False, description="s")] = None,
    end: Annotated[float | None, Query(alias="to", allow_inf_nan=False, description="s")] = None,
    points: Annotated[int | None, Query(ge=12, le=100_000, description="About how many; all where not given")] = None,
) -> Response:
    """Give signals as they were recorded; with `points` thinned so that extremes survive, else all of them."""
    with importing():
        from dynident_service.adapters.raw_signals import as_recorded, streamed, thinned
        from dynident_service.adapters.robots import robot_of

    found = services.resources.get("measurement", measurement_id)
    said = MeasurementMetadata.model_validate(found.request)
    robot = robot_of(services.resources.get("robot", said.robot_id).request)
    wanted = [name.strip() for name in (signals or "").split(",") if name.strip()]
    opened = as_recorded(services.objects.path(original_of(found).key), robot, said, wanted)
    if points is None:
        return StreamingResponse(streamed(opened, start, end), media_type="application/json")
    return Response(thinned(opened, points, start, end).model_dump_json(), media_type="application/json")


@router.get("/{measurement_id}/standstills")
def get_standstills(measurement_id: str, services: ServicesDep) -> Standstills:
    """Give the stretches of time in which each joint stands, as the recording's rows are told apart for friction."""
    with importing():
        from dynident_service.adapters.measurements import recording_of
        from dynident_service.adapters.raw_signals import standstills

    return standstills(recording_of(services.resources.get("measurement", measurement_id), services.objects))
