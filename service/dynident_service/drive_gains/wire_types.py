"""Bodies and answers of drive gains and models of currents."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dynident.identification.identification_choices import KnownLoad
from dynident_service.identifications.wire_types import JUDGEMENTS
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import (
    Computed,
    EffectChoice,
    Identifier,
    NamedRequest,
    SourcePath,
    ViewModel,
    WithTables,
)
from dynident_service.validations.wire_types import DriveGainView


class CurrentModelsRequest(NamedRequest):
    """Measurements with currents of a robot whose drive gains are unknown."""

    robot_id: Identifier = Field(
        description="The robot must state a drive gain for every joint: the gains that the measurements were read "
        "with, for example 1"
    )
    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=100)]
    validation_ids: list[Identifier] = Field(default=[], max_length=100)
    effects: Annotated[list[EffectChoice], Field(min_length=1, max_length=200)] | None = Field(
        default=None,
        description="Only effects that do not depend on the predicted torque and have no shape constant to search for; "
        "by default links, rotors, dry and viscous friction and offsets",
    )


class CurrentParameterView(ViewModel):
    """One parameter of a joint's current: a sum of base parameters divided by the joint's gain."""

    name: str
    value: float
    unit: str = Field(description="Unit of the parameter, times A/(N m) or A/N")
    standard_deviation: float | None
    interval: tuple[float | None, float | None] = Field(description="Holds the true value in 95 of 100 cases")
    judgement: JUDGEMENTS
    grouping: str = Field(description="As a sum of base parameters")


class CurrentModelView(ViewModel):
    """The parameters of one joint's current."""

    joint: str
    parameters: list[CurrentParameterView]
    rms: Annotated[float, SourcePath("fit.rms_total")] = Field(
        description="rms of the residual of the current in the fit, A"
    )
    relative: Annotated[float, SourcePath("fit.relative_total")] = Field(description="||i − î|| / ||i|| in the fit")
    held_out_rms: Annotated[float | None, SourcePath("held_out.rms_total")] = Field(
        description="The same on held-out data, A; null if there are none"
    )
    held_out_relative: Annotated[float | None, SourcePath("held_out.relative_total")] = Field(
        description="The same as a fraction"
    )


class CurrentModelsResult(ViewModel):
    """The currents of all joints."""

    joints: list[CurrentModelView] = Field(description="In the robot's order of joints")


class CurrentModelsView(Computed[CurrentModelsRequest, CurrentModelsResult]):
    """Every joint's parameters in units of its current."""


Measurements = Annotated[list[Identifier], Field(min_length=1, max_length=100)]


@derive_body(KnownLoad)
class DriveGainsRequest(NamedRequest):
    """Runs of the same motion without and with a load of known mass, of a robot whose drive gains are uncertain."""

    robot_id: Identifier
    unloaded: Measurements = Field(description="Measurements without the load")
    loaded: Measurements = Field(description="Measurements of the same motion with the load")
    weigh: Measurements | None = Field(
        default=None, description="Measurements with other loads, whose mass is computed with the identified gains"
    )
    weigh_unloaded: Measurements | None = Field(
        default=None,
        description="Measurements of the motions of weigh without their loads; by default those of unloaded",
    )


class IdentifiedGain(DriveGainView):
    """The drive gain [12.17] of one joint, and the gain that its torque was computed with."""

    stated: float = Field(description="Gain of the robot; 1 if it states none")
    standard_deviation: float | None
    unit: str = Field(
        description="N m/A or N/A; N m/rad or N/m of position servos; - if the robot states no gain: a factor on the "
        "recorded torque"
    )


class WeighedLoad(ViewModel):
    """A load weighed with the identified gains."""

    measurement_id: str
    name: str
    mass: float = Field(description="kg")
    standard_deviation: float | None = Field(description="kg")
    from_gains: float | None = Field(description="The part of it that comes from the uncertainty of the gains, kg")
    interval: tuple[float | None, float | None] = Field(description="95 %, kg")
    identifiable: bool = Field(description="Whether the interval excludes zero: then the load is visible")


class DriveGainsResult(ViewModel):
    """Drive gains of all joints."""

    gains: list[IdentifiedGain] = Field(description="In the robot's order of joints")
    loads: list[WeighedLoad] = Field(default=[], description="In the order of weigh")
    warnings: list[str]


class DriveGainsView(Computed[DriveGainsRequest, DriveGainsResult], WithTables):
    """Drive gains from runs without and with a known load."""
