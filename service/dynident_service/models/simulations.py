"""Simulations on the wire."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from dynident.recordings.metadata import Role
from dynident.simulation.virtual_robot_request import ActingEffect, Simulated, list_usual_effects
from dynident.simulation.virtual_robot_request import Sensors as Sensing
from dynident_service.models.common import Computed, Identifier, NamedRequest, RequestModel, ViewModel
from dynident_service.models.designs import Trajectory
from dynident_service.models.request_bodies import derive_body


@derive_body(ActingEffect)
class TrueEffect(RequestModel):
    """An effect of the virtual robot; of a size as found on real arms where no parameters are given."""


@derive_body(Sensing, "sampling_rate")
class Noise(RequestModel):
    """Sensors of the virtual robot."""


MOST_ROWS = 2_000_000
Row = Annotated[list[float], Field(fail_fast=True, max_length=200)]
Rows = Annotated[list[Row], Field(fail_fast=True, max_length=MOST_ROWS)]
"""[sample][joint]; the first that is wrong is told, not all of a million."""


class Samples(RequestModel):
    """A trajectory sample by sample: [sample][joint]; derivatives follow from q where they are not given."""

    t: list[float] = Field(min_length=2, max_length=MOST_ROWS, fail_fast=True)
    q: Rows = Field(min_length=2)
    dq: Rows | None = None
    ddq: Rows | None = None


@derive_body(Simulated)
class SimulationRequest(NamedRequest):
    """A virtual robot to be measured."""

    robot_id: Identifier
    effects: list[TrueEffect] = Field(
        max_length=1000,
        default=[TrueEffect.model_validate({"effect": effect.effect}) for effect in list_usual_effects()],
    )
    trajectory: Samples | Trajectory | None = Field(
        default=None, description="Samples; or a family, of which a random motion within the limits is taken."
    )
    design_id: Identifier | None = None
    role: Role | None = None

    @model_validator(mode="after")
    def _check_one_motion(self) -> Self:
        if (self.trajectory is None) == (self.design_id is None):
            raise ValueError("give either trajectory or design_id")
        return self


class SimulationResult(ViewModel):
    """What the virtual robot's measurement is."""

    measurement_id: str = ""
    n_samples: int
    sampling_rate: float
    noise: list[float] = Field(description="Standard deviation of the torque noise per joint: no model does better.")
    tracking_error: list[float] = Field(description="Largest distance from the reference per joint")


class SimulationView(Computed[SimulationRequest, SimulationResult]):
    """A simulation."""
