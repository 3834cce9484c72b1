"""Read the equalities of an MJCF as ties and cut loops, and find which joints are driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.robot.cut_joints import LoopKind
from dynident.robot.json_pointer import join_names
from dynident.robot.mjcf_xml import make_mjcf_error
from dynident.robot.model import Tie

if TYPE_CHECKING:
    import mujoco

# MuJoCo's numbers: of kinds of equalities, and of a site, a joint in a tendon's path and a transmission by a tendon.
_CONNECT, _WELD, _JOINT, _TENDON = 0, 1, 2, 3
_SITE, _WRAPPED_JOINT, _THROUGH_TENDON = 6, 1, 3


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
                f"An equality ties {join_names(equation.ratios)}, and each of them has an actuator or follows others "
                "already; leave one of them without, so that it can follow.",
                equation.line,
                pointer,
            )
        ratio_of_follower = equation.ratios[follower]
        others = {joint: -ratio / ratio_of_follower for joint, ratio in equation.ratios.items() if joint != follower}
        ties[follower] = Tie(others, equation.value / ratio_of_follower, pointer, equation.line)
    return ties, fixed
