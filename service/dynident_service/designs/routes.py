"""Routes of designs (create, trajectory as file, clearances) and of simulations."""

from __future__ import annotations

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse

from dynident.excitation.design_request import LEAST_SPEED, TRAJECTORY_FORMATS, TrajectoryFormat
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
from dynident_service.shared.resource_routes import PagesDep, SubmissionDep, require_succeeded, show_with_tables
from dynident_service.shared.wire_types import Page, Table
from dynident_service.storage.repository_values import NewJob, Resource, find_mesh_files
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/designs", tags=["designs"])
DESIGN = NewJob("design", "dynident_service.designs.jobs:design")
SIMULATION = NewJob("simulation", "dynident_service.designs.jobs:measure_virtual_robot")

CLEARANCES = "dynident_service.designs.jobs:answer_clearances"
PARQUET = "application/vnd.apache.parquet"
YAML = "application/yaml"


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.designs.adapters import build_tables
        from dynident_service.robots.adapters import restore_robot

    robot = services.resources.get("robot", resource.get_dependency("robot"))
    return build_tables(resource.request, resource.result or {}, restore_robot(robot.request))


@router.post("", status_code=202)
def create_design(body: DesignRequest, services: ServicesDep, submit: SubmissionDep) -> DesignView:
    """Design an experiment: a motion within the limits that determines the parameters."""
    with hold_import_lock():
        from dynident_service.designs.adapters import to_checked_request
        from dynident_service.robots.adapters import restore_robot

    robot = require_robot(services, body.robot_id)
    to_checked_request(body, restore_robot(robot.request))
    needs = [
        depend_on(robot),
        *require_measurements(services, robot, body.earlier_ids, "earlier", "/earlier_ids"),
    ]
    if body.identification_id is not None:
        needs.append(depend_on(require_model_of(services, robot, body.identification_id)))
    return submit(DesignView, "design", body, DESIGN, needs)


@router.get("")
def list_designs(pages: PagesDep, robot_id: str | None = None) -> Page[DesignView]:
    """List the designs, newest first; those of one robot if requested."""
    return pages.show("design", DesignView.show, robot_id)


@router.get("/{design_id}")
def get_design(design_id: str, services: ServicesDep) -> DesignView:
    """Show a design, with its result once there is one."""
    return show_with_tables(DesignView, services, "design", design_id, _build_tables)


@router.delete("/{design_id}", status_code=204)
def delete_design(design_id: str, services: ServicesDep) -> None:
    """Delete a design; 409 while other resources need it."""
    services.resources.delete("design", design_id)


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
    speed: Annotated[
        float, Query(ge=LEAST_SPEED, le=1.0, description="Share of the designed speed, such as 0.33 for a first run")
    ] = 1.0,
) -> Response:
    """Give t, q…, dq…, ddq… at the sampling rate, including the moves from and to standstill."""
    with hold_import_lock():
        from dynident_service.designs.adapters import (
            trajectory_as_csv,
            trajectory_as_parquet,
            trajectory_as_samples,
            trajectory_for_ros2,
        )

    design = require_succeeded(services.resources.get("design", design_id))
    path = services.objects.fetch_file(design.objects["trajectory"].key)
    # The trajectory is stored as Parquet: all other formats are made of it row by row.
    if format == "parquet" and speed == 1.0:
        return FileResponse(path, media_type=PARQUET, filename=f"{design_id}.parquet")
    ending = "yaml" if format == "ros2" else format
    headers = {"Content-Disposition": f'attachment; filename="{design_id}.{ending}"'}
    if format == "csv":
        return StreamingResponse(trajectory_as_csv(path, speed), media_type="text/csv", headers=headers)
    if format == "parquet":
        return Response(trajectory_as_parquet(path, speed), media_type=PARQUET, headers=headers)
    joints = DesignResult.model_validate(design.result).joints
    if format == "ros2":
        return StreamingResponse(trajectory_for_ros2(path, joints, speed), media_type=YAML, headers=headers)
    return JSONResponse(trajectory_as_samples(path, joints, speed).model_dump(), headers=headers)


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


@simulations_router.post("", status_code=202)
def create_simulation(body: SimulationRequest, services: ServicesDep, submit: SubmissionDep) -> SimulationView:
    """Simulate a motion of a virtual robot; this makes a measurement."""
    robot = require_robot(services, body.robot_id)
    _check_simulation(body, robot)
    needs = [depend_on(robot)]
    if body.design_id is not None:
        needs.append(require_design(services, body.design_id, robot))
    return submit(SimulationView, "simulation", body, SIMULATION, needs)


@simulations_router.get("")
def list_simulations(pages: PagesDep, robot_id: str | None = None) -> Page[SimulationView]:
    """List the simulations, newest first; those of one robot if requested."""
    return pages.show("simulation", SimulationView.show, robot_id)


@simulations_router.get("/{simulation_id}")
def get_simulation(simulation_id: str, services: ServicesDep) -> SimulationView:
    """Show a simulation; its result names the measurement."""
    return SimulationView.show(services.resources.get("simulation", simulation_id))


@simulations_router.delete("/{simulation_id}", status_code=204)
def delete_simulation(simulation_id: str, services: ServicesDep) -> None:
    """Delete a simulation; its measurement stays."""
    services.resources.delete("simulation", simulation_id)


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
