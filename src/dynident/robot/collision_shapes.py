"""Shapes for collision checks (capsule, cylinder, block, hull), and capsules that enclose them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray

# Corners of the polygon that stands for a circle, and their angles.
_RIM = 24
_AROUND = np.arange(_RIM) * (2 * np.pi / _RIM)
# Steps towards the centre of the smallest ball. The error falls about as fast as one over their number.
_CENTRING = 60


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within a radius of a segment; a sphere where its ends are the same.

    Parameters
    ----------
    start, end : (3,)
        Ends of the segment, m.
    radius : float
        m.
    """

    start: FloatArray
    end: FloatArray
    radius: float

    @property
    def volume(self) -> float:
        """Volume in m³."""
        length = float(np.linalg.norm(self.end - self.start))
        return float(np.pi * self.radius**2 * (length + 4 / 3 * self.radius))

    def contains(self, other: Capsule) -> bool:
        """Return whether `other` lies inside this capsule."""
        # Both are convex, so it is enough that the end balls of the other one lie inside.
        margin = self.radius - other.radius
        return all(
            compute_segment_distance(point, self.start, self.end) <= margin for point in (other.start, other.end)
        )

    def transform(self, placement: FloatArray) -> Capsule:
        """Return the capsule in the frame that `placement` (4, 4) takes its coordinates to."""
        start, end = (placement[:3, :3] @ point + placement[:3, 3] for point in (self.start, self.end))
        return Capsule(start, end, self.radius)


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder about the z axis of a frame, its middle at the origin there.

    Parameters
    ----------
    placement : (4, 4)
        The frame, m.
    radius, length : float
        m.
    """

    placement: FloatArray
    radius: float
    length: float

    @property
    def corners(self) -> FloatArray:
        """Points (m, 3) whose convex hull encloses it."""
        # The polygon goes around the circle, not within it.
        radius = self.radius / np.cos(np.pi / _RIM)
        rim = np.column_stack([radius * np.cos(_AROUND), radius * np.sin(_AROUND), np.zeros(_RIM)])
        half = np.array([0.0, 0.0, 0.5 * self.length])
        return _transform_points(self.placement, np.concatenate([rim - half, rim + half]))


@dataclass(frozen=True, eq=False)
class Block:
    """A box along the axes of a frame, its middle at the origin there.

    Parameters
    ----------
    placement : (4, 4)
        The frame, m.
    size : (3,)
        Lengths of its edges, m.
    """

    placement: FloatArray
    size: FloatArray

    @property
    def corners(self) -> FloatArray:
        """Its corners (8, 3)."""
        signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
        return _transform_points(self.placement, signs * self.size)


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of `corners` (m, 3)."""

    corners: FloatArray


Shape = Capsule | Cylinder | Block | Hull


def enclose_shape(shape: Shape) -> Capsule:
    """Return a small capsule around a shape."""
    return shape if isinstance(shape, Capsule) else enclose_points(shape.corners)


def enclose_points(points: FloatArray) -> Capsule:
    """Return a small capsule that contains points (m, 3): the smallest about a principal axis, or a sphere."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    centre = _find_ball_centre(points - middle) + middle
    ball = Capsule(centre, centre, float(np.linalg.norm(points - centre, axis=1).max()))
    return min(
        [ball, *(_enclose_along(points, direction) for direction in directions)], key=lambda capsule: capsule.volume
    )


def drop_contained(capsules: tuple[Capsule, ...]) -> tuple[Capsule, ...]:
    """Return the capsules without those that lie inside another one."""
    outer: list[Capsule] = []
    for candidate in sorted(capsules, key=lambda item: -item.volume):
        if not any(other.contains(candidate) for other in outer):
            outer.append(candidate)
    return tuple(outer)


def compute_segment_distance(point: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Return the distance of a point from a segment (all (3,))."""
    way = end - start
    length = float(way @ way)
    share = 0.0 if length == 0.0 else float(np.clip((point - start) @ way / length, 0.0, 1.0))
    return float(np.linalg.norm(start + share * way - point))


def _enclose_along(points: FloatArray, direction: FloatArray) -> Capsule:
    """Return the capsule around points (m, 3) whose axis has this direction."""
    along = points @ direction
    across = points - np.outer(along, direction)
    middle = 0.5 * (across.min(axis=0) + across.max(axis=0))
    centre = _find_ball_centre(across - middle) + middle
    centre = centre - (centre @ direction) * direction
    off = np.linalg.norm(across - centre, axis=1)
    radius = float(off.max())
    # A point off the axis may lie beyond an end of the segment as far as the ball around that end reaches there.
    reach = np.sqrt(np.maximum(radius**2 - off**2, 0.0))
    low, high = float((along + reach).min()), float((along - reach).max())
    # Every point lies within the radius of all centres between the two: a ball is enough.
    if low > high:
        low = high = 0.5 * (low + high)
        radius = float(np.linalg.norm(points - centre - low * direction, axis=1).max())
    return Capsule(centre + low * direction, centre + high * direction, radius)


def _find_ball_centre(points: FloatArray) -> FloatArray:
    """Return nearly the centre of the smallest ball around points (m, 3).

    Bădoiu and Clarkson, Smaller core-sets for balls, 2003: go towards the farthest point in ever shorter steps.
    """
    centre: FloatArray = np.zeros(3)
    best, least = centre, np.inf
    for step in range(1, _CENTRING):
        distance = np.linalg.norm(points - centre, axis=1)
        farthest = int(distance.argmax())
        if distance[farthest] < least:
            best, least = centre, float(distance[farthest])
        centre = centre + (points[farthest] - centre) / (step + 1)
    return best


def _transform_points(placement: FloatArray, points: FloatArray) -> FloatArray:
    placed: FloatArray = points @ placement[:3, :3].T + placement[:3, 3]
    return placed
