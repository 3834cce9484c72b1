"""What requests take, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypedDict

DesignKind = Literal["optimized", "random", "sequential", "constant_velocity", "slow_sweep", "reversals"]
ValidationKind = Literal[
    "direct",
    "cross",
    "inertia_matrix",
    "simulation",
    "methods",
    "filters",
    "bootstrap",
    "payload",
]


class Box(TypedDict, total=False):
    """A box in the base frame."""

    center: tuple[float, float, float]
    """Its centre, in m"""
    name: str
    rpy: tuple[float, float, float]
    """Roll, pitch, yaw as in a URDF, in rad"""
    size: tuple[float, float, float]
    """Its edges, in m"""


class Criterion(TypedDict, total=False):
    """How exciting a motion is (§12.3.4.1)."""

    a_priori: Mapping[str, float]
    """|Z| of [12.15] by parameter, else as the robot's description has it; what variances are relative to"""
    effects: Sequence[EffectChoice]
    """For separation: to be told from the rest of the model and from each other"""
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
    ]
    """How exciting a motion is (§12.3.4.1)"""
    parameters: Sequence[str]
    """For parameters: those whose variances count"""
    weight: float
    """k1 of [12.13], k2 of [12.14] (in the unit of the smallest singular value)"""


class DesignOptions(TypedDict, total=False):
    """A request to design an experiment."""

    criterion: Criterion
    earlier_ids: Sequence[str]
    """Measurements that the new experiment should complement"""
    effects: Sequence[EffectChoice] | None
    """What is to be identified"""
    home: Sequence[float] | None
    """Posture where it begins and ends, in rad or m"""
    limits: Mapping[str, Limits]
    """By joint; tighter ones, for this experiment"""
    model: Literal["dynamic", "filtered", "energy", "power"] | None
    """Rows that the criterion is computed from"""
    name: str | None
    noise: Mapping[str, float]
    """By joint: standard deviation of a sample of its torque, in N m or N"""
    random_trajectories: int
    """How many random ones stand beside the result"""
    seed: int
    """The same seed gives the same result"""
    starts: int | None
    """Starts of the optimisation; as many as the time allows, or 4"""
    surroundings: Surroundings
    """What the robot must not touch"""
    time_budget: float | None
    """Time of the optimisation; the best so far is taken, in s"""
    torque_margin: float
    """Share by which the torque may be larger than predicted: its limits leave room for that"""
    trajectory: Trajectory


class DiagnosisOptions(TypedDict, total=False):
    """The model to diagnose, and the measurements to use."""

    candidates: Sequence[str] | None
    """Ids of effects, only these; the whole catalogue where not given"""
    max_effects: int | None
    """At most so many are recommended"""
    name: str | None


class DriveGainsOptions(TypedDict, total=False):
    """Runs of the same motion without and with a load of known mass, of a robot whose drive gains are uncertain."""

    centre: tuple[float, float, float] | None
    """Centre of the known load in the last joint's frame, where known, in m"""
    mass: float | None
    """Mass of the known load, where the measurements do not state it, in kg"""
    name: str | None


class EffectChoice(TypedDict, total=False):
    """An effect of the catalogue, on some joints."""

    effect: str
    """An id from GET /v1/effects"""
    joints: Sequence[str]
    """Names of joints; by default, all joints that the effect can act on."""
    runs: Sequence[str]
    """Names of the measurements, or labels of their runs, in which the effect acts"""
    shape_parameters: Mapping[str, float]
    """Shape constants; searched for if not given."""


class IdentificationOptions(TypedDict, total=False):
    """What to identify, from which measurements, and how."""

    covariance: Literal["by_time_and_joints", "by_joint", "independent"]
    """What of the residuals is taken to be correlated: all joints' over stretches of time, each joint's over time, or
    nothing"""
    estimator: Literal["auto", "wls", "ols", "irls", "feasible", "iv", "didim", "ekf"]
    """How χ is solved for"""
    free_links: Sequence[str]
    """Joints whose links the prior is not believed of, such as a loaded one"""
    interval: float | None
    """Time that an equation of the energy model spans; from the data if left out, in s"""
    model: Literal["dynamic", "filtered", "energy", "power", "base_wrench"]
    """Rows of W"""
    name: str | None
    pole: float | None
    """a of the filtered model's F(s) = a²/(s + a)²; from the data if left out, in rad/s"""
    preprocessing: Preprocessing | Literal["auto"]
    """Filters; from the data if left out"""
    prior: Literal["description", "description_entropic"] | None
    """Inertias that the robot's description gives, weighted by their uncertainty"""
    prior_error: float
    """Share by which the description's inertias are usually off"""
    steps: Literal["link_by_link", "wrist_then_shoulder"]
    """Of the sequential strategy"""
    strategy: Literal["global", "sequential", "separate_friction"]
    """Parameters at a time"""
    weigh_turns: bool
    """Of joints' torques by wls or feasible: rows where a joint turns round count by a noise of their own"""


class Limits(TypedDict, total=False):
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W."""

    acceleration: float | None
    """rad/s² or m/s²"""
    effort: float | None
    """N m or N"""
    jerk: float | None
    """rad/s³ or m/s³"""
    position: tuple[float, float] | None
    """Lowest and highest, rad or m"""
    power: float | None
    """Of torque times velocity, in W"""
    velocity: float | None
    """rad/s or m/s"""


class MethodRequest(TypedDict, total=False):
    """A method of identification."""

    estimator: Literal["auto", "wls", "ols", "irls", "feasible", "iv", "didim", "ekf"]
    model: Literal["dynamic", "filtered", "energy", "power", "base_wrench"]
    prior: Literal["description", "description_entropic"] | None
    steps: Literal["link_by_link", "wrist_then_shoulder"]
    """Of the sequential strategy"""
    strategy: Literal["global", "sequential", "separate_friction"]


class Noise(TypedDict, total=False):
    """Sensors of the virtual robot."""

    current: bool
    """Record currents instead of torques; needs drive gains"""
    encoder_counts: int | None
    """Per turn or metre; 0 or null: exact"""
    jitter: float
    """Standard deviation of the sampling instants, in s"""
    torque_noise: float
    """Standard deviation, a share of the effort limit"""
    torque_noise_absolute: Sequence[float] | None
    """Per joint, N m or N, instead of it"""


class Preprocessing(TypedDict, total=False):
    """Cut-off frequencies in Hz (null: no filter) and decimation; missing values are chosen from the data."""

    decimation: int | Literal["auto"]
    """Every how many-th row is kept"""
    filter_order: int | Literal["auto"]
    """Of one pass of the filter of the positions"""
    position_cutoff: float | Literal["auto"] | None
    """Of the filter of the positions, in Hz"""
    torque_cutoff: float | Literal["auto"] | None
    """Of the filter of torque and columns, in Hz"""


class ReportOptions(TypedDict, total=False):
    """A request for a report."""

    format: Literal["html", "pdf", "json"]
    """What it is written as"""
    name: str | None
    """The heading; the robot's name by default"""


class SimulationOptions(TypedDict, total=False):
    """A request to simulate a measurement of a virtual robot."""

    feed_forward: Literal["computed_torque", "gravity", "none"]
    """What the controller knows beforehand"""
    name: str | None
    noise: Noise
    parameters: Mapping[str, float]
    """Standard parameters by name, such as ZZ2 or Fc1; else those of the description"""
    pause: float
    """Between runs, while the session's time goes on, in s"""
    role: Literal["identification", "validation", "friction", "payload"] | None
    runs: int
    """How often the motion is made: a segment for each"""
    sampling_rate: float | None
    """Of the sensors; the trajectory's where not given, in Hz"""
    seed: int
    """Of the noise and of a random motion"""
    warming: Warming | None
    """Records the joints' temperature; a usual warming where an effect needs it"""


class Surroundings(TypedDict, total=False):
    """What a motion must not touch."""

    assume_floor: bool
    """Where nothing around an upright robot is stated, a floor through its base is assumed"""
    boxes: Sequence[Box]
    clearance: float
    """Distance that is kept to everything, in m"""
    floor: float | None
    """Height of a floor that no link but the base may reach, in the base frame, in m"""
    link_radius: float | None
    """Links without collision geometry count as capsules of this radius between the joints' origins, in m"""
    may_touch: Sequence[tuple[str, str]]
    """Pairs of links (or joints) that are not checked against each other"""
    self_collision: bool
    """Links must not touch each other, as far as the description has collision geometry"""
    tool_range: ToolRange | None
    walls: Sequence[Wall]


class ToolRange(TypedDict, total=False):
    """Where the tool may go, m in the base frame."""

    high: tuple[float | None, float | None, float | None]
    """x, y, z; null: no bound"""
    joint: str | None
    """The joint that carries it; the last one"""
    low: tuple[float | None, float | None, float | None]
    """x, y, z; null: no bound"""
    point: tuple[float, float, float]
    """The tool in the frame of the joint, in m"""


class Trajectory(TypedDict, total=False):
    """The family of trajectories."""

    amplitudes: Sequence[float] | None
    """For reversals: how far back and forth, in rad or m"""
    duration: float
    """One period; of a set about one run, of constant velocity the longest stroke, of a slow sweep one way, of a point-
    to-point sequence a result, in s"""
    dwell: tuple[float, float]
    """For point_to_point: shortest and longest rest in a point, drawn between them, in s"""
    family: Literal["fourier", "b_spline", "point_to_point"]
    """How the motion is written"""
    harmonics: int
    """For fourier: of the fundamental frequency 1 / duration"""
    intervals: int
    """For b_spline: between its knots; as many free coefficients a joint"""
    joints: Sequence[str]
    """Those that move, the others locked at home; all where empty"""
    paces: Sequence[float]
    """For fourier and b_spline: the same path at each of these shares of its speed"""
    periods: int
    """How often the period (the set of strokes) is repeated"""
    points: int
    """For point_to_point: where the arm comes to rest in a round"""
    sampling_rate: float
    """Sampling rate, in Hz"""
    sets: Literal["link_by_link", "wrist_then_shoulder", "vandanjon"]
    """For sequential designs: the test motions (§12.3.4.2)"""
    speeds: Sequence[float] | None
    """For constant velocity and reversals: shares of each joint's velocity limit"""


class ValidationOptions(TypedDict, total=False):
    """The model to validate, and how."""

    cutoffs: Sequence[float] | None
    """filters: Position cut-offs to try, in Hz"""
    draws: int | None
    """bootstrap: How often stretches of time are drawn, 999"""
    limit: float | None
    """direct, cross, simulation: Largest relative error that passes, 0.15"""
    longest: float | None
    """simulation, filters: Simulated at most, in s"""
    mass: float | None
    """payload: The known mass, where the measurements do not state it, in kg"""
    methods: Sequence[MethodRequest] | None
    """methods: Which; all that are available if left out"""
    name: str | None
    seed: int
    """inertia_matrix, filters, bootstrap: Of the postures that are drawn"""


class Wall(TypedDict, total=False):
    """A plane that nothing may cross."""

    name: str
    normal: tuple[float, float, float]
    """To the side that is free"""
    point: tuple[float, float, float]
    """Any point on it, in the base frame, in m"""


class Warming(TypedDict, total=False):
    """Joints that warm up with the time t of the session: T = end + (start - end) exp(-t / time_constant)."""

    end: float
    """degC in the end"""
    start: float
    """degC at t = 0"""
    time_constant: float
    """How slowly, in s"""
