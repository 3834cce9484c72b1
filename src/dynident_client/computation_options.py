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
    """Its centre, in m (-10000 to 10000)"""
    name: str
    rpy: tuple[float, float, float]
    """Roll, pitch, yaw as in a URDF, in rad"""
    size: tuple[float, float, float]
    """Its edges, in m (above 0 to 10000)"""


class Criterion(TypedDict, total=False):
    """How exciting a motion is (§12.3.4.1)."""

    a_priori: Mapping[str, float]
    """|Z| of [12.15] by parameter, to which variances are relative; by default the value of the robot's description"""
    effects: Sequence[EffectChoice]
    """For separation: the effects to distinguish from the rest of the model and from each other"""
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
    """Measure of the information in a motion (§12.3.4.1)"""
    parameters: Sequence[str]
    """For parameters: the parameters whose variances count"""
    weight: float
    """k1 of [12.13], k2 of [12.14] (in the unit of the smallest singular value) (1e-12 to 1e+12)"""


class DesignOptions(TypedDict, total=False):
    """A request to design an experiment."""

    criterion: Criterion
    earlier_ids: Sequence[str]
    """Measurements that the new experiment should complement"""
    effects: Sequence[EffectChoice] | None
    """Effects to identify"""
    home: Sequence[float] | None
    """Posture where the motion begins and ends, in rad or m"""
    identification_id: str | None
    """Model of the robot by which torque is predicted for its limits: friction and rotors count, and a margin for what
    is uncertain. By default, the inertias of the description alone"""
    limits: Mapping[str, Limits]
    """By joint: tighter limits for this experiment"""
    model: Literal["dynamic", "filtered", "energy", "power"] | None
    """Rows that the criterion is computed from"""
    name: str | None
    noise: Mapping[str, float]
    """By joint: standard deviation of one torque sample, in N m or N (1e-09 to 1e+09)"""
    random_trajectories: int
    """Number of random motions to compare the result with (1 to 1e+06)"""
    seed: int
    """The same seed gives the same result (0 to 9.0072e+15)"""
    starts: int | None
    """Number of starts of the optimisation; as many as the time allows, or 4 (1 to 1e+06)"""
    surroundings: Surroundings
    """What the robot must not touch"""
    time_budget: float | None
    """Time limit of the optimisation; the best result until then is used, in s (above 0 to 604800)"""
    torque_margin: float
    """Share by which the torque may exceed the prediction; torque limits are reduced accordingly (0 to 100)"""
    trajectory: Trajectory


class DiagnosisOptions(TypedDict, total=False):
    """The model to diagnose, and the measurements to use."""

    candidates: Sequence[str] | None
    """Ids of the effects to try; the whole catalogue if not given"""
    has: Sequence[str]
    """Parts that the robot has, beside those stated with it: gravity_compensator, spring, cable, coupled_wrist"""
    has_not: Sequence[str]
    """Parts that the robot does not have, beside those stated with it"""
    max_effects: int | None
    """Largest number of recommended effects; contacts do not count (1 to 100)"""
    name: str | None
    significance: float
    """Largest p-value of a finding: the probability that anything is named where nothing is missing (0.001 to 0.2)"""


class DriveGainsOptions(TypedDict, total=False):
    """Runs of the same motion without and with a load of known mass, of a robot whose drive gains are uncertain."""

    centre: tuple[float, float, float] | None
    """Centre of the known load in the last joint's frame, if known, in m (-100 to 100)"""
    mass: float | None
    """Mass of the known load, if the measurements do not state it, in kg (1e-06 to 1e+06)"""
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
    """Which residuals count as correlated: those of all joints over blocks of time, those of each joint over time, or
    none"""
    estimator: Literal["auto", "wls", "ols", "irls", "feasible", "iv", "didim", "ekf"]
    """Method that estimates χ"""
    free_links: Sequence[str]
    """Joints whose links the prior does not apply to, such as a link with a load"""
    interval: float | None
    """Interval of one equation of the energy model; from the data if left out, in s (1e-06 to 86400)"""
    model: Literal["dynamic", "filtered", "energy", "power", "base_wrench"]
    """Rows of W"""
    name: str | None
    pole: float | None
    """a of the filtered model's F(s) = a²/(s + a)²; from the data if left out, in rad/s (0.001 to 1e+06)"""
    preprocessing: Preprocessing | Literal["auto"]
    """Filters; from the data if left out"""
    prior: Literal["description", "description_entropic"] | None
    """Use of the inertias in the robot's description, weighted by their uncertainty"""
    prior_error: float
    """Usual relative error of the description's inertias (1e-06 to 10)"""
    steps: Literal["link_by_link", "wrist_then_shoulder"]
    """Steps of the sequential strategy"""
    strategy: Literal["global", "sequential", "separate_friction"]
    """Order in which parameters are estimated"""
    weigh_turns: bool
    """For joint torques with wls or feasible: rows at reversals have their own weight"""


class Limits(TypedDict, total=False):
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W."""

    acceleration: float | None
    """Largest acceleration, in rad/s² or m/s² (1e-06 to 1e+09)"""
    effort: float | None
    """Largest torque or force, in N m or N (1e-06 to 1e+09)"""
    jerk: float | None
    """Largest change of the acceleration, in rad/s³ or m/s³ (1e-06 to 1e+09)"""
    position: tuple[float, float] | None
    """Lowest and highest position, in rad or m"""
    power: float | None
    """Largest product of torque and velocity, in W (1e-06 to 1e+09)"""
    velocity: float | None
    """Largest speed, in rad/s or m/s (1e-06 to 1e+09)"""


class MethodRequest(TypedDict, total=False):
    """A method of identification."""

    estimator: Literal["auto", "wls", "ols", "irls", "feasible", "iv", "didim", "ekf"]
    model: Literal["dynamic", "filtered", "energy", "power", "base_wrench"]
    prior: Literal["description", "description_entropic"] | None
    steps: Literal["link_by_link", "wrist_then_shoulder"]
    """Steps of the sequential strategy"""
    strategy: Literal["global", "sequential", "separate_friction"]


class Noise(TypedDict, total=False):
    """Sensors of the virtual robot."""

    current: bool
    """Record currents instead of torques; needs drive gains"""
    encoder_counts: int | None
    """Encoder counts per turn or metre; 0 or null: exact (0 to 1.09951e+12)"""
    jitter: float
    """Standard deviation of the sampling instants, in s (0 to 1)"""
    torque_noise: float
    """Standard deviation of the torque noise, as a share of the effort limit (0 to 1000)"""
    torque_noise_absolute: Sequence[float] | None
    """Standard deviation of each joint, N m or N; replaces torque_noise (0 to 1e+09)"""


class Preprocessing(TypedDict, total=False):
    """Cut-off frequencies in Hz (null: no filter) and decimation; missing values are chosen from the data."""

    decimation: int | Literal["auto"]
    """Every n-th row is kept (1 to 1e+06)"""
    filter_order: int | Literal["auto"]
    """Order of one pass of the position filter (1 to 12)"""
    position_cutoff: float | Literal["auto"] | None
    """Cut-off of the position filter, in Hz (0.0001 to 1e+06)"""
    torque_cutoff: float | Literal["auto"] | None
    """Cut-off of the filter of torque and columns, in Hz (0.0001 to 1e+06)"""


class ReportOptions(TypedDict, total=False):
    """A request for a report."""

    format: Literal["html", "pdf", "json"]
    """Format of the report"""
    name: str | None
    """Heading of the report; the robot's name by default"""


class SimulationOptions(TypedDict, total=False):
    """A request to simulate a measurement of a virtual robot."""

    feed_forward: Literal["computed_torque", "gravity", "none"]
    """Torque that the controller predicts"""
    name: str | None
    noise: Noise
    parameters: Mapping[str, float]
    """Standard parameters by name, such as ZZ2 or Fc1; the others are those of the description"""
    pause: float
    """Time between two runs, in which the session's time continues, in s (0 to 1e+07)"""
    role: Literal["identification", "validation", "friction", "payload"] | None
    runs: int
    """Number of repetitions of the motion, one segment each (1 to 100)"""
    sampling_rate: float | None
    """Sampling rate of the sensors; that of the trajectory if not given, in Hz (0.1 to 20000)"""
    seed: int
    """Seed of the noise and of a random motion (0 to 9.0072e+15)"""
    warming: Warming | None
    """Records the joints' temperature; by default a typical warming if an effect needs it"""


class Surroundings(TypedDict, total=False):
    """What a motion must not touch."""

    assume_floor: bool
    """Assume a floor through the base of an upright robot if no surroundings are stated"""
    boxes: Sequence[Box]
    clearance: float
    """Smallest distance to all bodies, in m (0.001 to 10)"""
    floor: float | None
    """Height of a floor that only the base may reach, in the base frame, in m (-10000 to 10000)"""
    link_radius: float | None
    """Links without collision geometry count as capsules of this radius between the joints' origins, in m (0.0001 to
    100)"""
    may_touch: Sequence[tuple[str, str]]
    """Pairs of links (or joints) that are not checked against each other"""
    self_collision: bool
    """Links must not touch each other (checked for links with collision geometry)"""
    tool_range: ToolRange | None
    walls: Sequence[Wall]


class ToolRange(TypedDict, total=False):
    """Where the tool may go, m in the base frame."""

    high: tuple[float | None, float | None, float | None]
    """x, y, z; null: no bound (-10000 to 10000)"""
    joint: str | None
    """The joint that carries the tool; the last one by default"""
    low: tuple[float | None, float | None, float | None]
    """x, y, z; null: no bound (-10000 to 10000)"""
    point: tuple[float, float, float]
    """Position of the tool in the frame of the joint, in m (-10000 to 10000)"""


class Trajectory(TypedDict, total=False):
    """The family of trajectories."""

    amplitudes: Sequence[float] | None
    """For reversals: lengths of the strokes, in rad or m (1e-06 to 1000)"""
    duration: float
    """Duration of one period; for a set, of about one run; for constant velocity, of the longest stroke; for a slow
    sweep, of one direction; for point to point, it is a result, in s (0.01 to 86400)"""
    dwell: tuple[float, float]
    """For point_to_point: shortest and longest rest in a point; rests are random between them, in s (0 to 60)"""
    family: Literal["fourier", "b_spline", "point_to_point"]
    """Family of functions that describes the motion"""
    harmonics: int
    """For fourier: number of harmonics of the frequency 1 / duration (2 to 100)"""
    intervals: int
    """For b_spline: number of intervals between knots; equals the free coefficients per joint (2 to 200)"""
    joints: Sequence[str]
    """Joints that move, with the others locked at home; all if empty"""
    paces: Sequence[float]
    """For fourier and b_spline: repeat the path at each of these shares of its speed (0.0001 to 1)"""
    periods: int
    """Number of repetitions of the period or of the set of strokes (1 to 1e+06)"""
    points: int
    """For point_to_point: number of points per round where the arm comes to rest (2 to 200)"""
    sampling_rate: float
    """Sampling rate, in Hz (0.1 to 100000)"""
    sets: Literal["link_by_link", "wrist_then_shoulder", "vandanjon"]
    """For sequential designs: the test motions (§12.3.4.2)"""
    speeds: Sequence[float] | None
    """For constant velocity and reversals: speeds, as shares of each joint's velocity limit (0.0001 to 1)"""


class ValidationOptions(TypedDict, total=False):
    """The model to validate, and how."""

    cutoffs: Sequence[float] | None
    """filters: Position cut-offs to try, in Hz (0.0001 to 1e+06)"""
    draws: int | None
    """bootstrap: Number of resamplings; 999 by default (99 to 9999)"""
    limit: float | None
    """direct, cross, simulation: Largest relative error that passes; 0.15 by default (1e-06 to 10)"""
    longest: float | None
    """simulation, filters: Longest time to simulate, in s (0.1 to 300)"""
    mass: float | None
    """payload: The known mass, if the measurements do not state it, in kg (1e-06 to 1e+06)"""
    methods: Sequence[MethodRequest] | None
    """methods: Methods to compare; all that are available if left out"""
    name: str | None
    seed: int
    """inertia_matrix, filters, bootstrap: Seed of the random postures (0 to 9.0072e+15)"""


class Wall(TypedDict, total=False):
    """A plane that nothing may cross."""

    name: str
    normal: tuple[float, float, float]
    """Points to the free side"""
    point: tuple[float, float, float]
    """Any point on it, in the base frame, in m (-10000 to 10000)"""


class Warming(TypedDict, total=False):
    """Joints that warm up with the time t of the session: T = end + (start - end) exp(-t / time_constant)."""

    end: float
    """degC at the end (-273 to 1000)"""
    start: float
    """degC at t = 0 (-273 to 1000)"""
    time_constant: float
    """Time constant of the warming, in s (0.001 to 1e+09)"""
