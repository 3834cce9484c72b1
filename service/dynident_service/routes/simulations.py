"""Simulations: virtual robots that are measured."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from dynident_service.models.designs import Trajectory
from dynident_service.models.simulations import Samples, SimulationRequest, SimulationView
from dynident_service.routes.kept import Kept, asked_for
from dynident_service.routes.needs import needed_design, needed_robot, resting_on
from dynident_service.science import importing
from dynident_service.services import Services
from dynident_service.storage.records import NewJob, Resource, RestsOn

router = APIRouter(prefix="/v1/simulations", tags=["simulations"])


@asked_for(
    router,
    Kept(
        "simulation",
        SimulationView,
        of="robot",
        shown="Show a simulation; its result names the measurement.",
        deleted="Delete a simulation; its measurement stays.",
    ),
    NewJob("simulation", "dynident_service.work.simulations:measure_virtual_robot"),
)
def create_simulation(services: Services, body: SimulationRequest) -> Sequence[RestsOn]:
    """Have a virtual robot make a motion; it gives a measurement."""
    robot = needed_robot(services, body.robot_id)
    _check(body, robot)
    needs = [resting_on(robot)]
    if body.design_id is not None:
        needs.append(needed_design(services, body.design_id, robot))
    return needs


def _check(body: SimulationRequest, robot_resource: Resource) -> None:
    """Refuse at once what would fail later."""
    with importing():
        from dynident.simulation import Simulated, check_acting
        from dynident_service.adapters.derived import taken
        from dynident_service.adapters.designs import random_design
        from dynident_service.adapters.robots import robot_of
        from dynident_service.adapters.simulations import reference_of

    robot = robot_of(robot_resource.request)
    check_acting(taken(body, Simulated), robot)
    if isinstance(body.trajectory, Samples):
        reference_of(body.trajectory)
    elif isinstance(body.trajectory, Trajectory):
        random_design(body.trajectory, robot)
