"""Exact smallest distances along a motion (by coal), to verify it; holds their precision (0.5 mm).

The distance of two bodies cannot change faster than the joints between them let their points travel. So a few samples
prove for long intervals that nothing comes near there, and only the rest of a fine grid is evaluated. The distance of
capsules around the bodies is a lower bound, too, and is known for many postures at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.motion.collision.smooth_clearance import compute_segment_distances
from dynident.robot.collision_reader import BASE, Body
from dynident.robot.collision_shapes import Block, Capsule, Cylinder, Shape, enclose_shape
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.robot_model import Robot

# Samples at which every pair is looked at first; the bounds between them tell where to look next.
_FIRST_LOOKS = 48
_EXACTNESS = 5e-4
"""Absolute precision of the nearest approach, m."""
# Far from everything a coarser answer does: nobody needs to know a distance of one metre to half a millimetre.
_RELATIVE_EXACTNESS = 0.05


@dataclass(frozen=True, eq=False)
class Solid:
    """Shapes of one body or obstacle in the frame of a joint.

    Parameters
    ----------
    name : str
        Name for messages.
    joint : int
        Index of the joint that carries it; -1 for the base.
    shapes : tuple of coal.CollisionGeometry
        Its shapes.
    placements : tuple of ((3, 3), (3,))
        Rotation and origin (m) of each shape in the frame of the joint.
    reach : float
        Distance of its farthest point from the joint's origin, m.
    capsules : tuple of Capsule
        A capsule around each shape; none for a half-space.
    """

    name: str
    joint: int
    shapes: tuple[coal.CollisionGeometry, ...]
    placements: tuple[tuple[FloatArray, FloatArray], ...]
    reach: float
    capsules: tuple[Capsule, ...]


def build_solid(name: str, joint: int, shapes: Sequence[Shape]) -> Solid:
    """Return shapes for coal; `reach` is the distance of their farthest point from the joint's origin.

    Parameters
    ----------
    name : str
        Name for messages.
    joint : int
        Index of the joint that carries it; -1 for the base.
    shapes : sequence of Shape
        Shapes in the frame of the joint.

    Returns
    -------
    Solid
        The solid.
    """
    geometries, placements, reach = [], [], 0.0
    for shape in shapes:
        geometry, rotation, origin = _build_geometry(shape)
        geometries.append(geometry)
        placements.append((rotation, origin))
        if isinstance(shape, Capsule):
            ends = max(float(np.linalg.norm(shape.start)), float(np.linalg.norm(shape.end)))
            reach = max(reach, ends + shape.radius)
        else:
            reach = max(reach, float(np.linalg.norm(shape.corners, axis=1).max()))
    return Solid(name, joint, tuple(geometries), tuple(placements), reach, tuple(map(enclose_shape, shapes)))


def build_half_space_solid(name: str, normal: FloatArray, offset: float) -> Solid:
    """Return the solid behind a plane: normal · x < offset.

    Parameters
    ----------
    name : str
        Name for messages.
    normal : (3,)
        Unit normal in the base frame, to the free side.
    offset : float
        Smallest value of normal · x on the free side, m.
    """
    return Solid(name, -1, (coal.Halfspace(normal, offset),), ((np.eye(3), np.zeros(3)),), 0.0, ())


@dataclass(frozen=True, eq=False)
class SolidPair:
    """Two solids that are kept apart.

    Parameters
    ----------
    moving, other : Solid
        The two solids, `moving` the one farther from the base.
    travel : (N,)
        Bound on how far a point between them moves while a joint of the tree moves by one, m/rad or m/m.
    clearance : float
        Distance to keep, m.
    """

    moving: Solid
    other: Solid
    travel: FloatArray
    clearance: float

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.moving.name} – {self.other.name}"


def build_pair(
    robot: Robot, moving: Solid, other: Solid, ends: tuple[FloatArray, FloatArray], clearance: float
) -> SolidPair:
    """Return a pair, `moving` being the one farther from the base.

    Parameters
    ----------
    robot : Robot
        The tree.
    moving, other : Solid
        The two solids.
    ends : two (N,) arrays
        Extreme positions of the joints of the tree.
    clearance : float
        Distance to keep, m.

    Returns
    -------
    SolidPair
        The pair, with the bound of how fast its distance can change.
    """
    travel = np.zeros(robot.n)
    chains = {solid.joint: robot.list_ancestors(solid.joint) for solid in (moving, other)}
    # Joints that carry both solids move them together: only those between the two change their distance.
    for solid, opposite in ((moving, other), (other, moving)):
        # The lever arm of a joint is at most the length of the chain from it to the farthest point.
        length = solid.reach
        for j in reversed([joint for joint in chains[solid.joint] if joint not in chains[opposite.joint]]):
            joint = robot.joints[j]
            travel[j] = 1.0 if joint.kind == "prismatic" else length
            length += float(np.linalg.norm(joint.placement[:3, 3]))
            if joint.kind == "prismatic":
                length += max(abs(float(end[j])) for end in ends)
    return SolidPair(moving, other, travel, clearance)


@dataclass(frozen=True)
class Approach:
    """The nearest approach of a body to anything along a motion.

    Parameters
    ----------
    name : str
        Names of the two solids.
    distance : float
        Their distance, m.
    sample : int
        Number of the sample.
    wanted : float
        Clearance to keep, m.
    """

    name: str
    distance: float
    sample: int
    wanted: float

    @property
    def slack(self) -> float:
        """Distance beyond the clearance, m."""
        return self.distance - self.wanted


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest solid to a body at each of m postures.

    Nearest is the one whose distance exceeds its clearance least.

    Parameters
    ----------
    body : Solid
        The body.
    others : tuple of Solid
        Solids that it is kept from.
    to : (m,)
        Index of the nearest of `others`.
    distance, wanted : (m,)
        Distance and clearance, m.
    here, there : (m, 3)
        Nearest points of the body and of the other solid, each in the frame of its joint.
    """

    body: Solid
    others: tuple[Solid, ...]
    to: IndexArray
    distance: FloatArray
    wanted: FloatArray
    here: FloatArray
    there: FloatArray


class ContactCheck:
    """Distances of pairs of solids along motions.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    pairs : sequence of SolidPair
        Pairs whose distance is computed.
    """

    def __init__(self, robot: Robot, pairs: Sequence[SolidPair]) -> None:
        self._robot, self.pairs = robot, tuple(pairs)
        self.bodies = tuple(sorted({pair.moving.joint for pair in pairs}))
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def compute_distances(self, pair: SolidPair, q: FloatArray) -> FloatArray:
        """Return the distance (m,) of a pair at postures q (m, n); negative where they overlap.

        Parameters
        ----------
        pair : SolidPair
            The pair.
        q : (m, n)
            Postures, rad or m.
        """
        return self._compute_distances(pair, _PlacedPostures(joint_frames(self._robot, q)))

    def find_too_near(self, q: FloatArray) -> BoolArray:
        """Return at which of the postures q (m, n) any pair is nearer than its clearance: (m,)."""
        frames, near = joint_frames(self._robot, q), np.zeros(len(q), dtype=np.bool_)
        for pair in self.pairs:
            # Capsules give a lower bound for all postures at once; only where it is too small the exact distance is
            # needed.
            doubtful = np.flatnonzero(~near & (_bound_distance(pair, frames) < pair.clearance))
            if len(doubtful):
                near[doubtful] = self._compute_distances(pair, _PlacedPostures(frames[doubtful])) < pair.clearance
        return near

    def find_closest_points(self, pair: SolidPair, frames: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distance (m,) of a pair, and the points (m, 2, 3) of both between which it lies, by frames."""
        return self._find_closest_points(pair, _PlacedPostures(frames))

    def list_moving_joints(self, name: str) -> tuple[int, ...]:
        """Return the joints that change the distance of a pair of bodies, by the name of the pair; else all of them."""
        joints: set[int] = set()
        # Of closed loops all joints move everything.
        for pair in () if self._robot.linkage is not None else self.pairs:
            if pair.name == name:
                chains = [
                    set() if solid.joint == BASE else set(self._robot.list_ancestors(solid.joint))
                    for solid in (pair.moving, pair.other)
                ]
                joints |= chains[0] ^ chains[1]
        return tuple(sorted(joints)) or tuple(range(self._robot.n))

    def find_nearest(self, q: FloatArray) -> list[Nearest]:
        """Return for every body (in the order of `bodies`) the nearest solid at each of the postures q (m, n)."""
        postures = _PlacedPostures(joint_frames(self._robot, q))
        return [
            self._find_nearest([pair for pair in self.pairs if pair.moving.joint == body], postures)
            for body in self.bodies
        ]

    def find_approaches(self, q: FloatArray) -> list[Approach]:
        """Return for every body (in the order of `bodies`) its nearest approach along q (m, n)."""
        moved = q if self._robot.linkage is None else self._robot.linkage.compute_positions(q)
        # The path length of every joint up to each sample: differences of it bound what happens in between.
        way = np.concatenate([np.zeros((1, moved.shape[1])), np.cumsum(np.abs(np.diff(moved, axis=0)), axis=0)])
        looks = np.unique(np.linspace(0, len(q) - 1, min(_FIRST_LOOKS, len(q))).astype(np.intp))
        first = _PlacedPostures(joint_frames(self._robot, q[looks]))
        searches = {
            pair: _DistanceBounds(way @ pair.travel, looks, self._compute_distances(pair, first) - pair.clearance)
            for pair in self.pairs
        }
        return [
            self._find_approach({pair: search for pair, search in searches.items() if pair.moving.joint == body}, q)
            for body in self.bodies
        ]

    def _find_approach(self, of_pairs: dict[SolidPair, _DistanceBounds], q: FloatArray) -> Approach:
        pairs, searches = list(of_pairs), list(of_pairs.values())
        while True:
            # All pairs of a body share the best distance so far: most of them are soon out of the question.
            nearest = min(range(len(pairs)), key=lambda k: searches[k].least)
            best = searches[nearest].least
            # Search on wherever the distance could be smaller than the best so far by more than the precision asked
            # for.
            goal = best - _EXACTNESS - _RELATIVE_EXACTNESS * max(best, 0.0)
            doubtful_samples = [search.find_doubtful(goal) for search in searches]
            if not any(len(samples) for samples in doubtful_samples):
                clearance = pairs[nearest].clearance
                return Approach(pairs[nearest].name, best + clearance, searches[nearest].least_sample, clearance)
            for pair, search, samples in zip(pairs, searches, doubtful_samples, strict=True):
                if len(samples):
                    distances = self._compute_distances(pair, _PlacedPostures(joint_frames(self._robot, q[samples])))
                    search.add_samples(samples, distances - pair.clearance)

    def _find_nearest(self, pairs: Sequence[SolidPair], postures: _PlacedPostures) -> Nearest:
        frames = postures.frames
        distances, ends = np.empty((len(pairs), len(frames))), np.empty((len(pairs), len(frames), 2, 3))
        for place, pair in enumerate(pairs):
            distances[place], points = self._find_closest_points(pair, postures)
            for k, frame in enumerate(frames):
                for end, (solid, point) in enumerate(zip((pair.moving, pair.other), points[k], strict=True)):
                    ends[place, k, end] = _transform_to_frame(solid, frame, point)
        clearances = np.array([pair.clearance for pair in pairs])
        to, rows = (distances - clearances[:, None]).argmin(axis=0), np.arange(len(frames))
        chosen = ends[to, rows]
        others = tuple(pair.other for pair in pairs)
        return Nearest(pairs[0].moving, others, to, distances[to, rows], clearances[to], chosen[:, 0], chosen[:, 1])

    def _find_closest_points(self, pair: SolidPair, postures: _PlacedPostures) -> tuple[FloatArray, FloatArray]:
        # The least of the shapes' distances, with the points that it lies between.
        gaps = (self._iterate_gaps(pair, postures, k) for k in range(len(postures.frames)))
        distances, points = zip(*(min(of_posture, key=lambda gap: gap[0]) for of_posture in gaps), strict=True)
        return np.array(distances), np.array(points)

    def _compute_distances(self, pair: SolidPair, postures: _PlacedPostures) -> FloatArray:
        least = np.full(len(postures.frames), np.inf)
        for a, at_a in zip(pair.moving.shapes, postures.place_solid(pair.moving), strict=True):
            for b, at_b in zip(pair.other.shapes, postures.place_solid(pair.other), strict=True):
                between = [self._compute_distance(a, here, b, there) for here, there in zip(at_a, at_b, strict=True)]
                np.minimum(least, between, out=least)
        return least

    def _iterate_gaps(
        self, pair: SolidPair, postures: _PlacedPostures, k: int
    ) -> Iterator[tuple[float, tuple[Any, Any]]]:
        """Yield the distances of the shapes of a pair at the k-th posture, and their nearest points."""
        for a, at_a in zip(pair.moving.shapes, postures.place_solid(pair.moving), strict=True):
            for b, at_b in zip(pair.other.shapes, postures.place_solid(pair.other), strict=True):
                distance = self._compute_distance(a, at_a[k], b, at_b[k])
                yield distance, (self._result.getNearestPoint1(), self._result.getNearestPoint2())

    def _compute_distance(self, a: Any, at_a: Any, b: Any, at_b: Any) -> float:
        # The result object is used again by every query, so that one check belongs to one thread.
        self._result.clear()
        return float(coal.distance(a, at_a, b, at_b, self._request, self._result))


class _DistanceBounds:
    """Bounds of one pair's distance along a motion; `way` (m,) limits how far it can change between samples."""

    def __init__(self, way: FloatArray, samples: Any, distances: FloatArray) -> None:
        self._way, self._samples, self._distances = way, samples, distances

    @property
    def least(self) -> float:
        return float(self._distances.min())

    @property
    def least_sample(self) -> int:
        return int(self._samples[self._distances.argmin()])

    def find_doubtful(self, goal: float) -> Any:
        """Return the middles of intervals in which the distance could fall below `goal`."""
        first, last = self._samples[:-1], self._samples[1:]
        # The lowest point of two cones of slope one that start at both ends of the interval.
        lowest = 0.5 * (self._distances[:-1] + self._distances[1:] - (self._way[last] - self._way[first]))
        split = (lowest < goal) & (last - first > 1)
        return (first[split] + last[split]) // 2

    def add_samples(self, samples: Any, distances: FloatArray) -> None:
        order = np.argsort(np.concatenate([self._samples, samples]))
        self._samples = np.concatenate([self._samples, samples])[order]
        self._distances = np.concatenate([self._distances, distances])[order]


class _PlacedPostures:
    """Postures by the frames (m, n, 4, 4) of their joints, with the placements of solids computed once."""

    def __init__(self, frames: FloatArray) -> None:
        self.frames = frames
        self._placed: dict[Solid, list[list[Any]]] = {}

    def place_solid(self, solid: Solid) -> list[list[Any]]:
        """Return the transforms of each of a solid's shapes, at every posture."""
        transforms = self._placed.get(solid)
        if transforms is None:
            transforms = [self._transforms(solid.joint, *placement) for placement in solid.placements]
            self._placed[solid] = transforms
        return transforms

    def _transforms(self, joint: int, rotation: FloatArray, origin: FloatArray) -> list[Any]:
        if joint < 0:
            return [coal.Transform3s(rotation, origin)] * len(self.frames)
        turned, moved = self.frames[:, joint, :3, :3], self.frames[:, joint, :3, 3]
        return list(map(coal.Transform3s, turned @ rotation, turned @ origin + moved))


def _bound_distance(pair: SolidPair, frames: FloatArray) -> FloatArray:
    """Return a lower bound (m,) of a pair's distance at the frames (m, n, 4, 4): that of enclosing capsules."""
    # No bound is known for a half-space, so that the exact distance is always computed.
    if not pair.other.capsules or not pair.moving.capsules:
        return np.full(len(frames), -np.inf)
    a, b = (_place_segments(solid, frames) for solid in (pair.moving, pair.other))
    radii = [np.array([capsule.radius for capsule in solid.capsules]) for solid in (pair.moving, pair.other)]
    distances = compute_segment_distances(a[0][..., None], a[1][..., None], b[0][:, :, None], b[1][:, :, None])
    return np.asarray((distances - radii[0][:, None] - radii[1]).min(axis=(1, 2)))


def _place_segments(solid: Solid, frames: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return starts and ends (3, m, c) of the axes of a solid's capsules, at the frames (m, n, 4, 4)."""
    starts, ends = (
        np.array([capsule.start for capsule in solid.capsules]),
        np.array([capsule.end for capsule in solid.capsules]),
    )
    if solid.joint < 0:
        still = (3, len(frames), len(starts))
        return np.broadcast_to(starts.T[:, None], still), np.broadcast_to(ends.T[:, None], still)
    frame = frames[:, solid.joint, :3].transpose(1, 0, 2)
    return frame[:, :, :3] @ starts.T + frame[:, :, 3:], frame[:, :, :3] @ ends.T + frame[:, :, 3:]


def _transform_to_frame(solid: Solid, frame: FloatArray, point: FloatArray) -> FloatArray:
    """Return a point of the base frame in that of a solid's joint."""
    if solid.joint < 0:
        return point
    turned, moved = frame[solid.joint, :3, :3], frame[solid.joint, :3, 3]
    inside: FloatArray = (point - moved) @ turned
    return inside


def _build_geometry(shape: Shape) -> tuple[Any, FloatArray, FloatArray]:
    if isinstance(shape, Capsule):
        way = shape.end - shape.start
        length = float(np.linalg.norm(way))
        return coal.Capsule(shape.radius, length), _align_z_axis(way, length), 0.5 * (shape.start + shape.end)
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length), shape.placement[:3, :3], shape.placement[:3, 3]
    if isinstance(shape, Block):
        return coal.Box(*shape.size), shape.placement[:3, :3], shape.placement[:3, 3]
    # All other shapes are clouds of points, of which the convex hull is kept clear.
    points = coal.StdVec_Vec3s()
    for corner in shape.corners:
        points.append(corner)
    return coal.Convex.convexHull(points, True, "Qt"), np.eye(3), np.zeros(3)


def _align_z_axis(direction: FloatArray, length: float) -> FloatArray:
    """Return a rotation (3, 3) whose z axis has this direction."""
    if length == 0.0:
        return np.eye(3)
    z = direction / length
    # The coordinate axis least parallel to the direction gives the best conditioned cross product.
    helper = np.eye(3)[int(np.abs(z).argmin())]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def list_nonadjacent(robot: Robot, bodies: Sequence[Body]) -> list[tuple[Body, Body]]:
    """Return pairs of bodies that are not neighbours, the one nearer to the base first."""
    shaped = {body.joint for body in bodies}

    def find_predecessor(joint: int) -> int:
        parent = robot.joints[joint].parent
        # Bodies without a shape are skipped: what they join are neighbours all the same.
        return parent if parent in shaped or parent == BASE else find_predecessor(parent)

    return [(a, b) for index, b in enumerate(bodies) for a in bodies[:index] if find_predecessor(b.joint) != a.joint]


def word_contact(name: str, distance: float, clearance: float) -> str:
    """Say that two things come too near each other.

    Parameters
    ----------
    name : str
        Names of both.
    distance : float
        Their smallest distance, m; not above 0 where they touch.
    clearance : float
        Distance that has to be kept, m.
    """
    near = f"would come within {distance:.4g} m of each other" if distance > 0 else "would touch each other"
    return f"'{name}' {near}; the clearance must be at least {clearance:g} m."
