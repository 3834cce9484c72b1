"""Read a robot from a JSON table of modified Denavit-Hartenberg parameters (Khalil and Kleinfinger).

The table is JSON: a list of rows, one a joint, or an object with that list and, if wanted, gravity::

    {"joints": [
        {"name": "joint1", "antecedent": 0, "sigma": 0,
         "gamma": 0, "b": 0, "alpha": 0, "d": 0, "theta": 0, "r": 0.333,
         "limits": {"position": [-2.9, 2.9], "velocity": 2.2, "acceleration": 15, "jerk": 7500, "effort": 87},
         "inertia": {"XX": 0.02, "XY": 0, …, "MX": 0.1, …, "M": 2.5}},
        {"name": "joint2", "alpha": "-pi/2"},
        …],
     "gravity": [0, 0, -9.81]}

======================  ================================================================================================
name                    name of the joint; `joint<j>` for row j by default
antecedent              the joint before it: its name or its number, counted from 1; 0 or "base" for the base. The row
                        above by default (the base for the first row). Two rows may share an antecedent: a tree
sigma                   0: revolute (default), 1: prismatic
gamma, b, alpha, d,     constants of the frame (rad, m), 0 by default; numbers, or texts such as "pi/2". The joint
theta, r                variable is added to theta of a revolute and to r of a prismatic joint
limits                  position, velocity, acceleration, jerk, effort, power; any of them
inertia                 XX XY XZ YY YZ ZZ MX MY MZ M of the link in frame j, about its origin [12.1]; 0 by default
mass_properties         instead of inertia: mass, center_of_mass [x, y, z] and inertia [xx, xy, xz, yy, yz, zz] about
                        the centre of mass, all in frame j
capsules                what of the link can be touched: [{"from": [x, y, z], "to": [x, y, z], "radius": …}, …] in
                        frame j (m); without "to" a sphere
link                    name of the link
tie                     {"joint2": -1, …}: the joint is not driven but follows others; its variable is the sum of so
                        many times theirs (what is constant belongs in theta or r). A parallelogram, a belt, a coupled
                        wrist
passive                 true: the joint is not driven; closed loops determine its position
start                   position of the joint (rad, m) in a posture near which the loops are closed; 0 by default
======================  ================================================================================================

Frame j is placed in its antecedent's frame by Rot(z, γ) Trans(z, b) Rot(x, α) Trans(x, d) Rot(z, θ) Trans(z, r); the
joint turns about or slides along its own z axis. Where γ and b are 0, as in most serial arms, this is Craig's notation
too: its α and a of index j - 1 are α and d of row j here. Where the machine has closed loops, the rows are those of the
tree that is left when each is cut open, and the top-level field `loops` says what coincides at the cuts
as below. The top-level field `base_capsules` is what of the base can
be touched; `title` and `source` are kept, not read.

The closed loops are a list of objects::

    [{"name": "rod", "kind": "planar",
      "between": [{"joint": "lever", "at": [0.4, 0, 0]}, {"joint": "elbow", "at": [-0.2, 0, 0]}]}]

======================  ================================================================================================
name                    of the loop, for messages; `loop<k>` by default
kind                    planar: a pin, the origins coincide in the xy plane of the first frame (2 equations); point: a
                        ball joint, the origins coincide (3); full: the frames coincide (6)
between                 the two frames: `joint` is the joint of the table that carries it, or "base"; `at` its origin in
                        that joint's frame (m); `rpy` its rotation, about x, then y, then z (rad), none by default
======================  ================================================================================================
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.collision_shapes import Capsule
from dynident.robot.cut_joint import EQUATIONS, FrameOnJoint, Loop, LoopKind
from dynident.robot.joint import JointKind
from dynident.robot.json_fields import (
    expect_mapping,
    expect_number,
    expect_numbers,
    expect_text,
    join_names,
    make_pointer,
    parse_json,
)
from dynident.robot.limits_and_drives import Drive, Limits
from dynident.robot.linkage import LoopCuts, link_joints, lock_followers
from dynident.robot.pinocchio_conversion import (
    ROUNDING_TOLERANCE,
    DescribedJoints,
    from_dynamic_parameters,
    from_pinocchio,
    mend_placement,
    to_dynamic_parameters,
)
from dynident.robot.robot_model import INERTIAL_NAMES, Description, Robot, Tie
from dynident.robot.stated_settings import build_settings, check_gravity
from dynident.schema.fields import point_within

_BASE_NAME = "base"


def read_loops(value: object, tree: Robot, at: str, title: str) -> tuple[Loop, ...]:
    """Return the loops of a document, between joints of the tree.

    Parameters
    ----------
    value : object
        JSON value of the field `loops`.
    tree : Robot
        The tree that is left when all loops are cut open.
    at : str
        JSON pointer to the field.
    title : str
        Title of errors.

    Returns
    -------
    tuple of Loop
        In the order of the document.

    Raises
    ------
    DynidentError
        With the pointer to the field that cannot be used.
    """
    if not isinstance(value, (list, tuple)):
        raise DynidentError("Expected a list of closed loops.", pointer=at, title=title)
    return tuple(
        _read_loop(item, index, tree, make_pointer(index, within=at), title) for index, item in enumerate(value)
    )


def _read_loop(item: object, index: int, tree: Robot, at: str, title: str) -> Loop:
    fields = expect_mapping(item, ("name", "kind", "between"), at, title)
    name = expect_text(fields.get("name", f"loop{index + 1}"), f"{at}/name", title)
    kinds: dict[str, LoopKind] = {"planar": "planar", "point": "point", "full": "full"}
    kind = fields.get("kind")
    if not isinstance(kind, str) or kind not in kinds:
        raise DynidentError(f"Expected {join_names(EQUATIONS)}.", pointer=f"{at}/kind", title=title)
    between = fields.get("between")
    if not isinstance(between, (list, tuple)) or len(between) != 2:
        raise DynidentError("Expected the two frames that coincide.", pointer=f"{at}/between", title=title)
    first, second = (
        _read_end(fields_of_end, tree, f"{at}/between/{k}", title) for k, fields_of_end in enumerate(between)
    )
    if first.joint == second.joint:
        detail = f"Both frames of loop '{name}' are on the same body, so they cannot close anything."
        raise DynidentError(detail, pointer=f"{at}/between", title=title)
    return Loop(name, kinds[kind], (first, second), at)


def _read_end(item: object, tree: Robot, at: str, title: str) -> FrameOnJoint:
    fields = expect_mapping(item, ("joint", "at", "rpy"), at, title)
    name = fields.get("joint")
    if name != _BASE_NAME and name not in tree.joint_names:
        detail = f"There is no moving joint {name!r}; expected {_BASE_NAME} or one of {join_names(tree.joint_names)}."
        raise DynidentError(detail, pointer=f"{at}/joint", title=title)
    frame = np.eye(4)
    frame[:3, 3] = expect_numbers(fields.get("at", [0.0, 0.0, 0.0]), 3, f"{at}/at", title)
    if "rpy" in fields:
        frame[:3, :3] = pin.rpy.rpyToMatrix(np.array(expect_numbers(fields["rpy"], 3, f"{at}/rpy", title)))
    return FrameOnJoint(-1 if name == _BASE_NAME else tree.joint_names.index(str(name)), frame)


TITLE = "Unusable modified Denavit-Hartenberg table"
_RESERVED = ("base", "universe")
_CONSTANTS = ("gamma", "b", "alpha", "d", "theta", "r")
_LIMITS = ("position", "velocity", "acceleration", "jerk", "effort", "power")
_MASS_PROPERTIES = ("mass", "center_of_mass", "inertia")
_ROW = (
    "name",
    "antecedent",
    "sigma",
    *_CONSTANTS,
    "limits",
    "inertia",
    "mass_properties",
    "capsules",
    "link",
    "tie",
    "passive",
    "start",
)
_TABLE = ("joints", "gravity", "base_capsules", "loops", "title", "source")


@dataclass(frozen=True, eq=False)
class Row:
    """One joint of a table.

    Parameters
    ----------
    name : str
        Name of the joint.
    antecedent : int
        Index of the row of its antecedent, from 0; -1 for the base.
    kind : {"revolute", "prismatic"}
        Whether it turns or slides.
    placement : (4, 4)
        Its frame at q = 0 in the antecedent's frame, m.
    limits : Limits
        Its limits, as far as they are stated.
    inertia : (10,)
        Inertial parameters of its link, in the order of [12.1]; zeros where none are stated.
    link : str
        Name of the link; empty where it has none.
    capsules : tuple of Capsule
        What of the link can be touched, in its frame.
    tie : Tie, optional
        The joints that it follows.
    passive : bool
        Whether closed loops determine its position.
    start : float, optional
        Its position (rad, m) in a posture near which the loops are closed.
    """

    name: str
    antecedent: int
    kind: JointKind
    placement: FloatArray
    limits: Limits
    inertia: FloatArray
    link: str
    capsules: tuple[Capsule, ...] = ()
    tie: Tie | None = None
    passive: bool = False
    start: float | None = None


def robot_from_modified_dh(
    name: str,
    table: str | Mapping[str, object] | Sequence[Mapping[str, object]],
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    pointer: str = "",
) -> Robot:
    """Return the robot that a table describes; the module's docstring lists the fields of a table.

    Parameters
    ----------
    name : str
        Name of the robot.
    table : str, mapping or sequence of mappings
        The table as JSON text or value.
    limits : mapping of str to Limits, optional
        By joint; they win over the description's, field by field.
    drives : mapping of str to Drive, optional
        Drive chains [12.17], by joint.
    locked_joints : mapping of str to float, optional
        Positions (rad, m) of joints that no longer move; their links become part of the link before.
    gravity : sequence of float, optional
        Acceleration of gravity in the base frame (m/s²); the table's, or else (0, 0, -9.81), by default.
    pointer : str
        JSON pointer to the table in the caller's request.

    Returns
    -------
    Robot
        Joints in the order of the rows.

    Raises
    ------
    DynidentError
        With the pointer to the field that cannot be used, `pointer` first.
    """
    settings = build_settings(limits, drives, locked_joints, gravity)
    # The description is kept as text: a stored robot is read from that again.
    content = table if isinstance(table, str) else json.dumps(table)
    value = parse_json(content, pointer, TITLE)
    _, rows = read_capsules_and_rows(value, pointer)
    if gravity is None and isinstance(value, Mapping) and "gravity" in value:
        table_gravity = expect_numbers(value["gravity"], 3, f"{pointer}/gravity", TITLE)
        settings = build_settings(limits, drives, locked_joints, check_gravity(table_gravity).tolist())
    # The tree must not have joints that cannot move because all that they follow are locked. The robot remembers only
    # the joints that the user locked.
    ties = {row.name: row.tie for row in rows if row.tie is not None}
    locked_by_user = settings.locked_joints
    settings = replace(settings, locked_joints=lock_followers(ties, locked_by_user))
    tree = from_pinocchio(
        _build_model(name, rows),
        name,
        Description("modified_dh", content),
        settings,
        DescribedJoints({row.name: row.limits for row in rows}, {row.name: row.link for row in rows}),
        pointer=pointer,
    )
    tree = replace(tree, locked_joints=dict(locked_by_user))
    starts = {row.name: row.start for row in rows if row.start is not None}
    passive = tuple(row.name for row in rows if row.passive and row.name in tree.joint_names)
    loops = value.get("loops", []) if isinstance(value, Mapping) else []
    cuts = LoopCuts(read_loops(loops, tree, f"{pointer}/loops", TITLE), passive, starts)
    return link_joints(tree, ties, title=TITLE, locked=settings.locked_joints, cuts=cuts)


def read_rows(value: object, at: str = "") -> tuple[Row, ...]:
    """Check the JSON value of a table and return its rows.

    Parameters
    ----------
    value : object
        A list of rows, or an object with them.
    at : str
        JSON pointer to the table in the caller's request.

    Returns
    -------
    tuple of Row
        Every antecedent comes before its successors.

    Raises
    ------
    DynidentError
        With the pointer to the field that cannot be used.
    """
    if isinstance(value, Mapping):
        value, at = (
            expect_mapping(value, _TABLE, at, TITLE).get("joints"),
            f"{at}/joints",
        )
    if not isinstance(value, (list, tuple)) or not value:
        raise DynidentError("Expected a list of joints, one row each.", pointer=at, title=TITLE)
    rows: list[Row] = []
    for index, item in enumerate(value):
        rows.append(_read_row(item, rows, make_pointer(index, within=at)))
    return tuple(rows)


def read_capsules_and_rows(value: object, at: str = "") -> tuple[tuple[Capsule, ...], tuple[Row, ...]]:
    """Check the JSON value of a table and return what of the base can be touched, and the rows.

    Parameters
    ----------
    value : object
        A list of rows, or an object with them.
    at : str
        JSON pointer to the table in the caller's request.

    Returns
    -------
    tuple of Capsule, tuple of Row
        Capsules of the base; rows have their own.

    Raises
    ------
    DynidentError
        With the pointer to the field that cannot be used.
    """
    rows = read_rows(value, at)
    base = value.get("base_capsules", []) if isinstance(value, Mapping) else []
    return _read_capsules(base, f"{at}/base_capsules"), rows


def build_placement(gamma: float, b: float, alpha: float, d: float, theta: float, r: float) -> FloatArray:
    """Return the transform (4, 4) Rot(z, γ) Trans(z, b) Rot(x, α) Trans(x, d) Rot(z, θ) Trans(z, r)."""
    return mend_placement(_screw_z(gamma, b) @ _screw_x(alpha, d) @ _screw_z(theta, r), ROUNDING_TOLERANCE)


def _screw_z(angle: float, distance: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, distance], [0, 0, 0, 1]])


def _screw_x(angle: float, distance: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, distance], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def _read_row(item: object, above: Sequence[Row], at: str) -> Row:
    fields = expect_mapping(item, _ROW, at, TITLE)
    name = expect_text(fields.get("name", f"joint{len(above) + 1}"), f"{at}/name", TITLE)
    if name in _RESERVED or name in (row.name for row in above):
        detail = f"No joint can be called '{name}'." if name in _RESERVED else f"The joint name '{name}' is used twice."
        raise DynidentError(detail, pointer=f"{at}/name", title=TITLE)
    sigma = fields.get("sigma", 0)
    if isinstance(sigma, bool) or sigma not in (0, 1):
        raise DynidentError("Expected 0 (revolute) or 1 (prismatic).", pointer=f"{at}/sigma", title=TITLE)
    constants = [expect_number(fields.get(key, 0.0), f"{at}/{key}", TITLE) for key in _CONSTANTS]
    link = fields.get("link", "")
    return Row(
        name=name,
        antecedent=_read_antecedent(fields.get("antecedent"), above, f"{at}/antecedent"),
        kind="prismatic" if sigma == 1 else "revolute",
        placement=build_placement(*constants),
        limits=_read_limits(fields.get("limits", {}), f"{at}/limits"),
        inertia=_read_inertia(fields, at),
        link=expect_text(link, f"{at}/link", TITLE) if link else "",
        capsules=_read_capsules(fields.get("capsules", []), f"{at}/capsules"),
        tie=_read_tie(fields["tie"], f"{at}/tie") if fields.get("tie") is not None else None,
        passive=_read_passive(fields, f"{at}/passive"),
        start=expect_number(fields["start"], f"{at}/start", TITLE) if "start" in fields else None,
    )


def _read_passive(fields: Mapping[str, object], at: str) -> bool:
    value = fields.get("passive", False)
    if not isinstance(value, bool):
        raise DynidentError("Expected true or false.", pointer=at, title=TITLE)
    if value and fields.get("tie") is not None:
        detail = "A joint with a tie follows other joints; give either passive or tie, not both."
        raise DynidentError(detail, pointer=at, title=TITLE)
    return value


def _read_tie(value: object, at: str) -> Tie:
    if not isinstance(value, Mapping) or not value:
        detail = 'Expected the joints that this one follows, each with its ratio, such as {"joint2": -1}.'
        raise DynidentError(detail, pointer=at, title=TITLE)
    ratios = {name: expect_number(ratio, make_pointer(name, within=at), TITLE) for name, ratio in value.items()}
    return Tie(ratios, where=at)


def _read_antecedent(value: object, above: Sequence[Row], at: str) -> int:
    names = [row.name for row in above]
    if value is None:
        return len(above) - 1
    if value == "base":
        return -1
    if isinstance(value, str) and value in names:
        return names.index(value)
    # Numbers count rows from 1, because 0 is the base.
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= len(above):
        return value - 1
    detail = f'The antecedent {reprlib.repr(value)} is not above this row; expected 0 or "base" for the base'
    detail += f", or a name or number of {join_names(names)}." if names else "."
    raise DynidentError(detail, pointer=at, title=TITLE)


def _read_limits(value: object, at: str) -> Limits:
    fields = expect_mapping(value, _LIMITS, at, TITLE)
    bounds = {key: field for key, field in fields.items() if field is not None}
    position = bounds.pop("position", None)
    numbers = {key: expect_number(field, f"{at}/{key}", TITLE) for key, field in bounds.items()}
    low_high = None if position is None else expect_numbers(position, 2, f"{at}/position", TITLE)
    with point_within(at):
        return Limits(position=None if low_high is None else (low_high[0], low_high[1]), **numbers)


def _read_inertia(fields: Mapping[str, object], at: str) -> FloatArray:
    if "inertia" in fields and "mass_properties" in fields:
        detail = "Give either inertia or mass_properties, not both."
        raise DynidentError(detail, pointer=f"{at}/mass_properties", title=TITLE)
    if "mass_properties" in fields:
        return _read_mass_properties(fields["mass_properties"], f"{at}/mass_properties")
    at = f"{at}/inertia"
    entries = expect_mapping(fields.get("inertia", {}), INERTIAL_NAMES, at, TITLE)
    values = np.array([expect_number(entries.get(key, 0.0), f"{at}/{key}", TITLE) for key in INERTIAL_NAMES])
    # Moments without a mass belong to no body, and Pinocchio would divide by the mass.
    if values[9] < 0 or (values[9] == 0 and np.any(values)):
        raise DynidentError("A link with inertia needs a positive mass M.", pointer=f"{at}/M", title=TITLE)
    return values


def _read_capsules(value: object, at: str) -> tuple[Capsule, ...]:
    if not isinstance(value, (list, tuple)):
        raise DynidentError("Expected a list of capsules.", pointer=at, title=TITLE)
    capsules = []
    for index, item in enumerate(value):
        place = make_pointer(index, within=at)
        fields = expect_mapping(item, ("from", "to", "radius"), place, TITLE)
        start = np.array(expect_numbers(fields.get("from"), 3, f"{place}/from", TITLE))
        end = np.array(expect_numbers(fields["to"], 3, f"{place}/to", TITLE)) if "to" in fields else start
        radius = expect_number(fields.get("radius"), f"{place}/radius", TITLE)
        if radius <= 0:
            detail = f"The radius is {radius}; expected a positive number."
            raise DynidentError(detail, pointer=f"{place}/radius", title=TITLE)
        capsules.append(Capsule(start, end, radius))
    return tuple(capsules)


def _read_mass_properties(value: object, at: str) -> FloatArray:
    properties = expect_mapping(value, _MASS_PROPERTIES, at, TITLE)
    for key in _MASS_PROPERTIES:
        if key not in properties:
            raise DynidentError(f"'{key}' is missing.", pointer=f"{at}/{key}", title=TITLE)
    mass = expect_number(properties["mass"], f"{at}/mass", TITLE)
    if mass <= 0:
        raise DynidentError(f"The mass is {mass}; expected a positive number.", pointer=f"{at}/mass", title=TITLE)
    center = np.array(expect_numbers(properties["center_of_mass"], 3, f"{at}/center_of_mass", TITLE))
    xx, xy, xz, yy, yz, zz = expect_numbers(properties["inertia"], 6, f"{at}/inertia", TITLE)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    try:
        # Pinocchio raises an error where an inertia about the centre of mass has a negative eigenvalue.
        return from_dynamic_parameters(pin.Inertia(mass, center, tensor).toDynamicParameters())
    except RuntimeError:
        detail = "This inertia is not physically possible: its eigenvalues must not be negative."
        raise DynidentError(detail, pointer=f"{at}/inertia", title=TITLE) from None


def _build_model(name: str, rows: Sequence[Row]) -> pin.Model:
    model = pin.Model()
    model.name = name
    for row in rows:
        # Pinocchio counts joints from 1: joint 0 is the base.
        joint = pin.JointModelPZ() if row.kind == "prismatic" else pin.JointModelRZ()
        index = model.addJoint(row.antecedent + 1, joint, pin.SE3(row.placement), row.name)
        model.addJointFrame(index)  # locking joints rests on it
        if np.any(row.inertia):
            inertia = pin.Inertia.FromDynamicParameters(to_dynamic_parameters(row.inertia))
            model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    return model
