"""Drive gains on the wire."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dynident.identification.loads.known_load import KnownLoad
from dynident_service.models.common import Computed, Identifier, NamedRequest, ViewModel
from dynident_service.models.request_bodies import derive_body
from dynident_service.models.tables import WithTables
from dynident_service.models.validations import DriveGainView

Measurements = Annotated[list[Identifier], Field(min_length=1, max_length=100)]


@derive_body(KnownLoad)
class DriveGainsRequest(NamedRequest):
    """Runs of the same motion without and with a load of known mass, of a robot whose drive gains are in question."""

    robot_id: Identifier
    unloaded: Measurements = Field(description="Measurements without the load")
    loaded: Measurements = Field(description="Measurements of the same motion with the load")
    weigh: Measurements | None = Field(
        default=None, description="Measurements of other loads, to be weighed with the gains that are found"
    )
    weigh_unloaded: Measurements | None = Field(
        default=None, description="Of the motions of weigh, without their loads; those of unloaded where not given"
    )


class IdentifiedGain(DriveGainView):
    """The drive gain [12.17] of one joint, beside the one that its torque was computed with."""

    stated: float = Field(description="The robot's own; 1 where it states none")
    standard_deviation: float | None
    unit: str = Field(description="N m/A or N/A; - where the robot states no gain: a factor on the recorded torque")


class WeighedLoad(ViewModel):
    """A load weighed with the identified gains."""

    measurement_id: str
    name: str
    mass: float = Field(description="kg")
    standard_deviation: float | None = Field(description="kg")
    from_gains: float | None = Field(description="The part of it that the uncertainty of the gains makes, kg")
    interval: tuple[float | None, float | None] = Field(description="95 %, kg")
    identifiable: bool = Field(description="Whether the interval leaves out zero: whether a load shows at all")


class DriveGainsResult(ViewModel):
    """Drive gains of all joints."""

    gains: list[IdentifiedGain] = Field(description="In the robot's order of joints")
    loads: list[WeighedLoad] = Field(default=[], description="In the order of weigh")
    warnings: list[str]


class DriveGainsView(Computed[DriveGainsRequest, DriveGainsResult], WithTables):
    """Drive gains from runs without and with a known load."""
