"""Decide whether gravity is in the torque, was compensated, or points elsewhere (mounting), by the dynamics.

Holds how much load, motion and fit that takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.description_fit import measure_left_by_description
from dynident.identification.recording_faults.rows_for_fault_search import thin_out
from dynident.identification.recording_faults.torque_scale import KNOWN, find_revolute_joints
from dynident.identification.recording_faults.tree_fit import BLOCKS
from dynident.identification.recording_faults.unexplained_torque import (
    CLEARLY,
    HeldOutFit,
    UnexplainedTorque,
    measure_unexplained_share,
)
from dynident.robot.pinocchio_conversion import compute_described_torque
from dynident.robot.robot_model import Robot

_STATIC_ROWS = 800
"""Rows that are used: a load of gravity has a few parameters a joint."""

_HEAVY_TORQUE = 0.3
"""Share of the largest torque above which a joint takes part: what gravity leaves of the others' is noise."""

_UNEXPLAINED_BY_GRAVITY = 0.2
"""Share of a joint's torque that the load of gravity may leave, in blocks of time that were not fitted to."""

_NO_FRICTION = 0.01
"""Share of a joint's torque that friction and inertia together may have: of measured torques friction alone has 0.02
and more, even of direct drives, since joints move on bearings and seals."""

_BY_CHANCE, _OF_LIGHT = 0.15, 0.5
"""Share of the load's residual that three columns explain of correlated noise by chance, and that friction has to have
of a joint that carries little."""

_MOVES = 0.01
"""rad or m that the fastest joint must move in the mean, or nothing tells friction."""


@dataclass(frozen=True)
class StaticTorque:
    """Shares of a torque that the load of gravity leaves, and that friction and inertia have.

    Parameters
    ----------
    unexplained : float
        Share that the load of gravity leaves; the largest of any joint.
    moving_share : float
        Share of friction and inertia; the largest of any joint.
    joints : tuple of int
        Numbers of the joints that were tested.
    """

    unexplained: float
    moving_share: float
    joints: tuple[int, ...]


def find_static_torque(robot: Robot, motion: Motion, judge: HeldOutFit) -> StaticTorque | None:
    """Decide whether gravity alone explains a torque, and motion has no part in it.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows. Joints without torque are not tested.
    judge : HeldOutFit
        That of the robot.

    Returns
    -------
    StaticTorque or None
        None where motion has a part in it, or the data do not tell.
    """
    if not np.linalg.norm(robot.gravity) > 1.0 or float(np.std(motion.q, axis=0).max(initial=0.0)) < _MOVES:
        return None
    few = thin_out(motion, _STATIC_ROWS)
    q, dq, ddq, tau, block = few.q, few.dq, few.ddq, few.tau, few.block
    spread = tau.std(axis=0)
    # Joints that carry little are left out, unless they show friction: their torque is friction and noise.
    heavy: BoolArray = (spread > _HEAVY_TORQUE * spread.max(initial=0.0)) & (dq.std(axis=0) > 0)
    loads = judge.compute_load_columns(q)
    # What links of the description's masses add to their load in this motion, where it has masses.
    load = _compute_load(robot, q) if _has_masses(robot) else None
    added = None if load is None else compute_described_torque(robot, q, dq, ddq) - load
    shares, shows_inertia = list[tuple[float, float]](), added is None
    for joint in np.flatnonzero((spread > 0) & (dq.std(axis=0) > 0)):
        # Friction and the inertia of the drive: what motion adds to any measured torque. A command that is late has a
        # smooth part of motion, too, which is all there is of it where a joint carries little.
        dry, smooth = np.sign(dq[:, [joint]]), np.column_stack([dq[:, joint], ddq[:, joint]])
        load_columns, own = ([loads[joint]], [dry, smooth]) if heavy[joint] else ([loads[joint], smooth], [dry])
        share_left, moving = _measure_static_shares(np.hstack(load_columns), np.hstack(own), tau[:, joint], block)
        bound = max(_NO_FRICTION, (_BY_CHANCE if heavy[joint] else _OF_LIGHT) * share_left)
        if moving > bound or (heavy[joint] and share_left > _UNEXPLAINED_BY_GRAVITY):
            return None
        shares += [(share_left, moving)] if heavy[joint] else []
        if heavy[joint] and load is not None and added is not None:
            size, moved = (float(np.linalg.norm(torque[:, joint])) for torque in (load, added))
            shows_inertia = shows_inertia or _BELIEVED * moved > bound * size
    # A sensor behind the gears measures no friction. In a slow motion it measures gravity alone, as a command would.
    if not shares or not shows_inertia:
        return None
    share_left, moving = np.max(shares, axis=0).tolist()
    return StaticTorque(share_left, moving, tuple(np.flatnonzero(heavy).tolist()))


def _measure_static_shares(loads: FloatArray, own: FloatArray, tau: FloatArray, block: IntArray) -> tuple[float, float]:
    """Return the shares of a joint's torque that the load leaves, held out, and of friction and inertia."""
    rows = np.column_stack([loads, np.ones(len(tau)), own])
    rows = rows / np.maximum(np.sqrt((rows**2).mean(axis=0)), np.finfo(float).tiny)
    n = rows.shape[1] - own.shape[1]
    squares = 0.0
    for number in range(BLOCKS):
        # Held out by blocks: the columns of the load could explain a short piece of any torque that they are fitted
        # to.
        inside = block != number
        solved = np.linalg.lstsq(rows[inside, :n], tau[inside], rcond=1e-6)[0]
        squares += float(((tau[~inside] - rows[~inside, :n] @ solved) ** 2).sum())
    size = float((tau**2).sum())
    # Only what friction and inertia explain beyond the load counts as theirs: in a small motion they may look like a
    # load.
    by_load, by_all = (tau - part @ np.linalg.lstsq(part, tau, rcond=1e-6)[0] for part in (rows[:, :n], rows))
    moving = max(float((by_load**2).sum() - (by_all**2).sum()), 0.0)
    return float(np.sqrt(squares / size)), float(np.sqrt(moving / size))


_STATES = 400
"""Rows that the description's load is computed at: it has a few parameters a joint."""
_HEAVY = 0.3
"""Share of the largest load of gravity above which a joint takes part in the decision."""
_ABSENT, _BELIEVED, _MOST = 0.25, 0.5, 6.0
"""Gravity's share over inertia's below which it is absent, and the shares of inertia that are to be believed: of the
torques of open recordings gravity's is at least 0.4 times inertia's; where it was taken out at most 0.15, and where all
that the robot needs was, inertia's is at most 0.4 (`benchmarks/effort_kinds.py`)."""
_APART, _EXPLAINED = 1.7, 0.3
"""Times what the robot's dynamics leave with gravity that they leave without it: at least that in right torques; and
what they may leave."""
_POOR = 0.15
"""Left of the torque of the joint that is explained worst, from which on another direction of gravity is looked for."""
_ON_AXIS, _BESIDE = 0.9976, 0.9
"""Cosine of 4 degrees to an axis or a slope of 45 degrees between two, within which gravity is taken for along it, and
of directions that are other ones: 26 degrees away."""
_NOTHING = 1e-4
"""Share of a joint's load, with a gravity of 1 m/s², below which its torque is none."""
_NEAR_USUAL = 0.97
"""Cosine of 14 degrees up to which masses that are not quite right are taken to mean a direction that is usual."""
_SIMPLEX, _FINE, _MOST_TRIED = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]]), 0.01, 40
"""Tangents of the first angles from the best of the usual directions (11 degrees), of those that are told apart at
last, and of how many."""
_USUAL = tuple(
    np.array(axis) / np.linalg.norm(axis)
    for axis in product((-1.0, 0.0, 1.0), repeat=3)
    if 0 < np.count_nonzero(axis) < 3
)
"""Directions of bases on floors, walls and ceilings, and slopes of 45 degrees."""
_CLEARLY = 1.25
"""Times what another direction of gravity leaves that no gravity has to."""
_BORNE_OUT = 0.3
"""Mean logarithm by which the description leaves less with its gravity than without, from which on gravity is there: in
right short motions 0.6 and more, where it was taken out of them at most 0.1."""
_ZEROS = np.deg2rad(range(-150, 181, 30))
"""Angles of a joint that are tried, between which a load changes little."""
_GRAVITY = 9.81


@dataclass(frozen=True)
class LoadShares:
    """Shares of the description's load that are in a torque.

    Parameters
    ----------
    gravity : float
        Share of the load's gravity part.
    motion : float
        Share of the load's motion part.
    motion_error : float
        Standard error of the motion's share, by the jackknife over blocks of time.
    """

    gravity: float
    motion: float
    motion_error: float = 0.0


@dataclass(frozen=True, eq=False)
class Mounting:
    """Gravity in the base frame that explains most of the torque.

    Parameters
    ----------
    gravity : (3,)
        The gravity in m/s².
    unexplained : float
        Unexplained share of the torque of the joint that it explains worst.
    unexplained_as_stated : float
        The same with the stated gravity.
    is_sure : bool
        Whether it leaves clearly less than every other direction along an axis.
    explains : UnexplainedTorque
        Unexplained shares of all joints with this gravity.
    as_stated : UnexplainedTorque
        The same with the stated gravity.
    is_of_masses : bool
        Whether the masses of the description tell it, and not the motion: links with other centres of mass explain
        the torque with either gravity. The unexplained shares are then those that the description leaves.
    """

    gravity: FloatArray
    unexplained: float
    unexplained_as_stated: float
    is_sure: bool
    explains: UnexplainedTorque
    as_stated: UnexplainedTorque
    is_of_masses: bool = False


def measure_load_shares(robot: Robot, motion: Motion, factor: float = 1.0) -> LoadShares | None:
    """Return the shares of the description's load in a torque.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    factor : float
        Makes N m of the torque.

    Returns
    -------
    LoadShares or None
        None without masses or gravity.
    """
    if not _has_masses(robot) or not np.linalg.norm(robot.gravity) > 1.0:
        return None
    few = thin_out(motion, _STATES)
    q, dq, ddq, tau = few.q, few.dq, few.ddq, few.tau * factor
    others = few.block != np.arange(BLOCKS)[:, None]
    load = _compute_load(robot, q)
    # The same description gives both parts, so an error of all masses cancels in their ratio.
    rest = compute_described_torque(robot, q, dq, ddq) - load
    size = np.sqrt((load**2).mean(axis=0))
    # Fit each joint's torque by its gravity load, the rest of the described torque, and friction. The two factors are
    # the shares.
    shares = []
    for joint in np.flatnonzero((size > _HEAVY * size.max()) & (np.ptp(load, axis=0) > 0)):
        speed = dq[:, joint]
        rows = np.column_stack([load[:, joint], rest[:, joint], speed, np.sign(speed)])
        length = np.sqrt((rows**2).sum(axis=0)) + 1e-30
        row_sets = (np.ones(len(rows), dtype=bool), *others)
        factors = [
            np.linalg.lstsq(rows[selected] / length, tau[selected, joint], rcond=1e-10)[0][:2] for selected in row_sets
        ]
        shares.append(np.array(factors) / length[:2])
    if not shares:
        return None
    # The first fit is of all rows; the others each leave one block out, for the jackknife.
    (gravity, inertia), *without = np.median(np.abs(shares), axis=0)
    error = np.sqrt((BLOCKS - 1) * np.var([share[1] for share in without]))
    return LoadShares(float(gravity), float(inertia), float(error))


def detect_compensated_gravity(robot: Robot, motion: Motion, factor: float = 1.0) -> LoadShares | None:
    """Return the shares where gravity was taken out of a torque; None where it was not, or the data do not tell.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    factor : float
        Makes N m of the torque.
    """
    shares = measure_load_shares(robot, motion, factor)
    if shares is None or shares.gravity > _ABSENT * shares.motion or not _BELIEVED < shares.motion < _MOST:
        return None
    if shares.motion < KNOWN * shares.motion_error:
        return None
    # Two independent tests have to agree: the shares of the description, and fits of all parameters with and without
    # gravity.
    floating = replace(robot, gravity=np.zeros(3))
    without, with_it = measure_unexplained_share(floating, motion), measure_unexplained_share(robot, motion)
    if without >= min(_APART * with_it, _EXPLAINED) or _is_borne_out(robot, floating, motion):
        return None
    # On a robot that is mounted otherwise, gravity acts along another direction. Then it is missing from the stated
    # load, but it was not taken out.
    return None if find_mounting(robot, motion).explains.average_share * _CLEARLY < without else shares


def _is_borne_out(robot: Robot, floating: Robot, motion: Motion) -> bool:
    """Tell whether the description explains more with its gravity than without, be it with another zero of a joint.

    A short motion does not determine motion's share, so this is a second test. A load at wrong angles looks like none.
    """
    few = thin_out(motion, _STATES)
    without = measure_left_by_description(floating, few)
    zeros = (angle * axis for axis in np.eye(robot.n)[find_revolute_joints(robot)] for angle in _ZEROS)
    turned = (replace(few, q=few.q - zero) for zero in (np.zeros(robot.n), *zeros))
    with_it = (measure_left_by_description(robot, moved) for moved in turned)
    return without is not None and any(left is not None and left < without - _BORNE_OUT for left in with_it)


def find_other_mounting(robot: Robot, bands: Sequence[tuple[Motion, float]], judge: HeldOutFit) -> Mounting | None:
    """Find another direction of gravity that surely explains more than the stated one; else None.

    It is judged by the joint that is explained worst: gravity of a wall is in the first joint's torque alone, where a
    mean over the joints hides it.

    Parameters
    ----------
    robot : Robot
        The robot.
    bands : sequence of Motion and float
        Rows of the recording by cut-offs, from `filter_for_search`. The first that shows another direction decides:
        narrow ones show that of an elastic arm.
    judge : HeldOutFit
        That of the robot.
    """
    if not np.linalg.norm(robot.gravity) > 1.0:
        return None
    for whole, _ in bands:
        motion = thin_out(whole)
        now = judge.measure_unexplained(motion)
        if now.worst_share >= _POOR:
            mounting = find_mounting(robot, motion)
            # A direction that leaves what made another one be looked for explains nothing, as of a few seconds.
            is_explained = mounting.unexplained < _POOR or _do_masses_agree(robot, motion, mounting.gravity)
            if mounting.is_sure and now.is_surely_above(mounting.explains) and is_explained:
                return mounting
        by_masses = _find_mounting_by_masses(robot, motion, now) if _has_masses(robot) else None
        if by_masses is not None:
            return by_masses
    return None


def _do_masses_agree(robot: Robot, motion: Motion, gravity: FloatArray) -> bool:
    """Tell whether the described masses, which no fit has changed, say the same other direction of gravity."""
    direction, size = _find_gravity_of_masses(robot, motion) if _has_masses(robot) else None, np.linalg.norm(gravity)
    return direction is not None and bool(
        direction @ gravity > _NEAR_USUAL * size and direction @ robot.gravity <= _BESIDE * size
    )


def _find_mounting_by_masses(robot: Robot, motion: Motion, now: UnexplainedTorque) -> Mounting | None:
    """Find another direction of gravity with which the described masses explain clearly more; else None.

    Motion alone does not tell the direction in the plane of an arm whose axes are parallel, nor up from down: other
    masses explain the same torque.
    """
    size = float(np.linalg.norm(robot.gravity))
    direction = _find_gravity_of_masses(robot, motion)
    if direction is None or direction @ robot.gravity > _BESIDE * size:
        return None
    near = max(_USUAL, key=lambda usual: float(usual @ direction))
    turned = replace(robot, gravity=size * (near if near @ direction > _NEAR_USUAL else direction))
    left, left_as_stated = (measure_left_by_description(other, motion) for other in (turned, robot))
    if left is None or left_as_stated is None or left > left_as_stated - _BORNE_OUT:
        return None
    explains = HeldOutFit(turned).measure_unexplained(motion)
    if explains.is_surely_above(now):
        return None
    shares = float(np.exp(left)), float(np.exp(left_as_stated))
    return Mounting(turned.gravity, *shares, True, explains, now, is_of_masses=True)


def _find_gravity_of_masses(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the direction (3,) of gravity that goes best with the described masses; None without a load."""
    few = thin_out(motion, _STATES)
    q, dq, ddq, tau = few.q, few.dq, few.ddq, few.tau
    # The torque is affine in gravity: one load for each of its three components, and what no gravity is needed for.
    loads = np.stack([_compute_load(replace(robot, gravity=axis), q) for axis in np.eye(3)], axis=2)
    rest = compute_described_torque(replace(robot, gravity=np.zeros(3)), q, dq, ddq)
    size = np.sqrt((loads**2).mean(axis=(0, 2)))
    rows, torques = [], []
    for joint in np.flatnonzero(size > _HEAVY * size.max()):
        speed = dq[:, joint]
        others = np.column_stack([np.sign(speed), speed, ddq[:, joint], rest[:, joint]])
        projector = np.linalg.pinv(others)
        load, torque = (part - others @ (projector @ part) for part in (loads[:, joint], tau[:, joint]))
        # Joints of any size have the same say, but for those whose motor is off or whose torque was not recorded.
        scale = float(np.sqrt((torque**2).mean()))
        if not scale > _NOTHING * size[joint]:
            continue
        rows.append(load / scale)
        torques.append(torque / scale)
    if not rows:
        return None
    gravity = np.linalg.lstsq(np.concatenate(rows), np.concatenate(torques), rcond=1e-3)[0]
    length = float(np.linalg.norm(gravity))
    return np.asarray(gravity / length) if length > 0.0 else None


def find_mounting(robot: Robot, motion: Motion) -> Mounting:
    """Find the direction in the base frame along which gravity pulls: of a robot on a floor, a wall, a slope.

    It is looked for along the axes and half way between them, and near the best of these where most is explained. Up
    and down often explain a torque alike; the masses of the description decide then, if it has any.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.

    Returns
    -------
    Mounting
        The direction, and what is unexplained with it.
    """
    # Only the direction is looked for: its size is the stated one, or that of the earth.
    size = float(np.linalg.norm(robot.gravity)) or _GRAVITY
    leanings = _GravityDirections(robot, motion, size)
    candidates = [(direction, leanings.measure_unexplained(direction)) for direction in _USUAL]
    best, explains = min(candidates, key=lambda pair: pair[1].score)
    # The usual directions are 45 degrees apart, so a slope in between is found by a local search from the best of
    # them.
    slope = leanings.find_lowest_near(best)
    if slope @ best < _ON_AXIS:
        best, explains = slope, leanings.measure_unexplained(slope)
    opposite = leanings.measure_unexplained(-best)
    # With the sign of gravity turned round, masses of the opposite sign explain the same torque.
    alike = not opposite.is_surely_above(explains)
    if alike and _has_masses(robot):
        # Masses are positive: with the wrong sign of gravity their load has the sign opposite to the torque.
        upright = [_is_upright(replace(robot, gravity=direction * size), motion) for direction in (best, -best)]
        if upright[0] != upright[1]:
            alike = False
            if upright[1]:
                best, explains = -best, opposite
    others = [other for direction, other in candidates if abs(direction @ best) < _BESIDE]
    is_distinct = all(other.compute_summed_fall_to(explains) >= CLEARLY for other in others)
    as_stated = leanings.measure_unexplained(robot.gravity / size)
    return Mounting(
        best * size, explains.worst_share, as_stated.worst_share, not alike and is_distinct, explains, as_stated
    )


class _GravityDirections:
    """Unexplained shares of a motion's torque with gravity along different directions, in which W is linear."""

    def __init__(self, robot: Robot, motion: Motion, size: float) -> None:
        # Gravity along no axis, so that no base parameter of it is lost in this robot.
        self._judge = HeldOutFit(replace(robot, gravity=size * _normalise(np.array([3.0, 4.0, 5.0]))))
        self._motion, self._size = motion, size
        self._parts = [
            HeldOutFit(replace(robot, gravity=gravity), like=self._judge) for gravity in (np.zeros(3), *np.eye(3))
        ]

    def measure_unexplained(self, direction: FloatArray) -> UnexplainedTorque:
        # W is affine in gravity: W(g) = W(0) + Σ g_k (W(e_k) - W(0)).
        return self._judge.measure_unexplained_of_sum(self._motion, self._parts, (direction * self._size).tolist())

    def find_lowest_near(self, start: FloatArray) -> FloatArray:
        """Return the direction (3,) near a first one with the lowest score."""
        # An orthonormal basis of the plane across the first direction: a direction near it has two coordinates there.
        across = np.linalg.svd(start[None, :])[2][1:]

        def score(tangent: FloatArray) -> float:
            return self.measure_unexplained(_normalise(start + tangent @ across)).score

        optimum = scipy.optimize.minimize(score, np.zeros(2), method="Nelder-Mead", options={
            "initial_simplex": _SIMPLEX, "xatol": _FINE, "fatol": _FINE, "maxfev": _MOST_TRIED})  # fmt: skip
        # Rounded to what the search tells, so that a message has no false digits.
        return _normalise(np.round(_normalise(start + optimum.x @ across), 2))


def _normalise(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _has_masses(robot: Robot) -> bool:
    return robot.inertias is not None and bool(np.any(robot.inertias[:, 9] > 0))


def _is_upright(robot: Robot, motion: Motion) -> bool:
    """Tell whether the loads of the description have the sign of the torques."""
    few = thin_out(motion, _STATES)
    load = _compute_load(robot, few.q)
    size = (load**2).sum(axis=0)
    heavy = size > _HEAVY**2 * size.max()
    return bool(((load * few.tau).sum(axis=0)[heavy] > 0).all())


def _compute_load(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the torque (m, n) that holds the description's links against gravity."""
    return compute_described_torque(robot, q, np.zeros_like(q), np.zeros_like(q))
