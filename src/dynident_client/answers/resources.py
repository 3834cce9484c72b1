"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class CapsuleView(TypedDict):
    """All points within a radius of a segment, fixed to a frame: encloses a part of the link's collision geometry."""

    end: tuple[float, float, float]
    """m"""
    frame: int | None
    """Index of the frame that it moves with; null on the base"""
    radius: float
    """m"""
    start: tuple[float, float, float]
    """m"""


class Catalogue(TypedDict):
    """All effects."""

    items: list[EffectView]


class CheckView(TypedDict):
    """One check, what it found, and what to do about it."""

    apply: dict[str, Any] | None
    """The correction, if it is known: a body for POST /v1/measurements/{id}/revisions; for a file that was refused,
    fields for the metadata of the next upload"""
    column: str
    """Column of the file"""
    detail: str
    name: str
    row: int | None
    """Data row of the file, from 1"""
    rows: dict[str, list[int]]
    """By column of the file, its data rows, from 1; at most a thousand per column"""
    status: Literal["ok", "warning", "error"]
    time: float | None
    """Seconds of t"""


class Dependent(TypedDict):
    """A resource that rests on another one."""

    id: str
    kind: str


class EffectParameter(TypedDict):
    """One parameter of an effect."""

    description: str
    name: str
    prismatic_unit: str
    unit: str
    """On a revolute joint"""


class EffectView(TypedDict):
    """A physical cause of joint torque."""

    appearance: str
    """What the data show of such an effect, whatever its cause"""
    confused_with: list[str]
    formula: str
    """LaTeX"""
    hardware: str
    """The part that the effect is of, if only some robots have it"""
    id: str
    parameters: list[EffectParameter]
    scope: Literal["joint", "robot"]
    shape_parameters: list[ShapeParameter]
    signature: str
    """What the effect leaves in the residual if a model lacks it"""
    sources: list[str]
    title: str


class FrameView(TypedDict):
    """The frame of a joint that carries a link; it moves with its joint."""

    axis: tuple[float, float, float]
    """Unit vector in this frame: the axis of rotation or the direction of translation"""
    name: str
    offset: float
    """rad or m"""
    parent: int | None
    """Index of the preceding frame in the list; null on the base"""
    placement: list[list[float]]
    """4 x 4: from this frame at zero position to the preceding one"""
    ratios: list[float]
    """Its position is the sum of ratio x position of the robot's joints, plus offset; after the ratios of the joints
    come those of the passive positions that closed loops determine, if there are any"""
    type: Literal["revolute", "prismatic"]


class GeometryView(TypedDict):
    """Geometry for a picture of the robot; lengths in m, angles in rad."""

    capsules: list[CapsuleView]
    closed: list[float]
    """Positions of the robot's joints, then the passive ones, at which all loops are closed"""
    frames: list[FrameView]
    """Each frame after the one that it is attached to"""
    joints: list[str]
    """The robot's joints, in the order of ratios"""
    loops: list[LoopView]
    """The closed loops, which determine the passive positions"""
    notes: list[str]
    """Parts of the geometry that could not be read"""
    surfaces: list[SurfaceView]
    """Drawn instead of the capsules of their frame"""


class Health(TypedDict):
    """The service answers."""

    status: Literal["ok"]
    version: str


class JointView(TypedDict):
    """One moving joint."""

    antecedent: str | None
    """The preceding joint; null on the base."""
    coupling: dict[str, float]
    """Other joints that its motor acts on."""
    drive_gain: float | None
    limits: Limits
    link: str
    name: str
    type: Literal["revolute", "prismatic"]


class KeyUsage(TypedDict):
    """What one key uses."""

    bytes: Quota
    """Of its recordings, imports and meshes; each file counts once"""
    jobs: Quota
    """Queued or running"""
    key: str | None
    """Name of the key; `null` for resources without a key, or from before keys were counted"""
    recordings: Quota
    """Measurements, including those that unfinished simulations will make"""


class KnownRobot(TypedDict):
    """A well-known arm."""

    description: dict[str, str]
    """For POST /v1/robots: format and content"""
    name: str
    source: str
    """Where its limits and inertial parameters are from"""


class KnownRobots(TypedDict):
    """The well-known arms, by name."""

    items: list[KnownRobot]


class Limits(TypedDict):
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


class LoopEndView(TypedDict):
    """One side of a cut joint: a frame fixed to a link."""

    frame: int | None
    """Index of the frame that it moves with; null on the base"""
    placement: list[list[float]]
    """4 x 4: from this side to that frame"""


class LoopView(TypedDict):
    """A closed loop: its two sides coincide completely, in their origins, or in the xy plane of the first side."""

    ends: tuple[LoopEndView, LoopEndView]
    kind: Literal["planar", "point", "full"]
    name: str


class MeshView(TypedDict):
    """A mesh that the description uses for collisions."""

    links: list[str]
    """The links that use it"""
    name: str
    """As in the description: package://…, or a path"""
    sha256: str | None
    """Hash of the uploaded file; null if none was uploaded."""
    size: int | None
    """Bytes"""


class MeshesView(TypedDict):
    """The result of an upload of meshes."""

    meshes: list[MeshView]
    """All meshes that the description names, in its order"""
    unused: list[str]
    """Uploaded files that match no mesh of the description"""


class PosesView(TypedDict):
    """Where the frames of a robot's geometry are."""

    poses: list[list[list[float] | None]]
    """[posture][frame]: the 12 numbers of the 3 x 4 matrix [rotation, origin (m)] in the base frame, row by row; null
    for frames in a loop that cannot be closed there"""


class Problem(TypedDict, total=False):
    """The body of every error (RFC 9457)."""

    checks: list[dict[str, Any]] | None
    """Everything that was found in a file."""
    dependents: list[Dependent] | None
    """On 409: the resources that must be deleted first."""
    dependents_count: int | None
    """On 409: their number; not all are listed."""
    detail: str
    errors: list[ProblemField] | None
    request_id: str | None
    """Id of the request in the log of the service."""
    status: int
    title: str
    type: str


class ProblemField(TypedDict, total=False):
    """One field, column or parameter that is wrong."""

    detail: str
    pointer: str
    """A JSON pointer into the body, a column of a file, or the name of a parameter."""
    row: int | None
    """Data row of a file, from 1"""
    time: float | None
    """Seconds of t"""


class QuestionView(TypedDict):
    """A question that must be answered before the file can be used."""

    choices: list[str] | None
    detail: str
    field: str


class Quota(TypedDict):
    """An amount in use, and its limit."""

    allowed: int | None
    """`null` if there is no limit"""
    used: int


class RawSignals(TypedDict):
    """Signals of a measurement's file, without filtering, repair or resampling."""

    available: list[str]
    """Signals of joints that the file has, by joint name"""
    n_samples: int
    """Number of samples from `from` to `to`, of which these are shown"""
    signals: dict[str, list[float | None]]
    """As long as t; null if there is no number"""
    t: list[float | None]
    """s"""
    units: dict[str, str]
    """By signal; empty for a column that is given as it is in the file"""


class Readiness(TypedDict):
    """Whether the service can do its work, part by part."""

    checks: dict[str, str]
    status: Literal["ready", "not_ready"]


class ShapeParameter(TypedDict):
    """A constant inside an effect's columns; it is searched for, because the torque is not linear in it."""

    default: float
    description: str
    name: str
    unit: str
    words: list[ShapeWord]
    """Empty if the constant is a number"""


class ShapeWord(TypedDict):
    """The meaning of a value of a constant that selects a kind."""

    value: float
    word: str


class Standstills(TypedDict):
    """Standstills of every joint of a measurement: friction may have any value there."""

    joints: list[StandstillsOfJoint]


class StandstillsOfJoint(TypedDict):
    """Standstills of one joint."""

    joint: str
    standing: list[tuple[float, float]]
    """Seconds of t, [from, to], in order"""


class SurfaceView(TypedDict):
    """The surface of a link's meshes as triangles, fixed to a frame; thinned, for pictures."""

    frame: int | None
    """Index of the frame that it moves with; null on the base"""
    points: list[tuple[float, float, float]]
    """m"""
    triangles: list[tuple[int, int, int]]
    """Indices in the list of points"""


class UsageView(TypedDict):
    """What is used, key by key."""

    items: list[KeyUsage]
