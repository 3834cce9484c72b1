"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class CapsuleView(TypedDict):
    """All points within a radius of a segment, fixed to a frame: encloses a part of the link's collision geometry."""

    end: tuple[float, float, float]
    """m"""
    frame: int | None
    """Place of the frame that it moves with; null on the base"""
    radius: float
    """m"""
    start: tuple[float, float, float]
    """m"""


class Catalogue(TypedDict):
    """All effects."""

    items: list[EffectView]


class CheckView(TypedDict):
    """One thing that was looked at, what was found, and what to do about it."""

    apply: dict[str, Any] | None
    """What cures it, where that is known: a body for POST /v1/measurements/{id}/revisions; of a file that was refused,
    fields for the metadata of another try"""
    column: str
    """Of the file"""
    detail: str
    name: str
    row: int | None
    """Data row of the file, from 1"""
    rows: dict[str, list[int]]
    """By column of the file, its data rows, from 1; the first thousand of each"""
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

    confused_with: list[str]
    formula: str
    """LaTeX"""
    id: str
    parameters: list[EffectParameter]
    scope: Literal["joint", "robot"]
    shape_parameters: list[ShapeParameter]
    signature: str
    """What it leaves in the residual"""
    sources: list[str]
    title: str


class FrameView(TypedDict):
    """The frame of a joint that carries a link; it moves with its joint."""

    axis: tuple[float, float, float]
    """Unit vector in this frame that the joint turns about or slides along"""
    name: str
    offset: float
    """rad or m"""
    parent: int | None
    """Place of the frame before it in the list; null on the base"""
    placement: list[list[float]]
    """4 x 4: from this frame at zero position to the one before it"""
    ratios: list[float]
    """Its position is the sum of ratio x position of the robot's joints, plus offset; behind those of the joints stand
    the ratios of the passive positions that closed loops determine, if there are any"""
    type: Literal["revolute", "prismatic"]


class GeometryView(TypedDict):
    """What a picture of the robot needs; lengths in m, angles in rad."""

    capsules: list[CapsuleView]
    closed: list[float]
    """Positions of the robot's joints, then the passive ones, at which all loops are closed"""
    frames: list[FrameView]
    """Each behind the one that it stands on"""
    joints: list[str]
    """The robot's joints, in the order of ratios"""
    loops: list[LoopView]
    """What determines the passive positions"""
    notes: list[str]
    """What of the geometry could not be read"""
    surfaces: list[SurfaceView]
    """Drawn instead of their frame's capsules"""


class Health(TypedDict):
    """The service answers."""

    status: Literal["ok"]
    version: str


class JointView(TypedDict):
    """One moving joint."""

    antecedent: str | None
    """The joint before it; null on the base."""
    coupling: dict[str, float]
    """Other joints that its motor acts on."""
    drive_gain: float | None
    limits: Limits
    link: str
    name: str
    type: Literal["revolute", "prismatic"]


class KeyUsage(TypedDict):
    """What one key has."""

    bytes: Quota
    """Of its recordings, imports and meshes; each file once, however often it is used"""
    jobs: Quota
    """Queued or running"""
    key: str | None
    """Its name; `null` has what no key sent, and what was there before keys counted"""
    recordings: Quota
    """Measurements, with those that simulations under way will give"""


class Limits(TypedDict):
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W."""

    acceleration: float | None
    """rad/s² or m/s²"""
    effort: float | None
    """N m or N"""
    jerk: float | None
    """rad/s³ or m/s³"""
    position: tuple[float, float] | None
    """Lowest and highest position, rad or m"""
    power: float | None
    """Limit of torque times velocity, in W"""
    velocity: float | None
    """rad/s or m/s"""


class LoopEndView(TypedDict):
    """One side of a cut joint: a frame fixed to a link."""

    frame: int | None
    """Place of the frame that it moves with; null on the base"""
    placement: list[list[float]]
    """4 x 4: from this side to that frame"""


class LoopView(TypedDict):
    """A closed loop: the two sides coincide, wholly, in their origins, or in the xy plane of the first."""

    ends: tuple[LoopEndView, LoopEndView]
    kind: Literal["planar", "point", "full"]
    name: str


class MeshView(TypedDict):
    """A mesh that the description names for collisions."""

    links: list[str]
    """The links that it is of"""
    name: str
    """As in the description: package://…, or a path"""
    sha256: str | None
    """Of the file that was sent for it; null where none was."""
    size: int | None
    """Bytes"""


class MeshesView(TypedDict):
    """What came of the meshes that were sent."""

    meshes: list[MeshView]
    """All that the description names, in its order"""
    unused: list[str]
    """Files that were sent and that no mesh of the description means"""


class PosesView(TypedDict):
    """Where the frames of a robot's geometry are."""

    poses: list[list[list[float] | None]]
    """[posture][frame]: 12 numbers, the rotation beside the origin (m) in the base frame, row by row; null for what
    moves in a loop that cannot be closed there"""


class Problem(TypedDict, total=False):
    """The body of every error (RFC 9457)."""

    checks: list[dict[str, Any]] | None
    """All that was found in a file."""
    dependents: list[Dependent] | None
    """On 409: what has to be deleted first."""
    dependents_count: int | None
    """On 409: how many there are; not all are listed."""
    detail: str
    errors: list[ProblemField] | None
    request_id: str | None
    """Under which the service's log tells of the request."""
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
    """What has to be answered before the file can be used."""

    choices: list[str] | None
    detail: str
    field: str


class Quota(TypedDict):
    """How much there is of one thing, and how much there may be."""

    allowed: int | None
    """`null` where there is no limit"""
    used: int


class RawSignals(TypedDict):
    """Signals of a measurement's file; nothing is filtered, mended or resampled."""

    n_samples: int
    """How many there are from `from` to `to`, of which these are shown"""
    signals: dict[str, list[float | None]]
    """As long as t; null where there is no number"""
    t: list[float | None]
    """s"""
    units: dict[str, str]
    """By signal; empty for a column of the file that is given as it stands"""


class Readiness(TypedDict):
    """Whether the service can do its work, part by part."""

    checks: dict[str, str]
    status: Literal["ready", "not_ready"]


class ShapeParameter(TypedDict):
    """A constant inside an effect's columns, searched for rather than solved for."""

    default: float
    description: str
    name: str
    unit: str
    words: list[ShapeWord]
    """Empty where the constant is a number"""


class ShapeWord(TypedDict):
    """What a value of a constant means that is a choice between kinds."""

    value: float
    word: str


class Standstills(TypedDict):
    """When every joint of a measurement stands: there friction may hold any torque."""

    joints: list[StandstillsOfJoint]


class StandstillsOfJoint(TypedDict):
    """When one joint stands."""

    joint: str
    standing: list[tuple[float, float]]
    """Seconds of t, [from, to], one after another"""


class SurfaceView(TypedDict):
    """The surface of a link's meshes as triangles, fixed to a frame; thinned, for pictures."""

    frame: int | None
    """Place of the frame that it moves with; null on the base"""
    points: list[tuple[float, float, float]]
    """m"""
    triangles: list[tuple[int, int, int]]
    """Places in the list of points"""


class UsageView(TypedDict):
    """What is used, key by key."""

    items: list[KeyUsage]
