"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import TypedDict


class BaselineValues(TypedDict):
    """The best of the random trajectories."""

    condition_number: float | None
    """[12.12]; null where W has no full rank"""
    count: int
    criterion: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    median_condition_number: float | None
    smallest_singular_value: float | None
    trace_of_inverse: float | None


class CriterionValues(TypedDict):
    """What a motion is worth; singular values are those of W / √N."""

    condition_number: float | None
    """[12.12]; null where W has no full rank"""
    criterion: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    smallest_singular_value: float | None
    trace_of_inverse: float | None


class DesignClearances(TypedDict):
    """How near each link is to others and to the surroundings along a motion, and what these look like."""

    edges: list[tuple[tuple[float, float, float], tuple[float, float, float]]]
    """Of the boxes around the robot: their ends, m, in the base frame"""
    links: list[LinkClearances]
    """Those that are kept clear of anything"""
    t: list[float]
    """s"""
    walls: list[WallPlane]


class DesignResult(TypedDict):
    """A verified experiment."""

    baseline_values: BaselineValues | None
    criterion_values: CriterionValues
    duration: float
    """s, from home to home"""
    exciting: tuple[float, float]
    """Seconds between which the exciting part lies"""
    expected_parameters: list[ExpectedParameter]
    """How well they will come out"""
    joints: list[str]
    margins: list[Margin]
    n_samples: int
    notes: list[str]
    parameter_names: list[str]
    period: float | None
    runs: list[Run]
    """Of a set of test motions; numbered in the trajectory's segment"""
    sampling_rate: float
    warnings: list[str]
    """The notes without which nobody should run the motion"""


class ExpectedParameter(TypedDict):
    """How well one parameter will come out."""

    effect: str
    link: str
    name: str
    share: float
    """What is left of its column beside all others; 0: not determined"""
    standard_deviation: float | None
    """null where no noise is stated or it is not determined"""
    unit: str


class LinkClearances(TypedDict):
    """What a link is nearest to, sample by sample: what leaves least over the distance that is wanted."""

    distance: list[float]
    """m; negative where they overlap"""
    frame: int
    """Place in the frames of the robot's geometry"""
    here: list[tuple[float, float, float]]
    """Nearest point of the link in its frame, m"""
    name: str
    others: list[Other]
    there: list[tuple[float, float, float]]
    """Nearest point of the other in its own frame, m"""
    to: list[int]
    """Place in the others"""
    wanted: list[float]
    """m"""


class Margin(TypedDict):
    """How near the motion comes to a limit, on a fine grid."""

    bound: float
    joint: str
    """The joint; of a clearance, the two that come near each other; of a condition: loops"""
    limit: str
    """position_min, position_max, velocity, …, torque, power, clearance, tool_min, tool_max or condition"""
    share: float | None
    """Of the room that is used: 1 touches the limit"""
    value: float
    """The extreme one"""


class Other(TypedDict):
    """What a link may be near to: another link, or a part of the surroundings."""

    frame: int | None
    """Place in the frames of the robot's geometry; null on the base"""
    name: str


class Run(TypedDict):
    """One test motion of a set."""

    end: float
    """s"""
    joints: list[str]
    """Those that move; the others are locked"""
    label: str
    start: float
    """s"""


class SimulationResult(TypedDict):
    """What the virtual robot's measurement is."""

    measurement_id: str
    n_samples: int
    noise: list[float]
    """Standard deviation of the torque noise per joint: no model does better."""
    sampling_rate: float
    tracking_error: list[float]
    """Largest distance from the reference per joint"""


class WallPlane(TypedDict):
    """The plane of a wall."""

    along: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Unit vectors in it, at right angles"""
    point: tuple[float, float, float]
    """m, in the base frame"""
