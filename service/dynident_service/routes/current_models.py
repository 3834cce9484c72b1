"""Routes of models in units of current."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from dynident_service.problems import make_unusable
from dynident_service.routes.required_resources import depend_on, refuse_coupled, require_measurements, require_robot
from dynident_service.routes.resource_routes import ResourceRoutes, add_create_route
from dynident_service.science_preload import hold_import_lock
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services
from dynident_service.wire_types.drive_gains import CurrentModelsRequest, CurrentModelsView
from dynident_service.wire_types.robots import RobotResult

router = APIRouter(prefix="/v1/current_models", tags=["current models"])


@add_create_route(
    router,
    ResourceRoutes(
        "current_models",
        CurrentModelsView,
        parent_kind="robot",
        plural="current_models",
        words="models of currents",
        show_description="Show models of currents, with the result once there is one.",
        delete_description="Delete models of currents.",
    ),
    NewJob("current_models", "dynident_service.job_functions.current_models:find_currents"),
)
def create_current_models(services: Services, body: CurrentModelsRequest) -> Sequence[Dependency]:
    """Identify every joint's parameters in units of its current; no drive gain is needed."""
    with hold_import_lock():
        from dynident.identification.loads.current_models import check_current_effects
        from dynident.identification.shape_search import check_choices
        from dynident_service.adapters.field_by_field import from_wire_choices
        from dynident_service.adapters.robots import restore_robot

    robot = require_robot(services, body.robot_id)
    _check_gains(robot)
    refuse_coupled(robot, "currents are identified only for")
    effects = from_wire_choices(body.effects or [])
    check_choices(effects, restore_robot(robot.request))
    check_current_effects(effects)
    return (
        depend_on(robot),
        *require_measurements(services, robot, body.measurement_ids, "measurement", "/measurement_ids"),
        *require_measurements(services, robot, body.validation_ids, "validation", "/validation_ids"),
    )


def _check_gains(robot: Resource) -> None:
    """Refuse a robot that does not state, be it wrongly, what its torques are in terms of currents."""
    joints_without_gain = [
        joint.name for joint in RobotResult.model_validate(robot.result).joints if joint.drive_gain is None
    ]
    if joints_without_gain:
        raise make_unusable(
            f"{', '.join(joints_without_gain)} of this robot state no drive gain, so its measurements contain "
            f'torques; make a robot with "drives": {{"…": {{"drive_gain": 1}}}} for each of them, and upload the '
            "currents for it",
            "/robot_id",
            title="No currents",
        )
