"""Read a robot from MJCF, compiled by MuJoCo; ties and loops from `equality`.

From ties and cut loops follows which joints are driven.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.optional_dependencies import format_install_hint
from dynident.robot.cut_joint import FrameOnJoint, Loop, LoopKind
from dynident.robot.description_formats import BASE_JOINTS, UPRIGHT, BaseKind
from dynident.robot.json_fields import join_names
from dynident.robot.limits_and_drives import Drive, Limits
from dynident.robot.linkage import LoopCuts, link_joints, lock_followers
from dynident.robot.loop_equations import CLOSED
from dynident.robot.mjcf_xml import TITLE, make_mjcf_error, parse_mjcf
from dynident.robot.pinocchio_conversion import LARGEST, DescribedJoints, add_base_joints, from_pinocchio, lock_joints
from dynident.robot.robot_model import Description, Robot, Tie
from dynident.robot.stated_settings import build_settings
from dynident.robot.xml_text import Element, write_with_line_numbers

if TYPE_CHECKING:
    import mujoco


# MuJoCo's numbers: of kinds of equalities, and of a site and a transmission by a tendon.
_CONNECT, _WELD, _JOINT, _TENDON = 0, 1, 2, 3
_FREE = 0
_SITE, _THROUGH_TENDON = 6, 3


@dataclass(frozen=True)
class Coincidence:
    """A `connect` or `weld`: two frames, each a named one of the model and a placement in it."""

    name: str
    kind: LoopKind
    ends: tuple[tuple[str, pin.SE3], tuple[str, pin.SE3]]
    line: int


@dataclass(frozen=True)
class Equalities:
    """Constraints between the joints of a model.

    Parameters
    ----------
    ties : mapping of joint name to Tie
        Joints that follow others.
    fixed : mapping of joint name to position
        Joints that stand still (rad, m).
    loops : tuple of Coincidence
        Pairs of frames that coincide.
    driven : frozenset of str
        Joints that an actuator acts on and that follow no others.
    starts : mapping of joint name to position
        The first key frame, or the posture in which the file is written.
    """

    ties: Mapping[str, Tie]
    fixed: Mapping[str, float]
    loops: tuple[Coincidence, ...]
    driven: frozenset[str]
    starts: Mapping[str, float]


@dataclass(frozen=True)
class _LinearEquation:
    """Σ ratio q = value, of joints by name."""

    ratios: Mapping[str, float]
    value: float
    line: int


def read_equalities(compiled: mujoco.MjModel, lines: Mapping[str, int], pointer: str) -> Equalities:
    """Read the active equalities of a compiled model.

    Parameters
    ----------
    compiled : mujoco.MjModel
        The compiled model.
    lines : mapping of str to int
        Lines of the text by the equality's name.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    Equalities
        Joints that follow others or stand still, loops, driven joints and the posture at the start.

    Raises
    ------
    DynidentError
        An equality is not linear, or all of the joints that it ties are driven (line).
    """
    linear: list[_LinearEquation] = []
    loops: list[Coincidence] = []
    for k in range(compiled.neq):
        name, kind = compiled.equality(k).name, int(compiled.eq_type[k])
        if not compiled.eq_active0[k]:
            continue
        if kind in (_CONNECT, _WELD):
            loops.append(_read_coincidence(compiled, k, name, lines[name]))
        else:
            linear.append(_read_linear_equation(compiled, k, lines[name], pointer))
    directly, by_tendon = _find_actuated_joints(compiled)
    ties, fixed = _choose_followers(linear, directly, by_tendon, pointer)
    posture = compiled.key_qpos[0] if compiled.nkey else compiled.qpos0
    starts = {compiled.joint(j).name: float(posture[compiled.jnt_qposadr[j]]) for j in range(compiled.njnt)}
    return Equalities(ties, fixed, tuple(loops), frozenset(directly | by_tendon) - set(ties), starts)


def _read_coincidence(compiled: mujoco.MjModel, k: int, name: str, line: int) -> Coincidence:
    ids, data = (compiled.eq_obj1id[k], compiled.eq_obj2id[k]), compiled.eq_data[k]
    kind: LoopKind = "point" if compiled.eq_type[k] == _CONNECT else "full"
    if compiled.eq_objtype[k] == _SITE:
        ends = [(f"site {object_id}", pin.SE3.Identity()) for object_id in ids]
    elif kind == "point":
        ends = [(f"body {object_id}", _translate(data[3 * side : 3 * side + 3])) for side, object_id in enumerate(ids)]
    else:
        # data[3:10] is the pose of the second body in the first one's frame, data[:3] the anchor in the second body.
        turn = pin.Quaternion(*map(float, data[6:10])).normalized().matrix()
        ends = [(f"body {ids[0]}", pin.SE3(turn, data[3:6].copy())), (f"body {ids[1]}", _translate(data[:3]))]
    return Coincidence(name, kind, (ends[0], ends[1]), line)


def _translate(place: FloatArray) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(place))


def _read_linear_equation(compiled: mujoco.MjModel, k: int, line: int, pointer: str) -> _LinearEquation:
    """Return the equation q₁ - r₁ = a₀ + a₁ (q₂ - r₂) of joints or tendons, with r the positions in the file."""
    tied, data = int(compiled.eq_type[k]) == _TENDON, compiled.eq_data[k]
    if np.any(data[2:5]):
        raise make_mjcf_error(
            f"polycoef of the equality '{compiled.equality(k).name}' is "
            f"{join_names(f'{coefficient:g}' for coefficient in data[:5])}; only the first two, a constant "
            f"and a ratio, "
            "can be other than 0.",
            line,
            pointer,
        )
    ids = [int(object_id) for object_id in (compiled.eq_obj1id[k], compiled.eq_obj2id[k])]
    sides = [_read_lengths(compiled, object_id, tied) if object_id >= 0 else ({}, 0.0) for object_id in ids]
    (first, drawn_first), (second, drawn_second) = sides
    # All joints on one side; a joint may be in both tendons.
    ratios = dict(first)
    for joint, ratio in second.items():
        ratios[joint] = ratios.get(joint, 0.0) - float(data[1]) * ratio
    ratios = {joint: ratio for joint, ratio in ratios.items() if ratio}
    return _LinearEquation(ratios, float(data[0]) + drawn_first - float(data[1]) * drawn_second, line)


def _read_lengths(compiled: mujoco.MjModel, index: int, tendon: bool) -> tuple[dict[str, float], float]:
    """Return the ratios of a joint (1) or of the joints of a fixed tendon, and the length at the file's positions."""
    if not tendon:
        return {compiled.joint(index).name: 1.0}, float(compiled.qpos0[compiled.jnt_qposadr[index]])
    first = compiled.tendon_adr[index]
    ratios: dict[str, float] = {}
    length = 0.0
    for wrap in range(first, first + compiled.tendon_num[index]):
        j, ratio = int(compiled.wrap_objid[wrap]), float(compiled.wrap_prm[wrap])
        ratios[compiled.joint(j).name] = ratio
        length += ratio * float(compiled.qpos0[compiled.jnt_qposadr[j]])
    return ratios, length


def _find_actuated_joints(compiled: mujoco.MjModel) -> tuple[set[str], set[str]]:
    """Return the joints that an actuator acts on directly, and those that it acts on through a tendon."""
    directly: set[str] = set()
    by_tendon: set[str] = set()
    for k in range(compiled.nu):
        acted = int(compiled.actuator_trnid[k, 0])
        if compiled.actuator_trntype[k] == _THROUGH_TENDON:
            by_tendon |= set(_read_lengths(compiled, acted, True)[0])
        else:
            directly.add(compiled.joint(acted).name)
    return directly, by_tendon - directly


def _choose_followers(
    linear: list[_LinearEquation], directly: set[str], by_tendon: set[str], pointer: str
) -> tuple[dict[str, Tie], dict[str, float]]:
    """Choose for each equation the joint that follows the others: the first that no actuator acts on."""
    ties: dict[str, Tie] = {}
    fixed: dict[str, float] = {}
    for equation in linear:
        if len(equation.ratios) == 1:
            [(joint, ratio)] = equation.ratios.items()
            fixed[joint] = equation.value / ratio
            continue
        # Prefer a joint without any actuator. A joint in a driven tendon may follow too: the tendon then acts through
        # its other joints.
        free = [joint for joint in equation.ratios if joint not in ties and joint not in directly]
        follower = next((joint for joint in free if joint not in by_tendon), free[0] if free else "")
        if not follower:
            raise make_mjcf_error(
                f"An equality ties {join_names(equation.ratios)}, but each of them has an actuator or already follows "
                "others; remove one actuator, so that its joint can follow.",
                equation.line,
                pointer,
            )
        ratio_of_follower = equation.ratios[follower]
        others = {joint: -ratio / ratio_of_follower for joint, ratio in equation.ratios.items() if joint != follower}
        ties[follower] = Tie(others, equation.value / ratio_of_follower, pointer, equation.line)
    return ties, fixed


# Pinocchio's name of the fixed base, and ours.
_RESERVED = ("universe", "base")
# An actuator whose largest force is below this (N m or N) counts as one without a limit.
_LENGTH_FREE = 1e-12
_NUMBERS = (
    *("body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia"),
    *("jnt_pos", "jnt_axis", "qpos0", "site_pos", "site_quat"),
)
"""Arrays of the compiled model that a robot is built from; all their numbers are checked."""


def robot_from_mjcf(
    name: str,
    text: str,
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    base: BaseKind | None = None,
    pointer: str = "",
) -> Robot:
    """Return the robot that an MJCF describes.

    Hinges and slides move. Equalities count: a `joint` or a fixed `tendon` ties joints, `connect` and `weld` close
    loops. Joints in loops are driven if an actuator acts on them, and passive otherwise. Equations that follow from
    others, as the third one of a `connect` in a plane, are left out. Loops start from the posture of the first key
    frame, or from that of the file. Damping, friction, armature, springs, contacts and visual elements are not read:
    the first ones are what is identified.

    Parameters
    ----------
    name, text : str
        Name of the robot; the MJCF, one file with all that it needs.
    limits : mapping of str to Limits, optional
        By joint; they win over the description's, field by field.
    drives : mapping of str to Drive, optional
        Drive chains [12.17], by joint.
    locked_joints : mapping of str to float, optional
        Positions (rad, m) of joints that no longer move; their links become part of the link before.
    gravity : sequence of float, optional
        Acceleration of gravity in the base frame (m/s²); that of `<option>` by default.
    base : {"fixed", "floating", "planar"}, optional
        How the root body moves; by default it floats if it has a free joint, and is fixed otherwise.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    Robot
        Joints in the order of the bodies.

    Raises
    ------
    DynidentError
        If MuJoCo is not installed or does not accept the text (line), the machine is not a tree of such joints on a
        fixed base, an equality is not linear, or loops do not close or do not determine the passive joints.
    """
    root, clamped = parse_mjcf(text, pointer, locked_joints or {}, base)
    compiled = _compile_model(root, pointer)
    user_settings = build_settings(limits, drives, locked_joints, compiled.opt.gravity if gravity is None else gravity)
    lines = {child.attributes["name"]: child.line for part in root.iter_children("equality") for child in part.children}
    kind: BaseKind = base or ("floating" if (compiled.jnt_type == _FREE).any() else "fixed")
    model, links = _build_tree(compiled, name, kind, pointer)
    held = read_equalities(compiled, lines, pointer)
    fixed = {
        **held.fixed,
        **{joint: position for joint, position in user_settings.locked_joints.items() if joint not in clamped},
    }
    settings = replace(user_settings, locked_joints=lock_followers(held.ties, fixed))
    tree = from_pinocchio(
        model,
        name,
        Description("mjcf", text),
        settings,
        DescribedJoints(dict(_iter_limits(compiled)), links, base=kind),
        pointer=pointer,
    )
    tree = replace(tree, locked_joints=dict(user_settings.locked_joints))
    cuts = _build_cuts(held, lock_joints(model, settings.locked_joints), tree, pointer)
    return link_joints(tree, held.ties, title=TITLE, locked=settings.locked_joints, cuts=cuts)


def has_gravity_compensation(text: str) -> bool:
    """Tell whether MuJoCo takes the weight of all moving bodies off their joints (`gravcomp`) of a model that it reads.

    Parameters
    ----------
    text : str
        The MJCF.
    """
    if "gravcomp" not in text:
        return False
    compiled = _compile_model(parse_mjcf(text, "", {})[0], "")
    moving = (compiled.body_weldid > 0) & (compiled.body_mass > 0.0)
    return bool((compiled.body_gravcomp[moving] == 1.0).all())


def _compile_model(root: Element, pointer: str) -> mujoco.MjModel:
    """Compile the reduced text with MuJoCo and check the numbers of the result."""
    try:
        import mujoco
    except ModuleNotFoundError as error:
        detail = f"Reading MJCF files needs MuJoCo, which is not installed; {format_install_hint('mujoco')}"
        raise DynidentError(detail, pointer=pointer, title=TITLE) from error
    try:
        compiled = mujoco.MjModel.from_xml_string(write_with_line_numbers(root))
    except ValueError as error:
        detail = " ".join(str(error).split())
        raise make_mjcf_error(f"MuJoCo rejects the model: {detail}", None, pointer) from error
    for name in _NUMBERS:
        values = getattr(compiled, name)
        # Negated, so that NaN is refused as well: no comparison with NaN is true.
        if not (np.abs(values) <= LARGEST).all():
            detail = f"MuJoCo changes a number to {values.ravel()[np.argmin(np.abs(values.ravel()) <= LARGEST)]:g}"
            raise make_mjcf_error(
                f"{detail} ({name}); lengths, masses and inertias are in m, kg and kg m².", None, pointer
            )
    return compiled


def _find_root_body(compiled: mujoco.MjModel, kind: BaseKind, pointer: str) -> int:
    """Return the body whose frame is that of a base that moves; -1 for a fixed base."""
    if kind == "fixed":
        return -1
    roots = [body for body in range(1, compiled.nbody) if compiled.body_parentid[body] == 0]
    floating = [body for body in roots if (compiled.jnt_type[compiled.jnt_bodyid == body] == _FREE).any()]
    # Beside a body that floats others may stand on the ground, as long as they do not move.
    moving = [body for body in roots if (compiled.body_rootid[compiled.jnt_bodyid] == body).any()]
    candidates = floating or moving or roots
    if len(candidates) > 1 or len(moving) > 1:
        names = join_names(compiled.body(body).name for body in dict.fromkeys((*candidates, *moving)))
        reason = (
            "a robot has only one base: leave out of the file what is not a part of it, such as objects that it handles"
        )
        raise make_mjcf_error(f"The bodies {names} are all children of the world; {reason}.", None, pointer)
    return candidates[0]


def _build_tree(compiled: mujoco.MjModel, name: str, kind: BaseKind, pointer: str) -> tuple[pin.Model, dict[str, str]]:
    """Return the joints of a compiled model as a Pinocchio model, and the name of the body that each joint moves.

    The model has a frame for every body and site, called "body 3" or "site 0".
    """
    model = pin.Model()
    model.name = name
    links: dict[str, str] = {}
    # For every body, the joint that carries it and its placement in that joint's frame. MuJoCo orders parents first.
    carried: list[tuple[int, pin.SE3]] = [(0, pin.SE3.Identity())]
    carrier, root = add_base_joints(model, kind), _find_root_body(compiled, kind, pointer)
    if carrier:
        links[model.names[carrier]] = compiled.body(root).name
    # By MuJoCo's numbers of kinds of joints: slide and hinge.
    kinds = {2: pin.JointModelPrismaticUnaligned, 3: pin.JointModelRevoluteUnaligned}
    for body in range(1, compiled.nbody):
        joint, before = carried[compiled.body_parentid[body]]
        place = before * _to_placement(compiled.body_pos[body], compiled.body_quat[body])
        if body == root:
            if kind == "planar" and place.rotation[2, 2] < UPRIGHT:
                raise make_mjcf_error(
                    f"Body '{compiled.body(root).name}' is tilted, but the z axis of a planar base is vertical.",
                    None,
                    pointer,
                )
            # The frame of the base is that of its body, wherever the file puts it at the start.
            joint, place = carrier, pin.SE3.Identity()
        for j in range(compiled.body_jntadr[body], compiled.body_jntadr[body] + compiled.body_jntnum[body]):
            if compiled.jnt_type[j] == _FREE:
                continue
            called, axis = compiled.joint(j).name, _normalize(compiled.jnt_axis[j])
            if called in (*_RESERVED, *BASE_JOINTS[kind]):
                raise make_mjcf_error(f"A joint cannot be called '{called}'; that is the base.", None, pointer)
            # A body may have several joints, one behind the other. Each has its own anchor in the body, and the file
            # shows the body at qpos0, so that the frame at q = 0 is turned back by that.
            anchor = pin.SE3(np.eye(3), compiled.jnt_pos[j])
            turned = _get_joint_motion(compiled.jnt_type[j], axis, -compiled.qpos0[compiled.jnt_qposadr[j]])
            joint = model.addJoint(joint, kinds[int(compiled.jnt_type[j])](axis), place * anchor * turned, called)
            model.addJointFrame(joint)
            place = anchor.inverse()
            links[called] = compiled.body(body).name
        carried.append((joint, place))
        if joint and compiled.body_mass[body] > 0:
            rotation = _to_placement(compiled.body_ipos[body], compiled.body_iquat[body]).rotation
            # MuJoCo states inertias about the centre of mass along principal axes. Average with the transposed tensor:
            # rounding makes it slightly asymmetric.
            tensor = rotation @ np.diag(compiled.body_inertia[body]) @ rotation.T
            inertia = pin.Inertia(float(compiled.body_mass[body]), compiled.body_ipos[body], 0.5 * (tensor + tensor.T))
            model.appendBodyToJoint(joint, inertia, place)
    for body, (joint, place) in enumerate(carried):
        model.addFrame(pin.Frame(f"body {body}", joint, 0, place, pin.FrameType.OP_FRAME))
    for site in range(compiled.nsite):
        joint, place = carried[compiled.site_bodyid[site]]
        place = place * _to_placement(compiled.site_pos[site], compiled.site_quat[site])
        model.addFrame(pin.Frame(f"site {site}", joint, 0, place, pin.FrameType.OP_FRAME))
    return model, links


def _to_placement(position: FloatArray, quaternion: FloatArray) -> pin.SE3:
    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(float(w), float(x), float(y), float(z)).normalized().matrix(), np.array(position))


def _normalize(axis: FloatArray) -> FloatArray:
    return np.asarray(axis / np.linalg.norm(axis))


def _get_joint_motion(kind: int, axis: FloatArray, distance: float) -> pin.SE3:
    """Return the motion of a hinge (3) or slide (2) by a distance along or about its axis."""
    if kind == 3:
        return pin.SE3(pin.exp3(distance * axis), np.zeros(3))
    return pin.SE3(np.eye(3), distance * axis)


def _iter_limits(compiled: mujoco.MjModel) -> Iterator[tuple[str, Limits]]:
    """Yield the range of every joint, and its largest torque if all actuators that act on it directly have a limit."""
    efforts: dict[int, float] = {}
    unlimited: set[int] = set()
    for k in range(compiled.nu):
        if compiled.actuator_trntype[k] not in (0, 1):  # joint, joint in parent
            continue
        j, gear = int(compiled.actuator_trnid[k, 0]), abs(float(compiled.actuator_gear[k, 0]))
        bounds = []
        if compiled.actuator_forcelimited[k]:
            bounds.append(np.abs(compiled.actuator_forcerange[k]).max())
        # Only where force = gain x control (fixed gain, no bias) does the range of the control limit the force.
        plain = compiled.actuator_gaintype[k] == 0 and compiled.actuator_biastype[k] == 0
        if compiled.actuator_ctrllimited[k] and plain:
            bounds.append(np.abs(compiled.actuator_ctrlrange[k] * compiled.actuator_gainprm[k, 0]).max())
        # Actuators on one joint add up, and one without a limit leaves the joint without any.
        if bounds and gear * min(bounds) > _LENGTH_FREE:
            efforts[j] = efforts.get(j, 0.0) + gear * float(min(bounds))
        else:
            unlimited.add(j)
    for j in range(compiled.njnt):
        if compiled.jnt_type[j] == _FREE:
            continue
        effort = None if j in unlimited else efforts.get(j)
        if compiled.jnt_actfrclimited[j]:
            joint_effort = float(np.abs(compiled.jnt_actfrcrange[j]).max())
            effort = joint_effort if effort is None else min(effort, joint_effort)
        low, high = compiled.jnt_range[j]
        bounded = bool(compiled.jnt_limited[j]) and low < high
        yield (
            compiled.joint(j).name,
            Limits.from_description((float(low), float(high)) if bounded else None, effort=effort),
        )


def _build_cuts(held: Equalities, model: pin.Model, tree: Robot, at: str) -> LoopCuts:
    """Return the loops between joints of the tree, and which of their joints are passive."""
    loops: list[Loop] = []
    inside: set[int] = set()
    for coincidence in held.loops:
        first, second = (_to_end(model, frame, place) for frame, place in coincidence.ends)
        if first.joint == second.joint:
            distance = float(np.abs(first.frame[:3, 3] - second.frame[:3, 3]).max())
            if distance > CLOSED:
                detail = (
                    f"Both frames of '{coincidence.name}' are on the same body, {distance:.3g} m apart, so they can "
                    "never coincide."
                )
                raise make_mjcf_error(detail, coincidence.line, at)
            continue
        loops.append(Loop(coincidence.name, coincidence.kind, (first, second), at, coincidence.line))
        # The joints of a loop are those that move one of its ends but not the other.
        inside |= set(tree.list_ancestors(first.joint)) ^ set(tree.list_ancestors(second.joint))
    names = [tree.joint_names[j] for j in sorted(inside)]
    if loops and not any(name in held.driven or name in held.ties for name in names):
        detail = (
            f"No actuator acts on a joint of loop '{loops[0].name}'. Add a <motor joint=…/> for each of the joints "
            f"{join_names(names)} that is driven; the others are passive."
        )
        raise make_mjcf_error(detail, loops[0].line, at)
    passive = tuple(name for name in names if name not in held.driven and name not in held.ties)
    return LoopCuts(tuple(loops), passive, held.starts, repeated=True)


def _to_end(model: pin.Model, frame: str, place: pin.SE3) -> FrameOnJoint:
    model_frame = model.frames[model.getFrameId(frame)]
    return FrameOnJoint(model_frame.parentJoint - 1, (model_frame.placement * place).homogeneous)
