"""Distances between segments, and from points to boxes, many at once.

Coordinates are the first axis (3, …): arrays then stay long where the work is done.
"""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.robot.shapes import Block

_NO_LENGTH = 1e-18
_TINY = 1e-12
_PARALLEL = 1e-9


def find_closest_shares(
    a: FloatArray, a_end: FloatArray, b: FloatArray, b_end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where on two segments the closest points lie: shares (…) from 0 (start) to 1 (end) of a and of b (3, …).

    After Ericson, Real-time collision detection (2005), §5.1.9, for arrays.
    """
    along_a, along_b, between = a_end - a, b_end - b, a - b
    aa, bb = dot(along_a, along_a), dot(along_b, along_b)
    ab, ar, br = dot(along_a, along_b), dot(along_a, between), dot(along_b, between)
    aa_safe, bb_safe = np.maximum(aa, _NO_LENGTH), np.maximum(bb, _NO_LENGTH)
    slanted = aa * bb - ab * ab
    parallel = slanted <= _PARALLEL * aa * bb
    # Of parallel segments many points are the closest: the middle of a is as good a choice as any.
    s = np.where(parallel, 0.5, _clip_shares((ab * br - ar * bb) / np.where(parallel, 1.0, slanted)))
    t = _clip_shares((ab * s + br) / bb_safe)
    # Clipping t moved the closest point of b, so the one of a has to follow, and then that of b once more.
    s = _clip_shares((ab * t - ar) / aa_safe)
    return s, _clip_shares((ab * s + br) / bb_safe)


def compute_segment_distances(a: FloatArray, a_end: FloatArray, b: FloatArray, b_end: FloatArray) -> FloatArray:
    """Return distances (…) of segments from `a` to `a_end` to those from `b` to `b_end`, all (3, …).

    The arrays broadcast.
    """
    s, t = find_closest_shares(a, a_end, b, b_end)
    between = a + s * (a_end - a) - b - t * (b_end - b)
    return np.asarray(np.sqrt(dot(between, between)))


def normalise(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths (…) and directions (3, …) of vectors; no direction where there is no length."""
    length: FloatArray = np.sqrt(dot(vectors, vectors))
    return length, vectors / np.maximum(length, _TINY)


def compute_block_distance(points: FloatArray, block: Block) -> tuple[FloatArray, FloatArray]:
    """Return the signed distance (…) of points (3, …) from a box, negative inside, and its gradient (3, …)."""
    rotation, centre = block.placement[:3, :3], block.placement[:3, 3]
    local = np.tensordot(rotation.T, points, 1)
    local -= (rotation.T @ centre).reshape(3, *[1] * (points.ndim - 1))
    beyond = np.abs(local) - 0.5 * block.size.reshape(3, *[1] * (points.ndim - 1))
    length, direction = normalise(np.maximum(beyond, 0.0))
    deepest = beyond.max(axis=0)
    inside = deepest <= 0.0
    # Inside, the nearest face is the one that is least deep.
    direction = np.where(inside, beyond == deepest, direction)
    gradient: FloatArray = np.tensordot(rotation, direction * np.where(local < 0.0, -1.0, 1.0), 1)
    return np.where(inside, deepest, length), gradient


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return scalar products (…) of vectors (3, …)."""
    product: FloatArray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return vector products (3, …) of vectors (3, …)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _clip_shares(shares: FloatArray) -> FloatArray:
    clipped: FloatArray = np.minimum(np.maximum(shares, 0.0), 1.0)
    return clipped
