"""Names, tags and the archive of robots, measurements and identifications."""

from __future__ import annotations

from fastapi import APIRouter

from dynident_service.models.identifications import IdentificationView
from dynident_service.models.labels import LabelsRequest
from dynident_service.models.measurements import MeasurementView
from dynident_service.models.robots import RobotView
from dynident_service.routes import identifications, measurements, robots
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import Kind, Resource

router = APIRouter(prefix="/v1")


@router.patch("/robots/{robot_id}", tags=["robots"])
def label_robot(robot_id: str, body: LabelsRequest, services: ServicesDep) -> RobotView:
    """Rename, tag or archive a robot."""
    return robots.show(_labelled(services, "robot", robot_id, body))


@router.patch("/measurements/{measurement_id}", tags=["measurements"])
def label_measurement(measurement_id: str, body: LabelsRequest, services: ServicesDep) -> MeasurementView:
    """Rename, tag or archive a measurement; the runs of a recording keep the name that they were read with."""
    return measurements.show(_labelled(services, "measurement", measurement_id, body))


@router.patch("/identifications/{identification_id}", tags=["identifications"])
def label_identification(identification_id: str, body: LabelsRequest, services: ServicesDep) -> IdentificationView:
    """Rename, tag or archive an identification."""
    return identifications.show(_labelled(services, "identification", identification_id, body))


def _labelled(services: Services, kind: Kind, identifier: str, body: LabelsRequest) -> Resource:
    return services.resources.label(kind, identifier, name=body.name, tags=body.tags, archived=body.archived)
