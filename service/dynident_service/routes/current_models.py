"""Currents told by parameters in units of current: no drive gain is needed."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from dynident_service.models.current_models import CurrentModelsRequest, CurrentModelsView
from dynident_service.models.robots import RobotResult
from dynident_service.problems import unusable
from dynident_service.routes.kept import Kept, asked_for
from dynident_service.routes.needs import needed_measurements, needed_robot, refuse_coupled, resting_on
from dynident_service.science import importing
from dynident_service.services import Services
from dynident_service.storage.records import NewJob, Resource, RestsOn

router = APIRouter(prefix="/v1/current_models", tags=["current models"])


@asked_for(
    router,
    Kept(
        "current_models",
        CurrentModelsView,
        of="robot",
        several="current_models",
        words="models of currents",
        shown="Show models of currents, with the result once there is one.",
        deleted="Delete models of currents.",
    ),
    NewJob("current_models", "dynident_service.work.current_models:find_currents"),
)
def create_current_models(services: Services, body: CurrentModelsRequest) -> Sequence[RestsOn]:
    """Identify every joint's parameters in units of its current: no drive gain has to be known."""
    with importing():
        from dynident.identification.loads.current_units import check_current_effects
        from dynident.identification.shapes.shapes import check_choices
        from dynident_service.adapters.effects import choices_of
        from dynident_service.adapters.robots import robot_of

    robot = needed_robot(services, body.robot_id)
    _check_gains(robot)
    refuse_coupled(robot, "currents are told joint by joint for")
    effects = choices_of(body.effects or [])
    check_choices(effects, robot_of(robot.request))
    check_current_effects(effects)
    return (
        resting_on(robot),
        *needed_measurements(services, robot, body.measurement_ids, "measurement", "/measurement_ids"),
        *needed_measurements(services, robot, body.validation_ids, "validation", "/validation_ids"),
    )


def _check_gains(robot: Resource) -> None:
    """What the torque of its measurements is in terms of currents has to be stated, be it wrong."""
    joints_without_gain = [
        joint.name for joint in RobotResult.model_validate(robot.result).joints if joint.drive_gain is None
    ]
    if joints_without_gain:
        raise unusable(
            f"{', '.join(joints_without_gain)} of this robot state no drive gain, so that its measurements "
            'hold torques; make one with "drives": {"…": {"drive_gain": 1}} for each of them, and upload the '
            "currents for it",
            "/robot_id",
            title="No currents",
        )
