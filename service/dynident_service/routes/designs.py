"""Designs of experiments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse

from dynident.excitation.formats.stated import FORMATS, TrajectoryFormat
from dynident_service.models.derived import choices_shown
from dynident_service.models.designs import DesignClearances, DesignRequest, DesignResult, DesignView, TrajectorySamples
from dynident_service.routes.common import succeeded
from dynident_service.routes.kept import Kept, asked_for
from dynident_service.routes.needs import needed_measurements, needed_robot, resting_on
from dynident_service.science import importing
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.meshes import meshes_of
from dynident_service.storage.records import NewJob, RestsOn

router = APIRouter(prefix="/v1/designs", tags=["designs"])

CLEARANCES = "dynident_service.work.awaited:clearances"
PARQUET = "application/vnd.apache.parquet"
YAML = "application/yaml"


@asked_for(
    router,
    Kept("design", DesignView, of="robot", deleted="Delete a design; 409 while others rest on it."),
    NewJob("design", "dynident_service.work.designs:design"),
)
def create_design(services: Services, body: DesignRequest) -> Sequence[RestsOn]:
    """Design an experiment: a motion within the limits that tells the parameters apart."""
    with importing():
        from dynident_service.adapters.designs import request_of
        from dynident_service.adapters.robots import robot_of

    robot = needed_robot(services, body.robot_id)
    request_of(body, robot_of(robot.request))
    return (
        resting_on(robot),
        *needed_measurements(services, robot, body.earlier_ids, "earlier", "/earlier_ids"),
    )


@router.get(
    "/{design_id}/trajectory",
    response_model=TrajectorySamples,
    responses={200: {"content": {"text/csv": {}, PARQUET: {}, YAML: {}}}},
)
def get_trajectory(
    design_id: str,
    services: ServicesDep,
    format: Annotated[
        TrajectoryFormat,
        Query(description="ros2: a JointTrajectory message in YAML", json_schema_extra=choices_shown(FORMATS)),
    ] = "csv",
) -> Response:
    """Give t, q…, dq…, ddq… at the sampling rate, with the moves from and to rest."""
    with importing():
        from dynident_service.adapters.designs import trajectory_as_csv, trajectory_as_samples, trajectory_for_ros2

    design = succeeded(services.resources.get("design", design_id))
    path = services.objects.path(design.objects["trajectory"].key)
    if format == "parquet":
        return FileResponse(path, media_type=PARQUET, filename=f"{design_id}.parquet")
    ending = "yaml" if format == "ros2" else format
    headers = {"Content-Disposition": f'attachment; filename="{design_id}.{ending}"'}
    if format == "csv":
        return StreamingResponse(trajectory_as_csv(path), media_type="text/csv", headers=headers)
    joints = DesignResult.model_validate(design.result).joints
    if format == "ros2":
        return StreamingResponse(trajectory_for_ros2(path, joints), media_type=YAML, headers=headers)
    return JSONResponse(trajectory_as_samples(path, joints).model_dump(), headers=headers)


@router.get("/{design_id}/clearances")
async def get_clearances(
    design_id: str,
    request: Request,
    services: ServicesDep,
    points: Annotated[int, Query(ge=2, le=2000, description="About how many samples")] = 200,
) -> DesignClearances:
    """Show what every link is nearest to along the motion, with the points between which that distance lies."""

    def asked() -> dict[str, Any]:
        design = succeeded(services.resources.get("design", design_id))
        robot = services.resources.get("robot", design.one("robot"))
        return {
            "request": dict(design.request),
            "robot": dict(robot.request),
            "meshes": {name: str(services.objects.path(mesh.key)) for name, mesh in meshes_of(robot).items()},
            "trajectory": str(services.objects.path(design.objects["trajectory"].key)),
            "points": points,
        }

    clearances = await services.awaited.call(request, CLEARANCES, dict, await to_thread.run_sync(asked))
    return DesignClearances.model_validate(clearances)
