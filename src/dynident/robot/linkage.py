"""Build machines with passive joints: which joints are driven, and how the others follow.

Data, drives and limits are those of the driven joints q_a (n,). The links hang on the tree's joints q (N,), which
follow from them: q = f(q_a), q̇ = G q̇_a with G = ∂f/∂q_a, and the torques of the driven joints are Γ = Gᵀ Γ_tree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.cut_joint import LOOP_TITLE, Loop
from dynident.robot.json_fields import join_names
from dynident.robot.loop_closure import Closure
from dynident.robot.loop_equations import CLOSED
from dynident.robot.robot_model import Linkage, Robot, Tie

_POSTURES, _NEAR, _ROUNDS = 20, 0.1, 30
_DEPENDENT = 1e-9
"""Share of the largest singular value below which a direction counts as zero: the rank of the equations."""
_OPEN_WHEN_DROPPED = 1e-7
"""Gap (m, rad) that an equation left out may have: descriptions are written with a limited number of digits."""


def drop_dependent_equations(closure: Closure) -> Closure:
    """Return the closure without the equations that follow from its others.

    A `connect` of MJCF has three equations although two hold a loop in a plane, and a hinge may be written as two
    points. Closed postures near the start tell which equations are independent.

    Raises
    ------
    DynidentError
        Loops do not close at the start, or all of their equations together hold the driven joints as well.
    """
    start = closure.close_start()
    postures = _sample_closed_postures(closure, start)
    _, slopes = closure.evaluate(postures[:, : closure.n], postures[:, closure.n :])
    left_out: set[int] = set()
    for rows, unknowns, driven in closure.groups:
        if len(rows) <= len(unknowns):
            continue
        if not unknowns and not driven:
            left_out |= set(rows)
            continue
        if driven and len(postures) < 2:
            names = join_names(closure.names[k] for k in driven)
            held = join_names(dict.fromkeys(closure.get_loop(row).name for row in rows))
            raise DynidentError(
                f"The {len(rows)} equations of {held} fix the driven joints {names} at their start: no motion keeps "
                "the loops closed. Let fewer directions of the frames coincide, or drive fewer joints.",
                pointer=closure.loops[0].where,
                title=LOOP_TITLE,
            )
        if not unknowns:
            continue
        # Take the posture in which the passive joints are determined best, and pivoted QR of the transposed slopes:
        # the rows that it chooses last are those that depend on the others.
        part = slopes[:, rows][:, :, unknowns]
        singular = np.linalg.svd(part, compute_uv=False)
        best = int(np.argmax(singular[:, -1] / singular[:, 0]))
        rank = int(np.sum(singular[best] > _DEPENDENT * singular[best, 0]))
        order = scipy.linalg.qr(part[best].T, mode="r", pivoting=True)[1]
        left_out |= {rows[k] for k in order[rank:]}
    if not left_out:
        return closure
    loops = []
    for loop in closure.loops:
        loop_rows = closure.get_rows(loop)
        loops.append(replace(loop, equations=tuple(k for k, row in enumerate(loop_rows) if row not in left_out)))
    return replace(closure, loops=tuple(loops))


def _sample_closed_postures(closure: Closure, start: FloatArray) -> FloatArray:
    """Return closed postures (m, n + p) around the start, the start first."""
    rng = np.random.default_rng(0)
    reach = np.minimum(_NEAR, 0.25 * (closure.high - closure.low))
    postures = [start]
    for step in rng.uniform(-1, 1, (_POSTURES, closure.n)):
        posture = start.copy()
        posture[: closure.n] += reach * step
        for _ in range(_ROUNDS):
            gap, slopes = closure.evaluate(posture[None, : closure.n], posture[None, closure.n :])
            if np.abs(gap).max() < CLOSED:
                break
            # Newton's step by least squares: there are more equations than unknowns here, some of them dependent.
            posture[closure.n :] -= np.linalg.lstsq(slopes[0], gap[0], rcond=1e-10)[0]
        if np.abs(gap).max() < _OPEN_WHEN_DROPPED:
            postures.append(posture)
    return np.array(postures)


def lock_followers(ties: Mapping[str, Tie], locked: Mapping[str, float]) -> dict[str, float]:
    """Return the locked joints and those that cannot move because all joints that they follow are locked.

    Parameters
    ----------
    ties : mapping of joint name to Tie
    locked : mapping of joint name to position (rad or m)

    Returns
    -------
    dict of joint name to position
    """
    positions = dict(locked)
    # Repeat until nothing changes: a joint may follow one that is found to be locked in this loop itself.
    while True:
        more = {
            name: sum(ratio * positions[other] for other, ratio in tie.ratios.items()) + tie.offset
            for name, tie in ties.items()
            if name not in positions and all(other in positions for other in tie.ratios)
        }
        if not more:
            return positions
        positions |= more


@dataclass(frozen=True)
class LoopCuts:
    """Closed loops of a description: the loops, their passive joints, and start positions of joints (rad or m).

    `repeated`: equations may depend on others and are then left out.
    """

    loops: tuple[Loop, ...] = ()
    passive: tuple[str, ...] = ()
    starts: Mapping[str, float] = field(default_factory=dict)
    repeated: bool = False


def link_joints(
    tree: Robot, ties: Mapping[str, Tie], *, title: str, locked: Mapping[str, float], cuts: LoopCuts | None = None
) -> Robot:
    """Return the machine of a tree some of whose joints follow others, or the tree itself if none does.

    Parameters
    ----------
    tree : Robot
    ties : mapping of joint name to Tie
    title : str
        Title of errors.
    locked : mapping of joint name to position
        Joints that were removed from the tree because they are locked (rad or m).
    cuts : LoopCuts, optional
        Closed loops and passive joints.

    Raises
    ------
    DynidentError
        A joint follows itself, directly or through others, or one that does not exist; a ratio is zero or not finite;
        or loops do not close, or do not determine the passive joints.
    """
    cuts = LoopCuts() if cuts is None else cuts
    ties = {name: tie for name, tie in ties.items() if name in tree.joint_names}
    if not ties and not cuts.loops and not cuts.passive:
        return tree
    ratios, offsets = _solve_ties(tree, ties, title, locked)
    driven = tuple(j for j, name in enumerate(tree.joint_names) if name not in ties and name not in cuts.passive)
    loose = tuple(j for j, name in enumerate(tree.joint_names) if name in cuts.passive)
    if not driven:
        raise DynidentError(
            f"No joint is driven: all of {join_names(tree.joint_names)} follow others or are passive. Drive "
            f"at least one.",
            pointer=cuts.loops[0].where if cuts.loops else "",
            title=title,
        )
    ratios = ratios[:, [*driven, *loose]]
    closure = _build_closure(tree, cuts, driven, loose, ratios, offsets)
    linkage = Linkage(tree, driven, ratios, offsets, ties, closure)
    for name in (*ties, *cuts.passive):
        if tree.drives[tree.joint_names.index(name)] != type(tree.drives[0])():
            raise DynidentError(
                f"Joint '{name}' follows other joints, so it cannot have a drive; driven joints: "
                f"{join_names(tree.joint_names[j] for j in driven)}.",
                pointer=f"/drives/{name}",
                title=title,
            )
    return build_driven_robot(linkage)


def build_driven_robot(linkage: Linkage) -> Robot:
    """Return the robot whose joints are the driven ones; the antecedent of each is the driven joint before it."""
    tree, driven = linkage.tree, linkage.driven
    joints = []
    for j in driven:
        before = [k for k in tree.list_ancestors(j)[:-1] if k in driven]
        joints.append(replace(tree.joints[j], parent=driven.index(before[-1]) if before else -1))
    return replace(
        tree,
        joints=tuple(joints),
        drives=tuple(tree.drives[j] for j in driven),
        linkage=linkage,
        inertias=tree.inertias,
    )


def _build_closure(
    tree: Robot,
    cuts: LoopCuts,
    driven: tuple[int, ...],
    loose: tuple[int, ...],
    ratios: FloatArray,
    offsets: FloatArray,
) -> Closure | None:
    if not cuts.loops and not loose:
        return None
    if not cuts.loops:
        raise DynidentError(
            f"The passive joints {join_names(cuts.passive)} belong to no loop; drive or tie them, or close a loop "
            "with them.",
            pointer="/loops",
            title=LOOP_TITLE,
        )
    free = [tree.joints[j] for j in (*driven, *loose)]
    start = np.array([cuts.starts.get(joint.name, 0.0) for joint in free])
    reach = {"revolute": math.pi, "prismatic": 1.0}
    bounds = [
        joint.reach or (centre - reach[joint.kind], centre + reach[joint.kind])
        for joint, centre in zip(free, start, strict=True)
    ]
    # Where no start is stated and zero lies outside a joint's limits, the middle of the range is the better guess.
    for place, (low, high) in enumerate(bounds[: len(driven)]):
        if free[place].name not in cuts.starts and not low <= 0.0 <= high:
            start[place] = 0.5 * (low + high)
    low, high = (np.array(bound) for bound in zip(*bounds[: len(driven)], strict=True))
    names = tuple(joint.name for joint in free)
    closure = Closure(tree.joints, cuts.loops, ratios, offsets, start, low, high, names)
    if cuts.repeated:
        closure = drop_dependent_equations(closure)
    closure.check()
    return closure


def is_usable_ratio(value: float) -> bool:
    """Return whether a joint can follow another by this ratio."""
    return math.isfinite(value) and value != 0


def _solve_ties(
    tree: Robot, ties: Mapping[str, Tie], title: str, locked: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the ratios (N, N) of all joints to those that follow none, and the offsets (N,)."""
    names = tree.joint_names
    ratios, offsets = np.zeros((tree.n, tree.n)), np.zeros(tree.n)
    done: set[str] = set()

    # Depth-first: a joint's row is complete once those of all joints that it follows are; `path` finds circles.
    def solve(name: str, path: tuple[str, ...]) -> None:
        if name in done:
            return
        j = names.index(name)
        tie = ties.get(name)
        if tie is None:
            ratios[j, j] = 1.0
        else:
            if name in path:
                way = " follows ".join(f"'{joint_name}'" for joint_name in (*path[path.index(name) :], name))
                raise _make_tie_error(
                    f"Joint {way}: a joint cannot follow itself. Make one of these joints independent.", tie, title
                )
            offsets[j] = tie.offset
            for other, ratio in tie.ratios.items():
                if other in locked:
                    offsets[j] += ratio * locked[other]
                    continue
                if other not in names:
                    raise _make_tie_error(
                        f"Joint '{name}' follows '{other}', which is not a moving joint; moving joints: "
                        f"{join_names(joint_name for joint_name in names if joint_name != name)}.",
                        tie,
                        title,
                    )
                if not is_usable_ratio(ratio):
                    raise _make_tie_error(
                        f"Joint '{name}' follows '{other}' by {ratio}; expected a number other than 0 (if the joint "
                        "does not move, make it fixed).",
                        tie,
                        title,
                    )
                solve(other, (*path, name))
                ratios[j] += ratio * ratios[names.index(other)]
                offsets[j] += ratio * offsets[names.index(other)]
        done.add(name)

    for name in names:
        solve(name, ())
    return ratios, offsets


def _make_tie_error(detail: str, tie: Tie, title: str) -> DynidentError:
    return DynidentError(f"line {tie.line}: {detail}" if tie.line else detail, pointer=tie.where, title=title)
