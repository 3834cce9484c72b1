"""Models of currents, for which no drive gain is needed, on the wire."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dynident_service.models.common import Computed, EffectChoice, Identifier, NamedRequest, SourcePath, ViewModel
from dynident_service.models.identifications import JUDGEMENTS


class CurrentModelsRequest(NamedRequest):
    """Measurements whose currents are to be explained, of a robot whose drive gains nobody knows."""

    robot_id: Identifier = Field(
        description="It states a drive gain for every joint: whatever the measurements were read with, 1 for example"
    )
    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=100)]
    validation_ids: list[Identifier] = Field(default=[], max_length=100)
    effects: Annotated[list[EffectChoice], Field(min_length=1, max_length=200)] | None = Field(
        default=None,
        description="None that rests on the predicted torque, or has a constant to be searched for; links, rotors, dry "
        "and viscous friction and offsets where not given",
    )


class CurrentParameterView(ViewModel):
    """One parameter of a joint's current: a sum of base parameters over the joint's gain."""

    name: str
    value: float
    unit: str = Field(description="That of the parameter, times A/(N m), or A/(N)")
    standard_deviation: float | None
    interval: tuple[float | None, float | None] = Field(description="Holds the true value in 95 of 100 cases")
    judgement: JUDGEMENTS
    grouping: str = Field(description="Written out in base parameters")


class CurrentModelView(ViewModel):
    """What the current of one joint is made of."""

    joint: str
    parameters: list[CurrentParameterView]
    rms: Annotated[float, SourcePath("fit.rms_total")] = Field(
        description="Of the residual of the current in the fit, A"
    )
    relative: Annotated[float, SourcePath("fit.relative_total")] = Field(description="||i − î|| / ||i|| in the fit")
    held_out_rms: Annotated[float | None, SourcePath("held_out.rms_total")] = Field(
        description="The same where no parameter saw the data, A; null where there are none"
    )
    held_out_relative: Annotated[float | None, SourcePath("held_out.relative_total")] = Field(
        description="The same as a fraction"
    )


class CurrentModelsResult(ViewModel):
    """The currents of all joints."""

    joints: list[CurrentModelView] = Field(description="In the robot's order of joints")


class CurrentModelsView(Computed[CurrentModelsRequest, CurrentModelsResult]):
    """Every joint's parameters in units of its current."""
