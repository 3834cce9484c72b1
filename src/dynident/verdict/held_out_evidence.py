"""Errors on held-out recordings and outcomes of validations, for a verdict; the smallest force and mass that show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, compare
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.estimation.residual_errors import compute_threshold
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase
from dynident.robot import Robot, compute_tool_jacobian, draw_unit_forces, tool_path
from dynident.validation import ValidationOutcome
from dynident.validation.contact_detection import (
    FALSE_ALARMS_AN_HOUR,
    FEWEST_BLOCKS,
    SEEN,
)

LONGEST = 600.0
"""Seconds of a recording that are looked at, at most: what is judged does not change with more."""

FEWEST_ROWS = 10
"""Rows of a phase, below which its error is chance."""

# Seconds of a block: the largest values of blocks hardly depend on each other, as neighbouring samples do.
_BLOCK = 1.0
# Postures along the motion that a force is tried in.
_POSTURES = 60
# Lift (1/N) below which no force is stated.
_SMALL_LIFT = 1e-12
# Step of the numerical second derivative in s.
_TIME = 1e-3


@dataclass(frozen=True)
class Outcome:
    """How a validation of the model ended.

    Parameters
    ----------
    kind : str
        Kind of the validation, as `dynident validate` names it.
    judged : ValidationOutcome
        Its verdict and the reason.
    """

    kind: str
    judged: ValidationOutcome


@dataclass(frozen=True, eq=False)
class PhaseErrors:
    """Errors of the joints in one phase of their motion.

    Parameters
    ----------
    name : str
        The phase in words.
    share : (n,)
        Rms of the residual in the phase over that of the joint's torque on all rows; nan where there are few rows.
    """

    name: str
    share: FloatArray


@dataclass(frozen=True, eq=False)
class HeldOutEvidence:
    """A model, the held-out recordings with their residuals, and the outcomes of validations.

    Parameters
    ----------
    identification : Identification
        The identified model.
    held_out : Errors
        Errors on all held-out rows, which a model from a file has without its recordings.
    recordings : tuple of Recording
        Held-out recordings, at most `LONGEST` s of each.
    comparisons : tuple of Comparison
        The model on those of them that are long enough to be compared.
    outcomes : tuple of Outcome
        How validations of the model ended.
    """

    identification: Identification
    held_out: Errors
    recordings: tuple[Recording, ...]
    comparisons: tuple[Comparison, ...]
    outcomes: tuple[Outcome, ...]

    @classmethod
    def from_identification(
        cls,
        identification: Identification,
        held_out: Errors,
        validation: Sequence[Recording],
        outcomes: Sequence[Outcome],
    ) -> HeldOutEvidence:
        """Compare the model with its held-out recordings; those that are too short for that are left out.

        Parameters
        ----------
        identification : Identification
            The identified model.
        held_out : Errors
            Its errors on all held-out rows.
        validation : sequence of Recording
            Held-out recordings; none where the model comes from a file.
        outcomes : sequence of Outcome
            How validations of the model ended.

        Returns
        -------
        HeldOutEvidence
            What the verdicts on all uses rest on.
        """
        shortened = tuple(_shorten_recording(recording) for recording in validation)
        comparisons = []
        for recording in shortened:
            try:
                comparisons.append(compare(identification, recording))
            except DynidentError:
                continue
        return cls(identification, held_out, shortened, tuple(comparisons), tuple(outcomes))

    @property
    def error(self) -> float:
        """Relative held-out error over all joints where they move, by which models are judged."""
        judged = self.identification.held_out_judged
        return (self.held_out if judged is None else judged).relative_total

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.identification.model.robot.joint_names

    @cached_property
    def joint_errors(self) -> FloatArray:
        """Relative error (n,) of each joint where it moves, on all rows where it never does; 0 where it has no rows."""
        return compute_joint_errors(self.held_out, self.identification.held_out_moving)

    @cached_property
    def never_moving(self) -> list[str]:
        """Joints that stand throughout the held-out data."""
        moving = self.identification.held_out_moving
        if moving is None:
            return []
        return [name for j, name in enumerate(self.joints) if self.held_out.counts[j] > 0 and moving.counts[j] == 0]

    @cached_property
    def phases(self) -> tuple[PhaseErrors, ...]:
        """Errors while joints move, reverse, and start or stop: of the torque itself, without a band at rest."""
        if not self.comparisons:
            return ()
        whole = np.sqrt(
            self._compute_mean_square(
                [np.ones_like(comparison.moving) for comparison in self.comparisons], measured=True
            )
        )
        phase_errors = []
        for name, select_rows in _PHASES:
            rows = [select_rows(comparison) for comparison in self.comparisons]
            counts = sum(mask.sum(axis=0) for mask in rows)
            # Every phase is held against the torque on all rows: at a reversal the torque itself may be near zero, and
            # a share of that would say little about what the controller has to add.
            share = np.sqrt(self._compute_mean_square(rows, measured=False)) / np.where(whole > 0, whole, 1.0)
            phase_errors.append(PhaseErrors(name, np.where(counts >= FEWEST_ROWS, share, np.nan)))
        return tuple(phase_errors)

    def list_failed(self, *kinds: str) -> list[Outcome]:
        """List the validations of these kinds that failed."""
        return [outcome for outcome in self.outcomes if outcome.kind in kinds and outcome.judged.verdict == "fail"]

    def list_passed(self, kind: str) -> list[Outcome]:
        """List the validations of a kind that passed."""
        return [outcome for outcome in self.outcomes if outcome.kind == kind and outcome.judged.verdict == "pass"]

    def _compute_mean_square(self, rows: Sequence[BoolArray], *, measured: bool) -> FloatArray:
        """Return (n,): the mean square over rows (m, n) of all recordings."""
        values = [comparison.measured if measured else comparison.raw_residual for comparison in self.comparisons]
        squares = sum((v**2 * r).sum(axis=0) for v, r in zip(values, rows, strict=True))
        return np.asarray(squares / np.maximum(sum(r.sum(axis=0) for r in rows), 1))


def compute_joint_errors(errors: Errors, moving: Errors | None) -> FloatArray:
    """Return the relative error (n,) of each joint where it moves.

    A joint that never moves has its error on all rows, one without rows has 0.

    Parameters
    ----------
    errors : Errors
        Errors on all rows.
    moving : Errors or None
        Errors on the rows where each joint moves.

    Returns
    -------
    array (n,)
        Relative errors (n,), as fractions.
    """
    relative = np.where(errors.counts > 0, errors.relative, 0.0)
    if moving is None:
        return np.asarray(relative)
    return np.asarray(np.where(moving.counts > 0, moving.relative, relative))


def _select_starts(comparison: Comparison) -> BoolArray:
    # The joint moves, but so near to a halt that the filters mix both: it has just started, or is about to stop.
    return np.asarray((comparison.phase == Phase.STANDING) & comparison.off_halts)


_PHASES = (
    ("while they move", lambda comparison: comparison.moving),
    ("at reversals", lambda comparison: comparison.phase == Phase.REVERSING),
    ("at starts and stops", _select_starts),
)


def _shorten_recording(recording: Recording) -> Recording:
    """Return the first ten minutes of a recording, inside its windows."""
    begin = recording.segments[0].start_time
    if recording.segments[-1].start_time + recording.segments[-1].length * recording.period <= begin + LONGEST:
        return recording
    # Without windows all of the recording counts, so its beginning becomes the only window.
    if not recording.windows:
        return recording.with_windows(((begin, begin + LONGEST),))
    begin = min(start for start, _ in recording.windows)
    windows = [(start, min(end, begin + LONGEST)) for start, end in recording.windows if start < begin + LONGEST]
    return replace(recording, windows=tuple(windows))


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
    # Each joint may raise an alarm, so each has its share of the false alarms.
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
    return DetectableForce(float(np.quantile(1.0 / np.maximum(lift, _SMALL_LIFT), SEEN)), thresholds, seconds)


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
