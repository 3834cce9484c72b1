"""Designs of experiments on the wire."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.models.common import Asked, Computed, EffectChoice, Identifier, Limits, Name, Shown
from dynident_service.models.surroundings import Surroundings

DesignKind = Literal["optimized", "sequential", "constant_velocity", "random", "slow_sweep", "reversals"]


class Criterion(Asked):
    """How exciting a motion is (§12.3.4.1)."""

    name: Literal[
        "condition_number",
        "equilibrated",
        "condition_plus_inverse_sigma",
        "weighted",
        "d_optimal",
        "a_optimal",
        "e_optimal",
        "parameters",
        "separation",
    ] = "condition_number"
    weight: float = Field(default=1.0, description="k1 of [12.13], k2 of [12.14]")
    a_priori: dict[str, float] = Field(
        default={}, description="|Z| of [12.15] by parameter; what variances are relative to"
    )
    parameters: list[str] = Field(default=[], description="For parameters: those whose variances count")
    effects: list[EffectChoice] = Field(
        default=[], description="For separation: to be told from the rest of the model and from each other"
    )


class Trajectory(Asked):
    """The family of motions."""

    family: Literal["fourier", "b_spline", "point_to_point"] = "fourier"
    harmonics: int = Field(default=5, description="For fourier: of the fundamental frequency 1 / duration")
    intervals: int = Field(default=9, description="For b_spline: between its knots; as many free coefficients a joint")
    points: int = Field(default=12, description="For point_to_point: where the arm comes to rest in a round")
    dwell: tuple[float, float] = Field(
        default=(0.0, 0.0),
        description="For point_to_point: shortest and longest rest in a point, s; drawn between them",
    )
    sets: Literal["link_by_link", "wrist_then_shoulder", "vandanjon"] = Field(
        default="vandanjon", description="For sequential designs: the test motions (§12.3.4.2)"
    )
    duration: float = Field(
        default=10.0,
        description="One period, s; of a set about one run, of constant velocity the longest stroke, of a slow sweep "
        "one way",
    )
    periods: int = 1
    sampling_rate: float = Field(default=100.0, description="Hz")
    speeds: list[float] | None = Field(
        default=None, description="For constant velocity and reversals: shares of each joint's velocity limit"
    )
    amplitudes: list[float] | None = Field(
        default=None, min_length=1, description="For reversals: how far back and forth, rad or m"
    )
    joints: list[str] = Field(default=[], description="Those that move, the others locked at home; all where empty")
    paces: list[float] = Field(
        default=[1.0],
        min_length=1,
        description="For fourier and b_spline: the same path at each of these shares of its speed",
    )


class DesignRequest(Asked):
    """An experiment wanted."""

    robot_id: Identifier
    kind: DesignKind = "optimized"
    name: Name | None = None
    model: Literal["dynamic", "filtered", "energy", "power", "base_wrench"] | None = None
    effects: list[EffectChoice] | None = Field(default=None, description="What is to be identified")
    criterion: Criterion = Criterion()
    trajectory: Trajectory = Trajectory()
    limits: dict[str, Limits] = Field(default={}, description="By joint; tighter ones, for this experiment")
    home: list[float] | None = Field(default=None, description="Posture where it begins and ends, rad or m")
    time_budget: float | None = Field(default=None, description="Seconds of optimisation")
    starts: int | None = Field(default=None, description="Starts of the optimisation")
    random_trajectories: int = Field(default=100, description="How many stand beside the result")
    seed: int = 0
    noise: dict[str, float] = Field(
        default={}, description="By joint: standard deviation of a sample of its torque, N m or N"
    )
    torque_margin: float = Field(
        default=0.0, description="By what share the torque may be larger than predicted: its limits leave room for that"
    )
    surroundings: Surroundings = Surroundings()
    earlier_ids: list[Identifier] = Field(
        default=[], max_length=100, description="Measurements that the new experiment is to complement"
    )


class CriterionValues(Shown):
    """What a motion is worth; singular values are those of W / √N."""

    condition_number: float | None = Field(description="[12.12]; null where W has no full rank")
    criterion: float | None
    smallest_singular_value: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    trace_of_inverse: float | None


class BaselineValues(CriterionValues):
    """The best of the random trajectories."""

    count: int
    median_condition_number: float | None


class Margin(Shown):
    """How near the motion comes to a limit, on a fine grid."""

    joint: str = Field(description="The joint; of a clearance, the two that come near each other")
    limit: str = Field(
        description="position_min, position_max, velocity, …, torque, power, clearance, tool_min or tool_max"
    )
    value: float = Field(description="The extreme one")
    bound: float
    share: float | None = Field(description="Of the room that is used: 1 touches the limit")


class ExpectedParameter(Shown):
    """How well one parameter will come out."""

    name: str
    effect: str
    link: str
    unit: str
    share: float = Field(description="What is left of its column beside all others; 0: not determined")
    standard_deviation: float | None = Field(description="null where no noise is stated or it is not determined")


class Run(Shown):
    """One test motion of a set."""

    label: str
    joints: list[str] = Field(description="Those that move; the others are locked")
    start: float = Field(description="s")
    end: float = Field(description="s")


class DesignResult(Shown):
    """A verified experiment."""

    criterion_values: CriterionValues
    baseline_values: BaselineValues | None
    margins: list[Margin]
    n_samples: int
    sampling_rate: float
    duration: float = Field(description="s, from home to home")
    exciting: tuple[float, float] = Field(description="Seconds between which the exciting part lies")
    period: float | None
    parameter_names: list[str]
    expected_parameters: list[ExpectedParameter] = Field(default=[], description="How well they will come out")
    joints: list[str]
    runs: list[Run] = Field(default=[], description="Of a set of test motions; numbered in the trajectory's segment")
    notes: list[str]


class TrajectorySamples(Shown):
    """A trajectory sample by sample, [sample][joint]."""

    joints: list[str]
    t: list[float]
    q: list[list[float]]
    dq: list[list[float]]
    ddq: list[list[float]]


class DesignView(Computed[DesignRequest, DesignResult]):
    """A design."""
