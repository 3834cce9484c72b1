"""Convert between Pinocchio models and `Robot`; snap rounded constants; the most joints (100).

A URDF writes a right angle as 1.57079632679, whose cosine is 5e-12 where 0 was meant. Such entries cost instructions in
every symbolic expression and add parameters that no measurement could see. Entries within `ROUNDING_TOLERANCE` of 0,
±1/2 and ±1 are therefore set to them. The default moves nothing by more than 1e-10, so results stay those of Pinocchio
to ten digits. Angles written with fewer digits (1.5708) are left as they stand unless the caller raises the tolerance
(1e-5 mends 1.5708).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.description_formats import BASE_JOINTS, BaseKind
from dynident.robot.joint import Joint, JointKind
from dynident.robot.json_fields import check_name
from dynident.robot.limits_and_drives import Drive, Limits
from dynident.robot.robot_model import Description, Robot
from dynident.robot.stated_settings import Settings, check_names, merge_limits

ROUNDING_TOLERANCE = 1e-10
_EXACT = np.array([0.0, 0.5, -0.5, 1.0, -1.0])


def mend_placement(placement: FloatArray, tolerance: float = ROUNDING_TOLERANCE) -> FloatArray:
    """Return the homogeneous transform (4, 4) with rounded constants mended and a rotation that is still orthonormal.

    Distances are only compared with zero: any other length is as good as 1/2 or 1.

    Parameters
    ----------
    placement : (4, 4)
        A homogeneous transform, m.
    tolerance : float
        Entries this near to 0, ±1/2 and ±1 become these.

    Returns
    -------
    (4, 4) array
        The mended transform.
    """
    mended = np.eye(4)
    mended[:3, :3] = _orthonormalize(_snap(placement[:3, :3], tolerance))
    mended[:3, 3] = np.where(np.abs(placement[:3, 3]) <= tolerance, 0.0, placement[:3, 3])
    return mended


def mend_axis(axis: FloatArray, tolerance: float = ROUNDING_TOLERANCE) -> FloatArray:
    """Return a direction with rounded constants mended, of unit length.

    Parameters
    ----------
    axis : (3,)
        A direction of any length but zero.
    tolerance : float
        Entries of the unit vector this near to 0, ±1/2 and ±1 become these.

    Returns
    -------
    (3,) array
        A unit vector.
    """
    unit = _snap(axis / np.linalg.norm(axis), tolerance)
    mended: FloatArray = unit / np.linalg.norm(unit)
    return mended


def _snap(values: FloatArray, tolerance: float) -> FloatArray:
    snapped = values.copy()
    for exact in _EXACT:
        snapped[np.abs(values - exact) <= tolerance] = exact
    return snapped


def _orthonormalize(rotation: FloatArray) -> FloatArray:
    """Return the nearest rotation by two Newton steps: each squares the error, and exact zeros and ones stay."""
    for _ in range(2):
        rotation = rotation - 0.5 * rotation @ (rotation.T @ rotation - np.eye(3))
    # The steps themselves round: an entry that was exactly 1 may have become 1 - eps.
    return _snap(rotation, 4 * np.finfo(float).eps)


MOST_JOINTS = 100
"""Most moving joints of a robot: a model of more takes gigabytes, and no machine that is identified as one has more."""

LARGEST = 1e12
"""Largest number in m, kg or kg m²: no machine is that large, and beyond it rounding errors are."""

_FROM_DYNAMIC = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]
"""INERTIAL_NAMES as places in Pinocchio's m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
_TO_DYNAMIC = np.argsort(_FROM_DYNAMIC)


def to_dynamic_parameters(inertial: FloatArray) -> FloatArray:
    """Reorder inertial parameters (…, 10) from `INERTIAL_NAMES` to Pinocchio's dynamic parameters."""
    return inertial[..., _TO_DYNAMIC]


def from_dynamic_parameters(dynamic: FloatArray) -> FloatArray:
    """Reorder Pinocchio's dynamic parameters (…, 10) to `INERTIAL_NAMES`."""
    return dynamic[..., _FROM_DYNAMIC]


def to_pinocchio(robot: Robot) -> pin.Model:
    """Return the Pinocchio model of a robot.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    pinocchio.Model
        Same joints, order and frames, one coordinate a joint. Where joints follow others, it is the whole tree, without
        the constraints that hold it together.
    """
    robot = robot.tree
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = robot.gravity
    kinds = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
    for index, joint in enumerate(robot.joints):
        placement = pin.SE3(joint.placement)
        added = model.addJoint(joint.parent + 1, kinds[joint.kind](joint.axis), placement, joint.name)
        model.addJointFrame(added)
        if robot.inertias is not None:
            model.appendBodyToJoint(added, _build_body(robot.inertias[index]), pin.SE3.Identity())
    return model


def _build_body(inertial: FloatArray) -> pin.Inertia:
    """Return the body of inertial parameters (10,) in the order of `INERTIAL_NAMES`."""
    xx, xy, xz, yy, yz, zz = inertial[:6]
    if inertial[9] == 0.0:
        # Pinocchio divides by the mass. Links without one, as some descriptions have, have no centre of mass either.
        return pin.Inertia(0.0, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    return pin.Inertia.FromDynamicParameters(to_dynamic_parameters(inertial))


def compute_described_torque(
    robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray, rotors: FloatArray | None = None
) -> FloatArray:
    """Return the torque that the links of the description need, by the recursion of Newton and Euler.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq : ndarray (m, n)
        Motion of the driven joints: rad or m, and their derivatives.
    rotors : ndarray (N,), optional
        Rotor inertias of all joints of the tree, kg m² or kg.

    Returns
    -------
    ndarray (m, n)
        N m or N. Where joints follow others, that of the driven ones: Gᵀ times the tree's.
    """
    model = to_pinocchio(robot)
    data = model.createData()
    motion = (q, dq, ddq) if robot.linkage is None else robot.linkage.compute_motion(q, dq, ddq)
    torque = np.array([pin.rnea(model, data, *state) for state in zip(*motion, strict=True)])
    if rotors is not None:
        torque = torque + rotors * motion[2]
    if robot.linkage is None:
        return torque
    return np.asarray(np.einsum("mji,mj->mi", robot.linkage.compute_jacobian(q), torque))


_BASE_MODELS = {
    "base_x": pin.JointModelPX,
    "base_y": pin.JointModelPY,
    "base_z": pin.JointModelPZ,
    "base_yaw": pin.JointModelRZ,
    "base_pitch": pin.JointModelRY,
    "base_roll": pin.JointModelRX,
}


def add_base_joints(model: pin.Model, kind: BaseKind) -> int:
    """Add the coordinates of a base to a model without joints.

    Parameters
    ----------
    model : pinocchio.Model
        The model.
    kind : {"fixed", "floating", "planar"}
        Kind of the base.

    Returns
    -------
    int
        Index of the joint that carries the root link; 0, the world, for a fixed base.
    """
    joint = 0
    for name in BASE_JOINTS[kind]:
        joint = model.addJoint(joint, _BASE_MODELS[name](), pin.SE3.Identity(), name)
        model.addJointFrame(joint)
    return joint


def release_base(model: pin.Model, kind: BaseKind, pointer: str = "") -> pin.Model:
    """Return a model whose root link moves.

    Parameters
    ----------
    model : pinocchio.Model
        A model on a fixed base, with the inertia of its root link.
    kind : {"fixed", "floating", "planar"}
        Kind of the base; a fixed one leaves the model as it is.
    pointer : str
        JSON pointer to the description in the caller's request.

    Returns
    -------
    pinocchio.Model
        With the coordinates of the base in front of the joints; the last one carries the root link.

    Raises
    ------
    DynidentError
        If a joint of the model has the name of such a coordinate.
    """
    if kind == "fixed":
        return model
    shared = sorted(set(model.names) & set(BASE_JOINTS[kind]))
    if shared:
        raise DynidentError(
            f"The description has a joint '{shared[0]}', which is the name of a coordinate of a {kind} base: rename "
            "the joint, or read the robot without a moving base if its joints are the base's.",
            pointer=pointer,
            title="Unusable robot description",
        )
    released = pin.Model()
    released.name = model.name
    carrier = add_base_joints(released, kind)
    frame = released.addFrame(pin.Frame("carrier", carrier, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    # The inertia of the root link, which is the world's on a fixed base, goes to the carrier.
    return pin.appendModel(released, model, frame, pin.SE3.Identity())


@dataclass(frozen=True)
class DescribedJoints:
    """Data of a description's joints that a Pinocchio model does not hold.

    Parameters
    ----------
    limits : mapping of str to Limits
        By joint.
    links : mapping of str to str
        Names of links by joint.
    fixed : tuple of str
        Names of the fixed joints, which the model has merged.
    base : {"fixed", "floating", "planar"}
        Kind of the base; the model has its coordinates.
    """

    limits: Mapping[str, Limits]
    links: Mapping[str, str]
    fixed: tuple[str, ...] = ()
    base: BaseKind = "fixed"


def from_pinocchio(
    model: pin.Model,
    name: str,
    description: Description,
    settings: Settings,
    described: DescribedJoints,
    *,
    tolerance: float = ROUNDING_TOLERANCE,
    pointer: str = "",
) -> Robot:
    """Return the robot of a Pinocchio model whose joints each have one degree of freedom.

    Parameters
    ----------
    model : pinocchio.Model
        The joints, their placements and the inertias of their links.
    name : str
        Name of the robot.
    description : Description
        The text that the model was read from.
    settings : Settings
        What the user states beside the description.
    described : DescribedJoints
        What the description says of joints beside the model.
    tolerance : float
        Rounded constants within it are mended, see `dynident.robot.pinocchio_conversion`.
    pointer : str
        JSON pointer to the description in the caller's request.

    Returns
    -------
    Robot
        Joints in Pinocchio's order, without those that the settings lock.

    Raises
    ------
    DynidentError
        For too many joints, unusable names, settings of joints that do not exist, or numbers that are too large.
    """
    moving = tuple(model.names)[1:]
    if len(moving) > MOST_JOINTS:
        detail = f"The description has {len(moving)} moving joints; at most {MOST_JOINTS} are supported."
        raise DynidentError(detail, pointer=pointer, title="Unusable robot description")
    for joint_name in (*moving, *described.links.values()):
        check_name(joint_name, pointer, "Unusable robot description")
    # Before joints are locked: the settings name those too.
    own = moving[len(BASE_JOINTS[described.base]) :]
    check_names(settings, own, described.fixed)
    model = lock_joints(model, settings.locked_joints)
    joints = tuple(
        replace(
            joint,
            limits=merge_limits(described.limits.get(joint.name, Limits()), settings.limits.get(joint.name)),
            link=described.links.get(joint.name, ""),
        )
        for joint in _read_joints(model, tolerance)
    )
    inertias = from_dynamic_parameters(np.array([body.toDynamicParameters() for body in tuple(model.inertias)[1:]]))
    for joint, inertial in zip(joints, inertias, strict=True):
        if not (np.all(np.abs(joint.placement) <= LARGEST) and np.all(np.abs(inertial) <= LARGEST)):
            raise DynidentError(
                f"Joint '{joint.name}': lengths or inertias are too large; expected values in m, kg and kg m².",
                pointer=pointer,
                title="Unusable robot description",
            )
    return Robot(
        name=name,
        joints=joints,
        gravity=settings.gravity,
        drives=tuple(settings.drives.get(joint.name, Drive()) for joint in joints),
        description=description,
        inertias=inertias if np.any(inertias) else None,
        locked_joints=dict(settings.locked_joints),
        base=described.base,
    )


def lock_joints(model: pin.Model, values: Mapping[str, float]) -> pin.Model:
    """Return a model with joints locked at positions; its frames stay.

    Parameters
    ----------
    model : pinocchio.Model
        The model.
    values : mapping of str to float
        Positions (rad, m) by joint.

    Returns
    -------
    pinocchio.Model
        The model itself where no joint is locked.
    """
    if not values:
        return model
    configuration = pin.neutral(model)
    indices = [model.getJointId(name) for name in values]
    for index, value in zip(indices, values.values(), strict=True):
        joint = model.joints[index]
        # An unbounded revolute joint counts its angle as (cos, sin).
        configuration[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
    return pin.buildReducedModel(model, indices, configuration)


def _read_joints(model: pin.Model, tolerance: float) -> list[Joint]:
    neutral = pin.neutral(model)
    joints = []
    for index in range(1, model.njoints):
        # The motion subspace: linear part first, in the joint's own frame. Taken from the joint alone, because the data
        # of a whole model grow with the cube of its joints.
        joint = model.joints[index]
        joint_data = joint.createData()
        joint.calc(joint_data, neutral)
        subspace = np.asarray(joint_data.S, dtype=float).reshape(6)
        kind: JointKind = "revolute" if np.any(subspace[3:]) else "prismatic"
        joints.append(
            Joint(
                name=model.names[index],
                kind=kind,
                parent=model.parents[index] - 1,
                placement=mend_placement(model.jointPlacements[index].homogeneous, tolerance),
                axis=mend_axis(subspace[3:] if kind == "revolute" else subspace[:3], tolerance),
            )
        )
    return joints
