"""Routes of designs (create, trajectory as file, clearances) and of simulations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse

from dynident.excitation.design_request import TRAJECTORY_FORMATS, TrajectoryFormat
from dynident_service.designs.wire_types import (
    DesignClearances,
    DesignRequest,
    DesignResult,
    DesignView,
    Samples,
    SimulationRequest,
    SimulationView,
    Trajectory,
    TrajectorySamples,
)
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.request_bodies import describe_choices
from dynident_service.shared.required_resources import (
    depend_on,
    require_design,
    require_measurements,
    require_model_of,
    require_robot,
)
from dynident_service.shared.resource_routes import ResourceRoutes, add_create_route, require_succeeded
from dynident_service.shared.wire_types import Table
from dynident_service.storage.repository_values import Dependency, NewJob, Resource, find_mesh_files
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/designs", tags=["designs"])

CLEARANCES = "dynident_service.designs.jobs:answer_clearances"
PARQUET = "application/vnd.apache.parquet"
YAML = "application/yaml"


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.designs.adapters import build_tables
        from dynident_service.robots.adapters import restore_robot

    robot = services.resources.get("robot", resource.get_dependency("robot"))
    return build_tables(resource.request, resource.result or {}, restore_robot(robot.request))


@add_create_route(
    router,
    ResourceRoutes(
        "design",
        DesignView,
        parent_kind="robot",
        tables=_build_tables,
        delete_description="Delete a design; 409 while other resources need it.",
    ),
    NewJob("design", "dynident_service.designs.jobs:design"),
)
def create_design(services: Services, body: DesignRequest) -> Sequence[Dependency]:
    """Design an experiment: a motion within the limits that determines the parameters."""
    with hold_import_lock():
        from dynident_service.designs.adapters import to_checked_request
        from dynident_service.robots.adapters import restore_robot

    robot = require_robot(services, body.robot_id)
    to_checked_request(body, restore_robot(robot.request))
    return (
        depend_on(robot),
        *require_measurements(services, robot, body.earlier_ids, "earlier", "/earlier_ids"),
        *(
            ()
            if body.identification_id is None
            else (depend_on(require_model_of(services, robot, body.identification_id)),)
        ),
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
        Query(
            description="ros2: a JointTrajectory message in YAML",
            json_schema_extra=describe_choices(TRAJECTORY_FORMATS),
        ),
    ] = "csv",
) -> Response:
    """Give t, q…, dq…, ddq… at the sampling rate, including the moves from and to standstill."""
    with hold_import_lock():
        from dynident_service.designs.adapters import trajectory_as_csv, trajectory_as_samples, trajectory_for_ros2

    design = require_succeeded(services.resources.get("design", design_id))
    path = services.objects.fetch_file(design.objects["trajectory"].key)
    # The trajectory is stored as Parquet: all other formats are made of it row by row.
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
    points: Annotated[int, Query(ge=2, le=2000, description="Approximate number of samples")] = 200,
) -> DesignClearances:
    """Show what every link is nearest to along the motion, with the two nearest points."""

    def collect_arguments() -> dict[str, Any]:
        design = require_succeeded(services.resources.get("design", design_id))
        robot = services.resources.get("robot", design.get_dependency("robot"))
        return {
            "request": dict(design.request),
            "robot": dict(robot.request),
            "meshes": {
                name: str(services.objects.fetch_file(mesh.key)) for name, mesh in find_mesh_files(robot).items()
            },
            "trajectory": str(services.objects.fetch_file(design.objects["trajectory"].key)),
            "points": points,
        }

    clearances = await services.interactive.call(request, CLEARANCES, dict, await to_thread.run_sync(collect_arguments))
    return DesignClearances.model_validate(clearances)


simulations_router = APIRouter(prefix="/v1/simulations", tags=["simulations"])


@add_create_route(
    simulations_router,
    ResourceRoutes(
        "simulation",
        SimulationView,
        parent_kind="robot",
        show_description="Show a simulation; its result names the measurement.",
        delete_description="Delete a simulation; its measurement stays.",
    ),
    NewJob("simulation", "dynident_service.designs.jobs:measure_virtual_robot"),
)
def create_simulation(services: Services, body: SimulationRequest) -> Sequence[Dependency]:
    """Simulate a motion of a virtual robot; this makes a measurement."""
    robot = require_robot(services, body.robot_id)
    _check_simulation(body, robot)
    needs = [depend_on(robot)]
    if body.design_id is not None:
        needs.append(require_design(services, body.design_id, robot))
    return needs


def _check_simulation(body: SimulationRequest, robot_resource: Resource) -> None:
    """Refuse at once what would fail later."""
    with hold_import_lock():
        from dynident.simulation import Simulated, check_acting_effects
        from dynident_service.designs.adapters import build_random_design, samples_to_reference
        from dynident_service.robots.adapters import restore_robot
        from dynident_service.shared.field_by_field import to_request

    robot = restore_robot(robot_resource.request)
    check_acting_effects(to_request(body, Simulated), robot)
    # Building it is the check: samples must increase in time, and a family of motions must fit the limits.
    if isinstance(body.trajectory, Samples):
        samples_to_reference(body.trajectory)
    elif isinstance(body.trajectory, Trajectory):
        build_random_design(body.trajectory, robot)
