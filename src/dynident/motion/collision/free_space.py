"""Which pairs of bodies are checked, and how near a motion comes to each.

Holds which pairs are left out, and when a smaller clearance is accepted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.motion.collision.constraint_slack import Balance, ExactClearances, JoinedConstraints, LoopConstraints
from dynident.motion.collision.exact_distances import (
    ContactCheck,
    SolidPair,
    build_half_space_solid,
    build_pair,
    build_solid,
    list_nonadjacent,
    word_contact,
)
from dynident.motion.collision.obstacle_geometry import (
    FLOOR_ASSUMED,
    HalfSpace,
    Surroundings,
    ToolRange,
    assume_floor,
    build_block,
    list_half_spaces,
)
from dynident.motion.collision.smooth_clearance import (
    Ball,
    CapsulePart,
    ClearanceConstraints,
    ClearancePairs,
    cover_with_balls,
)
from dynident.motion.collision.surroundings import SMALLEST_CLEARANCE
from dynident.robot.collision_reader import BASE, CollisionGeometry, collision_geometry
from dynident.robot.collision_shapes import drop_contained, enclose_shape
from dynident.robot.forward_kinematics import tool_path
from dynident.robot.json_fields import join_names
from dynident.robot.robot_model import Robot

# It may have some, in meshes that are missing: another note names these.
_NO_GEOMETRY = "no collision geometry that could be read"
# Random postures from which it is judged which pairs come near each other.
_POSTURES = 200
# Links that are closer than the clearance in this share of all postures cannot be kept apart by a motion.
_MOSTLY = 0.5
# Capsules that never come as near as this (m) in the postures looked at are not followed while optimising.
_NEAR = 0.1
# Distance (m) beyond the clearance that is designed for, at most.
_SPARE = 1e-3
# Half: links near the floor that are not quite round come a little nearer to it as they turn.
_SHARE_OF_ATTAINABLE = 0.5
# Postures that show whether the distance of a pair changes at all, and by how much (m) it has to.
_POSTURES_OF_A_PAIR, _UNCHANGED = 20, 1e-6


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """What a motion must stay clear of.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    clearances : ClearanceConstraints or None
        Smooth distances for the optimiser.
    exact : ExactClearances, optional
        Those of pairs that its capsules are too thick for.
    contacts : ContactCheck or None
        Exact distances for the final check.
    tool : ToolRange or None
        Where the tool may go, at `tool_joint`.
    notes : tuple of str
        What was assumed, or is not checked, in words for the user.
    loops : LoopConstraints, optional
        Limits of joints that are not driven.
    assumed : bool
        Whether all that is around the robot is an assumed floor.
    balance : Balance, optional
        Balance of a robot on its feet.
    """

    robot: Robot
    clearances: ClearanceConstraints | None
    contacts: ContactCheck | None
    tool: ToolRange | None
    notes: tuple[str, ...]
    loops: LoopConstraints | None = None
    assumed: bool = False
    balance: Balance | None = None
    exact: ExactClearances | None = None

    @cached_property
    def constraints(self) -> JoinedConstraints | None:
        """All constraints of the optimiser; None where there are none."""
        every = (self.clearances, self.exact, self.loops, self.balance)
        parts = tuple(part for part in every if part is not None and part.count)
        return JoinedConstraints(parts) if parts else None

    @property
    def tool_joint(self) -> int:
        """Index of the joint of the tree that carries the tool."""
        return _find_tool_joint(self.robot, self.tool)

    def locate_tool(self, q: FloatArray) -> FloatArray:
        """Return the tool (m, 3) in the base frame at postures q (m, n)."""
        assert self.tool is not None
        return tool_path(self.robot, q, self.tool_joint, np.array(self.tool.point))

    def find_complaint(self, q: FloatArray) -> str | None:
        """Return what is not kept along a path q (m, n), as the end of a sentence; None where all is clear."""
        parts: tuple[LoopConstraints | Balance | None, ...] = (self.loops, self.balance)
        for part in parts:
            if part is not None and (complaint := part.find_complaint(q)) is not None:
                return complaint
        if self.tool is not None:
            at = self.locate_tool(q)
            for k, (low, high) in enumerate(zip(self.tool.low, self.tool.high, strict=True)):
                if (low is not None and at[:, k].min() < low) or (high is not None and at[:, k].max() > high):
                    ends = f"[{at[:, k].min():.4g}, {at[:, k].max():.4g}]"
                    return f"the tool would be at {'xyz'[k]} = {ends} m, beyond its range [{low}, {high}]."
        # First the cheap question whether anything is too near at all, then the costly one what it is.
        if self.contacts is not None and self.contacts.find_too_near(q).any():
            nearest = min(self.contacts.find_approaches(q), key=lambda approach: approach.slack)
            if nearest.slack < 0:
                return word_contact(nearest.name, nearest.distance, nearest.wanted)
        return None

    def describe_narrowness(self, q: FloatArray) -> str:
        """Return what leaves no room to move at a posture (n,) that is clear itself, as the end of a sentence."""
        if self.contacts is None and self.loops is not None:
            return "joints that follow others are at their limits, or the loops near a singular posture."
        if self.contacts is None:
            return "the robot hardly balances." if self.balance is not None else "the tool is at an end of its range."
        nearest = min(self.contacts.find_approaches(q[None]), key=lambda approach: approach.slack)
        return f"'{nearest.name}' are {nearest.distance:.3g} m apart, which is too close for any motion."

    def find_blocked(self, q: FloatArray) -> BoolArray:
        """Return at which of postures q (m, n) something is not kept: (m,)."""
        blocked = np.zeros(len(q), dtype=np.bool_) if self.loops is None else self.loops.find_broken(q)
        if self.balance is not None:
            blocked |= self.balance.find_broken(q)
        if self.contacts is not None:
            blocked |= self.contacts.find_too_near(q)
        if self.tool is not None:
            at = self.locate_tool(q)
            for k, (low, high) in enumerate(zip(self.tool.low, self.tool.high, strict=True)):
                blocked |= (at[:, k] < (-np.inf if low is None else low)) | (
                    at[:, k] > (np.inf if high is None else high)
                )
        return blocked

    def compute_least_slack(self, q: FloatArray) -> FloatArray:
        """Return the smallest distance beyond the clearance (m) at postures q (m, n), by enclosing capsules: (m,).

        Where that is less, it is the slack of joints that follow, of loops, or of the balance of a standing robot.
        """
        return np.full(len(q), np.inf) if self.constraints is None else self.constraints.find_least(q)


def build_free_space(robot: Robot, surroundings: Surroundings, low: FloatArray, high: FloatArray) -> FreeSpace | None:
    """Set up what a motion must stay clear of.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    surroundings : Surroundings
        The surroundings that the request states.
    low, high : (n,)
        Position limits, rad or m.

    Returns
    -------
    FreeSpace or None
        The free space; None where there is nothing to stay clear of.

    Raises
    ------
    DynidentError
        There are obstacles, but nothing is known of the robot's shape; or a name does not exist.
    """
    surroundings, assumed_radius = assume_floor(robot, surroundings, low, high)
    tool, tree = surroundings.tool_range, robot.tree
    if not (surroundings.self_collision or surroundings.has_obstacles or tool is not None):
        return None
    folders = [Path(folder) for folder in surroundings.mesh_folders]
    geometry = collision_geometry(robot, mesh_folders=folders, link_radius=surroundings.link_radius)
    above_floor = geometry
    # Above an assumed floor links without geometry get a thickness, too: nobody said how near they may come to it.
    if assumed_radius is not None and geometry.bare and surroundings.link_radius is None:
        above_floor = collision_geometry(robot, mesh_folders=folders, link_radius=assumed_radius)
    _check_geometry(above_floor, surroundings)
    may_touch = _read_allowed_contacts(robot, geometry, surroundings)
    # Random postures show which pairs can come near each other at all. The seed is fixed, so that a request always
    # gives the same checks.
    postures = _select_closed(robot, np.random.default_rng(0).uniform(low, high, (_POSTURES, robot.n)))
    ends = (low, high) if robot.linkage is None else _find_ends(robot.linkage.compute_positions(postures))
    solids = {body.joint: build_solid(body.name, body.joint, body.shapes) for body in above_floor.bodies}
    own: list[SolidPair] = []
    assumed = assumed_radius is not None
    notes = [*([FLOOR_ASSUMED] if assumed else []), *dict.fromkeys((*geometry.notes, *above_floor.notes))]
    if surroundings.self_collision:
        candidates = [
            build_pair(tree, solids[b.joint], solids[a.joint], ends, surroundings.clearance)
            for a, b in list_nonadjacent(tree, geometry.bodies)
            if frozenset((a.joint, b.joint)) not in may_touch
        ]
        check = ContactCheck(robot, candidates)
        close = [
            float(np.mean(check.compute_distances(pair, postures) < surroundings.clearance)) for pair in candidates
        ]
        # Bodies that are close in most postures are so by construction; no motion can keep them apart.
        own = [pair for pair, share in zip(candidates, close, strict=True) if share < _MOSTLY]
        touching = [pair.name for pair, share in zip(candidates, close, strict=True) if share >= _MOSTLY]
        own, pair_notes = _adapt_to_zero_posture(robot, own, low, high)
        notes += [*_note_self_collision(geometry, touching), *pair_notes]
    obstacles = [build_half_space_solid(half.name, half.normal, half.offset) for half in list_half_spaces(surroundings)]
    obstacles += [build_solid(box.solid_name, BASE, [build_block(box)]) for box in surroundings.boxes]
    moving = [body for body in above_floor.bodies if body.joint != BASE]
    against = [
        build_pair(tree, solids[body.joint], obstacle, ends, surroundings.clearance)
        for body in moving
        for obstacle in obstacles
    ]
    against, pair_notes = _select_changeable(robot, against, postures, surroundings.clearance)
    notes += pair_notes
    against, pair_notes = _reduce_clearances(robot, against, postures, drop=assumed)
    notes += pair_notes
    if obstacles and above_floor.bare:
        notes.append(
            f"Not checked against the surroundings, because they have {_NO_GEOMETRY}: {join_names(above_floor.bare)}."
        )
    hindrances, thick = _build_clearance_pairs(robot, above_floor, own, against, surroundings, postures)
    pairs = [*own, *against]
    if not pairs and tool is None and not notes:
        return None
    return FreeSpace(
        robot=robot,
        clearances=ClearanceConstraints(robot, hindrances) if hindrances.count else None,
        contacts=ContactCheck(robot, pairs) if pairs else None,
        tool=tool,
        notes=tuple(notes),
        assumed=assumed,
        exact=ExactClearances(robot, thick, _add_spare([pair.clearance for pair in thick])) if thick else None,
    )


def _select_closed(robot: Robot, q: FloatArray) -> FloatArray:
    """Return those of driven postures (m, n) in which the loops are closed; all where hardly any is."""
    # Positions of open loops mean nothing, and distances from them would not either.
    if robot.linkage is None or robot.linkage.closure is None:
        return q
    closed = np.isfinite(robot.linkage.closure.compute_log_condition(q)[0])
    return q[closed] if np.count_nonzero(closed) > 1 else q


def _find_ends(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    return positions.min(axis=0), positions.max(axis=0)


def _select_changeable(
    robot: Robot, pairs: Sequence[SolidPair], postures: FloatArray, clearance: float
) -> tuple[list[SolidPair], list[str]]:
    """Return pairs whose distance changes with the motion, and notes on near ones that do not.

    Such a pair is a turntable and its floor.
    """
    check = ContactCheck(robot, pairs)
    distances_of_pairs = [check.compute_distances(pair, postures[:_POSTURES_OF_A_PAIR]) for pair in pairs]
    changed = [float(np.ptp(distances)) > _UNCHANGED for distances in distances_of_pairs]
    near = [
        f"{pair.name} ({round(float(distances[0]), 4) + 0.0:g} m)"
        for pair, distances, changes in zip(pairs, distances_of_pairs, changed, strict=True)
        if not changes and distances[0] < clearance
    ]
    variable = [pair for pair, changes in zip(pairs, changed, strict=True) if changes]
    return variable, [f"Not checked, because no motion changes their distance: {join_names(near)}."] if near else []


def _reduce_clearances(
    robot: Robot, pairs: Sequence[SolidPair], postures: FloatArray, *, drop: bool
) -> tuple[list[SolidPair], list[str]]:
    """Return pairs with a clearance that can be kept, and notes where it had to be reduced.

    It is reduced where a pair is nearer than the clearance in every posture. An arm that stands on a floor has its
    first links near it, and one end of them does not move away. With `drop`, pairs that always touch are left out, as
    an assumed floor cannot be there for them.
    """
    check, attainable, notes = ContactCheck(robot, pairs), [], []
    for pair in pairs:
        # The largest distance over random postures is what a motion can attain at best.
        farthest = float(check.compute_distances(pair, postures).max())
        if farthest <= 0 and drop:
            notes.append(f"Not checked, because they touch in every posture: {pair.name}.")
            continue
        if 0 < farthest < pair.clearance:
            less = _SHARE_OF_ATTAINABLE * farthest
            notes.append(
                f"A clearance of {less:.3g} m is required instead of {pair.clearance:g} m between {pair.name}, which "
                f"are never more than {farthest:.3g} m apart."
            )
            pair = replace(pair, clearance=less)
        attainable.append(pair)
    return attainable, notes


def _adapt_to_zero_posture(
    robot: Robot, pairs: Sequence[SolidPair], low: FloatArray, high: FloatArray
) -> tuple[list[SolidPair], list[str]]:
    """Return pairs of links with a clearance that the zero posture keeps, and a note where it had to be reduced.

    Who describes a robot draws it at zero, where it stands: the hips of a humanoid are near each other there.
    """
    zero = np.clip(np.zeros(robot.n), low, high)
    if not pairs or zero.any():
        return list(pairs), []
    check, kept, reduced = ContactCheck(robot, pairs), [], []
    for pair in pairs:
        distance = float(check.compute_distances(pair, zero[None]).min())
        if SMALLEST_CLEARANCE < distance < pair.clearance:
            pair = replace(pair, clearance=max(_SHARE_OF_ATTAINABLE * distance, SMALLEST_CLEARANCE))
            reduced.append(f"{pair.name} ({pair.clearance:.3g} m)")
        kept.append(pair)
    note = f"Links that are near each other at zero keep half of their distance there: {join_names(reduced)}."
    return kept, [note] if reduced else []


def _check_geometry(geometry: CollisionGeometry, surroundings: Surroundings) -> None:
    if surroundings.has_obstacles and not any(body.joint != BASE for body in geometry.bodies):
        raise DynidentError(
            f"the robot's description has {_NO_GEOMETRY}, so its distance to the surroundings cannot be checked; state "
            "surroundings.link_radius to model its links as capsules, or leave the obstacles out",
            pointer="/surroundings",
            title="No collision geometry",
        )


def _read_allowed_contacts(
    robot: Robot, geometry: CollisionGeometry, surroundings: Surroundings
) -> set[frozenset[int]]:
    known = {body.name: body.joint for body in geometry.bodies}
    known |= {name: j for j, name in enumerate(robot.tree.joint_names)} | {"base": BASE}
    for index, pair in enumerate(surroundings.may_touch):
        for name in pair:
            if name not in known:
                raise DynidentError(
                    f"there is no link '{name}'; links: {join_names(known)}", pointer=f"/surroundings/may_touch/{index}"
                )
    return {frozenset(known[name] for name in pair) for pair in surroundings.may_touch}


def _note_self_collision(geometry: CollisionGeometry, touching: Sequence[str]) -> list[str]:
    notes = []
    if not any(body.joint != BASE for body in geometry.bodies):
        return [f"Self-collision is not checked: the robot's description has {_NO_GEOMETRY}."]
    if geometry.bare:
        notes.append(f"Not checked for self-collision, because they have {_NO_GEOMETRY}: {join_names(geometry.bare)}.")
    if touching:
        notes.append(
            f"Not checked against each other, because they are close in most postures: {join_names(touching)}."
        )
    return notes


def _build_clearance_pairs(
    robot: Robot,
    geometry: CollisionGeometry,
    own: Sequence[SolidPair],
    against: Sequence[SolidPair],
    surroundings: Surroundings,
    postures: FloatArray,
) -> tuple[ClearancePairs, tuple[SolidPair, ...]]:
    kept_from = {(pair.moving.joint, pair.other.name): pair.clearance for pair in against}
    parts = {
        body.joint: [
            CapsulePart(body.joint, capsule) for capsule in drop_contained(tuple(map(enclose_shape, body.shapes)))
        ]
        for body in geometry.bodies
    }
    capsules = [(pair, (b, a)) for pair in own for b in parts[pair.moving.joint] for a in parts[pair.other.joint]]
    moving = [part for joint, joint_parts in parts.items() if joint != BASE for part in joint_parts]
    half_spaces = _select_attainable_ends(
        robot,
        [
            (Ball(part.joint, end, part.capsule.radius), half)
            for half in list_half_spaces(surroundings)
            for part in moving
            if (part.joint, half.name) in kept_from
            for end in (part.capsule.start, part.capsule.end)
        ],
        kept_from,
        postures,
    )
    planes = _build_tool_planes(robot, surroundings)
    box_balls = [
        (ball, box)
        for box in surroundings.boxes
        for part in moving
        if (part.joint, box.solid_name) in kept_from
        for ball in cover_with_balls(part)
    ]
    followed, thick = _select_followed(robot, capsules, postures)
    # In the order of the distances: pairs of links, ends at planes, planes of the tool, boxes.
    clearances = [
        *(pair.clearance for pair, _ in followed),
        *(kept_from[ball.joint, half.name] for ball, half in half_spaces),
        *(surroundings.clearance for _ in planes),
        *(kept_from[ball.joint, box.solid_name] for ball, box in box_balls),
    ]
    hindrances = ClearancePairs(
        tuple(pair for _, pair in followed),
        (*half_spaces, *planes),
        tuple((ball, build_block(box)) for ball, box in box_balls),
        _add_spare(clearances),
    )
    return hindrances, thick


def _add_spare(clearances: Sequence[float]) -> FloatArray:
    # What is designed for is a little more than what must hold: the arm moves between the samples as well.
    return np.array(clearances) + np.minimum(_SPARE, 0.1 * np.array(clearances))


def _select_attainable_ends(
    robot: Robot,
    ends: Sequence[tuple[Ball, HalfSpace]],
    kept_from: Mapping[tuple[int, str], float],
    postures: FloatArray,
) -> list[tuple[Ball, HalfSpace]]:
    """Return ends of capsules that can keep their clearance to a plane.

    Those around a first link near a floor never can. What the capsules enclose is checked against the plane all the
    same.
    """
    if not ends:
        return []
    clearances = np.array([kept_from[ball.joint, half.name] for ball, half in ends])
    slacks = (
        ClearanceConstraints(robot, ClearancePairs(half_spaces=tuple(ends), clearance=clearances + _SPARE))
        .evaluate(postures)
        .values
    )
    return [end for end, farthest in zip(ends, slacks.max(axis=0), strict=True) if farthest >= 0]


def _select_followed(
    robot: Robot, capsules: Sequence[tuple[SolidPair, tuple[CapsulePart, CapsulePart]]], postures: FloatArray
) -> tuple[list[tuple[SolidPair, tuple[CapsulePart, CapsulePart]]], tuple[SolidPair, ...]]:
    """Return capsules that come near each other, and pairs that come near and whose capsules are too thick to tell."""
    if not capsules:
        return [], ()
    hindrances = ClearancePairs(
        tuple(each for _, each in capsules), clearance=np.array([p.clearance for p, _ in capsules])
    )
    slacks = ClearanceConstraints(robot, hindrances).evaluate(postures).values
    # Capsules are thicker than the links. A pair that they hold nearer than the clearance most of the time would forbid
    # almost every motion.
    near, thick = slacks.min(axis=0) < _NEAR, np.mean(slacks < 0, axis=0) >= _MOSTLY
    hidden = dict.fromkeys(pair for (pair, _), is_hidden in zip(capsules, near & thick, strict=True) if is_hidden)
    check = ContactCheck(robot, tuple(hidden))
    exact = tuple(pair for pair in hidden if (check.compute_distances(pair, postures) < pair.clearance).any())
    return [each for each, is_useful in zip(capsules, near & ~thick, strict=True) if is_useful], exact


def _build_tool_planes(robot: Robot, surroundings: Surroundings) -> list[tuple[Ball, HalfSpace]]:
    """Return the tool's range as half-spaces for a ball of radius minus the clearance.

    The clearance cancels that way: none is kept to the ends of the range.
    """
    tool = surroundings.tool_range
    if tool is None:
        return []
    ball = Ball(_find_tool_joint(robot, tool), np.array(tool.point), -surroundings.clearance)
    # A range in one coordinate is one half-space for either end, the upper one with the axis reversed.
    planes = []
    for axis, low, high in zip(np.eye(3), tool.low, tool.high, strict=True):
        if low is not None:
            planes.append((ball, HalfSpace("tool", axis, low)))
        if high is not None:
            planes.append((ball, HalfSpace("tool", -axis, -high)))
    return planes


def _find_tool_joint(robot: Robot, tool: ToolRange | None) -> int:
    if tool is None or tool.joint is None:
        return robot.tree.n - 1
    return robot.tree.joint_names.index(tool.joint)
