"""Routes of simulations."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from dynident_service.routes.required_resources import depend_on, require_design, require_robot
from dynident_service.routes.resource_routes import ResourceRoutes, add_create_route
from dynident_service.science_preload import hold_import_lock
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services
from dynident_service.wire_types.designs import Samples, SimulationRequest, SimulationView, Trajectory

router = APIRouter(prefix="/v1/simulations", tags=["simulations"])


@add_create_route(
    router,
    ResourceRoutes(
        "simulation",
        SimulationView,
        parent_kind="robot",
        show_description="Show a simulation; its result names the measurement.",
        delete_description="Delete a simulation; its measurement stays.",
    ),
    NewJob("simulation", "dynident_service.job_functions.simulations:measure_virtual_robot"),
)
def create_simulation(services: Services, body: SimulationRequest) -> Sequence[Dependency]:
    """Simulate a motion of a virtual robot; this makes a measurement."""
    robot = require_robot(services, body.robot_id)
    _check_request(body, robot)
    needs = [depend_on(robot)]
    if body.design_id is not None:
        needs.append(require_design(services, body.design_id, robot))
    return needs


def _check_request(body: SimulationRequest, robot_resource: Resource) -> None:
    """Refuse at once what would fail later."""
    with hold_import_lock():
        from dynident.simulation import Simulated, check_acting_effects
        from dynident_service.adapters.designs import build_random_design, samples_to_reference
        from dynident_service.adapters.field_by_field import to_request
        from dynident_service.adapters.robots import restore_robot

    robot = restore_robot(robot_resource.request)
    check_acting_effects(to_request(body, Simulated), robot)
    # Building it is the check: samples must increase in time, and a family of motions must fit the limits.
    if isinstance(body.trajectory, Samples):
        samples_to_reference(body.trajectory)
    elif isinstance(body.trajectory, Trajectory):
        build_random_design(body.trajectory, robot)
