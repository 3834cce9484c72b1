"""The smallest collision force and load mass at the tool that a residual does not hide.

Holds the false alarms that are allowed (1 an hour) and the fewest data.

A force F at the tool adds Jᵀ F to the torques. It is seen where it lifts a joint's residual above a threshold that the
residual itself crosses seldom. Residuals are correlated in time, so thresholds come from the largest values in
intervals of a second, not from single samples (block maxima; Gumbel 1958, Coles 2001, ch. 3). Of normal residuals, with
a memory of 0.05 to 3 s and 30 s of data, 95 of 100 thresholds keep to the rate; of white ones with Student's
distribution of five degrees of freedom, whose tail is heavier, there are five alarms for one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.comparison.residual_autocorrelation_and_spectra import count_independent_squares
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.recordings.joint_phases import Phase
from dynident.robot import Robot, tool_path

FALSE_ALARMS_AN_HOUR = 1.0
"""What a detector may cost: a cell that stops for nothing more than once an hour is switched off."""

FEWEST_BLOCKS = 15
"""Seconds of held-out motion, at least: from fewer largest values no tail is told."""

SEEN = 0.95
"""Share of postures along the held-out motion and of directions in which the force that is stated shows."""

# Seconds of a block: the largest values of blocks hardly depend on each other, as neighbouring samples do.
_BLOCK = 1.0
_ONE_SIDED_95 = 1.645
_EULER = 0.5772156649
# Scale of Gumbel's distribution over its standard deviation.
_GUMBEL = 6.0**0.5 / np.pi
# Postures along the motion and directions in each that a force is tried in.
_POSTURES, _DIRECTIONS = 60, 60
# Jacobian (m/rad) below which a force moves no joint; its square bounds the lift from below.
_SMALL = 1e-6
# Steps of the numerical derivatives: joints in rad or m, time in s.
_MOVE, _TIME = 1e-6, 1e-3
# Share of the largest singular value below which an arm feels no force in a direction.
_FLAT = 1e-3


@dataclass(frozen=True, eq=False)
class DetectableForce:
    """The force at the tool that is seen in nearly all postures and directions.

    Parameters
    ----------
    force : float
        The force in N.
    thresholds : (n,)
        Threshold on every joint's residual, in N m or N, behind the filters of the identification; infinite for joints
        that move too seldom to have one.
    seconds : float
        Held-out motion in s that the thresholds come from.
    """

    force: float
    thresholds: FloatArray
    seconds: float


def compute_detectable_force(robot: Robot, comparisons: Sequence[Comparison]) -> DetectableForce | None:
    """Compute which force at the tool shows at `FALSE_ALARMS_AN_HOUR`; None where the data are too short or see none.

    Parameters
    ----------
    robot : Robot
        The robot, for the Jacobian of its tool.
    comparisons : sequence of Comparison
        The model on held-out recordings.

    Returns
    -------
    DetectableForce or None
        None where the data are too short for a threshold, or no joint feels a force at the tool.
    """
    blocks = [_BlockMaxima.from_comparison(comparison) for comparison in comparisons]
    seconds = _BLOCK * sum(len(block.maxima) for block in blocks)
    # Every joint may cry out: each has its share of the false alarms.
    share = FALSE_ALARMS_AN_HOUR / 3600.0 * _BLOCK / robot.n
    # Static friction hides what pushes a joint that stands: only seconds in which it moves tell.
    moving = [[block.maxima[block.moves[:, j], j] for block in blocks] for j in range(robot.n)]
    counts = [sum(len(maxima) for maxima in own) for own in moving]
    if max(counts, default=0) < FEWEST_BLOCKS:
        return None
    thresholds = np.array(
        [
            compute_threshold([maxima for maxima in own if len(maxima)], share) if count >= FEWEST_BLOCKS else np.inf
            for own, count in zip(moving, counts, strict=True)
        ]
    )
    q = np.concatenate([comparison.q for comparison in comparisons])
    jacobian = compute_tool_jacobian(robot, q[:: max(1, len(q) // _POSTURES)])
    lift = _compute_lift(jacobian, thresholds)
    if lift is None:
        return None
    return DetectableForce(float(np.quantile(1.0 / np.maximum(lift, _SMALL**2), SEEN)), thresholds, seconds)


def compute_detectable_mass(robot: Robot, comparisons: Sequence[Comparison]) -> float | None:
    """Compute from which mass in kg on a load at the tool shows along the held-out motion.

    The mass that the residual itself looks like counts, and its 95 % interval from blocks of time.

    Parameters
    ----------
    robot : Robot
        The robot, for the torque of a mass at its tool.
    comparisons : sequence of Comparison
        The model on held-out recordings.

    Returns
    -------
    float or None
        The mass in kg; None where no mass at the tool has a torque.
    """
    above, below, blocks = 0.0, 0.0, []
    for comparison in comparisons:
        # Weighted least squares with one unknown, the mass: each joint's residual is regressed on the torque of one
        # kilogram.
        column = _compute_torque_of_one_kilogram(robot, comparison)
        weights = comparison.moving / np.maximum(comparison.noise, 1e-300) ** 2
        product, size = (weights * column * comparison.raw_residual).sum(axis=1), (weights * column**2).sum(axis=1)
        block = _number_blocks(comparison)
        blocks.append(np.array([(product[block == k].sum(), size[block == k].sum()) for k in np.unique(block)]))
        above, below = above + float(product.sum()), below + float(size.sum())
    if not below > 0:
        return None
    mass = above / below
    each = np.concatenate(blocks)
    # A cluster-robust deviation: residuals are correlated within a block, and independent between blocks.
    deviation = float(np.sqrt(((each[:, 0] - mass * each[:, 1]) ** 2).sum())) / below
    return abs(mass) + NORMAL_95 * deviation


def compute_tool_jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Compute the Jacobian of the last joint's origin by central differences.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : (m, n)
        Postures in rad or m.

    Returns
    -------
    (m, 3, n)
        Change of the origin's position (m) by joint (rad or m), in the base frame.
    """
    columns = []
    for joint in range(robot.n):
        step = np.zeros(robot.n)
        step[joint] = _MOVE
        columns.append((tool_path(robot, q + step) - tool_path(robot, q - step)) / (2 * _MOVE))
    return np.stack(columns, axis=2)


def _compute_lift(jacobian: FloatArray, thresholds: FloatArray) -> FloatArray | None:
    """Return (k,): the share of its threshold to which 1 N lifts the most lifted residual, by posture and direction.

    None where no force at the tool moves a joint. Directions that no joint ever feels are left out.
    """
    forces = draw_unit_forces(jacobian)
    if forces is None:
        return None
    # Jᵀ F, the torque of each joint by the force; the joint that is nearest to its threshold sees it.
    torque = np.abs(np.einsum("mdi,mij->mdj", forces, jacobian))
    return np.asarray((torque / np.maximum(thresholds, 1e-300)).max(axis=2).reshape(-1))


def draw_unit_forces(jacobian: FloatArray) -> FloatArray | None:
    """Return directions (m, d, 3) of forces at the tool that some posture feels; None where no joint feels any."""
    left_vectors, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
    largest = float(singular.max(initial=0.0))
    if largest <= _SMALL:
        return None
    # A planar arm feels forces in its plane alone. Directions are drawn in the space that some posture feels at all, or
    # a share of them would never show.
    rank = int((singular.max(axis=0) > _FLAT * largest).sum())
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, rank))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.asarray(np.einsum("mir,dr->mdi", left_vectors[:, :, :rank], directions))


def compute_threshold(maxima: Sequence[FloatArray], share: float) -> float:
    """Return the value that block maxima exceed with this probability at most, with a confidence of 95 %."""
    values = np.concatenate(maxima)
    # Gumbel's distribution by the method of moments: its standard deviation is π / √6 times the scale, its mean lies
    # Euler's constant times the scale above the mode.
    scale = float(values.std(ddof=1)) * _GUMBEL
    place = float(values.mean()) - _EULER * scale
    return float(place + scale * _compute_gumbel_quantile(share, max(count_independent_squares(maxima), 2.0)))


def _compute_gumbel_quantile(share: float, count: float) -> float:
    """Return the upper quantile of the standard Gumbel distribution, plus what `count` values leave open about it."""
    # log1p, since the share is below 3e-4, and one minus it would lose its digits.
    y = -np.log(-np.log1p(-share))
    # Standard error of the quantile by the method of moments (Kite 1977), in standard deviations of the values.
    k = _GUMBEL * (y - _EULER)
    error = np.sqrt((1.0 + 1.14 * k + 1.1 * k**2) / count)
    return float(y + _ONE_SIDED_95 * error / _GUMBEL)


def _number_blocks(comparison: Comparison) -> FloatArray:
    """Return (m,): the number of the block of `_BLOCK` s that a row is in; blocks end with their segment."""
    # The large factor keeps blocks of different segments apart.
    return np.asarray(np.floor((comparison.t - comparison.t[0]) / _BLOCK) + 1e6 * comparison.segment)


@dataclass(frozen=True, eq=False)
class _BlockMaxima:
    """Of every block that is nearly whole the largest residual `maxima` (k, n), and whether a joint `moves` (k, n)."""

    maxima: FloatArray
    moves: BoolArray

    @classmethod
    def from_comparison(cls, comparison: Comparison) -> _BlockMaxima:
        _, first, counts = np.unique(_number_blocks(comparison), return_index=True, return_counts=True)
        # A short block at the end of a segment has a smaller maximum than a whole one, and would lower the threshold.
        whole = counts >= 0.8 * np.median(counts)
        rows = [slice(a, a + k) for a, k in zip(first[whole], counts[whole], strict=True)]
        n = comparison.residual.shape[1]
        maxima = np.array([np.abs(comparison.residual[block_rows]).max(axis=0) for block_rows in rows]).reshape(-1, n)
        moves = np.array([(comparison.phase[block_rows] != Phase.STANDING).any(axis=0) for block_rows in rows]).reshape(
            -1, n
        )
        return cls(maxima, moves)


def _compute_torque_of_one_kilogram(robot: Robot, comparison: Comparison) -> FloatArray:
    """Return (m, n): the torque that a point mass of 1 kg at the tool needs along the motion."""
    ahead, here, behind = (
        tool_path(robot, comparison.q + dt * comparison.dq + 0.5 * dt**2 * comparison.ddq)
        for dt in (_TIME, 0.0, -_TIME)
    )
    # The tool's acceleration is a second difference of its path, with the joints moved along the motion by ± _TIME.
    force = (ahead - 2.0 * here + behind) / _TIME**2 - np.asarray(robot.gravity)
    return np.asarray(np.einsum("mij,mi->mj", compute_tool_jacobian(robot, comparison.q), force))
