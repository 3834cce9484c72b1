"""Smooth distances of capsules with gradients, for the optimiser; the exact ones are in `exact_distances`.

Distances between segments, and from points to boxes, are computed many at once. Coordinates are the first axis (3, …):
arrays then stay long where the work is done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.motion.collision.obstacle_geometry import HalfSpace
from dynident.robot.collision_shapes import Block, Capsule
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.robot_model import Robot

# Squared length (m²) of a segment that counts as a point, and length (m) of a vector without direction.
_NO_LENGTH = 1e-18
_TINY = 1e-12
# Squared sine of the angle below which segments count as parallel: the equations for the closest points are then
# singular.
_PARALLEL = 1e-9


def find_closest_shares(
    a: FloatArray, a_end: FloatArray, b: FloatArray, b_end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where on two segments the closest points lie, as shares from 0 (start) to 1 (end).

    After Ericson, Real-time collision detection (2005), §5.1.9, for arrays.

    Parameters
    ----------
    a, a_end : (3, …)
        Ends of the first segments, m.
    b, b_end : (3, …)
        Ends of the second segments, m; the arrays broadcast.

    Returns
    -------
    tuple of two (…)
        Shares along the first and along the second segments.
    """
    along_a, along_b, between = a_end - a, b_end - b, a - b
    aa, bb = dot(along_a, along_a), dot(along_b, along_b)
    ab, ar, br = dot(along_a, along_b), dot(along_a, between), dot(along_b, between)
    # A segment without length is a point: any share along it is right, as long as nothing is divided by zero.
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
    """Return the distances of two sets of segments.

    Parameters
    ----------
    a, a_end : (3, …)
        Ends of the first segments, m.
    b, b_end : (3, …)
        Ends of the second segments, m; the arrays broadcast.

    Returns
    -------
    (…)
        Distances, m.
    """
    s, t = find_closest_shares(a, a_end, b, b_end)
    between = a + s * (a_end - a) - b - t * (b_end - b)
    return np.asarray(np.sqrt(dot(between, between)))


def normalise(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths (…) and directions (3, …) of vectors; no direction where there is no length."""
    length: FloatArray = np.sqrt(dot(vectors, vectors))
    return length, vectors / np.maximum(length, _TINY)


def compute_block_distance(points: FloatArray, block: Block) -> tuple[FloatArray, FloatArray]:
    """Return the signed distances of points from a box, and their gradient.

    Parameters
    ----------
    points : (3, …)
        Points in the base frame, m.
    block : Block
        The box.

    Returns
    -------
    tuple of (…), (3, …)
        Distances, m, negative inside the box, and unit vectors in which they grow fastest.
    """
    rotation, centre = block.placement[:3, :3], block.placement[:3, 3]
    local = np.tensordot(rotation.T, points, 1)
    local -= (rotation.T @ centre).reshape(3, *[1] * (points.ndim - 1))
    # The box is symmetric, so one corner stands for all eight; the signs come back with the gradient.
    beyond = np.abs(local) - 0.5 * block.size.reshape(3, *[1] * (points.ndim - 1))
    length, direction = normalise(np.maximum(beyond, 0.0))
    # Outside of the box the distance is that of the nearest corner, edge or face, whose components beyond the box
    # count.
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


# Balls along a capsule stand this many radii apart where it is kept from a box.
_BALL_SPACING = 0.5
# Postures that are evaluated at a time.
_AT_ONCE = 1000
# Distance (m) beyond the clearance from which on a lower bound of it does.
_FAR = 0.1


@dataclass(frozen=True, eq=False)
class CapsulePart:
    """A capsule that a joint carries.

    Parameters
    ----------
    joint : int
        Index of the joint; -1 for the base.
    capsule : Capsule
        The capsule in the frame of the joint.
    """

    joint: int
    capsule: Capsule


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball that a joint carries, which is kept inside half-spaces or outside a box.

    Parameters
    ----------
    joint : int
        Index of the joint; -1 for the base.
    point : (3,)
        Centre in the frame of the joint, m.
    radius : float
        Radius, m.
    """

    joint: int
    point: FloatArray
    radius: float


@dataclass(frozen=True, eq=False)
class ClearancePairs:
    """Pairs that are kept apart: capsules and capsules, balls and half-spaces, balls and boxes.

    Parameters
    ----------
    pairs : tuple of (CapsulePart, CapsulePart)
        Capsules that are kept apart.
    half_spaces : tuple of (Ball, HalfSpace)
        Balls that are kept within half-spaces.
    blocks : tuple of (Ball, Block)
        Balls that are kept outside boxes.
    clearance : float or (K,)
        Distance to keep, m, one for all or one for each.
    """

    pairs: tuple[tuple[CapsulePart, CapsulePart], ...] = ()
    half_spaces: tuple[tuple[Ball, HalfSpace], ...] = ()
    blocks: tuple[tuple[Ball, Block], ...] = ()
    clearance: float | FloatArray = 0.0

    @property
    def count(self) -> int:
        """Number of distances K."""
        return len(self.pairs) + len(self.half_spaces) + len(self.blocks)

    @property
    def pair_clearance(self) -> FloatArray:
        """Distance to keep (k,) between the capsules of each pair, m."""
        return np.broadcast_to(self.clearance, self.count)[: len(self.pairs)]


def cover_with_balls(part: CapsulePart) -> list[Ball]:
    """Return balls whose union contains a capsule."""
    capsule = part.capsule
    length = float(np.linalg.norm(capsule.end - capsule.start))
    steps = int(np.ceil(length / (_BALL_SPACING * capsule.radius)))
    if steps == 0:
        return [Ball(part.joint, capsule.start, capsule.radius)]
    # The union covers the capsule also halfway between two centres, where the balls' surfaces cross.
    radius = float(np.hypot(capsule.radius, 0.5 * length / steps))
    return [
        Ball(part.joint, capsule.start + share * (capsule.end - capsule.start), radius)
        for share in np.linspace(0.0, 1.0, steps + 1)
    ]


@dataclass(frozen=True, eq=False)
class ClearanceSlack:
    """Distance beyond the clearance (m) at m postures, `values` (m, K), and its derivative."""

    values: FloatArray
    _forces: FloatArray
    _places: FloatArray
    _frames: FloatArray
    _map: PointMap
    _robot: Robot
    _rates: FloatArray | None

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂values (m, K): forces at the nearest points, as torques of the joints."""
        torques = self._pull_back_to_tree(gradient)
        return torques if self._rates is None else np.asarray(np.einsum("mi,mij->mj", torques, self._rates))

    def _pull_back_to_tree(self, gradient: FloatArray) -> FloatArray:
        """Return the torques (m, N) of all joints that carry links."""
        # Most pairs are far from each other, and act on nothing.
        sizes = self._map.gather_gradient(gradient)
        acting = np.flatnonzero(sizes.any(axis=0))
        forces = sizes[:, acting] * self._forces[:, :, acting]
        force = self._map.sum_over_joints(forces, acting)
        moment = self._map.sum_over_joints(cross(self._places[:, :, acting], forces), acting)
        torques = np.empty((len(gradient), self._robot.n))
        # By the principle of virtual work: forces and moments about the base's origin add up from the tips to the base,
        # as in the backward recursion of Newton-Euler.
        for j in range(self._robot.n - 1, -1, -1):
            joint, frame = self._robot.joints[j], self._frames[:, j]
            axis = (frame[:, :3, :3] @ joint.axis).T
            if joint.kind == "prismatic":
                torques[:, j] = dot(axis, force[:, :, j])
            else:
                torques[:, j] = dot(axis, moment[:, :, j] - cross(frame[:, :3, 3].T, force[:, :, j]))
            if joint.parent >= 0:
                force[:, :, joint.parent] += force[:, :, j]
                moment[:, :, joint.parent] += moment[:, :, j]
        return torques


class PointMap:
    """Assignment of forces to slacks and to the joints that they move; -1 is the base."""

    def __init__(self, slacks: Sequence[int], joints: Sequence[int], n: int) -> None:
        self._slacks = np.array(slacks, dtype=np.intp)
        self._incidence = np.zeros((len(slacks), n))
        for k, joint in enumerate(joints):
            if joint >= 0:
                self._incidence[k, joint] = 1.0

    def gather_gradient(self, gradient: FloatArray) -> FloatArray:
        """Return for each force the derivative (m, F) over its slack, of those over all slacks (m, K)."""
        return gradient[:, self._slacks]

    def sum_over_joints(self, vectors: FloatArray, acting: IndexArray) -> FloatArray:
        """Return sums (3, m, n) of vectors (3, m, f) by the joints that they act on; f of all F forces are `acting`."""
        summed: FloatArray = vectors @ self._incidence[acting]
        return summed


class ClearanceConstraints:
    """Distances between the parts of a robot and their hindrances, as functions of the posture.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    hindrances : ClearancePairs
        The pairs that are kept apart.
    """

    def __init__(self, robot: Robot, hindrances: ClearancePairs) -> None:
        self.robot, self.hindrances = robot, hindrances
        pairs = hindrances.pairs
        parts = list(dict.fromkeys(part for pair in pairs for part in pair))
        ends = [(part.joint, point) for part in parts for point in (part.capsule.start, part.capsule.end)]
        balls = [ball for ball, _ in (*hindrances.half_spaces, *hindrances.blocks)]
        self._points = _CarriedPoints([*ends, *((ball.joint, ball.point) for ball in balls)], robot.tree.n)
        # Every capsule stands once among the points, with its two ends, however many pairs it is in.
        number = {part: k for k, part in enumerate(parts)}
        self._n_parts = len(parts)
        self._pairs = np.array([[number[part] for part in pair] for pair in pairs], dtype=np.intp).reshape(-1, 2)
        self._pair_radii = np.array([a.capsule.radius + b.capsule.radius for a, b in pairs])
        half_lengths = [0.5 * float(np.linalg.norm(part.capsule.end - part.capsule.start)) for part in parts]
        self._half_lengths = np.array(half_lengths)[self._pairs].sum(axis=1)
        self._ball_radii = np.array([ball.radius for ball in balls])
        self._normals = np.array([half.normal for _, half in hindrances.half_spaces]).reshape(-1, 1, 3).T
        self._offsets = np.array([half.offset for _, half in hindrances.half_spaces])
        # A pair of capsules is moved by forces at both of its closest points, a ball by one at its centre.
        slacks = [*range(len(pairs)), *range(len(pairs)), *(len(pairs) + k for k in range(len(balls)))]
        joints = [*(a.joint for a, _ in pairs), *(b.joint for _, b in pairs), *(ball.joint for ball in balls)]
        self._map = PointMap(slacks, joints, robot.tree.n)

    @property
    def count(self) -> int:
        """Number of distances K."""
        return self.hindrances.count

    def evaluate(self, q: FloatArray) -> ClearanceSlack:
        """Return the distances beyond the clearance at postures q (m, n)."""
        frames = joint_frames(self.robot, q)
        world = self._points.locate(frames)
        n_planes = len(self._offsets)
        on_a, on_b, distance, separation = self._find_closest_points(world)
        balls = world[:, :, 2 * self._n_parts :]
        from_boxes, away = self._measure_blocks(balls[:, :, n_planes:])
        upward = np.broadcast_to(self._normals, (3, len(q), n_planes))
        return ClearanceSlack(
            self._subtract_sizes(distance, balls, from_boxes),
            # The gradient of a distance over a point is the unit vector along it; the two ends of a pair move it
            # oppositely.
            np.concatenate([separation, -separation, upward, away], axis=2),
            np.concatenate([on_a, on_b, balls], axis=2),
            frames,
            self._map,
            self.robot.tree,
            # With closed loops the tree's joints follow the driven ones; their rates take the torques of the tree to
            # the drives.
            None if self.robot.linkage is None else self.robot.linkage.compute_jacobian(q),
        )

    def find_least(self, q: FloatArray) -> FloatArray:
        """Return the smallest distance beyond the clearance (m,) at postures q (m, n)."""
        least = np.empty(len(q))
        # Batches bound the memory of the arrays (3, m, K).
        for first in range(0, len(q), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            world = self._points.locate(joint_frames(self.robot, q[part]))
            balls = world[:, :, 2 * self._n_parts :]
            from_boxes, _ = self._measure_blocks(balls[:, :, len(self._offsets) :])
            least[part] = self._subtract_sizes(self._find_closest_points(world)[2], balls, from_boxes).min(axis=1)
        return least

    def _find_closest_points(self, world: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the closest points (3, m, pairs) of the centre lines of each pair of capsules.

        Distance (m, pairs) and direction (3, m, pairs) of the first from the second come with them. Where a pair is
        farther than `_FAR`, its points are the middles, and the distance is a lower bound, by balls around the
        capsules: such pairs are most, and act on nothing.
        """
        starts, ends = world[:, :, 0 : 2 * self._n_parts : 2], world[:, :, 1 : 2 * self._n_parts : 2]
        first, second = self._pairs.T
        middles = 0.5 * (starts + ends)
        on_a, on_b = middles[:, :, first], middles[:, :, second]
        distance, direction = normalise(on_a - on_b)
        distance -= self._half_lengths
        postures, pairs = np.nonzero(distance < self._pair_radii + self.hindrances.pair_clearance + _FAR)
        a, a_end, b, b_end = (of[:, postures, part[pairs]] for part in (first, second) for of in (starts, ends))
        s, t = find_closest_shares(a, a_end, b, b_end)
        here, there = a + s * (a_end - a), b + t * (b_end - b)
        on_a[:, postures, pairs], on_b[:, postures, pairs] = here, there
        distance[postures, pairs], direction[:, postures, pairs] = normalise(here - there)
        return on_a, on_b, distance, direction

    def _subtract_sizes(self, distance: FloatArray, balls: FloatArray, from_boxes: FloatArray) -> FloatArray:
        """Return the distances beyond the clearance (m, K) from those of centre lines, planes and boxes' centres."""
        n_planes = len(self._offsets)
        above = dot(balls[:, :, :n_planes], self._normals) - self._offsets
        of_balls = np.concatenate([above, from_boxes], axis=1) - self._ball_radii
        return np.concatenate([distance - self._pair_radii, of_balls], axis=1) - self.hindrances.clearance

    def _measure_blocks(self, balls: FloatArray) -> tuple[FloatArray, FloatArray]:
        distance, away = np.empty(balls.shape[1:]), np.empty(balls.shape)
        for block, chosen in self._grouped_blocks:
            distance[:, chosen], away[:, :, chosen] = compute_block_distance(balls[:, :, chosen], block)
        return distance, away

    @cached_property
    def _grouped_blocks(self) -> list[tuple[Block, IndexArray]]:
        """Every box with the indices of its balls."""
        groups: dict[int, tuple[Block, list[int]]] = {}
        for k, (_, block) in enumerate(self.hindrances.blocks):
            groups.setdefault(id(block), (block, []))[1].append(k)
        return [(block, np.array(places, dtype=np.intp)) for block, places in groups.values()]


class _CarriedPoints:
    """Points in the frames of joints; those of the base stay where they are.

    A point that stands in the list several times, as the ends of a capsule of many pairs do, is moved once.
    """

    def __init__(self, points: Sequence[tuple[int, FloatArray]], n: int) -> None:
        carried = [(joint, tuple(point.tolist())) for joint, point in points]
        # Those of one joint stand side by side.
        distinct = sorted(dict.fromkeys(carried), key=lambda item: item[0])
        number = {item: k for k, item in enumerate(distinct)}
        self._places = np.array([number[item] for item in carried], dtype=np.intp)
        self._local = np.array([point for _, point in distinct]).reshape(-1, 3)
        ends = np.searchsorted([joint for joint, _ in distinct], np.arange(n + 1))
        self._of_joint = [(j, slice(*ends[j : j + 2])) for j in range(n) if ends[j] < ends[j + 1]]

    def locate(self, frames: FloatArray) -> FloatArray:
        """Return the points in the base frame (3, m, P), at frames (m, n, 4, 4)."""
        world = np.empty((3, len(frames), len(self._local)))
        world[:] = self._local.T[:, None]
        for joint, chosen in self._of_joint:
            frame = frames[:, joint, :3].transpose(1, 0, 2)
            np.matmul(frame[:, :, :3], self._local[chosen].T, out=world[:, :, chosen])
            world[:, :, chosen] += frame[:, :, 3:]
        return world[:, :, self._places]
