"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import TypedDict


class BaselineValues(TypedDict):
    """The best of the random trajectories."""

    condition_number: float | None
    """[12.12]; null if W does not have full rank"""
    count: int
    criterion: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    median_condition_number: float | None
    smallest_singular_value: float | None
    trace_of_inverse: float | None


class CriterionValues(TypedDict):
    """How well a motion excites the parameters; singular values are those of W / √N."""

    condition_number: float | None
    """[12.12]; null if W does not have full rank"""
    criterion: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    smallest_singular_value: float | None
    trace_of_inverse: float | None


class DesignClearances(TypedDict):
    """Clearances of each link along a motion, to other links and to the surroundings, with their shapes."""

    edges: list[tuple[tuple[float, float, float], tuple[float, float, float]]]
    """Edges of the boxes around the robot: their end points, m, in the base frame"""
    links: list[LinkClearances]
    """The links whose clearance is checked"""
    t: list[float]
    """s"""
    walls: list[WallPlane]


class DesignResult(TypedDict):
    """A verified experiment."""

    baseline_values: BaselineValues | None
    criterion_values: CriterionValues
    duration: float
    """Duration in s, from home to home"""
    exciting: tuple[float, float]
    """Start and end of the exciting part, s"""
    expected_parameters: list[ExpectedParameter]
    """Expected accuracy of the parameters"""
    floor: float | None
    """Height in m of the floor that was checked, in the base frame; if the request states none, the floor was assumed.
    null: no floor was checked"""
    joints: list[str]
    margins: list[Margin]
    n_samples: int
    notes: list[str]
    parameter_names: list[str]
    period: float | None
    runs: list[Run]
    """Runs of a set of test motions; the column segment of the trajectory has their numbers"""
    sampling_rate: float
    warnings: list[str]
    """Notes that everybody must read before running the motion"""


class ExpectedParameter(TypedDict):
    """Expected accuracy of one parameter."""

    effect: str
    link: str
    name: str
    share: float
    """Share of its column that the other columns do not explain; 0: not determined"""
    standard_deviation: float | None
    """null if no noise is stated or the parameter is not determined"""
    unit: str


class LinkClearances(TypedDict):
    """What a link is closest to, sample by sample: the body with the least clearance beyond the required distance."""

    distance: list[float]
    """m; negative if they overlap"""
    frame: int
    """Index of the frame in the robot's geometry"""
    here: list[tuple[float, float, float]]
    """Nearest point on the link, in its frame, m"""
    name: str
    others: list[Other]
    there: list[tuple[float, float, float]]
    """Nearest point on the other body, in its own frame, m"""
    to: list[int]
    """Index in the others"""
    wanted: list[float]
    """m"""


class Margin(TypedDict):
    """How close the motion comes to a limit, on a fine grid."""

    bound: float
    joint: str
    """The joint; for a clearance, the two bodies that come close to each other; for a condition: loops"""
    limit: str
    """position_min, position_max, velocity, …, torque, power, clearance, tool_min, tool_max or condition"""
    share: float | None
    """Share of the available range that is used: 1 reaches the limit"""
    value: float
    """The extreme value"""


class Other(TypedDict):
    """What a link may come close to: another link, or a part of the surroundings."""

    frame: int | None
    """Index of the frame in the robot's geometry; null for the base"""
    name: str


class Run(TypedDict):
    """One test motion of a set."""

    end: float
    """s"""
    joints: list[str]
    """Joints that move; the others are locked"""
    label: str
    start: float
    """s"""


class SimulationResult(TypedDict):
    """The measurement of the virtual robot."""

    measurement_id: str
    n_samples: int
    noise: list[float]
    """Standard deviation of the torque noise per joint: no model can predict better."""
    sampling_rate: float
    tracking_error: list[float]
    """Largest deviation from the reference per joint"""


class WallPlane(TypedDict):
    """The plane of a wall."""

    along: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Orthogonal unit vectors in the plane"""
    point: tuple[float, float, float]
    """m, in the base frame"""
