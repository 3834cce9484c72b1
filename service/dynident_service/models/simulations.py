"""Simulations on the wire."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from dynident_service.models.common import Asked, Computed, Identifier, Name, Shown
from dynident_service.models.designs import Trajectory
from dynident_service.models.measurements import Role


class TrueEffect(Asked):
    """An effect of the virtual robot; of a size as found on real arms where no parameters are given."""

    effect: str = Field(description="An id of GET /v1/effects")
    joints: list[str] = Field(default=[], description="All that it may sit on where none is given")
    parameters: dict[str, float] = Field(default={}, description="By the names that the catalogue gives them")
    shape_parameters: dict[str, float] = Field(default={})
    runs: list[str] = Field(default=[], description='The runs that it is in: "1", "2", …; all where none is given')


class Warming(Asked):
    """Joints that warm up with the time of the session: T = end + (start - end) exp(-t / time_constant)."""

    start: float = Field(default=20.0, description="degC at t = 0")
    end: float = Field(default=45.0, description="degC in the end")
    time_constant: float = Field(default=1200.0, gt=0, description="s")


class Noise(Asked):
    """Sensors of the virtual robot."""

    torque_noise: float = Field(default=0.005, description="Standard deviation, a share of the effort limit")
    torque_noise_absolute: list[float] | None = Field(
        max_length=1000, default=None, description="Per joint, N m or N, instead of it"
    )
    encoder_counts: int | None = Field(default=2**19, description="Per turn or metre; null: exact")
    jitter: float = Field(default=0.0, description="Standard deviation of the sampling instants, s")
    current: bool = Field(default=False, description="Record currents instead of torques; needs drive gains")


Rows = Annotated[list[Annotated[list[float], Field(fail_fast=True)]], Field(fail_fast=True)]
"""[sample][joint]; the first that is wrong is told, not all of a million."""


class Samples(Asked):
    """A trajectory sample by sample: [sample][joint]; derivatives follow from q where they are not given."""

    t: list[float] = Field(min_length=2, max_length=2_000_000, fail_fast=True)
    q: Rows = Field(min_length=2)
    dq: Rows | None = None
    ddq: Rows | None = None


class SimulationRequest(Asked):
    """A virtual robot to be measured."""

    robot_id: Identifier
    name: Name | None = None
    parameters: dict[str, float] = Field(
        default={}, description='Standard parameters: {"ZZ2": 0.5, "Fc1": 8}; else those of the description'
    )
    effects: list[TrueEffect] = Field(
        max_length=1000, default=[TrueEffect(effect=name) for name in ("rotor_inertia", "coulomb", "viscous")]
    )
    trajectory: Samples | Trajectory | None = Field(
        default=None, description="Samples; or a family, of which a random motion within the limits is taken."
    )
    design_id: Identifier | None = None
    noise: Noise = Noise()
    sampling_rate: float | None = Field(default=None, gt=0, le=20_000, description="Hz; else the trajectory's")
    feed_forward: Literal["computed_torque", "gravity", "none"] = "computed_torque"
    runs: int = Field(default=1, ge=1, le=100, description="How often the motion is made: a segment for each")
    pause: float = Field(default=60.0, ge=0, description="Seconds between runs; the session's time goes on")
    warming: Warming | None = Field(
        default=None, description="Records the joints' temperature; a usual warming where an effect needs it"
    )
    role: Role | None = None
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _one_motion(self) -> Self:
        if (self.trajectory is None) == (self.design_id is None):
            raise ValueError("give either trajectory or design_id")
        return self


class SimulationResult(Shown):
    """What the virtual robot's measurement is."""

    measurement_id: str = ""
    n_samples: int
    sampling_rate: float
    noise: list[float] = Field(description="Standard deviation of the torque noise per joint: no model does better.")
    tracking_error: list[float] = Field(description="Largest distance from the reference per joint")


class SimulationView(Computed[SimulationRequest, SimulationResult]):
    """A simulation."""
