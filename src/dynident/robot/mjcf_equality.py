"""What holds an MJCF's joints together: its equalities as ties and cut loops, and which joints are driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from dynident.arrays import FloatArray
from dynident.robot.cut_joints import LoopKind
from dynident.robot.linkage import Tie
from dynident.robot.mjcf_xml import mjcf_error
from dynident.robot.pointers import listed

if TYPE_CHECKING:
    import mujoco

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
class Held:
    """Equalities of a model.

    `ties` say which joints follow others, `fixed` which stand still, and where (rad, m). `driven` are the joints that
    an actuator acts on. `starts` are the positions of the first key frame, or those that the file is drawn in.
    """

    ties: Mapping[str, Tie]
    fixed: Mapping[str, float]
    loops: tuple[Coincidence, ...]
    driven: frozenset[str]
    starts: Mapping[str, float]


@dataclass(frozen=True)
class _Linear:
    """Σ ratio q = value, of joints by name."""

    ratios: Mapping[str, float]
    value: float
    line: int


def held_by(compiled: mujoco.MjModel, lines: Mapping[str, int], pointer: str) -> Held:
    """Read the equalities that are active; `lines` are those of the text by their names.

    Raises
    ------
    DynidentError
        An equality is not linear, or all of the joints that it ties are driven (line).
    """
    linear: list[_Linear] = []
    loops: list[Coincidence] = []
    for k in range(compiled.neq):
        name, kind = compiled.equality(k).name, int(compiled.eq_type[k])
        if not compiled.eq_active0[k]:
            continue
        if kind in (_CONNECT, _WELD):
            loops.append(_coincidence(compiled, k, name, lines[name]))
        else:
            linear.append(_linear(compiled, k, lines[name], pointer))
    directly, by_tendon = _actuated(compiled)
    ties, fixed = _followers(linear, directly, by_tendon, pointer)
    posture = compiled.key_qpos[0] if compiled.nkey else compiled.qpos0
    starts = {compiled.joint(j).name: float(posture[compiled.jnt_qposadr[j]]) for j in range(compiled.njnt)}
    return Held(ties, fixed, tuple(loops), frozenset(directly | by_tendon) - set(ties), starts)


def _coincidence(compiled: mujoco.MjModel, k: int, name: str, line: int) -> Coincidence:
    ids, data = (compiled.eq_obj1id[k], compiled.eq_obj2id[k]), compiled.eq_data[k]
    kind: LoopKind = "point" if compiled.eq_type[k] == _CONNECT else "full"
    if compiled.eq_objtype[k] == _SITE:
        ends = [(f"site {one}", pin.SE3.Identity()) for one in ids]
    elif kind == "point":
        ends = [(f"body {one}", _at(data[3 * side : 3 * side + 3])) for side, one in enumerate(ids)]
    else:
        # The second body's frame as it is held in the first one's, and the point of the second that this is said of.
        turn = pin.Quaternion(*map(float, data[6:10])).normalized().matrix()
        ends = [(f"body {ids[0]}", pin.SE3(turn, data[3:6].copy())), (f"body {ids[1]}", _at(data[:3]))]
    return Coincidence(name, kind, (ends[0], ends[1]), line)


def _at(place: FloatArray) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(place))


def _linear(compiled: mujoco.MjModel, k: int, line: int, pointer: str) -> _Linear:
    """q₁ - r₁ = a₀ + a₁ (q₂ - r₂) of joints or tendons, r where the file is drawn."""
    tied, data = int(compiled.eq_type[k]) == _TENDON, compiled.eq_data[k]
    if np.any(data[2:5]):
        raise mjcf_error(
            f"polycoef of the equality '{compiled.equality(k).name}' is {listed(f'{one:g}' for one in data[:5])}; only "
            "the first two, a constant and a ratio, can be other than 0.",
            line,
            pointer,
        )
    ids = [int(one) for one in (compiled.eq_obj1id[k], compiled.eq_obj2id[k])]
    sides = [_lengths(compiled, one, tied) if one >= 0 else ({}, 0.0) for one in ids]
    (first, at), (second, other) = sides
    ratios = dict(first)
    for joint, ratio in second.items():
        ratios[joint] = ratios.get(joint, 0.0) - float(data[1]) * ratio
    ratios = {joint: ratio for joint, ratio in ratios.items() if ratio}
    return _Linear(ratios, float(data[0]) + at - float(data[1]) * other, line)


def _lengths(compiled: mujoco.MjModel, index: int, tendon: bool) -> tuple[dict[str, float], float]:
    """A joint, or the joints of a fixed tendon, with their ratios, and how long that is where the file is drawn."""
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


def _actuated(compiled: mujoco.MjModel) -> tuple[set[str], set[str]]:
    """Joints that an actuator acts on by itself, and by way of a tendon."""
    directly: set[str] = set()
    by_tendon: set[str] = set()
    for k in range(compiled.nu):
        acted = int(compiled.actuator_trnid[k, 0])
        if compiled.actuator_trntype[k] == _THROUGH_TENDON:
            by_tendon |= set(_lengths(compiled, acted, True)[0])
        else:
            directly.add(compiled.joint(acted).name)
    return directly, by_tendon - directly


def _followers(
    linear: list[_Linear], directly: set[str], by_tendon: set[str], pointer: str
) -> tuple[dict[str, Tie], dict[str, float]]:
    """Which joint of each equation follows the others: the first that no actuator acts on."""
    ties: dict[str, Tie] = {}
    fixed: dict[str, float] = {}
    for one in linear:
        if len(one.ratios) == 1:
            [(joint, ratio)] = one.ratios.items()
            fixed[joint] = one.value / ratio
            continue
        free = [joint for joint in one.ratios if joint not in ties and joint not in directly]
        follower = next((joint for joint in free if joint not in by_tendon), free[0] if free else "")
        if not follower:
            raise mjcf_error(
                f"An equality ties {listed(one.ratios)}, and each of them has an actuator or follows others already; "
                "leave one of them without, so that it can follow.",
                one.line,
                pointer,
            )
        own = one.ratios[follower]
        others = {joint: -ratio / own for joint, ratio in one.ratios.items() if joint != follower}
        ties[follower] = Tie(others, one.value / own, pointer, one.line)
    return ties, fixed
