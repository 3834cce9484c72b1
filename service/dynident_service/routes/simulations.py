"""Simulations: virtual robots that are measured."""

from __future__ import annotations

from fastapi import APIRouter, Response

from dynident_service.models.common import plain
from dynident_service.models.designs import Trajectory
from dynident_service.models.simulations import Samples, SimulationRequest, SimulationView
from dynident_service.routes.common import RetryKeyDep, computed, make
from dynident_service.routes.kept import Kept, keep
from dynident_service.routes.needs import needed_design, needed_robot
from dynident_service.science import importing
from dynident_service.services import ServicesDep
from dynident_service.storage.records import NewJob, NewResource, Resource, RestsOn

router = APIRouter(prefix="/v1/simulations", tags=["simulations"])

JOB = NewJob("simulation", "dynident_service.work.simulations:measure_virtual_robot")
keep(
    router,
    Kept(
        "simulation",
        SimulationView,
        of="robot",
        shown="Show a simulation; its result names the measurement.",
        deleted="Delete a simulation; its measurement stays.",
    ),
)


@router.post("", status_code=202)
def create_simulation(
    body: SimulationRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> SimulationView:
    """Have a virtual robot make a motion; it gives a measurement."""
    robot = needed_robot(services, body.robot_id)
    _check(body, robot)
    needs = [RestsOn(robot.id, "robot", "robot", "/robot_id")]
    if body.design_id is not None:
        needs.append(needed_design(services, body.design_id, robot))
    new = NewResource("simulation", plain(body), name=body.name, rests_on=tuple(needs), job=JOB, retry=retry.of(body))
    return computed(SimulationView, make(services, new, response))


def _check(body: SimulationRequest, stored: Resource) -> None:
    """Refuse at once what would fail later."""
    with importing():
        from dynident.simulation import Simulated, check_acting
        from dynident_service.adapters.derived import taken
        from dynident_service.adapters.designs import random_design
        from dynident_service.adapters.robots import robot_of
        from dynident_service.adapters.simulations import reference_of

    robot = robot_of(stored.request)
    check_acting(taken(body, Simulated), robot)
    if isinstance(body.trajectory, Samples):
        reference_of(body.trajectory)
    elif isinstance(body.trajectory, Trajectory):
        random_design(body.trajectory, robot)
